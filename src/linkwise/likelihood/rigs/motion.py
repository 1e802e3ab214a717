"""Links alone on a rig: the ends move as recorded, and what noise of that record does to the forces in the links.

The recorded motion is smoothed, and prescribed to the equations of motion as that of a base. What is left of the noise of its
sensor is correlated from sample to sample. To first order it adds noise to what load cells show, by which residuals are
weighed; the covariance of the estimates is that of an M-estimator, with the covariance of the scores under both noises.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.likelihood.rigs.paths import LinkPath
from linkwise.likelihood.shooting.linear_model import EliminatedRows
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import F, Scales, Segments
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel, require_complete
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma
from linkwise.signals.states import SmoothingSpline, smoothing_spline

BASE_CHANNEL = Channel("x", BASE)
_FEWEST = 32  # samples
_FLOOR = 1e-12  # of the largest displacement: smaller noise is below rounding
_DRAWS = 32  # of the noise of the motion, for the size of what it does to the forces
_SEED = 7
_NEGLIGIBLE = (
    1e-3  # of the variance of the noise of load cells; of that of a coefficient up to ten times as much
)


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """The motion at the nodes (J): the samples, and `substeps` - 1 between each two.

    `sigma` is the noise of the displacement sensor in m.
    """

    spline: SmoothingSpline
    substeps: int
    sigma: float

    @cached_property
    def _basis(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """(J, N + 4) what the coefficients of the quintic B-splines make of the displacement and the velocity at the nodes."""
        count = len(self.spline.coefficients)
        knots = np.arange(-5.0, count + 1.0)
        nodes = np.arange((count - 5) * self.substeps + 1) / self.substeps
        lagged = scipy.sparse.eye_array(count - 1, count, k=1) - scipy.sparse.eye_array(count - 1, count)
        values, slopes = (
            scipy.interpolate.BSpline.design_matrix(
                nodes, knots[5 - degree : len(knots) - 5 + degree], degree
            )
            for degree in (5, 4)
        )
        return values, self.spline.rate * (slopes @ lagged)

    @cached_property
    def d(self) -> Floats:
        """(J,) displacement in m."""
        return np.asarray(self._basis[0] @ self.spline.coefficients[:, 0])

    @cached_property
    def v(self) -> Floats:
        """(J,) velocity in m/s."""
        return np.asarray(self._basis[1] @ self.spline.coefficients[:, 0])

    @property
    def step(self) -> float:
        """Time between nodes in s."""
        return 1.0 / (self.spline.rate * self.substeps)

    @property
    def period(self) -> int:
        """Samples in a period of the motion, by the ratio of displacement and velocity."""
        speed = float(np.std(self.v)) or 1.0
        return max(int(2.0 * np.pi * float(np.std(self.d)) / speed * self.spline.rate), 1)

    def liveliest(self, count: int) -> int:
        """First of the `count` samples in a row that move most."""
        power = np.concatenate([[0.0], np.cumsum(self.v[:: self.substeps] ** 2)])
        return int(np.argmax(power[count:] - power[:-count]))

    def noise_draws(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """(J, count) what draws of the sensor's noise do to d and v at the nodes."""
        noise = self.sigma * rng.standard_normal((len(self.spline.coefficients) - 4, count))
        drawn = self.spline.smoothed(noise).coefficients
        return self._basis[0] @ drawn, self._basis[1] @ drawn

    def noise_of(self, by_d: Floats, by_v: Floats) -> Floats:
        """(N, q) by how much sums with derivatives (J, q) by d and v at the nodes change with the noise of each sample."""
        by_coefficient = self._basis[0].T @ by_d + self._basis[1].T @ by_v
        return self.spline.transposed(by_coefficient) * self.sigma

    @property
    def samples(self) -> int:
        """N, the number of samples."""
        return len(self.spline.coefficients) - 4


