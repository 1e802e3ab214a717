"""Restarts of a fit whose starting states come from inverse dynamics.

A search that fails mostly started with part of the motion on a wrong branch of a law while its parameters are nearly right;
from these the states are computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.anneal import AnnealingStatus

_ATTEMPTS = 3


def _none(options: LikelihoodOptions) -> None:
    """No start of another kind."""


class Search(Protocol):
    """`likelihood_fit` of some records and a structure."""

    def __call__(self, theta: Floats, *, options: LikelihoodOptions) -> LikelihoodFit: ...


def fit_with_restarts(
    fitted: Search,
    theta: Floats,
    options: LikelihoodOptions,
    *,
    another: Callable[[LikelihoodOptions], LikelihoodFit | None] = _none,
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
        Fits with options from a start of another kind, which is tried after the first; None where there is none.

    Returns
    -------
    LikelihoodFit
        The first that converges with the expected noise, else the last; an interrupt ends the search.
    """
    best, start = None, theta
    strict = replace(options, model_error=False)
    for attempt in range(_ATTEMPTS):
        fit = fitted(start, options=strict)
        if _ends(fit):
            return fit
        if attempt == 0 and (rival := another(strict)) is not None:
            if _ends(rival):
                return rival
            if rival.status is AnnealingStatus.CONVERGED and rival.chi_square < fit.chi_square:
                return fitted(rival.values, options=replace(options, nodes=rival.optimum.point.nodes))
        if best is not None and fit.chi_square >= best.chi_square:
            break
        best, start = fit, fit.values
    return fitted(theta if best is None else best.values, options=options)


def _ends(fit: LikelihoodFit) -> bool:
    """Whether a fit converged with the expected noise, or was interrupted."""
    return fit.status is AnnealingStatus.INTERRUPTED or (
        fit.status is AnnealingStatus.CONVERGED and not fit.chi_square_off
    )
