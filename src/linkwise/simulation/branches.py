"""The branch of a law with kinks on which a motion continues: the sign of every kink just after the current time.

At an event, and at the start of an interval, a kink g may be exactly zero and its sign open. A trial step that does not detect
kinks decides: with the branches assumed, g a moment later must have the sign that was assumed. If neither sign agrees, the
force pushes the motion back onto the kink from both sides, as dry friction does to a mass at rest: the link sticks, and the
equations of motion have no solution.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkwise.simulation.integrator.compiled import CompiledSystem
from linkwise.simulation.integrator.interface import Placement

_FRACTION = 1e-3  # of a step: far enough for g to exceed rounding, short enough for g to keep its sign
_SHORTEST = 1e-12  # of a step
_INSTANT = 4.0  # of the spacing of numbers: a moment that time can tell
_ROUNDING = 1e-12  # of the terms of g: a g that stays that small counts as zero
_ON_KINK = 1e-6  # of the change of g within the moment: if smaller, g counts as zero
_CLEAR = 1e-6  # of the terms of g: a g that is larger has the sign that it shows


class BranchChoice(NamedTuple):
    """How a motion continues: with `parameters` (P,), and up to `time` in s without detection of kinks.

    `stuck` is the number of the kink that the motion cannot leave, or None.
    """

    time: float
    parameters: NDArray[Any]
    stuck: int | None = None


def branches_hold(system: CompiledSystem, start: Placement) -> bool:
    """Whether every kink is watched, far from zero, and of the sign that `start` has, so that the motion just goes on."""
    parameters, layout, time = start.parameters, system.layout, float(start.time)
    if parameters[layout.unwatched].any():
        return False
    values = system.kink_values(start.state, parameters, time) * parameters[layout.branches]
    return bool((values > _CLEAR * system.kink_sizes(start.state, parameters, time)).all())


@np.errstate(over="ignore", invalid="ignore")  # of a kink's value; what is not finite has no branch
def choose_branches(system: CompiledSystem, start: Placement, longest: float) -> BranchChoice:
    """The branches of the motion that follows from `start`; `longest` in s bounds the trial step.

    A kink that stays exactly zero (nothing moves), or as small as rounding, is not watched.
    """
    state, time, parameters = start.state, float(start.time), start.parameters.copy()
    integrator, layout = system.without_events, system.layout
    branches, unwatched = parameters[layout.branches], parameters[layout.unwatched]
    values = system.kink_values(state, parameters, time)
    for _ in range(system.kinks):  # kinks may be nested, inner ones first
        signs = np.where(values == 0.0, branches, np.sign(values))
        if (signs == branches).all():
            break
        branches[:] = signs
        values = system.kink_values(state, parameters, time)
    reversals = np.zeros(system.kinks, dtype=int)
    fraction = _FRACTION
    while True:
        integrator.place(Placement(time, state, parameters))
        later_state, later = integrator.trial_step(fraction, longest)
        then = system.kink_values(later_state, parameters, later)
        on_kink = np.abs(values) <= _ON_KINK * np.abs(then - values)
        passed = ~on_kink & (values * then < 0.0)
        if passed.any() and fraction > _SHORTEST and 0.1 * (later - time) > _INSTANT * np.spacing(time):
            fraction *= 0.1  # another kink is passed within this moment
            continue
        on_kink |= passed  # nearer to it than time can tell
        wrong = on_kink & (then * branches < 0.0)
        if not wrong.any():
            unwatched[:] = then == 0.0
            still = (then == values) & (values != 0.0)
            if still.any():  # a slider that slides: its force stays at the limit, up to rounding
                sizes = system.kink_sizes(state, parameters, time)
                unwatched[still] = (np.abs(values) <= _ROUNDING * sizes)[still]
            return BranchChoice(later, parameters)
        reversals += wrong
        if reversals.max() > 2:
            return BranchChoice(time, parameters, int(np.argmax(reversals)))
        branches[wrong] *= -1.0
        values = system.kink_values(state, parameters, time)