def prescribed(record: Record, structure: Structure) -> tuple[Record, PrescribedMotion]:
    """A record with its motion smoothed, and that motion; IdentificationError where it lacks the motion or a force."""
    name = BASE_CHANNEL
    if name not in record.channels:
        raise IdentificationError(
            f"a link alone on a rig is identified from the displacement of its base, {name}, but the record holds "
            f"{', '.join(record.channels)}; where one end is fixed, call the other end the base"
        )
    motion = prescribed_motion(record)
    require_forces(record, structure)
    values = record.values.copy()
    values[:, record.channels.index(name)] = motion.spline.value()[:, 0]
    return replace(record, values=values, simulated=None), motion


def prescribed_motion(record: Record) -> PrescribedMotion:
    """The motion of the base of a record, smoothed at the level of its noise."""
    name = BASE_CHANNEL
    values = record.channel(name)
    require_complete(name, values, record.start, record.rate)
    if len(values) < _FEWEST:
        raise IdentificationError(
            f"{len(values)} samples are too few for links on a rig, which need {_FEWEST}"
        )
    if not np.ptp(values) > 0.0:
        raise IdentificationError(
            f"{name} does not change: the force in a link that does not move says nothing about its law"
        )
    spline = smoothing_spline(values, record.rate)
    sigma = record.noise.get(name)
    if sigma is None:  # that of a coarse resolution is what smoothing takes out
        estimated, left = float(np.nan_to_num(noise_sigma(values)[0])), np.std(values - spline.value()[:, 0])
        sigma = max(estimated, float(left), _FLOOR * float(np.abs(values).max()))
    return PrescribedMotion(spline, 2, float(sigma))


def cell_name(structure: Structure, link: int) -> Channel:
    """The channel of the load cell of a link, by its number."""
    return Channel("f", structure.links[link].name)


def require_forces(record: Record, structure: Structure) -> None:
    """Raise IdentificationError where a load cell shows nothing, or no link with an unknown has one."""
    names = [cell_name(structure, number) for number in range(len(structure.links))]
    for name in names:
        if name in record.channels and not np.isfinite(record.channel(name)).any():
            raise IdentificationError(f"channel {name} has no sample that is a number")
    for parameter in structure.parameters:
        cells = [names[index] for index, _ in parameter.members]
        if not set(cells) & set(record.channels):
            raise IdentificationError(
                f"{parameter.name} is unknown, but the record has no load cell of its link: give channel {cells[0]}, "
                "the force in it"
            )


@dataclass(frozen=True, eq=False)
class Cell:
    """A load cell in a record: the number of its channel, its segments, and the link along the motion of the record, with the
    elongation per displacement of the base.
    """

    channel: int
    part: slice
    path: LinkPath
    motion: PrescribedMotion
    sign: float


