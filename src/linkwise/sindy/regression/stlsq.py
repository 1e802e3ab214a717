"""Sequentially thresholded least squares (Brunton et al. 2016; step 6 of the paper's section 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.runtime import one_blas_thread
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor, SupportCandidate
from linkwise.sindy.regression.selection import EXACT, best_support, score_support

_PASSES = 50  # supports only shrink; a loop this long means nothing is left to drop one by one
_FEW, _FEWER = 64, 16  # terms from which the path goes down more gently, and one by one


@final
@dataclass(frozen=True)
class Stlsq(Regressor):
    """Fit, drop every term whose contribution ||c_j A_j|| / ||b|| is below the threshold, fit again, until none drops.

    The threshold is a share of the equation's right-hand side, so it means the same in every unit. With `threshold`
    None it is chosen on rows held out (`sums.held_out`). In the other rows it rises, step by step, so that each step drops
    the weakest third of the terms (the weakest tenth of fewer than 64, one of fewer than 16, and all that contribute
    less than rounding), each step going on from the support of the one before. The support of smallest BIC in the rows
    held out is taken (`selection`) and fitted to all rows; the whole path stands in the fit.

    Raises IdentificationError for a threshold outside [0, 1), and without one for a system of fewer than 25 rows.
    """

    title: ClassVar[str] = "sequentially thresholded least squares"

    threshold: float | None = None

    def __post_init__(self) -> None:
        if self.threshold is not None and not 0 <= self.threshold < 1:
            raise IdentificationError(
                f"a threshold of {self.threshold!r} was given; it is the share of an equation's right-hand side below which a "
                "term is dropped, 0 <= threshold < 1"
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
    """Scaled coefficients after dropping, from those of a larger support, until every term left reaches the threshold."""
    for _ in range(_PASSES):
        kept = (np.abs(scaled) >= threshold * gram.norms[target]) & (scaled != 0)
        if np.array_equal(kept, scaled != 0):
            break
        scaled = gram.solve(kept, target)
    return scaled


def _path(training: Gram, target: int) -> Iterator[SupportCandidate]:
    """Supports of falling size, from all columns to none, as the threshold rises."""
    gram, places = training, np.arange(len(training.names))
    scaled, squares = gram.project(gram.alive, target)
    setting, norm = 0.0, float(gram.norms[target])
    while True:
        judged = score_support(gram, target, scaled, squares, setting)
        support = np.zeros(len(training.names), dtype=bool)
        support[places] = judged.support
        yield replace(judged, support=support)
        if not judged.terms or not norm:
            return
        ranked = np.argsort(np.abs(scaled), kind="stable")[-judged.terms :]
        negligible = int(np.count_nonzero(np.abs(scaled[ranked]) < EXACT * norm))
        dropped = ranked[: max(_step(judged.terms), min(negligible, judged.terms - 1))]
        setting = max(setting, float(np.abs(scaled[dropped[-1]])) / norm)
        kept = judged.support.copy()
        kept[dropped] = False
        if 0 < np.count_nonzero(kept) < len(places) / 2:
            gram, places, target = gram.restricted(kept, target), places[kept], 0
            scaled, squares = gram.anchor[:, 0], float(gram.sums.squares[0])
        else:
            scaled, squares = gram.project(kept, target)


def _step(terms: int) -> int:
    """How many of so many terms are dropped at once."""
    if terms < _FEWER:
        return 1
    return terms // (10 if terms < _FEW else 3)
