"""Odd and even distortion of the response to a periodic force, and its scatter from period to period.

A linear structure answers at the frequencies of the force alone. Where these are odd multiples of the reciprocal of the
period, what even terms of the laws add is at even multiples, and what odd terms add at odd multiples that the force leaves
out. The scatter from period to period is noise, and what of the motion at the start has not died out in the second half of
the periods, which alone counts; that motion is at all frequencies, even and odd multiples among them.

References
----------
R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach (2012), section 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.record import Record

_ALIKE = 0.02  # power of the difference of two periods of a force over its own
_SHORTEST = 8  # samples of a period
_EXCITED = 0.01  # of the largest amplitude of the force: a frequency that it excites
_SETTLING = 0.5  # of the periods, at the start, which are left out where two remain


@dataclass(frozen=True)
class Distortion:
    """Distortion of the response in one channel.

    Attributes
    ----------
    channel : str
        The response.
    period : float
        Period of the force in s.
    odd, even : float or None
        Power at odd and even multiples that the force leaves out, over that of the response, in dB; None where the force
        excites even multiples, or leaves none out.
    noise : float
        Power of the scatter from period to period, over that of the response, in dB: noise, and what of the start has not died
        out. Odd or even distortion below it may be a part of these.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_sine.csv"), lw.read_record("hard_sine.csv")], modes=1)
    >>> found.distortions[0].period
    0.0625
    """

    channel: str
    period: float
    odd: float | None
    even: float | None
    noise: float


def distortion(record: Record, response: str, force: str) -> Distortion | None:
    """That of a response to a force; None where the force does not repeat, or samples are missing."""
    applied, values = record.channel(force), record.channel(response)
    period = _period(applied)
    if period is None or not np.isfinite(values).all():
        return None
    count = len(record) // period
    skipped = min(int(_SETTLING * count), count - 2)
    first = len(record) - (count - skipped) * period
    blocks = [signal[first:].reshape(-1, period) for signal in (applied, values)]
    of_force, of_response = (np.fft.rfft(block, axis=1)[:, 1 : period // 2] for block in blocks)
    lines = np.arange(1, of_force.shape[1] + 1)
    amplitude = np.abs(of_force.mean(axis=0))
    excited = amplitude > _EXCITED * amplitude.max()
    mean = of_response.mean(axis=0)
    scatter = np.sum(np.abs(of_response - mean) ** 2, axis=0) / max(len(of_response) - 1, 1)
    power = float(np.sum(np.abs(mean[excited]) ** 2))
    only_odd = not excited[lines % 2 == 0].any()
    decibels = {}
    for name, parity in (("odd", 1), ("even", 0)):
        unexcited = ~excited & (lines % 2 == parity)
        measured = only_odd and unexcited.any()
        decibels[name] = _decibel(float(np.sum(np.abs(mean[unexcited]) ** 2)), power) if measured else None
    return Distortion(
        channel=response,
        period=period * record.step,
        noise=_decibel(float(scatter.sum()) / len(of_response), power),
        **decibels,
    )


def _decibel(part: float, whole: float) -> float:
    tiny = np.finfo(float).tiny
    return float(10.0 * np.log10(max(part, tiny) / max(whole, tiny)))


def _period(force: Floats) -> int | None:
    """The shortest shift in samples after which a force repeats, twice or more in the record; None if there is none."""
    values = force - force.mean()
    n = len(values)
    spectrum = np.fft.rfft(values, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: n // 2 + 1]
    squares = np.concatenate([[0.0], np.cumsum(values**2)])
    shift = np.arange(n // 2 + 1)
    power = squares[n] - squares[shift] + squares[n - shift]  # of both parts
    difference = np.divide(power - 2.0 * products, power, out=np.ones_like(power), where=power > 0.0)
    repeats = difference[_SHORTEST:-1] < _ALIKE
    dips = repeats & (difference[_SHORTEST:-1] <= difference[_SHORTEST - 1 : -2])
    dips &= difference[_SHORTEST:-1] <= difference[_SHORTEST + 1 :]
    shifts = np.flatnonzero(dips) + _SHORTEST
    return int(shifts[0]) if len(shifts) else None
