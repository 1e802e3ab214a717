"""What is to be found on a rig: the unknowns of its links and sensors, and the forces of links along recorded motions, with
residuals of the load cells and their derivatives by the unknowns.

Records of a rig must hold the displacement of the base, and the force in each link that has unknowns. The
recorded motion is a smoothing spline: values between samples, and what its noise does to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.rigs.link_path import LinkPath
from linkwise.model.parameters import Parameter
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_complete
from linkwise.signals.noise import channel_noise, noise_sigma
from linkwise.signals.states import SmoothingSpline, smoothing_spline

BASE_CHANNEL = Channel("x", BASE)
_FLOOR = 1e-12  # of the largest displacement: smaller noise is below rounding
_SUBSTEPS = 2  # between samples, at first


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


def _sensor_noise(record: Record, values: Floats, smooth: Floats) -> float:
    """Standard deviation in m of the noise of the displacement; that of a coarse resolution is what smoothing takes out."""
    stated = record.noise.get(BASE_CHANNEL)
    if stated is not None:
        return float(stated)
    estimated = float(np.nan_to_num(noise_sigma(values)[0]))
    return max(estimated, float(np.std(values - smooth)), _FLOOR * float(np.abs(values).max()))


_FEWEST = 32  # samples


@dataclass(frozen=True, eq=False)
class Cell:
    """A load cell in a record: the numbers of the record and of its link, its channel, the places among the unknowns of the
    coefficients of the link that are `free` and of its initial `states`, the motion, the elongation per displacement of the
    base, and the samples (N,), NaN where missing.
    """

    record: int
    link: int
    channel: Channel
    free: Mapping[str, int]
    states: slice
    motion: PrescribedMotion
    sign: float
    measured: Floats


@dataclass(frozen=True, eq=False)
class RigProblem:
    """Motions of the base in records, and the forces (N,) in links by their number, NaN where samples miss.

    Unknowns: the p parameters, `offsets` of sensors, initial states.
    """

    structure: Structure
    motions: tuple[PrescribedMotion, ...]
    forces: tuple[Mapping[int, Floats], ...]
    offsets: tuple[Channel, ...] = ()

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure) -> RigProblem:
        """That of records; IdentificationError where one does not hold motion and forces."""
        motions, forces = zip(*(_motion_and_forces(record, structure) for record in records), strict=True)
        return cls(structure, motions, forces)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.structure.parameters

    @cached_property
    def beforehand(self) -> Floats:
        """(4, u) what is known of the unknowns: bounds, the most likely value, and one over its standard deviation."""
        known = np.tile([[-np.inf], [np.inf], [0.0], [0.0]], self.size)
        of_laws = [(p.lower, p.upper, p.start or 0.0, 1.0 / p.sigma) for p in self.parameters]
        known[:, : len(of_laws)] = np.reshape(of_laws, (-1, 4)).T
        return known

    def with_substeps(self, substeps: int) -> RigProblem:
        """The problem with other steps between samples."""
        return replace(self, motions=tuple(replace(motion, substeps=substeps) for motion in self.motions))

    @cached_property
    def links(self) -> tuple[int, ...]:
        """Numbers of the links with a load cell."""
        return tuple(sorted(self.forces[0]))

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The channels of load cells, and that of the displacement."""
        return (*(cell_name(self.structure, link) for link in self.links), BASE_CHANNEL)

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Those of all records; their initial states follow the other unknowns."""
        cells, first = [], len(self.parameters) + len(self.offsets)
        for number, (motion, forces) in enumerate(zip(self.motions, self.forces, strict=True)):
            for link, force in sorted(forces.items()):
                members = ((index, m) for index, p in enumerate(self.parameters) for m in p.members)
                free = {key: index for index, (owner, key) in members if owner == link}
                states = slice(first, first + len(self.structure.links[link].law.states))
                sign = float(self.structure.base_incidence[link])
                channel = cell_name(self.structure, link)
                cells.append(Cell(number, link, channel, free, states, motion, sign, force))
                first = states.stop
        return tuple(cells)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.cells[-1].states.stop)

    def paths(self, unknowns: Floats, before: Sequence[LinkPath] | None = None) -> tuple[LinkPath, ...]:
        """The links along the motions; states are sought near those `before`, or from rest where that fails."""
        shift = self.offset(BASE_CHANNEL, unknowns)
        paths = []
        for number, cell in enumerate(self.cells):
            link, motion = self.structure.links[cell.link], cell.motion
            values = {key: coefficient.value or 0.0 for key, coefficient in link.coefficients.items()}
            values |= {key: float(unknowns[place]) for key, place in cell.free.items()}
            d, v = cell.sign * (motion.d - shift), cell.sign * motion.v
            near = None if before is None or not before[number].converged else before[number].states
            paths.append(LinkPath.of(link.law, values, d, v, motion.step, unknowns[cell.states], near))
        settled = before is None or all(path.converged for path in paths)
        return tuple(paths) if settled else self.paths(unknowns)

    @cached_property
    def measured(self) -> Floats:
        """(R,) samples of all load cells."""
        return np.concatenate([cell.measured for cell in self.cells])

    def offset(self, channel: Channel, unknowns: Floats) -> float:
        """Zero error of a sensor, 0 where it is not unknown."""
        if channel not in self.offsets:
            return 0.0
        return float(unknowns[len(self.parameters) + self.offsets.index(channel)])

    def residuals(self, unknowns: Floats, paths: Sequence[LinkPath]) -> Floats:
        """Measured less modelled forces (R,) in N, 0 where a sample is missing and NaN where a law is not finite."""
        rows = []
        for cell, path in zip(self.cells, paths, strict=True):
            force = path.force()[:: cell.motion.substeps]
            measured = cell.measured - self.offset(cell.channel, unknowns)
            left = np.where(np.isfinite(force), measured - force, np.nan)
            rows.append(np.where(np.isfinite(measured), left, 0.0))
        return np.concatenate(rows)

    def jacobian(self, paths: Sequence[LinkPath]) -> Floats:
        """(R, u) derivatives of the modelled forces by the unknowns."""
        blocks = []
        for cell, path in zip(self.cells, paths, strict=True):
            slopes = path.tangents(tuple(cell.free)).by_unknowns()[:: cell.motion.substeps]
            block = np.zeros((len(slopes), self.size))
            for column, place in enumerate(cell.free.values()):
                block[:, place] += slopes[:, column]
            for column, channel in enumerate(self.offsets, start=len(self.parameters)):
                of_motion = channel == BASE_CHANNEL
                block[:, column] = -cell.sign * slopes[:, -1] if of_motion else channel == cell.channel
            block[:, cell.states] = slopes[:, len(cell.free) : -1]
            block[~np.isfinite(cell.measured)] = 0.0
            blocks.append(block)
        return np.concatenate(blocks)

    def noise_of_motion(self, paths: Sequence[LinkPath], weights: Floats) -> Floats:
        """(M, q) how sums of modelled forces with weights (R, q) change with the noise of each displacement sample."""
        by_record: dict[int, Floats] = {}
        of_cells = np.split(weights, np.cumsum([len(cell.measured) for cell in self.cells])[:-1])
        for cell, path, own in zip(self.cells, paths, of_cells, strict=True):
            spread = np.zeros((len(path.d), weights.shape[1]))
            spread[:: cell.motion.substeps] = own
            by_motion = path.tangents(tuple(cell.free)).to_motion(spread)
            part = cell.sign * cell.motion.noise_of(*by_motion)
            by_record[cell.record] = by_record.get(cell.record, 0.0) + part
        return np.concatenate([by_record[record] for record in sorted(by_record)])


def cell_name(structure: Structure, link: int) -> Channel:
    """The channel of the load cell of a link, by its number."""
    return Channel("f", structure.links[link].name)


def _motion_and_forces(record: Record, structure: Structure) -> tuple[PrescribedMotion, dict[int, Floats]]:
    """Motion and forces of a record; IdentificationError where it does not hold them."""
    name = BASE_CHANNEL
    if name not in record.channels:
        raise IdentificationError(
            f"a link alone on a rig is identified from the displacement of its base, {name}, but the record holds "
            f"{', '.join(record.channels)}; where one end is fixed, call the other end the base"
        )
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
    cells = {
        number: record.channel(cell_name(structure, number))
        for number in range(len(structure.links))
        if cell_name(structure, number) in record.channels
    }
    for number, force in cells.items():
        if not np.isfinite(force).any():
            raise IdentificationError(
                f"channel {cell_name(structure, number)} has no sample that is a number"
            )
    for parameter in structure.parameters:
        unseen = [index for index, _ in parameter.members if index not in cells]
        if len(unseen) == len(parameter.members):
            raise IdentificationError(
                f"{parameter.name} is unknown, but the record has no load cell of its link: give channel "
                f"{cell_name(structure, unseen[0])}, the force in it"
            )
    spline = smoothing_spline(values, record.rate)
    noise = _sensor_noise(record, values, spline.value()[:, 0])
    return PrescribedMotion(spline, _SUBSTEPS, noise), cells


def cell_noise(records: Sequence[Record]) -> dict[str, float]:
    """Noise in N by the channels of load cells: of several records the largest."""
    by_record = [channel_noise(record) for record in records]
    return {name: max(noise[name] for noise in by_record) for name in records[0].channels if name.kind == "f"}
