"""The score of the variance of something random, from draws of what is there without it.

Slopes of half the cost by what is random have a covariance under the rest of the noise. Their sum of squares has a mean and a
scatter that draws of that noise give; its excess is the score of the variance. Variances that were found from the same
residuals leave less of it: what their own scores explain of it is subtracted (the efficient score).

References
----------
C. R. Rao, Proc. Camb. Phil. Soc. 44, 50 (1948), for score tests; X. Lin, Biometrika 84, 309 (1997), for those of variances.

E. S. Pearson, Biometrika 46, 364 (1959), for a sum of squares as a chi-square of the same three first moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats

_APART = 0.02  # of a score that is left beside those of variances found: with less the record does not distinguish them


@dataclass(frozen=True, eq=False)
class SquareSum:
    """A sum of squares of slopes, its `total`, and the `products` (d, d) of those of draws."""

    total: float
    products: Floats

    @classmethod
    def of(cls, slopes: Floats, draws: Floats) -> SquareSum:
        """From slopes (K,), and those (K, d) of draws."""
        return cls(float(slopes @ slopes), draws.T @ draws)

    def plus(self, added: SquareSum, weight: float) -> SquareSum:
        """The sum with another one times a weight."""
        return SquareSum(self.total + weight * added.total, self.products + weight * added.products)

    def with_other(self, second: SquareSum) -> float:
        """Half the covariance of both, from products of different draws."""
        count = len(self.products)
        both = self.products * second.products
        return float(both.sum() - np.trace(both)) / (count * (count - 1))


@dataclass(frozen=True)
class VarianceScore:
    """Of a variance: its `normal` score, the standard `deviation` that follows from it, and the `error` of its square.

    Attributes
    ----------
    excess : float
        The score: the sum of squares less its mean.
    gain : float
        What the variance would take off -2 log likelihood.
    """

    normal: float
    deviation: float
    error: float
    excess: float
    gain: float

    @classmethod
    def of(cls, tested: SquareSum, estimated: Sequence[SquareSum] = ()) -> VarianceScore | None:
        """From the sums of squares of what is tested, and of what has variances that were found.

        None where kicks move nothing, or do what those found do. Products of different draws tell the traces of the square
        and the cube of the covariance of the slopes.
        """
        alone = tested.with_other(tested)
        if estimated:
            among = np.array([[a.with_other(b) for b in estimated] for a in estimated])
            weights = np.linalg.lstsq(
                among, np.array([tested.with_other(square_sum) for square_sum in estimated])
            )[0]
            for square_sum, weight in zip(estimated, weights.tolist(), strict=True):
                tested = tested.plus(square_sum, -weight)
        products = tested.products.copy()
        count = len(products)
        excess = tested.total - float(np.trace(products)) / count
        square = tested.with_other(tested)
        np.fill_diagonal(products, 0.0)
        cube = float(np.trace(products @ products @ products)) / (count * (count - 1) * (count - 2))
        if square <= _APART * alone:
            return None
        return cls(
            normal=normal_score(excess, square, cube),
            deviation=float(np.sqrt(max(excess, 0.0) / square)),
            error=float(np.sqrt(2.0 / square)),
            excess=excess,
            gain=_gain(excess, square, cube),
        )


def _gain(excess: float, square: float, cube: float) -> float:
    """What a variance takes off -2 log likelihood, the sum of squares being a chi-square of the same moments."""
    if cube <= 0.0:
        return 0.5 * excess**2 / square
    freedom = square**3 / cube**2
    ratio = max(1.0 + excess / (cube / square * freedom), np.finfo(float).tiny)
    return float(freedom * (ratio - 1.0 - np.log(ratio)))


def normal_score(excess: float, square: float, cube: float) -> float:
    """The normal score of the `excess` over its mean of a sum of squares, by traces of powers of their covariance.

    Of many slopes draws may tell a `cube` that is not positive; their sum is then normal.
    """
    if cube <= 0.0:
        return excess / float(np.sqrt(2.0 * square))
    freedom, scale = square**3 / cube**2, cube / square
    half, place = 0.5 * freedom, 0.5 * max(excess / scale + freedom, 0.0)
    below, above = float(scipy.special.gammainc(half, place)), float(scipy.special.gammaincc(half, place))
    if above > 0.0:
        chance = float(np.log1p(-below) if below < 0.5 else np.log(above))
    else:  # below the least number: the first term of the incomplete gamma function far out
        chance = (half - 1.0) * float(np.log(place)) - place - float(scipy.special.gammaln(half))
    return -float(scipy.special.ndtri_exp(chance))
