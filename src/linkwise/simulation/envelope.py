"""The motion after a release, with the range of orbits from releases that differ by less than can be repeated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.simulation.simulate import simulate

NEIGHBOURS = 12
APART = 1e-12  # of the release, from one neighbour to the next: less than any test rig could repeat


@dataclass(frozen=True, eq=False)
class OrbitEnvelope:
    """A simulated `record` of displacements, and the range of its neighbouring orbits.

    `least` and `greatest` (N, n) in m are the extremes, sample by sample, of orbits whose releases differ by multiples of
    `APART`. Up to the horizon they coincide; past it the record is one of many possible orbits.
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


def motion_after(
    structure: Structure, release: Mapping[str, float], *, duration: float, rate: float
) -> OrbitEnvelope:
    """The motion of every mass after `release`, ``{"v:m1": m/s, "x:m1": m}``, over `duration` in s at `rate` in Hz.

    Neighbouring orbits are simulated only if the motion is chaotic. Raises the errors of `simulate`.
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
