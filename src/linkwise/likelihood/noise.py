"""How large the noise of sensors and the error of the laws are, judged by the residuals of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.minimise import (
    Annealer,
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    freedom,
)
from linkwise.likelihood.shooting.residuals import Gaussian, Misfit
from linkwise.likelihood.shooting.segments import Iterate

_RATIO = 3.0  # of neighbouring relaxations on the grid
_COUNT = 19  # relaxations on the grid, from q = 1e-5 to 4e3
# of all fits of a grid; a search that takes more creeps, and its laws are not those of the record
_MOST_STEPS = 400
_WORSE = 0.1  # of the cost: a point less than this above the best is on a plateau; the cost may fall beyond


@dataclass(frozen=True, eq=False)
class ModelErrorCandidate:
    """A fit at a relaxation, its factor on the noise, and -2 log of its marginal likelihood.

    `exact` where the laws need no model error: the search went down to them from one, and they are as likely without.
    `surpassed` where a search at the next relaxation, which may be likelier, did not converge.
    """

    fit: AnnealingFit
    noise: float
    cost: float
    exact: bool = False
    surpassed: bool = False


def with_model_error(fit: AnnealingFit, start: Iterate, annealer: Annealer) -> ModelErrorCandidate | None:
    """The most likely division of the residuals into noise of the sensors and errors of the flow.

    For every relaxation q of a geometric grid the orbit is fitted again and the noise profiled out; the marginal likelihood
    in the Laplace approximation selects q. The search goes up from a converged fit; without one, where the laws are too far
    off, it goes down from the `start`, to exact laws at most. None where no point of the grid is the best.
    """
    if fit.status is AnnealingStatus.CONVERGED:
        grid = [fit.q * _RATIO**power for power in range(_COUNT)]
        return _grid_search(fit.misfit, grid, annealer)
    exact = AnnealingSchedule.final_q
    above = [q for q in (_RATIO**-power for power in range(_COUNT)) if q > exact]
    best = _grid_search(fit.misfit.at(start), [*above, exact], annealer)
    if best is not None and best.fit.q == 1.0:
        grid = [_RATIO**power for power in range(_COUNT)]
        return _grid_search(best.fit.misfit, grid, annealer)
    return best


def _grid_search(misfit: Misfit, grid: Sequence[float], annealer: Annealer) -> ModelErrorCandidate | None:
    """The best relaxation, once two worse ones follow it, or of those before a search that does not converge, or takes too
    many steps; None where the grid ends before.

    The last point of a grid that goes down stands for exact laws, and is taken where it is as likely. An interrupt from the
    keyboard ends the search where it is.
    """
    best, worse, steps = None, 0, 0
    for q in grid:
        fit = annealer(misfit, AnnealingSchedule(initial_q=q, final_q=q))
        if fit.status is AnnealingStatus.INTERRUPTED:
            return ModelErrorCandidate(fit, 1.0, np.inf)
        steps += len(fit.path)
        if fit.status is not AnnealingStatus.CONVERGED or steps > _MOST_STEPS:
            return best and replace(best, surpassed=True)
        misfit = fit.misfit
        noise, cost = evidence(fit)
        if best is None or cost < best.cost:
            best, worse = ModelErrorCandidate(fit, noise, cost), 0
        elif cost > best.cost + _WORSE:
            worse += 1
        if worse == 2:
            return best
    if best is not None and grid[-1] < grid[0] and cost <= best.cost + _WORSE:
        return ModelErrorCandidate(fit, noise, cost, exact=True)
    return best if best is not None and best.fit.q != grid[-1] else None


def evidence(fit: AnnealingFit) -> tuple[float, float]:
    """The most likely factor on the noise (and on q) of an orbit, and -2 log of the marginal likelihood with it."""
    misfit, q = fit.misfit, fit.q
    factor = linear_model(misfit).equations(q).factor()
    misfit.orbit.release()
    if factor is None:
        return 1.0, np.inf
    degrees = degrees_of_freedom(fit)
    defects = misfit.segments.system.dimension * int(misfit.segments.linked.sum())
    noise = np.sqrt(misfit.cost_of_samples(q) / (degrees * misfit.loss.expected))
    return float(noise), float(
        2.0 * degrees * np.log(noise) + 2.0 * defects * np.log(q) + factor.log_determinant(~fit.at_bound)
    )


def degrees_of_freedom(fit: AnnealingFit) -> float:
    """Residuals, priors and defects less nodes and parameters that are not at a bound."""
    return freedom(fit.misfit.segments) + int(fit.at_bound.sum())


def lag_one_autocorrelation(misfit: Misfit) -> float:
    """Largest autocorrelation at one sample among the channels' residuals."""
    r = misfit.residuals
    before, after = r[:-1], r[1:]
    power = np.maximum(np.sum(r**2, axis=(0, 2)) * (1.0 - 1.0 / len(r)), np.finfo(float).tiny)
    return float(np.max(np.sum(before * after, axis=(0, 2)) / power))


