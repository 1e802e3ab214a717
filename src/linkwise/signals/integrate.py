"""Displacement, velocity and acceleration from one measured channel, by smoothing and by integration over time."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth
from linkwise.signals.smooth import savitzky_golay, savitzky_golay_half

DRIFT_FREQUENCY = 3.0  # Hz: below it a twice integrated acceleration is drift, unless the structure is slow
_BELOW = 0.2  # of the frequency below which half of the power lies: the noise of an integral grows towards low ones
_ROUNDING = 1e-24  # of the power of a constant
_DEGREE = 5


def bridged(record: Record, channel: str) -> Floats:
    """Samples of a channel with gaps interpolated linearly, for starting values.

    Parameters
    ----------
    record : Record
        The record.
    channel : str
        Name of the channel.

    Returns
    -------
    array of shape (N,)
        The samples.
    """
    values = record.channel(channel)
    missing = np.isnan(values)
    if missing.any():
        index = np.arange(len(values))
        values = np.interp(index, index[~missing], values[~missing])
    return values


def smoothed(record: Record, channel: str, sigma: float) -> tuple[Floats, Floats, Floats]:
    """Smoothed channel and its derivatives, by a Savitzky-Golay filter.

    Parameters
    ----------
    record : Record
        The record.
    channel : str
        Name of the channel.
    sigma : float
        Standard deviation of its noise.

    Returns
    -------
    value, first, second : array of shape (N,)
        The channel and its first and second time derivative.
    """
    values = bridged(record, channel)
    highest = float(bandwidth(values, record.rate, [sigma])[0])
    half = min(savitzky_golay_half(highest, record.rate, degree=_DEGREE), (len(values) - 1) // 2)
    value, first, second = savitzky_golay(values, record.rate, half=half, degree=_DEGREE)
    return value[:, 0], first[:, 0], second[:, 0]


def integral(values: Floats, step: float) -> Floats:
    """Cumulative integral by Simpson's rule, from the first sample.

    Parameters
    ----------
    values : array of shape (N,)
        The samples.
    step : float
        Sampling interval in s.

    Returns
    -------
    array of shape (N,)
        The integral, 0 at the first sample.

    Notes
    -----
    The result is that of `scipy.integrate.cumulative_simpson`, to the last digit; importing that takes longer than a fit. Each
    interval belongs to the parabola through its ends and the sample after or before it; two samples give the trapezoidal rule.
    """
    result = np.zeros(len(values))
    if len(values) < 3:
        result[1:] = np.cumsum(step * (values[1:] + values[:-1]) / 2.0)
        return result
    result[1:-1:2] = _first_interval(values, step)[::2]
    result[2:-1:2] = _first_interval(values[::-1], step)[::-1][:-1:2]
    result[-1] = _first_interval(values[::-1], step)[0]
    return np.cumsum(result)


def _first_interval(values: Floats, step: float) -> Floats:
    """Integrals (N - 2,) of the parabolas through three samples in a row, from the first to the second of them."""
    first, second, third = values[:-2], values[1:-1], values[2:]
    return np.asarray(step / 3 * (5 * first / 4 + 2 * second - third / 4))


def drift_frequency(acceleration: Floats, rate: float) -> float:
    """Frequency below which the integral of an acceleration is taken for drift.

    Parameters
    ----------
    acceleration : array of shape (N,)
        The samples.
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    float
        Frequency in Hz: a part of that below which half of the power lies, so that slow structures keep their motion and a
        weaker drift of the sensor does not count, and at most `DRIFT_FREQUENCY`.
    """
    power = np.cumsum(np.abs(np.fft.rfft(acceleration - acceleration.mean())) ** 2)
    if not power[-1] > _ROUNDING * len(acceleration) * float(acceleration @ acceleration):
        return DRIFT_FREQUENCY  # at rest
    median = float(np.searchsorted(power, 0.5 * power[-1])) * rate / len(acceleration)
    return min(_BELOW * median, DRIFT_FREQUENCY)


def highpass(values: Floats, rate: float, cutoff: float) -> Floats:
    """High-pass filter: a Gaussian in frequency, with mirrored ends.

    Parameters
    ----------
    values : array of shape (N,)
        The samples.
    rate : float
        Sampling rate in Hz.
    cutoff : float
        Cut-off frequency in Hz.

    Returns
    -------
    array of shape (N,)
        The filtered samples.
    """
    mirrored = np.concatenate([values, values[::-1]])
    frequency = np.fft.rfftfreq(len(mirrored), 1.0 / rate)
    gain = 1.0 - np.exp(-0.5 * (frequency / cutoff) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(mirrored) * gain, len(mirrored))[: len(values)])


def channel_motion(record: Record, channel: str, sigma: float) -> Floats:
    """Displacement, velocity and acceleration from one channel of any of the three.

    Parameters
    ----------
    record : Record
        The record.
    channel : str
        Name of the channel.
    sigma : float
        Standard deviation of its noise.

    Returns
    -------
    array of shape (3, N)
        Displacement in m, velocity in m/s and acceleration in m/s^2; integrals start at 0.
    """
    kind = Channel.parse(channel).kind
    if kind == "x":
        return np.stack(smoothed(record, channel, sigma))
    values = bridged(record, channel)
    if kind == "v":
        velocity, acceleration, _ = smoothed(record, channel, sigma)
        return np.stack([integral(values, record.step), velocity, acceleration])
    velocity = integral(values, record.step)
    return np.stack([integral(velocity, record.step), velocity, values])
