"""Restarts of a fit whose starting states come from inverse dynamics.

A search that fails mostly started with part of the motion on a wrong branch of a law while its parameters are nearly right;
from these the states are computed again. A start of another kind competes with the first one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus

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
