"""Laws that are a little wrong: the error of the flow that is most likely, beside the noise of the sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.likelihood.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.loss import Loss
from linkwise.likelihood.normal_equations import linearise
from linkwise.likelihood.residuals import Misfit
from linkwise.likelihood.segments import Iterate, Scales, Segments

_LOOSENING = 3.0  # from rung to rung of the ladder of model errors
_RUNGS = 19  # from q = 1e-5 to 4e3
_WORSE = 0.1  # of the cost: a rung less than this above the best stands on a plateau, behind which the cost may fall


@dataclass(frozen=True, eq=False)
class ModelErrorCandidate:
    """A fit at relaxation q, the factor on the noise that it asks for, and -2 log of its marginal likelihood."""

    fit: AnnealingFit
    q: float
    noise: float
    cost: float


def with_model_error(
    segments: Segments, fit: AnnealingFit, start: Iterate, annealer: Annealer
) -> ModelErrorCandidate | None:
    """The most likely split of what the laws leave into noise of the sensors and errors of the flow.

    For every relaxation q on a ladder the orbit is fitted again and the noise profiled out; the marginal likelihood, Gaussian
    in nodes and theta about their optimum (Laplace), chooses q. A tight fit is loosened; where there is none, for laws too
    wrong for it, the `start` is tightened. None where no rung is the best.
    """
    if fit.status is AnnealingStatus.CONVERGED:
        rungs = [fit.q * _LOOSENING**rung for rung in range(_RUNGS)]
        return _ladder_search(segments, fit.point, fit.scales, rungs, annealer)
    best = _ladder_search(
        segments, start, fit.scales, [_LOOSENING**-rung for rung in range(_RUNGS)], annealer
    )
    if best is not None and best.q == 1.0:
        rungs = [_LOOSENING**rung for rung in range(_RUNGS)]
        return _ladder_search(segments, best.fit.point, fit.scales, rungs, annealer)
    return best


def _ladder_search(
    segments: Segments, point: Iterate, scales: Scales, rungs: Sequence[float], annealer: Annealer
) -> ModelErrorCandidate | None:
    """The best rung, once two worse ones follow it; None where the ladder ends before, or a rung is out of reach.

    An interrupt from the keyboard ends the climb on the rung where it was."""
    best, worse = None, 0
    for q in rungs:
        fit = annealer(segments, point, scales, AnnealingSchedule(initial_q=q, final_q=q))
        if fit.status is AnnealingStatus.INTERRUPTED:
            return ModelErrorCandidate(fit, q, 1.0, np.inf)
        if fit.status is not AnnealingStatus.CONVERGED:
            return None
        point = fit.point
        noise, cost = _evidence(segments, fit, q, annealer.loss)
        if best is None or cost < best.cost:
            best, worse = ModelErrorCandidate(fit, q, noise, cost), 0
        elif cost > best.cost + _WORSE:
            worse += 1
        if worse == 2:
            return best
    return best if best is not None and best.q != rungs[-1] else None


def _evidence(segments: Segments, fit: AnnealingFit, q: float, loss: Loss) -> tuple[float, float]:
    """The factor on the noise (and on q) that this orbit asks for, and -2 log of the marginal likelihood with it."""
    linear = linearise(segments, fit.misfit, fit.scales, loss)
    factor = linear.equations(q).factor()
    if factor is None:
        return 1.0, np.inf
    defects = 2 * segments.system.incidence.shape[0] * int(segments.linked.sum())
    nodes = 2 * segments.system.incidence.shape[0] * int((~segments.unconstrained).sum())
    free = ~fit.at_bound
    known = 0 if segments.prior is None else segments.prior.count
    freedom = fit.samples + known + defects - nodes - int(free.sum())
    noise = np.sqrt(fit.misfit.cost(q) / (freedom * loss.expected))
    return float(noise), float(
        2.0 * freedom * np.log(noise) + 2.0 * defects * np.log(q) + factor.log_determinant(free)
    )


def lag_one_autocorrelation(misfit: Misfit) -> float:
    """Largest autocorrelation at one sample among the channels' residuals."""
    r = misfit.residuals
    before, after = r[:-1], r[1:]
    power = np.maximum(np.sum(r**2, axis=(0, 2)) * (1.0 - 1.0 / len(r)), np.finfo(float).tiny)
    return float(np.max(np.sum(before * after, axis=(0, 2)) / power))
