"""The rule that chooses among supports: what they predict in rows that were held out, less what their terms cost.

Rows that are fitted always prefer the larger support, and noise in the columns (errors in variables) lets hundreds of wrong
terms explain a little. In rows that were not seen those terms do harm, and the criterion finds its minimum near the true
number of terms.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import SupportCandidate

EXACT = 1e-11  # a residual this far below its target is rounding: below it fewer terms always win


def score_support(
    training: Gram, target: int, scaled: Floats, squares: float, setting: float
) -> SupportCandidate:
    """A least squares solution `scaled` (p,) on its support in the rows of `training`, which leaves `squares` there, judged by
    the rows held out.

    The criterion is BIC = R log(rss / R) + k log R over the R rows held out. To the sum of squares is added (1e-11 ||b||)^2:
    noise-free data leave rounding as their residual, and no term is worth having for explaining that. A support of more than
    half as many terms as rows were fitted scores infinity: such a fit follows its rows, whatever they are.
    """
    held = training.held
    assert held is not None  # `Gram.training` has refused systems without
    norm = held.norms[target]
    missed = held.squares_at(scaled - training.anchor[:, target], target) + (EXACT * norm) ** 2
    support = scaled != 0
    terms = int(np.count_nonzero(support))
    tiny = np.finfo(np.float64).tiny
    bic = held.rows * np.log(max(missed, tiny) / held.rows) + terms * np.log(held.rows)
    if terms > training.rows / 2:
        bic = np.inf
    return SupportCandidate(
        support=support,
        setting=setting,
        terms=terms,
        residual=float(np.sqrt(squares) / training.norms[target]) if training.norms[target] > 0 else 0.0,
        held_out=float(np.sqrt(missed) / norm) if norm > 0 else 0.0,
        bic=float(bic),
    )


def best_support(candidates: Iterable[SupportCandidate]) -> SupportCandidate:
    """The candidate of smallest BIC; of equals the one with fewer terms."""
    return min(candidates, key=lambda one: (one.bic, one.terms))
