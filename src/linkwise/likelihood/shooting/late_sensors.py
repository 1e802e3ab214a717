"""What sensors show that are late: the fitted motion between its samples, and its rate.

Between two samples the motion is the polynomial of fifth degree that agrees with displacement, velocity and acceleration at
both; before the first of a segment it is that of the first two.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.flow import Trajectories

LARGEST = 1.5
"""Delay in samples up to which the polynomials hold; the records are shifted by whole samples for more."""


def late_motion(
    orbit: Trajectories, step: Floats, stride: int, *, mass: int, kind: int, delay: float
) -> tuple[Floats, Floats]:
    """(M, K) what a sensor of this `kind` shows of a mass at the samples, `delay` s late, and the rate of it.

    `step` (K,) is that of the samples, with `stride` steps of the flow.
    """
    x = orbit.states[::stride, 0, mass]
    v = orbit.states[::stride, 1, mass] * stride
    a = orbit.accelerations[::stride, mass] * step**2
    sample = np.arange(len(x) - 1)[:, None]
    first = np.clip(sample + np.floor(-delay / step).astype(int), 0, len(x) - 2)
    ends = (np.take_along_axis(each, first + end, axis=0) for end in (0, 1) for each in (x, v, a))
    place, polynomial = sample - delay / step - first, _quintic(*ends)
    shown, rate = (_derivative(polynomial, place, order) / step**order for order in (kind, kind + 1))
    return shown, rate


def _quintic(*ends: Floats) -> tuple[Floats, ...]:
    """Coefficients of the polynomial on 0..1 with value, slope and curvature x, v, a at 0 and y, w, b at 1."""
    x, v, a, y, w, b = ends
    value, slope, curvature = y - x - v - 0.5 * a, w - v - a, b - a
    return (
        x,
        v,
        0.5 * a,
        10.0 * value - 4.0 * slope + 0.5 * curvature,
        -15.0 * value + 7.0 * slope - curvature,
        6.0 * value - 3.0 * slope + 0.5 * curvature,
    )


def _derivative(coefficients: tuple[Floats, ...], place: Floats, order: int) -> Floats:
    """The polynomial's derivative of an order at `place`, by Horner's scheme."""
    total = np.zeros_like(place)
    for power in range(len(coefficients) - 1, order - 1, -1):
        factor = np.prod(np.arange(power - order + 1, power + 1, dtype=float))
        total = total * place + factor * coefficients[power]
    return total
