"""A record as the checks look at it: its channels, each with its noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.kinematics import KinematicFit, kinematic_fits
from linkwise.inspection.rest import QUIET
from linkwise.records.channel import ANGULAR_UNITS
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma


@dataclass(frozen=True, eq=False)
class RecordSignals:
    """The `channels` of a `record`."""

    record: Record
    channels: tuple[ChannelSignal, ...]

    @classmethod
    def of(cls, record: Record) -> RecordSignals:
        """Those of a record; noise is what the record states, else estimated."""
        estimated = noise_sigma(record.values)
        channels = []
        for name, values, sigma in zip(record.channels, record.values.T, estimated, strict=True):
            stated = record.noise.get(name, np.nan)
            noise = float(sigma if np.isnan(stated) else stated)
            angular = record.unit(name) in ANGULAR_UNITS.values()
            channels.append(ChannelSignal(name, values, record.rate, record.start, noise, angular))
        return cls(record, tuple(channels))

    @property
    def moving(self) -> tuple[ChannelSignal, ...]:
        """Channels that are not constant."""
        return tuple(signal for signal in self.channels if not signal.is_constant)

    @property
    def responses(self) -> tuple[ChannelSignal, ...]:
        """Channels of masses that are not constant."""
        return tuple(signal for signal in self.moving if not signal.is_input)

    def rest_of(self, signal: ChannelSignal) -> slice | None:
        """The samples at an end in which a channel rests and nothing drives the structure; None where there are none."""
        if signal.rest is None:
            return None
        driven = (
            float(np.std(given.filled[signal.rest])) > QUIET * given.rms
            for given in self.moving
            if given.is_input
        )
        return None if any(driven) else signal.rest

    @cached_property
    def kinematics(self) -> tuple[KinematicFit, ...]:
        """How channels of one place follow from each other."""
        return tuple(kinematic_fits(self.moving))
