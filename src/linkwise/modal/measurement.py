"""What a modal test measured: responses at points to forces at points, record by record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.modal.oscillators import Complex, SampledForce, pole, pole_changes
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_complete
from linkwise.signals.noise import channel_noise

_SHORTEST = 50  # samples


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One record: `responses` (C, N), NaN where missing, their `noise` (C,), and the `forces` (P), every `step` s."""

    responses: Floats
    noise: Floats
    forces: tuple[SampledForce, ...]
    step: float

    @property
    def count(self) -> int:
        """Number of samples, N."""
        return int(self.responses.shape[1])

    @cached_property
    def applied(self) -> Floats:
        """(P, N) the forces at the samples."""
        return np.array([force.samples for force in self.forces]).reshape(-1, self.count)

    def motions(self, frequency: float, damping: float) -> Floats:
        """(P + 2, 3, N) displacements, velocities and accelerations of a mode of unit modal mass: from rest under each force,
        then two free decays a quarter of a period apart, the first of which begins at an acceleration of 1 m/s2.
        """
        s = pole(frequency, damping)
        motions = s ** np.arange(3)[:, None] * self.signals(s)[:, None]
        forced, free = motions[:-1].imag / s.imag, motions[-1] / s**2
        forced[:, 2] += self.applied
        return np.concatenate([forced, [free.real, free.imag]])

    def motion_derivatives(self, frequency: float, damping: float) -> Floats:
        """(2, P + 2, 3, N) derivatives of `motions` by the logarithms of frequency and damping."""
        s, kinds = pole(frequency, damping), np.arange(3)[:, None]
        signals = self.signals(s)
        by_pole = self.signals_by_pole(s, signals)
        motions = s**kinds * signals[:, None]
        slopes = kinds * s ** (kinds - 1) * signals[:, None] + s**kinds * by_pole[:, None]
        free = (slopes[-1] - 2.0 / s * motions[-1]) / s**2
        changes = []
        for change in pole_changes(frequency, damping):
            turned = (slopes * change).imag / s.imag - motions.imag * (change.imag / s.imag**2)
            changes.append([*turned[:-1], (free * change).real, (free * change).imag])
        return np.array(changes)

    def signals(self, s: complex) -> Complex:
        """(P + 1, N) complex modes with the pole `s` under each force of unit participation, and in a free decay."""
        decay = np.exp(s * self.step * np.arange(self.count))
        return np.array([*(force.recursion(s) for force in self.forces), decay])

    def signals_by_pole(self, s: complex, signals: Complex) -> Complex:
        """(P + 1, N) derivatives of the `signals` by the pole."""
        forced = zip(self.forces, signals, strict=False)
        decay = self.step * np.arange(self.count) * signals[-1]
        return np.array([*(force.derivative_by_pole(s, z) for force, z in forced), decay])

    def shortened(self, count: int) -> MeasuredRun:
        """The first samples."""
        if self.count <= count:
            return self
        forces = tuple(SampledForce(force.samples[:count], self.step) for force in self.forces)
        return MeasuredRun(self.responses[:, :count], self.noise, forces, self.step)


