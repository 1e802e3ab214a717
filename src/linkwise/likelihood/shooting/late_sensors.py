"""What sensors show that are late: the fitted motion between its samples, and its rate.

Between its samples the motion is the polynomial of degree 11 that agrees with displacement, velocity and acceleration at
four of them around; before the first of a segment it is that of the first four.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.flow import Trajectories

_POINTS = 4  # samples of a polynomial: before a segment, fewer would leave more of accelerations at a third of the rate
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
    points = min(_POINTS, len(x))
    sample = np.arange(len(x) - 1)[:, None]
    around = np.floor(-delay / step).astype(int) + 1 - points // 2
    first = np.clip(sample + around, 0, len(x) - points)
    at_points = [
        np.take_along_axis(signal, first + point, axis=0) for point in range(points) for signal in (x, v, a)
    ]
    place = sample - delay / step - first
    polynomial = np.tensordot(_through(points), np.stack(at_points), axes=1)
    shown, rate = (_derivative(polynomial, place, order) / step**order for order in (kind, kind + 1))
    return shown, rate


@cache
def _through(points: int) -> Floats:
    """(3P, 3P) coefficients of the polynomial with values, slopes and curvatures, point by point, at 0, 1, .. P - 1."""
    degrees, places = np.arange(3 * points), np.arange(points)
    rows = []
    for place in places:
        for order in range(3):
            factor = np.prod([degrees - lower for lower in range(order)], axis=0)
            rows.append(factor * float(place) ** np.maximum(degrees - order, 0))
    return np.asarray(np.linalg.solve(np.array(rows, dtype=float), np.eye(3 * points)))


def _derivative(coefficients: Floats, place: Floats, order: int) -> Floats:
    """The polynomial's derivative of an order at `place`, by Horner's scheme."""
    total = np.zeros_like(place)
    for power in range(len(coefficients) - 1, order - 1, -1):
        factor = np.prod(np.arange(power - order + 1, power + 1, dtype=float))
        total = total * place + factor * coefficients[power]
    return total
