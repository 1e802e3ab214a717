"""Whether residuals are white: the largest departure of their cumulated spectrum from a straight line.

Bartlett, "An introduction to stochastic processes", 1955, section 9.2; the statistic is that of Kolmogorov and Smirnov.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_SIGNIFICANT = 2.5  # the statistic exceeds it by chance once in 130 000 channels
_SIZEABLE = 0.03  # of the residual power that is in the wrong part of the band: less does not widen intervals
_FEWEST = 32  # samples that tell a spectrum


def is_coloured(residuals: Floats) -> bool:
    """Whether any channel of `residuals` (M, C, K), K segments of M samples, zero where nothing was measured, is not white."""
    return any(_coloured(residuals[:, channel].T.ravel()) for channel in range(residuals.shape[1]))


def _coloured(series: Floats) -> bool:
    samples = series[series != 0.0]
    if len(samples) < _FEWEST:
        return False
    power = np.abs(np.fft.rfft(samples - samples.mean()))[1:] ** 2
    count = len(power)
    departure = float(np.max(np.abs(np.cumsum(power) / power.sum() - np.arange(1, count + 1) / count)))
    return departure > _SIZEABLE and departure * np.sqrt(count) > _SIGNIFICANT