def residual_levels(misfit: Misfit) -> Floats:
    """(C,) root mean square of the residuals of each channel."""
    counts = np.maximum(misfit.segments.observed.sum(axis=(0, 2)), 1)
    return np.asarray(np.sqrt(np.sum(misfit.residuals**2, axis=(0, 2)) / counts))


_CHANCE = 2.0  # standard deviations of chi-square
_LEAST = 0.08  # by which chi-square is below 1: what the estimate of the noise scatters by in long records
_STEPS = 20  # beside the optimum; a search that takes more may creep along a bend of the likelihood ...
_LOOSE = 0.01  # ... which looser links straighten: the relaxation from which it starts again


def with_noise_of_residuals(fit: AnnealingFit, annealer: Annealer, lowest: Floats) -> AnnealingFit:
    """A fit whose chi-square is below 1 again, with the noise of its residuals in place of that found beforehand.

    Motion that fills the band up to half the sampling rate is taken for a part of the noise, and a fit of laws that are right
    shows less. Its residuals, per degree of freedom, are no less than the noise, whatever the laws are, and so the noise of
    each channel may be lowered to them.

    Parameters
    ----------
    fit : AnnealingFit
        The fit.
    annealer : Annealer
        Fits again.
    lowest : array of shape (C,)
        The least deviations; infinite where the noise of a channel is stated, which stays as it is.

    Returns
    -------
    AnnealingFit
        The fit; the given one where its chi-square is not below 1, or without an optimum.
    """
    least = max(_LEAST, _CHANCE * np.sqrt(2.0 / fit.samples))
    if fit.status is not AnnealingStatus.CONVERGED or fit.chi_square > 1.0 - least:
        return fit
    if not isinstance(fit.misfit.loss, Gaussian):  # whose mean cost alone is that of the noise
        return fit
    levels = residual_levels(fit.misfit) * np.sqrt(fit.samples / freedom(fit.misfit.segments))
    factors = np.clip(levels, np.minimum(lowest / fit.scales.sigma, 1.0), 1.0)
    if (factors == 1.0).all():
        return fit
    start = fit.misfit.at(fit.point, factors)
    tight = AnnealingSchedule(initial_q=fit.q, final_q=fit.q, max_steps=_STEPS)
    again = annealer(start, tight)
    if again.status in (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK):
        loose = AnnealingSchedule(initial_q=max(fit.q, _LOOSE), final_q=fit.q)
        again = annealer(start, loose)
    if again.status is AnnealingStatus.INTERRUPTED:
        return again
    if again.status is not AnnealingStatus.CONVERGED:
        return fit
    return replace(again, path=(*fit.path, *again.path))


_ROUNDS = 4  # of a search with the noise that the one before left
_EVEN = 0.05  # by which that differs at most where it has settled


def with_noise_from_misfit(start: Iterate, fit: AnnealingFit, annealer: Annealer) -> AnnealingFit | None:
    """The fit of exact laws from a `start`, with what a `fit` that did not converge left of each channel as its noise.

    Beside noise that is far below what laws leave, what is known beforehand, as of the modes of a host, counts for nothing:
    the search creeps along directions that the records hardly determine. None where it does not converge either; an interrupt
    from the keyboard ends it where it is.
    """
    point, schedule = start, AnnealingSchedule()
    for _ in range(_ROUNDS):
        levels = residual_levels(fit.misfit)
        settled = fit.status is AnnealingStatus.CONVERGED and np.abs(levels - 1.0).max() < _EVEN
        if settled or fit.status is AnnealingStatus.INTERRUPTED:
            break
        fit = annealer(fit.misfit.at(point, np.where(levels > 0.0, levels, 1.0)), schedule)
        point, schedule = fit.point, AnnealingSchedule(initial_q=fit.q, final_q=fit.q)
    return fit if fit.status in (AnnealingStatus.CONVERGED, AnnealingStatus.INTERRUPTED) else None
