"""Ordinary least squares on all columns."""

from __future__ import annotations

from typing import final

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor, SupportCandidate


@final
class LeastSquares(Regressor):
    """Every column that is not zero throughout takes part."""

    title = "least squares, nothing thresholded"

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        return gram.solve(gram.alive, target), 0.0, ()
