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
    def _basis(self) -> scipy.sparse.csr_array:
        """(2 J, N + 4) what the coefficients of the quintic B-splines make of displacements, then of velocities, at nodes."""
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
        return scipy.sparse.vstack([values, self.spline.rate * (slopes @ lagged)], format="csr")

    def _along(self, spline: SmoothingSpline) -> Floats:
        """(2, J, C) displacements and velocities at the nodes."""
        return np.asarray(self._basis @ spline.coefficients).reshape(2, -1, spline.coefficients.shape[1])

    @cached_property
    def at_nodes(self) -> Floats:
        """(2, J) displacement in m and velocity in m/s."""
        return self._along(self.spline)[..., 0]

    @property
    def at_samples(self) -> Floats:
        """(2, N) the same at the samples."""
        return self.at_nodes[:, :: self.substeps]

    @property
    def step(self) -> float:
        """Time between nodes in s."""
        return 1.0 / (self.spline.rate * self.substeps)

    def noise_draws(self, rng: np.random.Generator, count: int) -> Floats:
        """(2, J, count) what draws of the sensor's noise do to d and v at the nodes."""
        noise = self.sigma * rng.standard_normal((len(self.spline.coefficients) - 4, count))
        return self._along(self.spline.smoothed(noise))

    def noise_of(self, by_motion: Floats) -> Floats:
        """(N, q) by how much sums with derivatives (2, J, q) by d and v at the nodes change with the noise of each sample."""
        by_coefficient = self._basis.T @ by_motion.reshape(-1, by_motion.shape[2])
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
    """A load cell in a record: its channel, the number of its link, the motion, the samples (N,), NaN where missing, and
    their places among those of all records.

    The coefficients of the link that are `free`, its initial states, what adds to its elongation, and what to its force, are
    `from_unknowns` (c + S + 2, u) times the unknowns; `sign` is its elongation per displacement of the base.
    """

    channel: Channel
    link: int
    motion: PrescribedMotion
    measured: Floats
    samples: slice
    free: tuple[str, ...]
    from_unknowns: Floats
    sign: float


@dataclass(frozen=True, eq=False)
class RigProblem:
    """Motions of the base in records, the forces (N,) in links by their number, NaN where samples miss, and the `noise` of
    load cells in N by channel.

    Unknowns: the p parameters, `offsets` of sensors, initial states.
    """

    structure: Structure
    motions: tuple[PrescribedMotion, ...]
    forces: tuple[Mapping[int, Floats], ...]
    noise: Mapping[str, float]
    offsets: tuple[Channel, ...] = ()

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure) -> RigProblem:
        """That of records, with the largest noise in any; IdentificationError where one does not hold motion and forces."""
        motions, forces = zip(*(_motion_and_forces(record, structure) for record in records), strict=True)
        by_record = [channel_noise(record) for record in records]
        cells = (name for name in records[0].channels if name.kind == "f")
        return cls(structure, motions, forces, {name: max(own[name] for own in by_record) for name in cells})

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
    def size(self) -> int:
        """Number of unknowns."""
        states = sum(len(self.structure.links[link].law.states) for link in self.links)
        return len(self.parameters) + len(self.offsets) + len(self.motions) * states

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Those of all records; their initial states follow the other unknowns."""
        cells, state, sample = [], len(self.parameters) + len(self.offsets), 0
        for motion, forces in zip(self.motions, self.forces, strict=True):
            samples = slice(sample, sample + motion.at_samples.shape[1])
            for link in self.links:
                channel, sign = cell_name(self.structure, link), float(self.structure.base_incidence[link])
                members = [
                    (key, n) for n, p in enumerate(self.parameters) for own, key in p.members if own == link
                ]
                states = range(state, state + len(self.structure.links[link].law.states))
                state, rows = states.stop, [*(n for _, n in members), *states]
                from_unknowns = np.zeros((len(rows) + 2, self.size))
                from_unknowns[range(len(rows)), rows] = 1.0
                for column, off in enumerate(self.offsets, start=len(self.parameters)):
                    from_unknowns[-2:, column] = -sign * (off == BASE_CHANNEL), off == channel
                free = tuple(key for key, _ in members)
                cells.append(Cell(channel, link, motion, forces[link], samples, free, from_unknowns, sign))
            sample = samples.stop
        return tuple(cells)

    @cached_property
    def measured(self) -> Floats:
        """(R,) samples of all load cells."""
        return np.concatenate([cell.measured for cell in self.cells])

    def at_samples(self, along: Sequence[Floats]) -> Floats:
        """(R, ...) what is along the link of each load cell (J, ...), at its samples; 0 where one is missing."""
        every = [values[:: cell.motion.substeps] for cell, values in zip(self.cells, along, strict=True)]
        rows = np.concatenate(every)
        rows[~np.isfinite(self.measured)] = 0.0
        return rows


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
    names = [cell_name(structure, number) for number in range(len(structure.links))]
    cells = {number: record.channel(cell) for number, cell in enumerate(names) if cell in record.channels}
    for number, force in cells.items():
        if not np.isfinite(force).any():
            raise IdentificationError(f"channel {names[number]} has no sample that is a number")
    for parameter in structure.parameters:
        if not any(index in cells for index, _ in parameter.members):
            raise IdentificationError(
                f"{parameter.name} is unknown, but the record has no load cell of its link: give channel "
                f"{names[parameter.members[0][0]]}, the force in it"
            )
    spline = smoothing_spline(values, record.rate)
    noise = _sensor_noise(record, values, spline.value()[:, 0])
    return PrescribedMotion(spline, _SUBSTEPS, noise), cells
