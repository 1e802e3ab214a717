"""How a structure moves after a release, and how far that can be known: worked out once for every picture of it."""

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
    """A simulated `record` of displacements and the range that its neighbours cover.

    `least` and `greatest` (N, n) in m are the extremes, sample by sample, of orbits whose releases differ by
    parts of `APART`. Up to the horizon they are one curve; past it the record shows one of many.
    """

    record: Record
    least: Floats
    greatest: Floats

    @property
    def horizon(self) -> float | None:
        """The time in s past which the orbit is one of many; None where it can be told throughout."""
        return self.record.simulated.horizon if self.record.simulated else None

    @property
    def masses(self) -> tuple[str, ...]:
        """The masses, in the structure's order."""
        return self.record.masses


def motion_after(
    structure: Structure, release: Mapping[str, float], *, duration: float, rate: float
) -> OrbitEnvelope:
    """The motion of every mass after `release` ({"v:m1": m/s, "x:m1": m}), as `simulate` has it.

    Neighbours are run only where chaos leaves something to show. Raises what `simulate` raises.
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
