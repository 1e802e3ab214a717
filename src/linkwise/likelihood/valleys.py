"""Fits from several starts, where the likelihood may have several valleys: the lowest is kept, others as good are reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.starts.memory import Valley

_MOST = 3  # fits
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a fit
_ALIKE = 4.0  # standard errors within which two fits are one
_TIED = 20.0  # in -2 log likelihood: a valley that near is as good


def fit_from_valleys(search: Callable[[Floats], LikelihoodFit], valleys: Sequence[Valley]) -> LikelihoodFit:
    """Fit from the best starts until a fit explains the records to within their noise.

    Raises IdentificationError if the motion from none of them is finite.
    """
    fits: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    for valley in valleys[:_MOST]:
        if valley.misfit > _NEAR * valleys[0].misfit:
            break
        try:
            fits.append(search(valley.values))
        except IdentificationError as error:
            failures.append(error)
            continue
        if fits[-1].status is AnnealingStatus.INTERRUPTED or _explains(fits[-1]):
            break
    if not fits:
        raise failures[0]
    best = min(fits, key=_rank)
    others = tuple(fit.values for fit in fits if fit is not best and _converged(fit) and _as_good(fit, best))
    return replace(best, others=others)


def fit_or_another(fit: LikelihoodFit, search: Callable[[], LikelihoodFit]) -> LikelihoodFit:
    """The fit where it explains the records to within their noise, else the better of it and of another that starts."""
    if fit.status is AnnealingStatus.INTERRUPTED or _explains(fit):
        return fit
    try:
        return min(fit, search(), key=_rank)
    except IdentificationError:
        return fit


def _converged(fit: LikelihoodFit) -> bool:
    return fit.status is AnnealingStatus.CONVERGED


def _explains(fit: LikelihoodFit) -> bool:
    return _converged(fit) and not fit.chi_square_off and fit.model_error == 0.0


def _rank(fit: LikelihoodFit) -> tuple[bool, float]:
    """Fits that converged first, then those that leave least: the relaxation of a model error counts as misfit."""
    return not _converged(fit), fit.chi_square if fit.model_error == 0.0 else fit.misfit.cost(fit.model_error)


def _as_good(fit: LikelihoodFit, best: LikelihoodFit) -> bool:
    errors = np.sqrt(np.maximum(best.covariance.diagonal(), 0.0))
    apart = np.abs(fit.values - best.values) > _ALIKE * errors
    return bool(apart.any() and abs(fit.misfit.cost(1.0) - best.misfit.cost(1.0)) < _TIED)
