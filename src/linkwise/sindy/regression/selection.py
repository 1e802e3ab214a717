"""Choice among supports by cross-validation: a BIC on rows held out.

On the rows that are fitted the larger support always has the smaller residual, and noise in the columns (errors in
variables) lets hundreds of wrong terms explain a little. On rows held out those terms increase the residual, and the
criterion has its minimum near the true number of terms.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import SupportCandidate

EXACT = 1e-11  # relative residual below which it is rounding: there fewer terms are always better


def score_support(
    training: Gram, target: int, scaled: Floats, squares: float, setting: float
) -> SupportCandidate:
    """Score a least squares solution on a support by the rows held out.

    The criterion is BIC = R log(rss / R) + k log R over the R rows held out. To the sum of squares rss is added
    (1e-11 ||b||)^2: the residual of noise-free data is rounding, which no term should explain. A support of more than half as
    many terms as rows were fitted scores infinity, since such a fit interpolates its rows.

    Parameters
    ----------
    training : Gram
        Gram matrix of the rows that are fitted.
    target : int
        Index of the target.
    scaled : array of shape (p,)
        Scaled coefficients, zero outside the support.
    squares : float
        Sum of squared residuals of the rows that are fitted.
    setting : float
        Threshold or penalty that led to the support.

    Returns
    -------
    SupportCandidate
        The support and its scores.
    """
    held_out = training.held_out
    assert held_out is not None  # `Gram.training` has refused systems without
    norm = held_out.norms[target]
    squares_held_out = held_out.squares_at(scaled - training.anchor[:, target], target) + (EXACT * norm) ** 2
    support = scaled != 0
    terms = int(np.count_nonzero(support))
    tiny = np.finfo(np.float64).tiny
    bic = held_out.rows * np.log(max(squares_held_out, tiny) / held_out.rows) + terms * np.log(held_out.rows)
    if terms > training.rows / 2:
        bic = np.inf
    return SupportCandidate(
        support=support,
        setting=setting,
        terms=terms,
        residual=float(np.sqrt(squares) / training.norms[target]) if training.norms[target] > 0 else 0.0,
        held_out=float(np.sqrt(squares_held_out) / norm) if norm > 0 else 0.0,
        bic=float(bic),
    )


def best_support(candidates: Iterable[SupportCandidate]) -> SupportCandidate:
    """The candidate of smallest BIC.

    Parameters
    ----------
    candidates : iterable of SupportCandidate
        The supports, one at least.

    Returns
    -------
    SupportCandidate
        The best; among equals the one with fewer terms.
    """
    return min(candidates, key=lambda candidate: (candidate.bic, candidate.terms))