@dataclass(frozen=True, eq=False)
class NoiseOfMotion:
    """Noise that residuals are weighed by, with deviations `unit` (C, K) in N over segments of so many `samples`, and what
    noise of prescribed motions adds to the forces in the links of `cells`.
    """

    cells: tuple[Cell, ...]
    unit: Floats
    samples: int

    @classmethod
    def along(
        cls,
        motions: Sequence[PrescribedMotion],
        identified: Structure,
        segments: Segments,
        misfit: Misfit,
        scales: Scales,
    ) -> NoiseOfMotion:
        """That of the motions of records along an orbit of a structure with a value for each parameter."""
        sensors, samples = segments.sensors, len(segments.samples)
        cells, first = [], 0
        for motion in motions:
            finer = replace(motion, substeps=segments.refine)
            part = slice(first, first - (-motion.samples // samples))
            first = part.stop
            for channel in np.flatnonzero(sensors.kind == F).tolist():
                place = int(sensors.mass[channel])
                sign = float(segments.system.base[place])
                cells.append(
                    Cell(channel, part, _path(identified, segments, misfit, place, part, finer), finer, sign)
                )
        unit = np.broadcast_to(segments.deviations(scales), (len(scales.sigma), segments.count))
        return cls(tuple(cells), unit, samples)

    @property
    def channels(self) -> Indices:
        """The channels whose noise is correlated from sample to sample."""
        return np.unique([cell.channel for cell in self.cells])

    @cached_property
    def added(self) -> Floats:
        """(C, K) standard deviations in N of what noise of the motions adds, over segments."""
        powers, rng = np.zeros(self.unit.shape), np.random.default_rng(_SEED)
        draws: dict[int, tuple[Floats, Floats]] = {}
        for cell in self.cells:
            if cell.part.start not in draws:
                draws[cell.part.start] = cell.motion.noise_draws(rng, _DRAWS)
            moved = cell.path.tangents(()).by_motion(*draws[cell.part.start])[:: cell.motion.substeps]
            power, firsts = np.mean(moved**2, axis=1), np.arange(0, len(moved), self.samples)
            counts = np.diff(np.append(firsts, len(moved)))
            powers[cell.channel, cell.part] = np.add.reduceat(power, firsts) / counts
        return np.sqrt(np.nan_to_num(powers, posinf=0.0))

    @property
    def is_negligible(self) -> bool:
        """Whether noise of the motions is next to nothing beside that of the sensors."""
        return bool(np.mean(self.added**2) <= _NEGLIGIBLE * np.mean(self.unit**2))

    def weighed(self, segments: Segments, scales: Scales) -> Segments:
        """Segments whose residuals are weighed by both noises, where `unit` is that of the load cells alone."""
        return replace(segments, relative_noise=np.hypot(self.unit, self.added) / scales.sigma[:, None])

    def score_covariance(self, rows: Iterable[EliminatedRows], linked: Bools, samples: int) -> Floats:
        """(p, p) covariance that both noises, together `unit`, give to the sums of `rows` times residuals."""
        data = np.concatenate([chunk.data for chunk in rows])
        data = data.reshape(len(data), samples, -1, data.shape[-1]) / self.unit.T[:, None, :, None]
        of_cells = np.sqrt(np.maximum(self.unit**2 - self.added**2, 0.0))
        white = (data * of_cells.T[:, None, :, None]).reshape(-1, data.shape[-1])
        total, by_record = white.T @ white, dict[int, Floats]()
        for cell in self.cells:
            own = data[cell.part, :, cell.channel].reshape(-1, data.shape[-1])
            spread = np.zeros((len(cell.path.d), data.shape[-1]))
            spread[:: cell.motion.substeps] = own[: cell.motion.samples]
            moved = cell.sign * cell.motion.noise_of(*cell.path.tangents(()).to_motion(spread))
            by_record[cell.part.start] = by_record.get(cell.part.start, 0.0) + moved
        return np.asarray(total + sum(moved.T @ moved for moved in by_record.values()))

    def drawn(self, white: Floats, channel: int) -> Floats:
        """Noise of a channel, over its deviation, from `white` noise (N, d): taken for white."""
        return white


def _path(
    identified: Structure,
    segments: Segments,
    misfit: Misfit,
    place: int,
    part: slice,
    motion: PrescribedMotion,
) -> LinkPath:
    """The link at a place of the system along the orbit of a record, at the nodes of its motion."""
    system, orbit, nodes = segments.system, misfit.trajectories, len(motion.d)
    number = int(system.order[place])
    law, values = identified.links[number].law, identified.links[number].values

    def in_time(values: Floats) -> Floats:
        return values[:-1, part].T.ravel()[:nodes]

    signals = list(segments.inputs.signals)
    states = [row for row, (index, _) in enumerate(system.states) if index == number]
    rows = [len(system.states) + signals.index(name) for name in law.signals]
    return LinkPath(
        law,
        tuple(values[name] for name in law.coefficients),
        in_time(orbit.links[:, 0, place]),
        in_time(orbit.links[:, 1, place]),
        motion.step,
        np.array([in_time(orbit.memory[:, row]) for row in states]).reshape(-1, nodes).T,
        True,
        tuple(in_time(orbit.memory[:, row]) for row in rows),
    )
