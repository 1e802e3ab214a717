"""Frequency and damping of a mode over its amplitude, as it rings down after the force has ended.

The motion is shifted by the frequency of the mode and low-pass filtered: the complex envelope has its amplitude and phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.record import Record

_SILENT = 0.01  # of the largest force: less is none
_PERIODS = 6.0  # of a window, in which a straight line is laid through phase and logarithm of the amplitude
_FEWEST = 4  # windows
_WIDEST = 0.25  # of the frequency: half the band that is kept
_NEIGHBOUR = 0.5  # of the distance to the next mode
_FLOOR = 10.0  # times the level in the band at the end of the record: what is lower is noise


@dataclass(frozen=True, eq=False)
class RingDown:
    """A mode as it rings down.

    Attributes
    ----------
    mode : int
        Its number, from 1.
    channel : str
        The response that was taken.
    unit : str
        The unit of the amplitude.
    amplitude, frequency, damping : array of shape (W,)
        Amplitude in the channel, frequency in Hz, and damping as a part of the critical one, window by window.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> [ring] = found.ring_downs
    >>> bool(abs(ring.frequency[0] - 20.0) < 0.1), bool(abs(ring.damping[0] - 0.005) < 0.001)
    (True, True)
    """

    mode: int
    channel: str
    unit: str
    amplitude: Floats
    frequency: Floats
    damping: Floats


def ring_down(record: Record, channel: str, frequencies: Floats, mode: int, noise: float) -> RingDown | None:
    """That of one of the modes with `frequencies` in Hz; None where the record has too little of it.

    `noise` is the standard deviation of the channel's noise.
    """
    first = _end_of_force(record)
    values = record.channel(channel)[first:]
    center = float(frequencies[mode])
    length = round(_PERIODS / center * record.rate)
    if length < 8 or len(values) < _FEWEST * length or not np.isfinite(values).all():
        return None
    others = np.delete(frequencies, mode)
    gap = float(np.min(np.abs(others - center), initial=np.inf))
    half = min(_WIDEST * center, _NEIGHBOUR * gap)
    envelope = _envelope(values, center, half, record.rate)
    edge = int(record.rate / half)  # that the filter needs
    windows = [slice(k, k + length) for k in range(edge, len(values) - edge - length + 1, length)]
    floor = _FLOOR * noise * float(np.sqrt(4.0 * half / record.rate))
    lines = [
        fitted for window in windows if (fitted := _line(envelope[window], center, record.rate))[0] > floor
    ]
    if len(lines) < _FEWEST:
        return None
    amplitude, frequency, damping = np.array(lines).T
    return RingDown(mode + 1, channel, record.unit(channel), amplitude, frequency, damping)


def _end_of_force(record: Record) -> int:
    """The first sample after which no force acts."""
    last = 0
    for name in record.inputs:
        applied = np.abs(record.channel(name))
        if applied.any():
            last = max(last, int(np.flatnonzero(applied > _SILENT * applied.max())[-1]) + 1)
    return last


def _envelope(values: Floats, center: float, half: float, rate: float) -> np.ndarray:
    """(N,) complex envelope of the motion within `half` a band around `center`, in Hz."""
    count = len(values)
    frequency = np.fft.fftfreq(2 * count, 1.0 / rate)
    weight = np.clip(2.0 * (1.0 - np.abs(frequency - center) / half), 0.0, 1.0)  # flat in its middle half
    mirrored = np.concatenate([values, -values[::-1]])
    analytic = np.fft.ifft(2.0 * np.fft.fft(mirrored) * weight)[:count]
    return np.asarray(analytic * np.exp(-2j * np.pi * center * np.arange(count) / rate))


def _line(envelope: np.ndarray, center: float, rate: float) -> tuple[float, float, float]:
    """Amplitude, frequency and damping from straight lines through the phase and the logarithm of the amplitude."""
    size = np.abs(envelope)
    time = (np.arange(len(envelope)) - 0.5 * (len(envelope) - 1)) / rate
    square = float(time @ time)
    tiny = np.finfo(float).tiny
    growth = float(time @ np.log(np.maximum(size, tiny))) / square
    turning = float(time @ np.unwrap(np.angle(envelope))) / square
    frequency = center + turning / (2.0 * np.pi)
    return (
        float(np.exp(np.mean(np.log(np.maximum(size, tiny))))),
        frequency,
        -growth / (2.0 * np.pi * frequency),
    )
