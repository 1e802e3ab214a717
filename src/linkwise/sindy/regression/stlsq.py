"""Sequentially thresholded least squares (Brunton et al. 2016; step 6 of the paper's section 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from linkwise.argument_types import checked_class
from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.runtime import one_blas_thread
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor, SupportCandidate
from linkwise.sindy.regression.selection import EXACT, best_support, score_support

_PASSES = 50  # supports only shrink, so far fewer passes are enough
_FEW, _FEWER = 64, 16  # terms below which a tenth is dropped at once, and below which one is


@checked_class
@final
@dataclass(frozen=True)
class Stlsq(Regressor):
    """Sequentially thresholded least squares.

    Terms whose contribution ||c_j A_j|| / ||b|| is below a threshold are dropped and the others refitted, until none drops.

    Parameters
    ----------
    threshold : float, optional
        At least 0 and below 1, relative to the norm of the target, so that it means the same in every unit. By default it is
        chosen on rows held out.

    Raises
    ------
    IdentificationError
        If the threshold is out of range; on fitting, if it is None and there are fewer than 25 rows.

    Notes
    -----
    To choose the threshold, every fifth of a hundred runs of neighbouring rows is held out. On the other rows the threshold
    rises; each step drops the weakest third of the terms (a tenth of fewer than 64, one of fewer than 16, and all that
    contribute less than rounding) and refits. The support of smallest BIC on the rows held out is fitted to all rows. The path
    is kept in `RegressionFit.paths`.

    References
    ----------
    S. L. Brunton, J. L. Proctor and J. N. Kutz, PNAS 113, 3932 (2016).

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> fit = lw.Stlsq(0.001).fit(lw.monomial_equations(lw.differentiate(record), order=3))
    >>> sorted(fit.terms("x1'"))
    ['v1']
    """

    title: ClassVar[str] = "sequentially thresholded least squares"

    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise IdentificationError(
                f"threshold must be at least 0 and below 1, got {self.threshold!r}; it is the share of an equation's "
                "right-hand side below which a term is dropped"
            )

    def with_threshold(self, threshold: float) -> Stlsq:
        return Stlsq(threshold)

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        if self.threshold is not None:
            scaled = gram.solve(gram.alive, target)
            return _shrink(gram, target, scaled, self.threshold), self.threshold, ()
        training = gram.training
        with one_blas_thread():  # many small steps
            path = tuple(_path(training, target))
        chosen = best_support(path)
        return gram.solve(chosen.support, target), chosen.setting, path


def _shrink(gram: Gram, target: int, scaled: Floats, threshold: float) -> Floats:
    """Scaled coefficients after dropping terms until every one that remains reaches the threshold."""
    for _ in range(_PASSES):
        support = (np.abs(scaled) >= threshold * gram.norms[target]) & (scaled != 0)
        if np.array_equal(support, scaled != 0):
            break
        scaled = gram.solve(support, target)
    return scaled


def _path(training: Gram, target: int) -> Iterator[SupportCandidate]:
    """Supports of decreasing size, from all columns to none, as the threshold rises."""
    gram, columns = training, np.arange(len(training.names))
    scaled, squares = gram.project(gram.alive, target)
    setting, norm = 0.0, float(gram.norms[target])
    while True:
        candidate = score_support(gram, target, scaled, squares, setting)
        support = np.zeros(len(training.names), dtype=bool)
        support[columns] = candidate.support
        yield replace(candidate, support=support)
        if not candidate.terms or not norm:
            return
        ranked = np.argsort(np.abs(scaled), kind="stable")[-candidate.terms :]
        negligible = int(np.count_nonzero(np.abs(scaled[ranked]) < EXACT * norm))
        dropped = ranked[: max(_step(candidate.terms), min(negligible, candidate.terms - 1))]
        setting = max(setting, float(np.abs(scaled[dropped[-1]])) / norm)
        remaining = candidate.support.copy()
        remaining[dropped] = False
        if 0 < np.count_nonzero(remaining) < len(columns) / 2:
            gram, columns, target = gram.restricted(remaining, target), columns[remaining], 0
            scaled, squares = gram.anchor[:, 0], float(gram.sums.squares[0])
        else:
            scaled, squares = gram.project(remaining, target)


def _step(terms: int) -> int:
    """How many of `terms` terms are dropped at once."""
    if terms < _FEWER:
        return 1
    return terms // (10 if terms < _FEW else 3)
