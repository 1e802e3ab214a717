"""Test of residuals for whiteness, by the cumulative periodogram.

References
----------
M. S. Bartlett, An Introduction to Stochastic Processes (1955), section 9.2; the statistic is that of Kolmogorov and Smirnov.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_SIGNIFICANT = 2.5  # the statistic exceeds it by chance once in 130 000 channels
_SIZEABLE = 0.03  # of the residual power in the wrong part of the band: less does not widen intervals
_FEWEST = 32  # samples needed for a spectrum


def is_coloured(residuals: Floats) -> bool:
    """Whether the residuals of a channel are not white.

    Parameters
    ----------
    residuals : array of shape (M, C, K)
        Residuals of K segments of M samples in C channels; 0 where a sample is missing.

    Returns
    -------
    bool
        Whether any channel is not white.
    """
    return not all(is_white(residuals[:, channel].T.ravel()) for channel in range(residuals.shape[1]))


def is_white(series: Floats) -> bool:
    """Whether a series is white; too short a one is taken to be.

    Parameters
    ----------
    series : array of shape (N,)
        The series; 0 or NaN where a sample is missing.

    Returns
    -------
    bool
        Whether its periodogram departs from a flat one by no more than chance and a small part of its power.
    """
    samples = series[np.isfinite(series) & (series != 0.0)]
    if len(samples) < _FEWEST:
        return True
    power = np.abs(np.fft.rfft(samples - samples.mean()))[1:] ** 2
    count = len(power)
    departure = float(np.max(np.abs(np.cumsum(power) / power.sum() - np.arange(1, count + 1) / count)))
    return departure <= _SIZEABLE or departure * np.sqrt(count) <= _SIGNIFICANT
