"""Model error: the most likely error of the flow, beside the noise of the sensors, where the laws are not exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

_RATIO = 3.0  # of neighbouring relaxations on the grid
_COUNT = 19  # relaxations on the grid, from q = 1e-5 to 4e3
# of all fits of a grid; a search that takes more creeps, and its laws are not those of the record
_MOST_STEPS = 400
_WORSE = 0.1  # of the cost: a point less than this above the best is on a plateau; the cost may fall beyond


@dataclass(frozen=True, eq=False)
class ModelErrorCandidate:
    """A fit at relaxation q, its factor on the noise, and -2 log of its marginal likelihood.

    `exact` where the laws need no model error: the search went down to them from one, and they are as likely without.
    """

    fit: AnnealingFit
    q: float
    noise: float
    cost: float
    exact: bool = False


def with_model_error(
    segments: Segments, fit: AnnealingFit, start: Iterate, annealer: Annealer
) -> ModelErrorCandidate | None:
    """The most likely division of the residuals into noise of the sensors and errors of the flow.

    For every relaxation q of a geometric grid the orbit is fitted again and the noise profiled out; the marginal likelihood
    in the Laplace approximation selects q. The search goes up from a converged fit; without one, where the laws are too far
    off, it goes down from the `start`, to exact laws at most. None where no point of the grid is the best, or where it takes
    too many steps.
    """
    if fit.status is AnnealingStatus.CONVERGED:
        grid = [fit.q * _RATIO**power for power in range(_COUNT)]
        return _grid_search(segments, fit.point, fit.scales, grid, annealer)
    exact = AnnealingSchedule.final_q
    above = [q for q in (_RATIO**-power for power in range(_COUNT)) if q > exact]
    best = _grid_search(segments, start, fit.scales, [*above, exact], annealer)
    if best is not None and best.q == 1.0:
        grid = [_RATIO**power for power in range(_COUNT)]
        return _grid_search(segments, best.fit.point, fit.scales, grid, annealer)
    return best


def _grid_search(
    segments: Segments, point: Iterate, scales: Scales, grid: Sequence[float], annealer: Annealer
) -> ModelErrorCandidate | None:
    """The best relaxation, once two worse ones follow it; None where the grid ends before, or a fit does not converge.

    The last point of a grid that goes down stands for exact laws, and is taken where it is as likely. An interrupt from the
    keyboard ends the search where it is.
    """
    best, worse, steps = None, 0, 0
    for q in grid:
        fit = annealer(segments, point, scales, AnnealingSchedule(initial_q=q, final_q=q))
        if fit.status is AnnealingStatus.INTERRUPTED:
            return ModelErrorCandidate(fit, q, 1.0, np.inf)
        steps += len(fit.path)
        if fit.status is not AnnealingStatus.CONVERGED or steps > _MOST_STEPS:
            return None
        point = fit.point
        noise, cost = evidence(segments, fit, q, annealer.loss)
        if best is None or cost < best.cost:
            best, worse = ModelErrorCandidate(fit, q, noise, cost), 0
        elif cost > best.cost + _WORSE:
            worse += 1
        if worse == 2:
            return best
    if best is not None and grid[-1] < grid[0] and cost <= best.cost + _WORSE:
        return ModelErrorCandidate(fit, q, noise, cost, exact=True)
    return best if best is not None and best.q != grid[-1] else None


def evidence(segments: Segments, fit: AnnealingFit, q: float, loss: Loss) -> tuple[float, float]:
    """The most likely factor on the noise (and on q) of this orbit, and -2 log of the marginal likelihood with it."""
    linear = linear_model(segments, fit.misfit, fit.scales, loss)
    factor = linear.equations(q).factor()
    if factor is None:
        return 1.0, np.inf
    freedom = degrees_of_freedom(segments, fit)
    defects = segments.system.dimension * int(segments.linked.sum())
    noise = np.sqrt(fit.misfit.cost_of_samples(q) / (freedom * loss.expected))
    return float(noise), float(
        2.0 * freedom * np.log(noise) + 2.0 * defects * np.log(q) + factor.log_determinant(~fit.at_bound)
    )


def degrees_of_freedom(segments: Segments, fit: AnnealingFit) -> int:
    """Residuals, priors and defects less nodes and parameters."""
    defects = segments.system.dimension * int(segments.linked.sum())
    nodes = segments.system.dimension * int((~segments.unconstrained).sum())
    known = 0 if segments.prior is None else segments.prior.count
    return fit.samples + known + defects - nodes - int((~fit.at_bound).sum())


def lag_one_autocorrelation(misfit: Misfit) -> float:
    """Largest autocorrelation at one sample among the channels' residuals."""
    r = misfit.residuals
    before, after = r[:-1], r[1:]
    power = np.maximum(np.sum(r**2, axis=(0, 2)) * (1.0 - 1.0 / len(r)), np.finfo(float).tiny)
    return float(np.max(np.sum(before * after, axis=(0, 2)) / power))
