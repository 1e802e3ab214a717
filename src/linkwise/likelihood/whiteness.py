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
    departure, count, _ = _departure(series)
    return departure <= _SIZEABLE or departure * np.sqrt(count) <= _SIGNIFICANT


def whiteness_text(channel: str, series: Floats) -> str:
    """What the test says of the residuals of a channel.

    Parameters
    ----------
    channel : str
        The channel.
    series : array of shape (N,)
        Its residuals, as of `is_white`.

    Returns
    -------
    str
        Whether they are white and, where they are not, at which part of the band most is too much or too little; or that
        there are too few samples.
    """
    departure, count, place = _departure(series)
    if count < _FEWEST // 2:
        return f"{channel}: not tested for whiteness, which takes {_FEWEST} samples."
    if is_white(series):
        return f"{channel}: white, by the cumulative periodogram."
    return (
        f"{channel}: not white, by the cumulative periodogram (Kolmogorov and Smirnov, {departure * np.sqrt(count):.3g} of "
        f"{_SIGNIFICANT:g} at most): {100.0 * departure:.2g} % of their power is on the wrong side of {place:.2g} of half the "
        "sampling rate."
    )


def _departure(series: Floats) -> tuple[float, int, float]:
    """The largest departure of the cumulative periodogram, the number of frequencies, and the place in the band.

    Zeros where there are fewer samples than a spectrum takes.
    """
    samples = series[np.isfinite(series) & (series != 0.0)]
    if len(samples) < _FEWEST:
        return 0.0, 0, 0.0
    power = np.abs(np.fft.rfft(samples - samples.mean()))[1:] ** 2
    count = len(power)
    departures = np.abs(np.cumsum(power) / power.sum() - np.arange(1, count + 1) / count)
    worst = int(np.argmax(departures))
    return float(departures[worst]), count, (worst + 1) / count
