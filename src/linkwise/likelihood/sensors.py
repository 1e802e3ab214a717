"""Sensors of several records: their noise, and which of them have an unknown offset or gain."""

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

SAMPLES = (
    5  # in a segment: shorter ones have more unknowns, longer ones a steeper cost where motion is chaotic
)


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Unknown offsets and gains of channels, and their noise.

    Attributes
    ----------
    offsets, gains : tuple of str
        Channels with an unknown constant error or factor.
    noise : tuple of dict of str to float
        For each record the standard deviations of the noise by channel, in SI units.
    """

    offsets: tuple[str, ...]
    gains: tuple[str, ...]
    noise: tuple[dict[str, float], ...]

    @classmethod
    def of(cls, records: Sequence[Record], offsets: Sequence[str], gains: Sequence[str]) -> SensorModel:
        """Sensors of records.

        Parameters
        ----------
        records : sequence of Record
            The records. Noise that they state is used; the rest is estimated.
        offsets, gains : sequence of str
            Channels with an unknown constant error or factor.

        Returns
        -------
        SensorModel
            The sensors.
        """
        return cls(tuple(offsets), tuple(gains), tuple(channel_noise(record) for record in records))

    @property
    def sigma(self) -> Floats:
        """(C,) standard deviations of the noise in the first record; those of others are relative to it."""
        return np.array(list(self.noise[0].values()))

    def segments(
        self, records: Sequence[Record], structure: Structure, system: System, refine: int
    ) -> Segments:
        """Cut records into segments.

        Parameters
        ----------
        records : sequence of Record
            The records.
        structure : Structure
            The structure.
        system : System
            The structure as arrays.
        refine : int
            Steps of the flow per sample.

        Returns
        -------
        Segments
            The segments.
        """
        relative_noise = (
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
            relative_noise=relative_noise,
        )
