"""Tests of noise and of residuals for outliers: more large errors than a normal distribution has."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_ORDER = 4  # of the differences, which remove nearly all motion
_POWER = 70.0  # sum of the squares of their weights 1, 4, 6, 4, 1
_MOTION = 1.15  # factor on the power of white noise beyond which the differences contain motion
# kurtosis less 3; that of 6000 normal samples scatters by 0.1, Student's t with 5 degrees has 2
_EXCESS = 1.0
_TYPICAL = 1.1  # of the power of the noise: the largest one of typical residuals, by their median
_NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal variable
_FEWEST = 500  # differences needed to estimate a kurtosis


def has_outliers(samples: Floats, sigma: Floats) -> bool:
    """Whether the noise of a channel has outliers, by the kurtosis of fourth differences.

    Channels without noise, and those whose differences contain as much motion as noise, are not tested.

    Parameters
    ----------
    samples : array of shape (N, C)
        The channels; NaN where a sample is missing.
    sigma : array of shape (C,)
        Standard deviations of the noise.

    Returns
    -------
    bool
        Whether any channel has.
    """
    differences = np.diff(samples, _ORDER, axis=0)
    squares = differences[:, sigma > 0.0] ** 2 / (_POWER * sigma[sigma > 0.0] ** 2)
    finite = np.isfinite(squares)
    count = finite.sum(axis=0)
    if not count.size:
        return False
    squares[~finite] = 0.0
    power = squares.sum(axis=0) / np.maximum(count, 1)
    fourth = (squares**2).sum(axis=0) / np.maximum(count, 1)
    testable = (count >= _FEWEST) & (power < _MOTION) & (power > 1.0 / _MOTION)
    return bool(np.any(testable & (fourth / np.where(power > 0.0, power, 1.0) ** 2 - 3.0 > _EXCESS)))


def outliers_exceed_noise(residuals: Floats) -> bool:
    """Whether nothing but outliers makes residuals larger than the noise.

    Parameters
    ----------
    residuals : array of shape (N, C)
        Residuals over the standard deviations of the noise; 0 or NaN where a sample is missing.

    Returns
    -------
    bool
        Whether the residuals of a channel have outliers, and typical ones are no larger than the noise in any channel.
    """
    heavy_tailed = False
    for column in residuals.T:
        series = column[np.isfinite(column) & (column != 0.0)]
        if len(series) < _FEWEST:
            return False
        if (np.median(np.abs(series)) / _NORMAL_MEDIAN) ** 2 > _TYPICAL:
            return False
        kurtosis = np.mean(series**4) / np.mean(series**2) ** 2
        heavy_tailed = heavy_tailed or bool(kurtosis - 3.0 > _EXCESS)
    return heavy_tailed
