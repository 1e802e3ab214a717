"""Steps that follow the curvature of the flow, which tight links between segments make costly.

A step solves the linearised equations, and the curvature of the flow leaves defects of second order behind it. Where links are
tight these cost more than the step gains, so that full steps are refused beside the optimum (Maratos' effect). The equations
are then solved again with the defects that the curvature left, by the same factor, which costs no sensitivities.

References
----------
J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 18.3, second-order corrections.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.damped_step import DampedEquations, damped_step, full_reduction
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_equations import Linearization
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Scales, Segments

_CORRECTIONS = 6
_ENOUGH = 0.5  # of the predicted reduction, from which a step is not corrected
_EXPLAINED = 1.3  # of the noise, in power: with more left than this the laws are wrong, or the states far off
_SLOW = 0.5  # of the cost before a correction: one that leaves more, and no reduction, is the last


def curved_step(
    segments: Segments,
    linear: GaussNewtonModel,
    damped: DampedEquations,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    length: float,
) -> tuple[Misfit, float, float] | None:
    """A damped step, corrected for the curvature of the flow where it gains much less than was predicted.

    That is done where noise explains the residuals. A search that cannot hold the motion to wrong laws had better not end: the
    model error that it needs is looked for then.

    Parameters
    ----------
    segments, damped, misfit, scales, length
        As of `damped_step`.
    linear : GaussNewtonModel
        The linearised problem; steps of many masses are not corrected.
    loss : Loss
        Loss of a residual.

    Returns
    -------
    tuple of (Misfit, float, float) or None
        The misfit behind the step, the predicted reduction of the cost, and what of it may be left: all after a correction,
        which meets the prediction along a bend where the gradient turns. None where the equations are not positive definite.
    """
    attempt = damped_step(segments, damped, misfit, scales, length)
    if attempt is None:
        return None
    q, predicted = damped.q, attempt[1]
    best = plain = evaluate(segments, attempt[0], scales, loss)
    if not _is_explained(segments, misfit, loss) or not isinstance(linear, Linearization):
        return plain, predicted, 0.0
    for _ in range(_CORRECTIONS):
        before, cost = misfit.cost(q), best.cost(q)
        if before - cost > _ENOUGH * predicted or not np.isfinite(cost):
            break
        bent = _with_curvature(damped, linear, misfit, best, scales, length)
        attempt = damped_step(segments, bent, misfit, scales, length)
        if attempt is None:
            break
        trial = evaluate(segments, attempt[0], scales, loss)
        if not trial.cost(q) < cost:
            break
        best = trial
        if trial.cost(q) > max(_SLOW * cost, before):
            break
    return best, predicted, 0.0 if best is plain else predicted


def is_settled(
    segments: Segments,
    linear: GaussNewtonModel,
    damped: DampedEquations,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    little: float,
) -> bool:
    """Whether a full step would gain as little as the last, damped one: always where the laws leave more than noise.

    Parameters
    ----------
    segments, linear, damped, misfit, scales, loss
        As of `curved_step`.
    little : float
        A reduction of the cost that ends the search.

    Returns
    -------
    bool
        Whether the search may end.
    """
    if not _is_explained(segments, misfit, loss):
        return True
    return full_reduction(segments, linear, misfit, scales, damped) < little


def _is_explained(segments: Segments, misfit: Misfit, loss: Loss) -> bool:
    """Whether the residuals of a misfit are hardly more than noise."""
    return bool(misfit.data < _EXPLAINED * loss.expected * int(segments.observed.sum()))


def _with_curvature(
    damped: DampedEquations,
    linear: Linearization,
    misfit: Misfit,
    moved: Misfit,
    scales: Scales,
    length: float,
) -> DampedEquations:
    """The equations with the defects that the curvature of the flow adds to the linearised ones on the way to `moved`."""
    assert isinstance(damped.factor, BorderedFactor)
    m, p = len(scales.state), len(scales.theta)
    nodes = ((moved.point.nodes - misfit.point.nodes) / scales.state[:, None]).T
    border = (moved.point.border - misfit.point.border) / scales.theta
    by_border = linear.right_ends[..., :p]
    linearised = linear.joined * nodes[1:] - np.einsum("kij,kj->ki", linear.state_ends, nodes[:-1])
    linearised -= by_border @ border
    added = (moved.defects - misfit.defects).reshape(m, -1).T - linearised
    weight = 1.0 / (length * damped.q**2)
    gradient = np.zeros_like(nodes)
    gradient[:-1] = weight * np.einsum("kij,ki->kj", linear.state_ends, added)
    gradient[1:] -= weight * linear.joined * added
    corner = weight * np.tensordot(added, by_border, 2)
    return replace(damped, factor=damped.factor.moved(gradient, corner))
