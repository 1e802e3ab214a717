"""The forces of links along recorded motions: residuals of the load cells, their derivatives, and what starts them best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.rigs.motion import PrescribedMotion, cell_name, prescribed_motion, require_forces
from linkwise.likelihood.rigs.paths import LinkPath
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise


@dataclass(frozen=True, eq=False)
class Forces:
    """A record of a rig: the motion of the base, and the forces (N,) in links by their number, NaN where samples miss."""

    motion: PrescribedMotion
    cells: Mapping[int, Floats]


@dataclass(frozen=True, eq=False)
class Cell:
    """A load cell in a record: the number of the record and of its link, the places of the initial states of that among the
    unknowns, the motion, the elongation per displacement of the base, and the samples (N,), NaN where they miss.
    """

    record: int
    link: int
    places: slice
    motion: PrescribedMotion
    sign: float
    measured: Floats


@dataclass(frozen=True, eq=False)
class RigProblem:
    """Unknowns: the p parameters, offsets of load cells (by number of the link) and of the displacement, initial states."""

    structure: Structure
    records: tuple[Forces, ...]
    cell_offsets: tuple[int, ...] = ()
    motion_offset: bool = False

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.structure.parameters

    @cached_property
    def certainty(self) -> Floats:
        """(u,) one over the standard deviations to which unknowns are known beforehand."""
        known = np.zeros(self.size)
        known[: len(self.parameters)] = 1.0 / np.array([p.sigma for p in self.parameters])
        return known

    def with_substeps(self, substeps: int) -> RigProblem:
        """The problem with other steps between samples."""
        finer = (replace(record, motion=replace(record.motion, substeps=substeps)) for record in self.records)
        return replace(self, records=tuple(finer))

    @cached_property
    def links(self) -> tuple[int, ...]:
        """Numbers of the links with a load cell."""
        return tuple(sorted(self.records[0].cells))

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Those of all records; their initial states follow the other unknowns."""
        cells, first = [], len(self.parameters) + len(self.cell_offsets) + self.motion_offset
        for number, record in enumerate(self.records):
            for link in self.links:
                places = slice(first, first + len(self.structure.links[link].law.states))
                sign = float(self.structure.base_incidence[link])
                cells.append(Cell(number, link, places, record.motion, sign, record.cells[link]))
                first = places.stop
        return tuple(cells)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.cells[-1].places.stop)

    def values(self, link: int, unknowns: Floats) -> dict[str, float]:
        """Values of the coefficients of a link."""
        known = {k: c.value or 0.0 for k, c in self.structure.links[link].coefficients.items()}
        for value, parameter in zip(unknowns, self.parameters, strict=False):
            known |= {key: float(value) for index, key in parameter.members if index == link}
        return known

    def paths(self, unknowns: Floats, before: Sequence[LinkPath] | None = None) -> tuple[LinkPath, ...]:
        """The links along the motions; states are sought near those `before`."""
        p = len(self.parameters)
        shift = unknowns[p + len(self.cell_offsets)] if self.motion_offset else 0.0
        return tuple(
            LinkPath.of(
                self.structure.links[cell.link].law, self.values(cell.link, unknowns),
                cell.sign * (cell.motion.d - shift), cell.sign * cell.motion.v, cell.motion.step, unknowns[cell.places],
                None if before is None or not before[number].converged else before[number].states,
            )
            for number, cell in enumerate(self.cells)
        )  # fmt: skip

    def free(self, link: int) -> tuple[str, ...]:
        """Coefficients of a link that are unknown."""
        unknown = {key for p in self.parameters for index, key in p.members if index == link}
        return tuple(key for key in self.structure.links[link].law.coefficients if key in unknown)

    @cached_property
    def measured(self) -> Floats:
        """(R,) samples of all load cells."""
        return np.concatenate([cell.measured for cell in self.cells])

    def offset(self, link: int, unknowns: Floats) -> float:
        """Zero error in N of the load cell of a link, 0 where it is not unknown."""
        if link not in self.cell_offsets:
            return 0.0
        return float(unknowns[len(self.parameters) + self.cell_offsets.index(link)])

    def residuals(self, unknowns: Floats, paths: Sequence[LinkPath]) -> Floats:
        """Measured less modelled forces (R,) in N, 0 where a sample is missing and NaN where a law is not finite."""
        rows = []
        for cell, path in zip(self.cells, paths, strict=True):
            force = path.force()[:: cell.motion.substeps]
            measured = cell.measured - self.offset(cell.link, unknowns)
            left = np.where(np.isfinite(force), measured - force, np.nan)
            rows.append(np.where(np.isfinite(measured), left, 0.0))
        return np.concatenate(rows)

    def jacobian(self, paths: Sequence[LinkPath]) -> Floats:
        """(R, u) derivatives of the modelled forces by the unknowns."""
        p, blocks = len(self.parameters), []
        for cell, path in zip(self.cells, paths, strict=True):
            free = self.free(cell.link)
            slopes = path.tangents(free).by_unknowns()[:: cell.motion.substeps]
            block = np.zeros((len(slopes), self.size))
            for column, parameter in enumerate(self.parameters):
                for index, key in parameter.members:
                    if index == cell.link:
                        block[:, column] += slopes[:, free.index(key)]
            if cell.link in self.cell_offsets:
                block[:, p + self.cell_offsets.index(cell.link)] = 1.0
            if self.motion_offset:
                block[:, p + len(self.cell_offsets)] = -cell.sign * slopes[:, -1]
            block[:, cell.places] = slopes[:, len(free) : -1]
            block[~np.isfinite(cell.measured)] = 0.0
            blocks.append(block)
        return np.concatenate(blocks)

    def noise_of_motion(self, paths: Sequence[LinkPath], weights: Floats) -> Floats:
        """(M, q) how sums of modelled forces with weights (R, q) change with the noise of each displacement sample."""
        by_record: dict[int, Floats] = {}
        for cell, path, own in zip(self.cells, paths, self.split(weights), strict=True):
            spread = np.zeros((len(path.d), weights.shape[1]))
            spread[:: cell.motion.substeps] = own
            by_motion = path.tangents(self.free(cell.link)).to_motion(spread)
            part = cell.sign * cell.motion.noise_of(*by_motion)
            by_record[cell.record] = by_record.get(cell.record, 0.0) + part
        return np.concatenate([by_record[record] for record in sorted(by_record)])

    def split(self, rows: Floats) -> list[Floats]:
        """Rows (R, q), one of each sample of each load cell, by paths."""
        return np.split(rows, np.cumsum([len(cell.measured) for cell in self.cells])[:-1])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Bounds (u,) of the unknowns."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[: len(self.parameters)] = [p.lower for p in self.parameters]
        high[: len(self.parameters)] = [p.upper for p in self.parameters]
        return low, high


