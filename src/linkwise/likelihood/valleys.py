"""Fits from several starts, where the likelihood may have several valleys: the lowest is kept, others as good are reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.starts.memory import Valley

_MOST = 3  # fits
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a fit
_ALIKE = 4.0  # standard errors within which two fits are one
_TIED = 20.0  # in -2 log likelihood: a valley that near is as good

_GLANCE = 2  # steps of a search that puts starts in order

SearchFrom: TypeAlias = Callable[[Floats], LikelihoodFit]
"""Fits from parameters (p,)."""


def at_a_glance(options: LikelihoodOptions) -> LikelihoodOptions:
    """Options of a search of few steps."""
    return replace(options, steps=_GLANCE, model_error=False)


def fit_from_valleys(
    search: SearchFrom, valleys: Sequence[Valley], *, glance: SearchFrom | None = None
) -> LikelihoodFit:
    """Fit from the best starts until a fit explains the records to within their noise.

    With a `glance`, a search of few steps, those after the first start are taken in the order of the cost that it leaves.

    Raises IdentificationError if the motion from none of them is finite.
    """
    fits: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    waiting = [valley for valley in valleys if valley.misfit <= _NEAR * valleys[0].misfit]
    while waiting and len(fits) + len(failures) < _MOST:
        try:
            fits.append(search(waiting.pop(0).values))
        except IdentificationError as error:
            failures.append(error)
        if fits and (fits[-1].status is AnnealingStatus.INTERRUPTED or _explains(fits[-1])):
            break
        if glance is not None:
            waiting, glance = _in_order(waiting, glance), None
    if not fits:
        raise failures[0]
    best = min(fits, key=_rank)
    others = tuple(fit.values for fit in fits if fit is not best and _converged(fit) and _as_good(fit, best))
    return replace(best, others=others)


def _in_order(valleys: Sequence[Valley], glance: SearchFrom) -> list[Valley]:
    """Starts in the order of the cost that a search of few steps leaves, with loose links; none after an interrupt.

    Those from which the motion is not finite come last.
    """
    costs = []
    for valley in valleys:
        try:
            fit = glance(valley.values)
        except IdentificationError:
            costs.append(np.inf)
            continue
        if fit.status is AnnealingStatus.INTERRUPTED:
            return []
        costs.append(fit.misfit.cost(1.0))
    return [valleys[number] for number in np.argsort(costs, kind="stable").tolist()]


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
