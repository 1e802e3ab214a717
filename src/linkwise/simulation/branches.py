"""On which branch of a law with kinks a motion goes on: the sign of every kink just after now.

At an event, and wherever a stretch begins, a kink g may be exactly zero and its sign open. A trial step that is blind to kinks
tells: with the branches assumed, g a moment later must have the sign that was assumed. Where neither sign agrees the force
pushes the motion back onto the kink from both sides, as dry friction does to a mass at rest: the structure sticks, and its
equations say no more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from linkwise.simulation.integrator import CompiledSystem, trial_step

_MOMENT = 1e-3  # of a step: far enough that g stands above rounding, near enough that it keeps its sign
_SHORTEST = 1e-12  # of a step
_ON = 1e-6  # of its change within the moment: so near to zero a kink counts as zero


class BranchChoice(NamedTuple):
    """How a motion goes on: up to `moment` it may be integrated blind to kinks. `stuck` is the kink that holds it, or None."""

    moment: float
    stuck: int | None = None


def settle(equations: CompiledSystem, longest: float) -> BranchChoice:
    """Set the branches in the parameters of `equations.blind` to those of the motion that follows from where it stands.

    `longest` in s bounds the trial step. A kink that stays exactly zero (nothing moves) is muted.
    """
    blind, layout = equations.blind, equations.layout
    state, time, parameters = blind.state.copy(), float(blind.time), blind.pars
    branches, muted = parameters[layout.branches], parameters[layout.muted]
    for _ in range(equations.kinks):  # kinks may stand inside kinks, inner ones first
        now = equations.bends(state, parameters, time)
        branches[:] = np.where(now == 0.0, branches, np.sign(now))
    turned = np.zeros(equations.kinks, dtype=int)
    part = _MOMENT
    while True:
        later, moment = trial_step(blind, part, longest)
        then = equations.bends(later, parameters, moment)
        blind.state[:], blind.time = state, time
        now = equations.bends(state, parameters, time)
        on = np.abs(now) <= _ON * np.abs(then - now)
        if np.any(~on & (now * then < 0.0)) and part > _SHORTEST:
            part *= 0.1  # another kink is passed within this moment
            continue
        wrong = on & (then * branches < 0.0)
        if not wrong.any():
            muted[:] = then == 0.0
            return BranchChoice(moment)
        turned += wrong
        if turned.max() > 2:
            return BranchChoice(time, int(np.argmax(turned)))
        branches[wrong] *= -1.0
