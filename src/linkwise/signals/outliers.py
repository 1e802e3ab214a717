"""Whether noise has more large errors than a normal distribution."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_ORDER = 4  # of the differences, which leave hardly any motion
_POWER = 70.0  # sum of the squares of their weights 1, 4, 6, 4, 1
_MOTION = 1.15  # factor on the power that white noise would have beyond which motion is left in them
_EXCESS = (
    1.0  # kurtosis less 3; that of 6000 normal samples scatters by 0.1, Student's t with 5 degrees has 2
)
_FEWEST = 500  # differences that tell a kurtosis


def has_outliers(samples: Floats, sigma: Floats) -> bool:
    """Whether any channel of `samples` (N, C), whose noise has deviations `sigma` (C,), has outliers in its noise.

    Channels in whose differences motion is as large as noise tell nothing, nor do those without noise.
    """
    differences = np.diff(samples, _ORDER, axis=0)
    squares = differences[:, sigma > 0.0] ** 2 / (_POWER * sigma[sigma > 0.0] ** 2)
    whole = np.isfinite(squares)
    count = whole.sum(axis=0)
    if not count.size:
        return False
    squares[~whole] = 0.0
    power = squares.sum(axis=0) / np.maximum(count, 1)
    fourth = (squares**2).sum(axis=0) / np.maximum(count, 1)
    told = (count >= _FEWEST) & (power < _MOTION) & (power > 1.0 / _MOTION)
    return bool(np.any(told & (fourth / np.where(power > 0.0, power, 1.0) ** 2 - 3.0 > _EXCESS)))
