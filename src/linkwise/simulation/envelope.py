"""The motion after a release, with the range of orbits from releases that differ by less than can be repeated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.simulation.simulate import simulate

NEIGHBOURS = 12
APART = 1e-12  # of the release, from one neighbour to the next: less than any test rig could repeat


@dataclass(frozen=True, eq=False)
class OrbitEnvelope:
    """A simulated motion, and the range of the orbits that start so close to it that no test could tell the releases apart.

    Up to the horizon they coincide; past it the record is one of many possible orbits.

    Attributes
    ----------
    record : Record
        The displacements of the N samples.
    least, greatest : numpy.ndarray, shape (N, n)
        The extremes of the neighbouring orbits, sample by sample, in m: releases differ by multiples of 1e-12 of themselves.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> motion.horizon is None, motion.masses
    (True, ('m1', 'm2'))
    """

    record: Record
    least: Floats
    greatest: Floats

    @property
    def horizon(self) -> float | None:
        """Time in s past which the orbit is one of many; None where it is predictable throughout."""
        return self.record.simulated.horizon if self.record.simulated else None

    @property
    def masses(self) -> tuple[str, ...]:
        """Names of the masses, in the order of the structure."""
        return self.record.masses


@checked
def orbit_envelope(
    structure: Structure, release: Mapping[str, float], *, duration: float, rate: float
) -> OrbitEnvelope:
    """The motion of every mass after a release, with the range of neighbouring orbits where it is chaotic.

    Twelve neighbours are simulated, and only if the motion has a horizon.

    Parameters
    ----------
    structure : Structure
        What moves; every coefficient is a number.
    release : dict of str to float
        Velocities in m/s and displacements in m at time 0: ``{"v:m1": 1.0, "x:m2": 0.01}``.
    duration : float
        Length of the record in s.
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    OrbitEnvelope
        The record and the extremes of its neighbours.

    Raises
    ------
    TypeError
        If `release` is no mapping.
    SimulationError, StructureError
        As `simulate` raises them.

    Examples
    --------
    >>> import linkwise as lw
    >>> motion = lw.orbit_envelope(lw.bnes_chain(2), {"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> bool((motion.least == motion.greatest).all())  # predictable throughout
    True
    """

    def run(factor: float) -> Record:
        start = {name: factor * value for name, value in release.items()}
        return simulate(structure, release=start, duration=duration, rate=rate)

    record = run(1.0)
    least, greatest = record.values.copy(), record.values.copy()
    if record.simulated is not None and record.simulated.horizon is not None:
        for number in range(1, NEIGHBOURS + 1):
            values = run(1.0 + number * APART).values
            np.minimum(least, values, out=least)
            np.maximum(greatest, values, out=greatest)
    return OrbitEnvelope(record, least, greatest)
