"""What late sensors show of coordinates that move: a known signal at delays of any size up to a sample and a half.

Over the delay the signal is the polynomial through its values at Chebyshev's points. To first order alone a delay of half a
sample would leave an eighth of a signal at a sixth of the sampling rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.late_sensors import LARGEST
from linkwise.model.excitation import Sampled

_POINTS = 9  # odd, so that one of them is no delay; 1e-4 of a signal at 0.29 of the sampling rate is left
EDGE = 3
"""Samples at both ends of a record that late sensors cannot use, as the base a delay earlier or later was not recorded."""
_BAND_LIMITED = 64  # samples from which a windowed sinc interpolates accurately


def values_at_delays(values: Floats, rate: float) -> Floats:
    """(P, N) a signal `values` (N,) at Chebyshev's points of delay, ascending; beyond its ends it runs straight on."""
    signal = Sampled(0.0, rate, values, band_limited=len(values) > _BAND_LIMITED)
    sample = np.arange(len(values)) / rate
    rows = []
    for place in places_of_delays():
        time = sample - place * LARGEST / rate
        inside = np.clip(time, 0.0, sample[-1])
        beyond = np.flatnonzero(time != inside)
        row = signal.value(inside)
        row[beyond] += signal.derivative(inside[beyond]) * (time[beyond] - inside[beyond])
        rows.append(row)
    return np.stack(rows)


def places_of_delays() -> Floats:
    """(P,) Chebyshev's points between -1 and 1, ascending; the middle one is 0."""
    places = np.cos(np.pi * (2 * np.arange(_POINTS)[::-1] + 1) / (2 * _POINTS))
    places[_POINTS // 2] = 0.0
    return np.asarray(places)


def powers_through(values: Floats) -> Floats:
    """Coefficients of powers of the delay over its largest, constant first, of `values` (P, ...) at Chebyshev's points."""
    powers = np.vander(places_of_delays(), increasing=True)
    coefficients = np.linalg.solve(powers, values.reshape(len(values), -1))
    return np.asarray(coefficients).reshape(values.shape)


@dataclass(frozen=True, eq=False)
class LateBase:
    """Polynomials in the delay of what `channels` show of moving coordinates.

    `coefficients` (P, M, L, K) of powers of the delay over its largest, constant first; `step` (K,) of the samples in s.
    """

    channels: tuple[int, ...]
    coefficients: Floats
    step: Floats

    @classmethod
    def through(cls, channels: Sequence[int], values: Floats, step: Floats) -> LateBase:
        """Through `values` (P, M, L, K) at the points of `values_at_delays`."""
        return cls(tuple(channels), powers_through(values), step)

    def chosen(self, which: Indices) -> LateBase:
        """Those of some of the segments."""
        return replace(self, coefficients=self.coefficients[..., which], step=self.step[which])

    def at(self, channel: int, delay: float, part: slice = slice(None)) -> tuple[Floats, Floats]:
        """(M, k) what a channel shows that is `delay` s late, and its rate; straight on beyond the largest delay."""
        coefficients = self.coefficients[:, :, self.channels.index(channel), part]
        unit = LARGEST * self.step[part]
        place = np.clip(delay / unit, -1.0, 1.0)
        value, slope = np.zeros(coefficients.shape[1:]), np.zeros(coefficients.shape[1:])
        for row in coefficients[::-1]:
            slope = slope * place + value
            value = value * place + row
        return value + slope * (delay / unit - place), -slope / unit
