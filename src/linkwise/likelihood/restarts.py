"""More than one search where states come from forces: the first that ends well is taken.

A search that ends badly mostly has a stretch on a wrong branch of a law while its coefficients are nearly right; with them the
states are read from the forces anew.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from linkwise.arrays import Floats
from linkwise.likelihood.anneal import AnnealingStatus
from linkwise.likelihood.fit import LikelihoodFit, LikelihoodOptions

_ATTEMPTS = 3


class Search(Protocol):
    """`likelihood_fit` with everything said but the start and the options."""

    def __call__(self, theta: Floats, *, options: LikelihoodOptions) -> LikelihoodFit: ...


def fit_with_restarts(fitted: Search, theta: Floats, options: LikelihoodOptions) -> LikelihoodFit:
    """The first fit that converges with the noise that was stated or found, each started from the values of the one before.

    Where none does, the best start decides with a model error allowed. An interrupt ends the search.
    """
    best, start = None, theta
    strict = replace(options, model_error=False)
    for _ in range(_ATTEMPTS):
        fit = fitted(start, options=strict)
        if fit.status is AnnealingStatus.INTERRUPTED or (
            fit.status is AnnealingStatus.CONVERGED and not fit.chi_square_off
        ):
            return fit
        if best is not None and fit.chi_square >= best.chi_square:
            break
        best, start = fit, fit.values
    return fitted(theta if best is None else best.values, options=options)
