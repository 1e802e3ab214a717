"""Restarts of a fit whose starting states come from inverse dynamics.

A search that fails mostly started with part of the motion on a wrong branch of a law while its parameters are nearly right;
from these the states are computed again. A start of another kind competes with the first one.

Fits from several starts, where the likelihood may have several valleys: the lowest is kept, others as good are reported.

Where the misfits of starts do not tell which is best, searches of few steps put them in order, and longer ones that end where
they crawl follow, until one comes to the noise.

Fits of structures with hosts whose links have memory: from starts that free runs bring close to the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.starts.memory import Valley

_ATTEMPTS = 3
_RELEVANT = 4.0  # of -2 log likelihood: what one more parameter lowers it by with a probability of 5 %
_TIED = 20.0  # of -2 log likelihood: two optima that near, with odds of 2e4 at most, are not told apart

_ALIKE = 4.0  # standard errors within which two fits are one


def _none(options: LikelihoodOptions, first: LikelihoodFit) -> None:
    """No start of another kind."""


class Search(Protocol):
    """`likelihood_fit` of some records and a structure."""

    def __call__(self, theta: Floats, *, options: LikelihoodOptions) -> LikelihoodFit: ...


def fit_with_restarts(
    fitted: Search,
    theta: Floats,
    options: LikelihoodOptions,
    *,
    another: Callable[[LikelihoodOptions, LikelihoodFit], LikelihoodFit | None] = _none,
) -> LikelihoodFit:
    """Fit up to three times, each time from the parameters of the fit before, until one converges with the expected noise.

    Parameters
    ----------
    fitted : Search
        The fit.
    theta : array of shape (p,)
        Starting values of the parameters.
    options : LikelihoodOptions
        The options; a model error is allowed only in a last fit from the best values.
    another : callable, optional
        Fits with options from a start of another kind, given the first fit; None where there is none. The likelier of both
        goes on, with the values of the other where they are as likely.

    Returns
    -------
    LikelihoodFit
        The first that converges with the expected noise, else the last; an interrupt ends the search.
    """
    best, start, nodes = None, theta, None
    strict = replace(options, model_error=False)
    for attempt in range(_ATTEMPTS):
        fit = fitted(start, options=strict)
        if attempt == 0 and not _interrupted(fit) and (rival := another(strict, fit)) is not None:
            chosen = rival if _interrupted(rival) else _likelier(fit, rival)
            nodes = rival.optimum.point.nodes if chosen.values is rival.values else None
            fit = chosen
        if _ends(fit):
            return fit
        if best is not None:
            if _gain(fit, best) < _RELEVANT:
                break
            nodes = None
        best, start = fit, fit.values
    last = options if nodes is None else replace(options, nodes=nodes)
    return fitted(theta if best is None else best.values, options=last)


def _likelier(fit: LikelihoodFit, rival: LikelihoodFit) -> LikelihoodFit:
    """The fit, or a rival that converged and is likelier by a relevant amount, with the values of the other if both may be."""
    if not _converged(rival):
        return fit
    if not _converged(fit):
        return rival
    gain = _gain(rival, fit)
    if not (_ends(fit) and _ends(rival)):
        return rival if gain > _RELEVANT else fit
    likely, rejected = (rival, fit) if gain > 0.0 else (fit, rival)
    if abs(gain) < _TIED and not _has_errors(likely) and _has_errors(rejected):
        likely, rejected = rejected, likely
    errors = np.sqrt(np.maximum(likely.covariance.diagonal(), 0.0))
    apart = np.abs(likely.values - rejected.values) > _ALIKE * errors
    return replace(likely, others=(rejected.values,)) if apart.any() and abs(gain) < _TIED else likely


def _has_errors(fit: LikelihoodFit) -> bool:
    """Whether rounding leaves standard errors to a fit."""
    return bool(np.isfinite(fit.covariance).all() and (fit.covariance.diagonal() >= 0.0).all())


def _gain(fit: LikelihoodFit, before: LikelihoodFit) -> float:
    """By how much -2 log likelihood is lower than in a fit before, their noise as it is left."""
    return float(fit.samples * np.log(before.chi_square / fit.chi_square))


def _converged(fit: LikelihoodFit) -> bool:
    return fit.status is AnnealingStatus.CONVERGED


def _interrupted(fit: LikelihoodFit) -> bool:
    return fit.status is AnnealingStatus.INTERRUPTED


def _ends(fit: LikelihoodFit) -> bool:
    """Whether a fit converged with the expected noise, or was interrupted."""
    return _interrupted(fit) or (_converged(fit) and not fit.chi_square_off)


_MOST = 3  # fits
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a fit

SearchFrom: TypeAlias = Callable[[Floats], LikelihoodFit]
"""Fits from parameters (p,)."""
FitFrom: TypeAlias = Callable[[Sequence[Valley]], LikelihoodFit]
"""Fits from starts."""


def fit_from_valleys(search: SearchFrom, valleys: Sequence[Valley]) -> LikelihoodFit:
    """Fit from the best starts until a fit explains the records to within their noise.

    Raises IdentificationError if the motion from none of them is finite.
    """
    fits: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    for valley in _near(valleys)[:_MOST]:
        try:
            fits.append(search(valley.values))
        except IdentificationError as error:
            failures.append(error)
        if fits and (_interrupted(fits[-1]) or _explains(fits[-1])):
            break
    if not fits:
        raise failures[0]
    return _best(fits)


def _near(valleys: Sequence[Valley]) -> list[Valley]:
    """Those whose misfit is not far above that of the first."""
    return [valley for valley in valleys if valley.misfit <= _NEAR * valleys[0].misfit]


def _best(fits: Sequence[LikelihoodFit]) -> LikelihoodFit:
    """The best of fits, with the values of others that are as good."""
    best = min(fits, key=_rank)
    others = tuple(fit.values for fit in fits if fit is not best and _converged(fit) and _as_good(fit, best))
    return replace(best, others=others)


def fit_or_another(fit: LikelihoodFit, search: Callable[[], LikelihoodFit]) -> LikelihoodFit:
    """The fit where it explains the records to within their noise, else the better of it and of another that starts."""
    if _stays(fit):
        return fit
    try:
        return min(fit, search(), key=_rank)
    except IdentificationError:
        return fit


def _stays(fit: LikelihoodFit) -> bool:
    return _interrupted(fit) or _explains(fit)


def _explains(fit: LikelihoodFit) -> bool:
    return _converged(fit) and not fit.chi_square_off and fit.model_error == 0.0


def _rank(fit: LikelihoodFit) -> tuple[bool, float]:
    """Fits that converged first, then those that leave least: the relaxation of a model error counts as misfit."""
    return not _converged(fit), fit.chi_square if fit.model_error == 0.0 else fit.misfit.cost(fit.model_error)


def _as_good(fit: LikelihoodFit, best: LikelihoodFit) -> bool:
    errors = np.sqrt(np.maximum(best.covariance.diagonal(), 0.0))
    apart = np.abs(fit.values - best.values) > _ALIKE * errors
    return bool(apart.any() and abs(fit.misfit.cost(1.0) - best.misfit.cost(1.0)) < _TIED)
