"""The rule that chooses among supports: the Bayesian information criterion, with a floor where data are exact."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from linkwise.sparse.gram import Gram, Mask
from linkwise.sparse.regressor import Candidate

EXACT = 1e-11  # a residual this far below its target is rounding: below it fewer terms always win


def candidate(gram: Gram, target: int, support: Mask, setting: float) -> Candidate:
    """Least squares on `support` (p,), judged by BIC = R log(rss / R) + k log R.

    To the sum of squares is added (1e-11 ||b||)^2: noise-free data leave rounding as their residual, and no term
    is worth having for explaining that. A support of more than half as many terms as rows scores infinity.
    """
    squares = gram.project(support, target)[1]
    floor = (EXACT * gram.norms[target]) ** 2
    terms = int(np.sum(support & gram.alive))
    tiny = np.finfo(np.float64).tiny
    bic = gram.rows * np.log(max(squares + floor, tiny) / gram.rows) + terms * np.log(gram.rows)
    if terms > gram.rows / 2:
        bic = np.inf
    residual = float(np.sqrt(squares) / gram.norms[target]) if gram.norms[target] > 0 else 0.0
    return Candidate(support, setting, terms, residual, float(bic))


def best(candidates: Iterable[Candidate]) -> Candidate:
    """The candidate of smallest BIC; of equals the one with fewer terms."""
    return min(candidates, key=lambda one: (one.bic, one.terms))
