"""States inside a piece of a record that settle while its ends and all other unknowns are held.

Motion close to where it parts bends away from the linearised equations within few segments. With damping of its own such a
piece is followed at its own pace, and no other one is held back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.bordered_system import BorderedSystem, Damping
from linkwise.likelihood.shooting.damped_step import SLIGHT
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

_STEPS = 40
_LITTLE = 0.01  # of the cost: what a full step may still gain
_MAX_DAMPING = 1e6


def with_held_parameters(
    segments: Segments, point: Iterate, scales: Scales
) -> tuple[Segments, Iterate, Scales]:
    """A problem whose parameters are known, so that nothing is derived by them.

    Parameters
    ----------
    segments : Segments
        The segments, without shapes of hosts among the unknowns.
    point : Iterate
        The unknowns.
    scales : Scales
        Their units.

    Returns
    -------
    tuple of (Segments, Iterate, Scales)
        The same without parameters.
    """
    p = len(point.theta)
    return (
        replace(segments, system=segments.system.without_parameters(point.theta), prior=None),
        replace(point, theta=np.empty(0)),
        replace(scales, theta=scales.theta[p:]),
    )


def settled_states(
    piece: Segments, point: Iterate, scales: Scales, q: float, loss: Loss, goal: float
) -> tuple[Floats, float]:
    """Lower the cost of a piece by its inner nodes alone.

    Parameters
    ----------
    piece : Segments
        The piece.
    point : Iterate
        Where it starts.
    scales : Scales
        Units of the unknowns.
    q : float
        Relaxation.
    loss : Loss
        Loss of a residual.
    goal : float
        Cost that is low enough.

    Returns
    -------
    nodes : array of shape (m, K)
        The nodes, the first and the last unchanged.
    cost : float
        Cost of the piece with them.
    """
    segments, point, scales = with_held_parameters(piece, point, scales)
    misfit = evaluate(segments, point, scales, loss)
    damping, growth, steps = 0.0, 2.0, 0
    linear: Linearization | None = None
    while steps < _STEPS and goal < misfit.cost(q) < np.inf and damping < _MAX_DAMPING:
        if linear is None:
            linear = linearise(segments, misfit, scales, loss)
            equations = _inner_nodes(linear.equations(q))
        steps += 1
        attempt = _attempt(segments, misfit, scales, loss, equations, _damping(linear, damping))
        if attempt is None:
            damping = max(10.0 * damping, 1e-6)
            continue
        trial, predicted = attempt
        gained = misfit.cost(q) - trial.cost(q)
        if gained > 0.0:
            ratio = gained / predicted
            damping *= max(1 / 3, 1 - (2 * ratio - 1) ** 3) if ratio < 1.5 else 1 / 3  # Nielsen 1999
            damping, growth = damping if damping >= SLIGHT else 0.0, 2.0
            misfit, linear = trial, None
        else:
            damping, growth = max(growth * damping, 0.01), 2.0 * growth
        if predicted < _LITTLE and damping == 0.0:
            break
    return misfit.point.nodes, misfit.cost(q)


def _inner_nodes(equations: BorderedSystem) -> BorderedSystem:
    """The equations of the nodes between the first and the last, which are held as the border is."""
    right = equations.right[1:-1, :, -1:].copy()
    return BorderedSystem(
        equations.diagonal[1:-1], equations.coupling[1:-1], right, np.zeros((0, 0)), np.zeros(0)
    )


def _damping(linear: Linearization, strength: float) -> Damping | None:
    damping = linear.damping(strength)
    return None if damping is None else Damping(damping.nodes[1:-1], np.zeros(0))


def _attempt(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    equations: BorderedSystem,
    damping: Damping | None,
) -> tuple[Misfit, float] | None:
    """The misfit behind a step and the reduction of the cost that it predicts; None where there is no step."""
    factor = equations.factor(damping)
    solved = None if factor is None else factor.solve(np.zeros(0, dtype=bool))
    if solved is None:
        return None
    nodes = misfit.point.nodes.copy()
    nodes[:, 1:-1] += (solved[0] * scales.state).T
    trial = evaluate(segments, replace(misfit.point, nodes=nodes), scales, loss)
    return trial, equations.drop(*solved)