@dataclass(frozen=True, eq=False)
class ModalMeasurement:
    """All records of a test of a `host` at m points.

    Of each response `kinds` (C,) is 0, 1 or 2 for displacement, velocity or acceleration, and `sensed` (C,) the number of
    its point; forces act at the points `forced` (P,). Without a force the scale of shapes is that of known `masses` (m,) in kg
    at the points, which are all that moves.
    """

    host: str
    points: tuple[str, ...]
    kinds: Indices
    sensed: Indices
    forced: Indices
    runs: tuple[MeasuredRun, ...]
    masses: Floats = field(default_factory=lambda: np.empty(0))

    @cached_property
    def samples(self) -> Indices:
        """(C,) numbers of samples that are not missing."""
        return np.asarray(np.sum([np.isfinite(run.responses).sum(axis=1) for run in self.runs], axis=0))

    @cached_property
    def power(self) -> Floats:
        """(C,) sums of the squares of the responses."""
        return np.asarray(np.sum([np.nansum(run.responses**2, axis=1) for run in self.runs], axis=0))

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        name: str | None = None,
        *,
        scaled: bool = True,
        masses: Mapping[str, float] = MappingProxyType({}),
    ) -> ModalMeasurement:
        """Those of `records`, whose channels are at points of the host `name`; without a name, of the one that all share.

        Without forces the records are free decays, whose shapes the `masses` in kg at the points scale. Raises
        IdentificationError if channels are of a host of another name, if responses are missing, if a mass is at another point,
        or if shapes are to be `scaled` and no response is where a force acts.
        """
        responses, forces = records[0].motions, records[0].forces
        for record in records:
            if set(record.channels) != set(records[0].channels):
                raise IdentificationError("the records of a modal test must have the same channels")
            _check_record(record, responses, forces)
        places = [channel.place for channel in (*responses, *forces)]
        host = _host_named(name, places)
        own = [place.removeprefix(f"{host}.") for place in places]
        points = tuple(dict.fromkeys(own))
        numbers = np.array([points.index(point) for point in own])
        sensed, forced = numbers[: len(responses)], numbers[len(responses) :]
        if scaled and forces and not set(sensed.tolist()) & set(forced.tolist()):
            raise IdentificationError(
                f"no response was measured at {' or '.join(dict.fromkeys(places[len(responses) :]))}, where the force acts: "
                "shapes have no scale without one. Hit the structure at a sensor, or add a sensor where it is hit"
            )
        runs = tuple(_measured_run(record, responses, forces) for record in records)
        kinds = np.array([channel.order for channel in responses])
        return cls(host, points, kinds, sensed, forced, runs, _point_masses(masses, points, forces))

    @classmethod
    def of_decay(cls, record: Record) -> ModalMeasurement:
        """The motions of a record on which no force acts."""
        points = tuple(dict.fromkeys(channel.place for channel in record.motions))
        sensed = np.array([points.index(channel.place) for channel in record.motions])
        kinds = np.array([channel.order for channel in record.motions])
        run = _measured_run(record, record.motions, ())
        return cls("", points, kinds, sensed, np.empty(0, dtype=np.intp), (run,))


def _point_masses(masses: Mapping[str, float], points: Sequence[str], forces: Sequence[str]) -> Floats:
    """(m,) kg at the points."""
    if masses and forces:
        raise IdentificationError(
            "the applied force sets the scale of the shapes: leave out the masses at points"
        )
    for point, mass in masses.items():
        if point not in points:
            raise IdentificationError(
                f"a mass is stated at {point}, which is none of the points {', '.join(points)}"
            )
        if not 0.0 < mass < np.inf:
            raise IdentificationError(f"the mass at {point} must be positive, got {mass:g} kg")
    return np.array([masses.get(point, 0.0) for point in points])


def _measured_run(record: Record, responses: Sequence[str], forces: Sequence[str]) -> MeasuredRun:
    """One record, its responses and its forces."""
    noise = channel_noise(record)
    deviations = np.array([noise[name] for name in responses])
    sampled = tuple(SampledForce(record.channel(channel), record.step) for channel in forces)
    return MeasuredRun(record.select(responses).values.T.copy(), deviations, sampled, record.step)


def _check_record(record: Record, responses: Sequence[str], forces: Sequence[str]) -> None:
    if not responses:
        raise IdentificationError(
            "a modal test needs the motion at points, and the applied force where one acts: channels such as force:beam.tip "
            f"and a:beam.tip, got {', '.join(record.channels)}"
        )
    if len(record) < _SHORTEST:
        message = f"the record has {len(record)} samples, too few to determine modes; a modal test needs at least {_SHORTEST}"
        raise IdentificationError(message)
    for name in forces:
        require_complete(name, record.channel(name), record.start, record.rate)
    if forces and not any(record.channel(name).any() for name in forces):
        raise IdentificationError("the applied force is zero throughout; record what was applied")


def _host_named(name: str | None, places: Sequence[str]) -> str:
    """The `name`, which that before the dot of a place must not contradict; without one, that which all places share, else
    "host".
    """
    if name is None:
        names = {place.partition(".")[0] if "." in place else "" for place in places}
        return names.pop() or "host" if len(names) == 1 else "host"
    for place in places:
        host, dot, _ = place.partition(".")
        if dot and host != name:
            raise IdentificationError(
                f'{place} is of the host "{host}", not of "{name}": points of a host are named as the channels of its '
                f'records; leave the name out, or name the channels "{name}.POINT"'
            )
    return name
