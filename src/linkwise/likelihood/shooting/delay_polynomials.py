"""Known signals with an unknown delay, applied forces and motion of a base, as polynomials in the delay.

They go through Chebyshev's points: to first order alone a delay of half a sample would leave an eighth of a signal at a sixth
of the sampling rate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.excitation import Sampled

LARGEST = 1.5
"""Delay in samples up to which the polynomials hold; the records are shifted by whole samples for more."""

# odd, so that one of them is no delay; 1e-4 of a signal at 0.29 of the sampling rate is left
_BASE_POINTS = 9
EDGE = 3
"""Samples at both ends of a record that late sensors cannot use, as the base a delay earlier or later was not recorded."""


def at_delays(signal: Sampled, time: Floats, largest: float) -> Floats:
    """(P, ...) a signal at times (...) that are late by Chebyshev's points of delay, ascending, up to the `largest` in s, a
    negative one where the signal is late; beyond its ends it runs straight on.
    """
    return np.stack([straight_on(signal, time - place * largest) for place in places_of_delays()])


def straight_on(signal: Sampled, time: Floats) -> Floats:
    """A signal from 0 s on at some times, beyond its ends by its slopes there."""
    inside = np.clip(time, 0.0, signal.end)
    value, beyond = signal.value(inside), time != inside
    value[beyond] += signal.derivative(inside[beyond]) * (time[beyond] - inside[beyond])
    return value


def places_of_delays() -> Floats:
    """(P,) Chebyshev's points between -1 and 1, ascending; the middle one is 0."""
    places = np.cos(np.pi * (2 * np.arange(_BASE_POINTS)[::-1] + 1) / (2 * _BASE_POINTS))
    places[_BASE_POINTS // 2] = 0.0
    return np.asarray(places)


def powers_through(values: Floats) -> Floats:
    """Coefficients of powers of the delay over its largest, constant first, of `values` (P, ...) at Chebyshev's points."""
    powers = np.vander(places_of_delays(), increasing=True)
    coefficients = np.linalg.solve(powers, values.reshape(len(values), -1))
    return np.asarray(coefficients).reshape(values.shape)


def value_and_slope(coefficients: Sequence[Floats] | Floats, late: Floats) -> tuple[Floats, Floats]:
    """The value and the slope of polynomials in the delay over the largest one, straight on beyond that."""
    place = np.clip(late, -1.0, 1.0)
    value, slope = np.zeros_like(coefficients[0]), np.zeros_like(coefficients[0])
    for row in coefficients[::-1]:
        slope = slope * place + value
        value = value * place + row
    return value + slope * (late - place), slope