def rig_forces(record: Record, structure: Structure) -> Forces:
    """Motion and forces of a record; IdentificationError where it does not hold them."""
    require_forces(record, structure)
    named = {number: cell_name(structure, number) for number in range(len(structure.links))}
    cells = {number: record.channel(name) for number, name in named.items() if name in record.channels}
    return Forces(prescribed_motion(record), cells)


def cell_noise(records: Sequence[Record], structure: Structure) -> dict[int, float]:
    """Noise of load cells in N by the number of their link: of several records the largest."""
    noise_by_record = [channel_noise(record) for record in records]
    names = {number: cell_name(structure, number) for number in range(len(structure.links))}
    return {
        number: max(noise[name] for noise in noise_by_record)
        for number, name in names.items()
        if name in noise_by_record[0]
    }


_LAST_STEPS = 300
# residual, relative to the forces, of a trial whose states run away or whose laws are not finite
_RUNAWAY = 1e6


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (u,) at a minimum, `cost` the sum of weighted squares there, the paths, and whether the search ended."""

    unknowns: Floats
    cost: float
    paths: tuple[LinkPath, ...]
    converged: bool


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> Minimum:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high = problem.bounds
    at = np.full(problem.size, np.nan)
    last: tuple[LinkPath, ...] | None = None
    prior = np.array([p.start or 0.0 for p in problem.parameters])
    certainty = problem.certainty[: len(prior)]

    def paths_at(unknowns: Floats) -> tuple[LinkPath, ...]:
        """The links along the motions, sought near those asked for before."""
        nonlocal at, last
        if last is None or not np.array_equal(unknowns, at):
            paths = problem.paths(unknowns, last)
            if not all(path.converged for path in paths):
                paths = problem.paths(unknowns)
            at, last = unknowns.copy(), paths
        return last

    def residuals(unknowns: Floats) -> Floats:
        paths = paths_at(unknowns)
        if not all(path.converged for path in paths):
            return np.full(len(weights) + len(prior), _RUNAWAY)
        left = np.where(weights > 0.0, problem.residuals(unknowns, paths), 0.0)
        if not np.isfinite(left).all():
            return np.full(len(weights) + len(prior), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (prior - unknowns[: len(prior)])])

    def jacobian(unknowns: Floats) -> Floats:
        own = np.zeros((len(prior), problem.size))
        own[:, : len(prior)] = -np.diag(certainty)
        slopes = -weights[:, None] * problem.jacobian(paths_at(unknowns))
        return np.concatenate([np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0), own])

    inside = np.clip(start, low, high)
    with np.errstate(all="ignore"):
        optimum = scipy.optimize.least_squares(
            residuals,
            inside,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            max_nfev=steps,
            xtol=1e-9,
            ftol=1e-9,
        )
        unknowns = np.asarray(optimum.x)
        end = paths_at(unknowns)
    return Minimum(
        unknowns, 2.0 * float(optimum.cost), end, bool(optimum.status > 0) and all(p.converged for p in end)
    )


_DRAWS = 32  # of the noise of the motion, for the size of what it does to the forces
_SEED = 7


def motion_deviations(problem: RigProblem, minimum: Minimum) -> Floats:
    """(R,) standard deviations in N of the modelled forces by the noise of the motion."""
    rng = np.random.default_rng(_SEED)
    changes = [record.motion.noise_draws(rng, _DRAWS) for record in problem.records]
    rows = []
    for cell, path in zip(problem.cells, minimum.paths, strict=True):
        moved = path.tangents(problem.free(cell.link)).by_motion(*changes[cell.record])
        moved = moved[:: cell.motion.substeps]
        rows.append(np.sqrt(np.mean(moved**2, axis=1)))
    return np.asarray(np.nan_to_num(np.concatenate(rows)))
