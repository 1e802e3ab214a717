"""Sensors of several records: their noise, their calibration, and which of them have an unknown offset or gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.likelihood.random_forces import RandomForce
from linkwise.likelihood.shooting.force_channels import with_uncertain_forces
from linkwise.likelihood.shooting.moving_coordinates import in_moving_coordinates
from linkwise.likelihood.shooting.prior import Prior
from linkwise.likelihood.shooting.segmentation import cut, cut_segments
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.waveforms import Disturbance, Waveforms
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.channel import FORCE, Channel
from linkwise.records.record import Record
from linkwise.signals.base_frame import FramedRecord
from linkwise.signals.noise import channel_noise, noise_floor

# in a segment: shorter ones have more unknowns, longer ones a steeper cost where motion is chaotic
SAMPLES = 5


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Unknown offsets and gains of channels, and their noise.

    Attributes
    ----------
    offsets, gains, delays : tuple of str
        Channels with an unknown constant error, factor or delay; ``"common"`` is a factor of all of them.
    noise : tuple of dict of str to float
        For each record the standard deviations of the noise by channel, in SI units.
    calibration : mapping of str to float
        Standard deviations to which gains are known beforehand, relative, by channel.
    offset_deviations : mapping of str to float
        Those of offsets, in the unit of the channel.
    delay_priors : mapping of str to tuple of float
        Mean and standard deviation of delays, in s.
    frames : tuple of FramedRecord
        Where the records are in coordinates that move, what these are.
    random : tuple of RandomForce
        Random forces on masses.
    disturbances : tuple of Disturbance
        Drifts and hums of channels.
    sparse : bool
        Whether the records have so few samples a period that a flow over several is far from linear in its start.
    """

    offsets: tuple[str, ...]
    gains: tuple[str, ...]
    noise: tuple[dict[str, float], ...]
    calibration: Mapping[str, float] = field(default_factory=dict)
    delays: tuple[str, ...] = ()
    offset_deviations: Mapping[str, float] = field(default_factory=dict)
    delay_priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    frames: tuple[FramedRecord, ...] = ()
    random: tuple[RandomForce, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    sparse: bool = False

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        offsets: Sequence[str],
        gains: Sequence[str],
        calibration: Mapping[str, float] | None = None,
        delays: Sequence[str] = (),
    ) -> SensorModel:
        """Sensors of records.

        Parameters
        ----------
        records : sequence of Record
            The records. Noise that they state is used; the rest is estimated.
        offsets, gains : sequence of str
            Channels with an unknown constant error or factor; of factors also those of applied forces.
        calibration : mapping of str to float, optional
            Standard deviations to which gains are known beforehand, relative, by channel; they are unknown too.
        delays : sequence of str, optional
            Channels with an unknown delay, of sensors and of applied forces.

        Returns
        -------
        SensorModel
            The sensors.
        """
        known = dict(calibration or {})
        every = dict.fromkeys((*gains, *known))
        noise = tuple(channel_noise(record) for record in records)
        return cls(tuple(offsets), tuple(every), noise, known, tuple(delays))

    def prior(self, parameters: Sequence[Parameter]) -> Prior | None:
        """What is known beforehand of parameters, offsets, gains and delays.

        Parameters
        ----------
        parameters : sequence of Parameter
            The parameters of the structure.

        Returns
        -------
        Prior or None
            The prior; None where nothing is known.
        """
        starts = [0.0 if p.start is None else p.start for p in parameters]
        late = np.array([self.delay_priors.get(name, (0.0, np.inf)) for name in self.delays]).reshape(-1, 2)
        waveforms = sum(disturbance.count for disturbance in self.disturbances)
        offsets = [self.offset_deviations.get(name, np.inf) for name in self.offsets] + [np.inf] * waveforms
        mean = np.concatenate([starts, np.zeros(len(offsets)), np.ones(len(self.gains)), late[:, 0]])
        sigma = [p.sigma for p in parameters]
        gains = [self.calibration.get(name, np.inf) for name in self.gains]
        prior = Prior(mean, np.concatenate([sigma, offsets, gains, late[:, 1]]))
        return prior if prior.count else None

    @property
    def samples(self) -> int:
        """Samples in a segment: one with random forces, each of which is constant in a segment, and of sparse samples."""
        return 1 if self.random or self.sparse else SAMPLES

    @property
    def centred(self) -> bool:
        """Whether samples are in the middle of segments: accelerations show ambient forces, as a mean over the time around."""
        record = self.frames[0].record if self.frames else None
        if record is None or not self.random or record.inputs:
            return False
        return any(channel.kind == "a" for channel in record.responses)

    @property
    def sigma(self) -> Floats:
        """(C,) standard deviations of the noise in the first record; those of others are relative to it."""
        return np.array(list(self.noise[0].values()))

    def stated(self, records: Sequence[Record]) -> Bools:
        """(C,) whether a record states the noise of a channel."""
        return np.array([any(name in record.noise for record in records) for name in self.noise[0]])

    def lowest(self, records: Sequence[Record]) -> Floats:
        """(C,) the least deviations of the noise that residuals may show: infinite where a record states it."""
        floors = [noise_floor(record) for record in records]
        least = [max(floor[name] for floor in floors) for name in self.noise[0]]
        return np.where(self.stated(records), np.inf, least)

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
        segments = cut_segments(
            records,
            structure,
            system,
            samples=self.samples,
            refine=refine,
            offsets=self.offsets,
            gains=self.gains,
            relative_noise=relative_noise,
        )
        segments = replace(
            segments,
            sensors=replace(
                segments.sensors,
                delay=self._delays(records[0].responses),
                waveforms=sum(disturbance.count for disturbance in self.disturbances),
            ),
            prior=self.prior(structure.parameters),
            waveforms=self._waveforms(records),
            clipped=None if self.random else segments.clipped,
            centred=self.centred,
        )
        segments = in_moving_coordinates(segments, self.frames)
        return with_uncertain_forces(segments, records, structure, self.gains, self.delays)

    def _waveforms(self, records: Sequence[Record]) -> Waveforms | None:
        """What the disturbances add to the samples, each in its own record; None without any."""
        if not self.disturbances:
            return None
        responses = records[0].responses
        channel = [
            responses.index(disturbance.channel)
            for disturbance in self.disturbances
            for _ in range(disturbance.count)
        ]
        parts = [
            cut(
                np.concatenate(
                    [
                        disturbance.shapes(record) * (disturbance.record == number)
                        for disturbance in self.disturbances
                    ],
                    axis=1,
                ),
                self.samples,
            )
            for number, record in enumerate(records)
        ]
        return Waveforms(np.array(channel), np.nan_to_num(np.concatenate(parts, axis=2)))

    def _delays(self, channels: Sequence[Channel]) -> Indices:
        """(C,) index of the unknown delay of each channel, -1 for none."""
        sensors = [channel for channel in channels if not channel.of_link]
        absent = [name for name in self.delays if not name.startswith(FORCE) and name not in sensors]
        if absent:
            raise IdentificationError(
                f"no delay of {absent[0]} can be estimated: the sensors of masses in the record are "
                f"{', '.join(sensors)}"
            )
        return np.array([self.delays.index(name) if name in self.delays else -1 for name in channels])
