"""Ordinary least squares on all columns."""

from __future__ import annotations

from typing import final

from linkwise.arrays import Floats
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.regressor import Regressor, SupportCandidate


@final
class LeastSquares(Regressor):
    """Ordinary least squares on every column that is not zero throughout.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> fit = lw.LeastSquares().fit(lw.monomial_equations(lw.differentiate(record), order=3))
    >>> fit.coefficients.shape
    (35, 4)
    """

    title = "least squares, nothing thresholded"

    def solve(self, gram: Gram, target: int) -> tuple[Floats, float, tuple[SupportCandidate, ...]]:
        return gram.solve(gram.alive, target), 0.0, ()
