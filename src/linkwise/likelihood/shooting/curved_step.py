"""Steps that follow the curvature of the flow, which tight links between segments make costly.

A step solves the linearised equations, and the curvature of the flow leaves defects of second order behind it. Where links are
tight these cost more than the step gains, so that full steps are refused beside the optimum (Maratos' effect). The equations
are then solved again with the defects that the curvature left, by the same factor, which costs no sensitivities.

References
----------
J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 18.3, second-order corrections.
D. G. Anderson, J. ACM 12, 547 (1965), for the extrapolation of these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.damped_step import DampedEquations, damped_step, full_reduction
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel
from linkwise.likelihood.shooting.linearised_defects import change_of_defects, pull_of_defects
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Scales, Segments

_ENOUGH = 0.5  # of the predicted reduction, from which a step is not corrected
_LEAST = 0.2  # of it, below which a shorter step is tried
_EXPLAINED = 1.3  # of the noise, in power: with more left than this the laws are wrong, or the states far off


@dataclass(frozen=True)
class _Corrections:
    """How far a step is followed: of many masses a trial costs a tenth of a linearisation, of few masses a third of it.

    Where corrections do not lead along the bend of a step, the next of its `parts` is tried. It is corrected until it gains
    `fully` of the predicted reduction. A correction that leaves more than `slow` of the cost, or, with `excess`, of what
    curvature adds to the predicted one, and no reduction, is the last.
    """

    parts: tuple[float, ...]
    most: int
    fully: float
    slow: float
    excess: bool


_OF_FEW = _Corrections(parts=(1.0,), most=6, fully=_ENOUGH, slow=0.5, excess=False)
_OF_MANY = _Corrections(parts=(1.0, 0.5, 0.25), most=8, fully=0.9, slow=0.3, excess=True)


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
        The linearised problem.
    loss : Loss
        Loss of a residual.

    Returns
    -------
    tuple of (Misfit, float, float) or None
        The misfit behind the step, the predicted reduction of the cost, and what of it may be left: all after a correction,
        which meets the prediction along a bend where the gradient turns. None where the equations are not positive definite.
    """
    q, rules = damped.q, _OF_FEW if len(segments.system.incidence) < MANY else _OF_MANY
    if not is_explained(segments, misfit, loss):
        rules = replace(rules, parts=(1.0,), most=0)
    first: tuple[Misfit, float, float] | None = None
    for part in rules.parts:
        followed = _followed(segments, linear, damped, misfit, scales, loss, part * length, rules)
        first = first or followed
        if followed is None:
            break
        moved, predicted, unclear = followed
        if misfit.cost(q) - moved.cost(q) > _LEAST * predicted:
            return moved, predicted, unclear if part == 1.0 else predicted
    return first


def _followed(
    segments: Segments,
    linear: GaussNewtonModel,
    damped: DampedEquations,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    length: float,
    rules: _Corrections,
) -> tuple[Misfit, float, float] | None:
    """A step that is corrected as long as that pays, as `curved_step` returns it.

    From the second correction on, the defects are extrapolated from those of the last two, as the same one is mostly left.
    """
    attempt = damped_step(segments, damped, misfit, scales, length)
    if attempt is None:
        return None
    q, predicted, before = damped.q, attempt[1], misfit.cost(damped.q)
    best = plain = evaluate(segments, attempt[0], scales, loss)
    counted, behind = np.zeros(1), None
    for _ in range(rules.most):
        cost = best.cost(q)
        if before - cost > (_ENOUGH if best is plain else rules.fully) * predicted or not np.isfinite(cost):
            break
        added = _added_defects(linear, misfit, best, scales)
        last = added, added - counted
        counted = added if behind is None else _extrapolated(last, behind)
        behind = last
        attempt = damped_step(
            segments, _with_defects(damped, linear, counted, length), misfit, scales, length
        )
        if attempt is None:
            break
        trial = evaluate(segments, attempt[0], scales, loss)
        if not trial.cost(q) < cost:
            break
        best, floor = trial, before - predicted if rules.excess else 0.0
        halting = trial.cost(q) > floor + rules.slow * (cost - floor)
        if halting and not before - _ENOUGH * predicted < trial.cost(q) < before:
            break
    return best, predicted, 0.0 if best is plain else predicted


def _extrapolated(last: tuple[Floats, Floats], before: tuple[Floats, Floats]) -> Floats:
    """The added defects from which nothing would differ, from those of two corrections and how they differed from counted."""
    (added, wrong), (earlier, earlier_wrong) = last, before
    turn = earlier_wrong - wrong
    length = float(np.vdot(turn, turn))
    return added - (float(np.vdot(turn, wrong)) / length if length else 0.0) * (earlier - added)


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
    if not is_explained(segments, misfit, loss):
        return True
    return full_reduction(segments, linear, misfit, scales, damped) < little


def is_explained(segments: Segments, misfit: Misfit, loss: Loss) -> bool:
    """Whether the residuals of a misfit are hardly more than noise.

    Parameters
    ----------
    segments, misfit, loss
        As of `curved_step`.

    Returns
    -------
    bool
        Whether they are.
    """
    return bool(misfit.data < _EXPLAINED * loss.expected * int(segments.observed.sum()))


def _added_defects(linear: GaussNewtonModel, misfit: Misfit, moved: Misfit, scales: Scales) -> Floats:
    """(K - 1, m) defects that the curvature of the flow adds to the linearised ones on the way to `moved`."""
    nodes = ((moved.point.nodes - misfit.point.nodes) / scales.state[:, None]).T
    border = (moved.point.border - misfit.point.border) / scales.theta
    added = (moved.defects - misfit.defects).reshape(nodes.shape[1], -1).T
    return np.asarray(added - change_of_defects(linear, nodes, border))


def _with_defects(
    damped: DampedEquations, linear: GaussNewtonModel, added: Floats, length: float
) -> DampedEquations:
    """The equations with defects (K - 1, m) beside the linearised ones at the end of a step of this length."""
    assert damped.factor is not None
    nodes, border = pull_of_defects(linear, added / (length * damped.q**2))
    return replace(damped, factor=damped.factor.moved(nodes, border))
