"""The vibration of the primary masses of one run or of many about their rest positions."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.absorption.decay import Decay
from linkwise.absorption.places import place_motion
from linkwise.absorption.rest_positions import RestPositions
from linkwise.absorption.runs import Runs
from linkwise.arrays import Floats
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Vibration:
    """The P primary masses and points, `places`, of W runs of `structures`, about the rest positions nearest to their ends."""

    runs: Runs
    structures: Sequence[Structure]
    places: Sequence[str]
    positions: Sequence[RestPositions]

    @cached_property
    def rest(self) -> Floats:
        """(P, W) m: where the masses come to rest."""
        last = place_motion(self.structures, self.runs.x[-1:], self.places)[0]
        return np.stack(
            [positions.nearest(last[:, run]) for run, positions in enumerate(self.positions)], axis=1
        )

    @cached_property
    def decay(self) -> Decay:
        """The excursions (N, P, W) from there."""
        x = place_motion(self.structures, self.runs.x, self.places)
        v = place_motion(self.structures, self.runs.v, self.places)
        return Decay(self.runs.time, x - self.rest, v)

    @property
    def peak(self) -> Floats:
        """(P, W) m: the largest excursion."""
        return self.decay.peak

    @cached_property
    def rms(self) -> Floats:
        """(P, W) m: the root mean square excursion."""
        return np.sqrt(self.decay.mean_square)

    def settled(self, level: Floats) -> Floats:
        """(P, W) s: the time after which a mass stays below `level` (P, W) m; NaN if it does not."""
        return self.decay.settled(level)


def reduction(with_sinks: Floats, without: Floats) -> Floats:
    """The relative reduction by the sinks; NaN if there is nothing to reduce."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(without > 0.0, 1.0 - with_sinks / without, np.nan))


def comparable(without: Floats, units: Collection[str]) -> Floats:
    """(P, ...) factors by which displacements of P masses may be added: 1, but over those `without` sinks in several `units`.

    Metres and radians have no sum, parts of what a mass would do without sinks have one. Masses at rest count for nothing.
    """
    if len(set(units)) <= 1:
        return np.ones_like(without)
    return np.divide(1.0, without, out=np.zeros_like(without), where=without > 0.0)


def root_sum_square(values: Floats) -> Floats:
    """(W,) of `values` (P, W), over the masses."""
    return np.asarray(np.sqrt(np.square(values).sum(axis=0)))
