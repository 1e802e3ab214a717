"""The forces of links along recorded motions: residuals of the load cells and their derivatives by the unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.prescribed.motion import PrescribedMotion
from linkwise.likelihood.prescribed.state_path import LinkPath
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Forces:
    """A record of a rig: the motion of the base, and the forces (N,) in links by their number, NaN where samples miss."""

    motion: PrescribedMotion
    cells: Mapping[int, Floats]


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
        finer = (replace(record, motion=record.motion.with_substeps(substeps)) for record in self.records)
        return replace(self, records=tuple(finer))

    def shortened(self, most: int) -> RigProblem:
        """The problem with the liveliest parts of its records, of so many samples at most."""
        parts = []
        for record in self.records:
            count = min(most, len(next(iter(record.cells.values()))))
            first = record.motion.liveliest(count)
            cells = {link: force[first : first + count] for link, force in record.cells.items()}
            parts.append(Forces(record.motion.part(first, count), cells))
        return replace(self, records=tuple(parts))

    @cached_property
    def links(self) -> tuple[int, ...]:
        """Numbers of the links with a load cell."""
        return tuple(sorted(self.records[0].cells))

    @cached_property
    def states(self) -> tuple[tuple[int, int, slice], ...]:
        """Number of the record, of the link, and places of its initial states among the unknowns."""
        places, first = [], self.first_state
        for record in range(len(self.records)):
            for link in self.links:
                count = len(self.structure.links[link].law.states)
                places.append((record, link, slice(first, first + count)))
                first += count
        return tuple(places)

    @property
    def first_state(self) -> int:
        """Number of unknowns before the initial states."""
        return len(self.parameters) + len(self.cell_offsets) + self.motion_offset

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.states[-1][2].stop)

    def values(self, link: int, unknowns: Floats) -> dict[str, float]:
        """Values of the coefficients of a link."""
        known = {k: c.value or 0.0 for k, c in self.structure.links[link].coefficients.items()}
        for value, parameter in zip(unknowns, self.parameters, strict=False):
            known |= {key: float(value) for index, key in parameter.members if index == link}
        return known

    def sign(self, link: int) -> float:
        """Elongation of a link per displacement of the base."""
        return float(self.structure.base_incidence[link])

    def paths(self, unknowns: Floats, before: Sequence[LinkPath] | None = None) -> tuple[LinkPath, ...]:
        """The links along the motions; states are sought near those `before`."""
        p = len(self.parameters)
        shift = unknowns[p + len(self.cell_offsets)] if self.motion_offset else 0.0
        return tuple(
            LinkPath.of(
                self.structure.links[link].law, self.values(link, unknowns),
                self.sign(link) * (self.records[record].motion.d - shift),
                self.sign(link) * self.records[record].motion.v,
                self.records[record].motion.step, unknowns[places],
                None if before is None or not before[number].converged else before[number].states,
            )
            for number, (record, link, places) in enumerate(self.states)
        )  # fmt: skip

    def free(self, link: int) -> tuple[str, ...]:
        """Coefficients of a link that are unknown."""
        unknown = {key for p in self.parameters for index, key in p.members if index == link}
        return tuple(key for key in self.structure.links[link].law.coefficients if key in unknown)

    def cell(self, number: int) -> Floats:
        """Samples (N,) of the load cell of a path."""
        record, link, _ = self.states[number]
        return self.records[record].cells[link]

    def offset(self, link: int, unknowns: Floats) -> float:
        """Zero error in N of the load cell of a link, 0 where it is not unknown."""
        if link not in self.cell_offsets:
            return 0.0
        return float(unknowns[len(self.parameters) + self.cell_offsets.index(link)])

    def residuals(self, unknowns: Floats, paths: Sequence[LinkPath]) -> Floats:
        """Measured less modelled forces (R,) in N, 0 where a sample is missing and NaN where a law is not finite."""
        rows = []
        for number, ((record, link, _), path) in enumerate(zip(self.states, paths, strict=True)):
            every = self.records[record].motion.substeps
            force = path.force()[::every]
            measured = self.cell(number) - self.offset(link, unknowns)
            left = np.where(np.isfinite(force), measured - force, np.nan)
            rows.append(np.where(np.isfinite(measured), left, 0.0))
        return np.concatenate(rows)

    def jacobian(self, paths: Sequence[LinkPath]) -> Floats:
        """(R, u) derivatives of the modelled forces by the unknowns."""
        p, blocks = len(self.parameters), []
        for number, ((record, link, places), path) in enumerate(zip(self.states, paths, strict=True)):
            free, every = self.free(link), self.records[record].motion.substeps
            slopes = path.tangents(free).by_unknowns()[::every]
            block = np.zeros((len(slopes), self.size))
            for column, parameter in enumerate(self.parameters):
                for index, key in parameter.members:
                    if index == link:
                        block[:, column] += slopes[:, free.index(key)]
            if link in self.cell_offsets:
                block[:, p + self.cell_offsets.index(link)] = 1.0
            if self.motion_offset:
                block[:, p + len(self.cell_offsets)] = -self.sign(link) * slopes[:, -1]
            block[:, places] = slopes[:, len(free) : -1]
            block[~np.isfinite(self.cell(number))] = 0.0
            blocks.append(block)
        return np.concatenate(blocks)

    def noise_of_motion(self, paths: Sequence[LinkPath], weights: Floats) -> Floats:
        """(M, q) how sums of modelled forces with weights (R, q) change with the noise of each displacement sample."""
        rows, first = [], 0
        by_record: dict[int, Floats] = {}
        for (record, link, _), path in zip(self.states, paths, strict=True):
            motion = self.records[record].motion
            count = len(path.d) // motion.substeps + 1
            spread = np.zeros((len(path.d), weights.shape[1]))
            spread[:: motion.substeps] = weights[first : first + count]
            by_d, by_v = path.tangents(self.free(link)).to_motion(spread)
            part = self.sign(link) * motion.noise_of(by_d, by_v)
            by_record[record] = by_record.get(record, 0.0) + part
            first += count
        rows = [by_record[record] for record in sorted(by_record)]
        return np.concatenate(rows)
