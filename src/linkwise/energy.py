"""Energies of a structure over a given motion: kinetic, stored in each link, dissipated by each link."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from linkwise.errors import StructureError
from linkwise.structure import Structure

Array = NDArray[np.float64]

ORDER = (
    5  # of the spline through the power: the dissipated energy is exact to the sixth order of the time step
)


def kinetic_energy(structure: Structure, v: ArrayLike) -> Array:
    """(N,) in J from velocities `v` (N, n) in m/s."""
    energy: Array = 0.5 * np.square(np.asarray(v, dtype=float)) @ structure.mass_values
    return energy


def potential_energy(structure: Structure, x: ArrayLike, base: ArrayLike | None = None) -> Array:
    """(N, L) in J stored in each link, zero at zero elongation, from displacements `x` (N, n) and `base` (N,) in m."""
    d = structure.elongations(x, base)
    return np.stack([link.potential(d[..., column]) for column, link in enumerate(structure.links)], axis=-1)


def dissipated_energy(
    structure: Structure,
    time: ArrayLike,
    x: ArrayLike,
    v: ArrayLike,
    *,
    base: ArrayLike | None = None,
    base_velocity: ArrayLike | None = None,
) -> Array:
    """(N, L) in J that each link has turned into heat since the first sample: the integral of (f(d, v) - f(d, 0)) v.

    `time` (N,) in s; `x`, `v` (N, n); `base`, `base_velocity` (N,) where a link holds on to the base. The power is integrated
    as a spline of order 5 through the samples. Raises StructureError with fewer than 6 samples.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size <= ORDER:
        raise StructureError(
            f"the dissipated energy needs at least {ORDER + 1} samples of the motion, got {time.size}"
        )
    d, rate = structure.elongations(x, base), structure.elongations(v, base_velocity)
    power = np.stack(
        [
            (link.force(d[:, column], rate[:, column]) - link.force(d[:, column])) * rate[:, column]
            for column, link in enumerate(structure.links)
        ],
        axis=1,
    )
    return np.asarray(make_interp_spline(time, power, k=ORDER).antiderivative()(time), dtype=float)
