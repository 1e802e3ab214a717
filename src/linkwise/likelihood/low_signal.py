"""Exact laws at a low signal: how closely the motion is held to them, so that the likelihood has one optimum.

The closer the motion must follow the laws, the longer each sample says something of the parameters. Where neighbouring
motions part, noise then leaves the likelihood with many narrow optima. A search that tightens the links between segments
quickly ends in one that is not the highest, and the curvature there says nothing of the distance to the others. With looser
links the motion forgets before that happens, and the likelihood has one optimum. From there the links are tightened slowly,
with -2 log of the marginal likelihood at each relaxation: it falls towards exact laws in the right valley and rises in a wrong
one. Where the tightest links leave no quadratic likelihood, the tightest that do are kept, if the likelihood also falls by
enough along the profile of each parameter; their covariance takes the loosened links for noise, and is on the safe side.

References
----------
V. F. Pisarenko and D. Sornette, "Statistical methods of parameter estimation for deterministically chaotic time series",
Phys. Rev. E 69, 036122 (2004).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import CostShape, LikelihoodFit
from linkwise.likelihood.local_optima import (
    is_quadratic,
    profiles_rise,
    rises_in_weak_directions,
    went_straight,
)
from linkwise.likelihood.model_error import evidence
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal

_LOW = (
    10.0**1.5
)  # power of a channel over that of its noise, 15 dB, below which few steps are no sign of one optimum
_LADDER = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, AnnealingSchedule.final_q)
_SINGLE = 1e-2  # relaxation down to which noise as strong as the motion leaves one optimum
_STEPS = 40  # at each relaxation; a search that takes more has left the valley
# of -2 log of the marginal likelihood: more than rounding and the error of Laplace's approximation
_WORSE = 2.0
_AGREES = 1.0  # of the cost: two searches that ended in the same optimum
_FACTOR = 2.0  # by which the cost may rise more or less than the covariance predicts
_BOTH = (1.0, -1.0)
_ON_THE_WAY = 3.0  # times the noise, in power: a search that did not converge may have been in a wrong valley


class Refit(Protocol):
    """`likelihood_fit` of exact laws from values and states, down to a relaxation."""

    def __call__(self, values: Floats, nodes: Floats, relaxation: float) -> LikelihoodFit: ...


def tightest_smooth_fit(fit: LikelihoodFit, refit: Refit) -> LikelihoodFit:
    """`fit`, or where its likelihood has other optima the closest fit to exact laws whose likelihood is quadratic.

    Looked at are fits with white noise and without a model error, at a low signal, of many steps, or not converged.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit of exact laws.
    refit : callable
        Fits again.

    Returns
    -------
    LikelihoodFit
        The fit; the given one where no other is better.
    """
    if not _may_be_wrong(fit):
        return fit
    converged, low = fit.status is AnnealingStatus.CONVERGED, _is_low(fit)
    if converged and not low and _is_smooth(fit):
        return replace(fit, shape=CostShape.QUADRATIC)
    relaxed = list(_relaxed_fits(fit))
    if not relaxed or relaxed[-1].fit.status is AnnealingStatus.INTERRUPTED:
        return fit
    tightest = relaxed[-1].fit
    agrees = (
        tightest.q <= fit.optimum.q
        and fit.misfit.cost(fit.optimum.q) < tightest.misfit.cost(tightest.q) + _AGREES
    )
    if agrees and converged and low and _is_smooth(fit) and rises_in_weak_directions(fit):
        return replace(fit, shape=CostShape.REGULAR)
    least = min(relaxed_fit.evidence for relaxed_fit in relaxed)
    for candidate in reversed(relaxed):
        if candidate.evidence > least + _WORSE and candidate.fit.q < _SINGLE:
            continue
        try:
            refitted = refit(candidate.fit.point.theta, candidate.fit.point.nodes, candidate.fit.q)
        except IdentificationError:  # the motion runs away
            continue
        if refitted.status is AnnealingStatus.INTERRUPTED:
            return fit
        is_good = refitted.status is AnnealingStatus.CONVERGED and not refitted.chi_square_off
        if is_good and _is_smooth(refitted) and profiles_rise(refitted):
            return replace(refitted, shape=CostShape.QUADRATIC)
    return fit


def is_loosened(fit: LikelihoodFit) -> bool:
    """Whether laws that are taken as exact hold between the segments of a fit only to within its relaxation.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    bool
        Whether they do.
    """
    exact = fit.status is AnnealingStatus.CONVERGED and fit.model_error == 0.0 and not fit.random_forces
    return exact and fit.optimum.q > AnnealingSchedule.final_q


@dataclass(frozen=True, eq=False)
class _RelaxedFit:
    """A fit at one relaxation, and -2 log of its marginal likelihood."""

    fit: AnnealingFit
    evidence: float


def _relaxed_fits(fit: LikelihoodFit) -> Iterator[_RelaxedFit]:
    """Fits at ever smaller relaxations, each from the one before, as long as they converge."""
    optimum, point = fit.optimum, fit.optimum.point
    for q in _LADDER:
        schedule = AnnealingSchedule(initial_q=q, final_q=q, max_steps=_STEPS)
        relaxed = anneal(optimum.segments, point, optimum.scales, schedule, loss=optimum.loss)
        if relaxed.status not in (AnnealingStatus.CONVERGED, AnnealingStatus.INTERRUPTED):
            return
        yield _RelaxedFit(relaxed, evidence(optimum.segments, relaxed, q, optimum.loss)[1])
        if relaxed.status is AnnealingStatus.INTERRUPTED:
            return
        point = relaxed.point


def _may_be_wrong(fit: LikelihoodFit) -> bool:
    """Whether the search for exact laws may have ended in an optimum that is not the highest."""
    if fit.status is AnnealingStatus.INTERRUPTED or fit.model_error > 0.0:
        return False
    if fit.random_forces or fit.optimum.coloured is not None:
        return False
    if fit.status is not AnnealingStatus.CONVERGED:
        return fit.chi_square < _ON_THE_WAY
    if fit.optimum.q > AnnealingSchedule.final_q:
        return False
    return _is_low(fit) or not went_straight(fit)


def _is_smooth(fit: LikelihoodFit) -> bool:
    return is_quadratic(fit, factor=_FACTOR, sides=_BOTH)


def _is_low(fit: LikelihoodFit) -> bool:
    """Whether a channel is hardly above its noise."""
    segments, sigma = fit.segments, fit.optimum.scales.sigma
    counts = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    power = np.sum((segments.samples * segments.observed) ** 2, axis=(0, 2)) / counts
    return bool((power < _LOW * sigma**2).any())
