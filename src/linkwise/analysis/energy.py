"""Energies of a structure over a given motion: kinetic, and stored in each link."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.model.structure import Structure


def kinetic_energy(structure: Structure, v: ArrayLike) -> Floats:
    """Kinetic energy (N,) in J, from velocities `v` (N, n) in m/s."""
    energy: Floats = 0.5 * np.square(np.asarray(v, dtype=float)) @ structure.mass_values
    return energy


def potential_energy(structure: Structure, x: ArrayLike, base: ArrayLike | None = None) -> Floats:
    """Energy (N, L) in J stored in each link, 0 at zero elongation, from displacements `x` (N, n) and `base` (N,) in m."""
    d = structure.elongations(x, base)
    return np.stack([link.potential(d[..., column]) for column, link in enumerate(structure.links)], axis=-1)
