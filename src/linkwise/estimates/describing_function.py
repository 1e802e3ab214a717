"""What a link's law is worth at an amplitude: the linear spring and damper that store and take as much in one cycle.

The describing function of a force f(d, v) for d = A sin(w t) (Krylov, Bogoliubov 1943; the first harmonic of the force over
that of the motion):

    k(A) = 1/(pi A) int_0^{2 pi} f sin,   c(A) = 1/(pi A w) int_0^{2 pi} f cos
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.estimates.link_estimate import NORMAL_95, LinkEstimate

_POINTS = 512  # of a cycle: exact for polynomials, and 1e-5 for laws with kinks


@dataclass(frozen=True, eq=False)
class Equivalent:
    """At `amplitude` (A,) m: `stiffness` (A,) N/m and `damping` (A,) N s/m with their 95 % bands, (A, 2), NaN without any."""

    amplitude: Floats
    stiffness: Floats
    stiffness_band: Floats
    damping: Floats
    damping_band: Floats


def equivalent(found: LinkEstimate, amplitude: ArrayLike, frequency: float) -> Equivalent:
    """The equivalent spring and damper of an identified link at `amplitude` in m and `frequency` in Hz."""
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    omega = 2.0 * np.pi * frequency
    phase = 2.0 * np.pi * np.arange(_POINTS) / _POINTS
    d, v = np.outer(a, np.sin(phase)), omega * np.outer(a, np.cos(phase))
    partials = found.link.law.partials(d, v, found.link.values)
    slopes = [np.broadcast_to(partials.by_coefficient[name], d.shape) for name in found.free]
    answers = []
    for shape, unit in ((np.sin(phase), a), (np.cos(phase), a * omega)):
        weight = 2.0 * shape / _POINTS
        value = partials.force @ weight / unit
        gradient = (
            np.stack([slope @ weight / unit for slope in slopes], axis=1) if slopes else np.zeros((len(a), 0))
        )
        answers += [value, _band(value, gradient, found)]
    return Equivalent(a, *answers)


def _band(value: Floats, gradient: Floats, found: LinkEstimate) -> Floats:
    """(A, 2) ends of the 95 % band; the law is taken as linear in its coefficients over their errors."""
    if found.covariance is None and found.free:
        return np.full((len(value), 2), np.nan)
    covariance = np.zeros((0, 0)) if found.covariance is None else found.covariance
    half = NORMAL_95 * np.sqrt(np.maximum(np.einsum("ai,ij,aj->a", gradient, covariance, gradient), 0.0))
    return np.stack([value - half, value + half], axis=1)
