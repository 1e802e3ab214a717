"""What is known of the sensors of several records: their noise, and which of them have an unknown offset or gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.segmentation import cut_segments
from linkwise.likelihood.segments import Segments
from linkwise.likelihood.system import System
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise

SAMPLES = 5  # in a segment: shorter ones cost unknowns, longer ones make a chaotic flow steep


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Which channels have an unknown offset or gain, and the `noise` of every channel in each record."""

    offsets: tuple[str, ...]
    gains: tuple[str, ...]
    noise: tuple[dict[str, float], ...]

    @classmethod
    def of(cls, records: Sequence[Record], offsets: Sequence[str], gains: Sequence[str]) -> SensorModel:
        """With the noise that the records state, else what is found in them."""
        return cls(tuple(offsets), tuple(gains), tuple(channel_noise(record) for record in records))

    @property
    def sigma(self) -> Floats:
        """(C,) noise in the first record; that of the others is cut in as a factor."""
        return np.array(list(self.noise[0].values()))

    def segments(
        self, records: Sequence[Record], structure: Structure, system: System, refine: int
    ) -> Segments:
        """The segments of the records."""
        loudness = (
            [np.array(list(noise.values())) / self.sigma for noise in self.noise]
            if len(self.noise) > 1
            else None
        )
        return cut_segments(
            records,
            structure,
            system,
            samples=SAMPLES,
            refine=refine,
            offsets=self.offsets,
            gains=self.gains,
            loudness=loudness,
        )
