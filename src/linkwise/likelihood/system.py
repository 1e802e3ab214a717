"""A structure as arrays: topology, laws by group and the linear map from free parameters to coefficients and masses.

Arrays here have the batch of segments on the LAST axis, (links, K) or (masses, K): link after link is then contiguous, a
group of links under one law is a slice, and B^T x is one matrix product for all segments. Links are sorted by law;
`System.order` says which link of the structure stands where.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate
from linkwise.model.law import VARIABLES, Law
from linkwise.model.structure import Structure


@dataclass(frozen=True)
class LawGroup:
    """Neighbouring links (a slice of the link axis) under one law; their coefficients start at `first`.

    `free` names the coefficients that are unknown in some link of the group.
    """

    law: Law
    links: slice
    first: int
    free: tuple[str, ...]

    @property
    def size(self) -> int:
        return int(self.links.stop - self.links.start)

    @cached_property
    def force(self) -> Program:
        """The law's force from d, v and its coefficients."""
        return _force_program(self.law)

    @cached_property
    def partials(self) -> Program:
        """The law's partials by d, v and the free coefficients."""
        return _slope_program(self.law, self.free)

    @property
    def rows(self) -> slice:
        """Where the coefficients of these links stand in the flat coefficient vector: name by name, link by link."""
        return slice(self.first, self.first + len(self.law.coefficients) * self.size)

    def row(self, name: str) -> slice:
        """Where coefficient `name` of these links stands."""
        start = self.first + self.law.coefficients.index(name) * self.size
        return slice(start, start + self.size)


@dataclass(frozen=True, eq=False)
class Parameters:
    """Free parameters theta (p,): coefficients = constant + map @ theta, masses = mass_constant + mass_map @ theta."""

    names: tuple[str, ...]
    constant: Floats
    map: Floats
    mass_constant: Floats
    mass_map: Floats
    lower: Floats
    upper: Floats

    @property
    def size(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class System:
    """Topology, laws and parameters; `at(theta)` puts numbers in. `order` (L,) are the structure's links, sorted by law."""

    incidence: Floats
    base: Floats
    groups: tuple[LawGroup, ...]
    parameters: Parameters
    order: Indices

    @classmethod
    def of(cls, structure: Structure) -> System:
        """The system of a structure; its parameters are `structure.parameters`."""
        by_law = structure.topology.by_law
        order = np.concatenate([indices for _, indices in by_law])
        unknown = {member for parameter in structure.parameters for member in parameter.members}
        groups, links, rows = [], 0, 0
        for law, indices in by_law:
            free = tuple(
                name
                for name in law.coefficients
                if any((index, name) in unknown for index in indices.tolist())
            )
            groups.append(LawGroup(law, slice(links, links + len(indices)), rows, free))
            links, rows = links + len(indices), rows + len(indices) * len(law.coefficients)
        return cls(
            incidence=structure.incidence.toarray()[:, order],
            base=structure.base_incidence[order],
            groups=tuple(groups),
            parameters=_parameters(structure, groups, order, rows),
            order=order,
        )

    def at(self, theta: Floats) -> NumericSystem:
        """The system with numbers (p,) for its parameters."""
        parameters = self.parameters
        return NumericSystem(
            self,
            parameters.constant + parameters.map @ theta,
            parameters.mass_constant + parameters.mass_map @ theta,
        )

    @cached_property
    def interactions(self) -> tuple[tuple[int, int, tuple[tuple[int, float], ...]], ...]:
        """Each (link, parameter) pair that interacts, with the rows of free coefficients and factors to sum for it."""
        found: dict[tuple[int, int], list[tuple[int, float]]] = {}
        rows = 0
        for group in self.groups:
            for name in group.free:
                for offset in range(group.size):
                    coefficient = group.row(name).start + offset
                    for column in np.flatnonzero(self.parameters.map[coefficient]):
                        pair = (group.links.start + offset, int(column))
                        factor = float(self.parameters.map[coefficient, column])
                        found.setdefault(pair, []).append((rows + offset, factor))
                rows += group.size
        return tuple((link, column, tuple(terms)) for (link, column), terms in found.items())

    @cached_property
    def free_rows(self) -> int:
        """Rows of partials by coefficients that `NumericSystem.partials` evaluates."""
        return sum(len(group.free) * group.size for group in self.groups)


def _parameters(structure: Structure, groups: list[LawGroup], order: Indices, rows: int) -> Parameters:
    place = {int(index): position for position, index in enumerate(order)}
    row_of = {}
    for group in groups:
        for index in order[group.links]:
            for name in group.law.coefficients:
                row_of[int(index), name] = group.row(name).start + place[int(index)] - group.links.start
    free = structure.parameters
    map_, mass_map = np.zeros((rows, len(free))), np.zeros((structure.size, len(free)))
    for column, parameter in enumerate(free):
        for index, name in parameter.members:
            if index < 0:
                mass_map[-1 - index, column] = 1.0
            else:
                map_[row_of[index, name], column] = 1.0
    constant = np.zeros(rows)
    for (index, name), row in row_of.items():
        constant[row] = 0.0 if map_[row].any() else structure.links[index].coefficients[name].value or 0.0
    masses = np.array([mass.mass.value or 0.0 for mass in structure.masses])
    return Parameters(
        names=tuple(parameter.name for parameter in free),
        constant=constant,
        map=map_,
        mass_constant=np.where(mass_map.any(axis=1), 0.0, masses),
        mass_map=mass_map,
        lower=np.array([parameter.lower for parameter in free]),
        upper=np.array([parameter.upper for parameter in free]),
    )


@dataclass(frozen=True, eq=False)
class ForcePartials:
    """Partials of the link forces: by elongation and its rate (..., L, K), by interacting parameter (..., E, K)."""

    by_d: Floats
    by_v: Floats
    by_parameter: Floats


@dataclass(frozen=True, eq=False)
class NumericSystem:
    """A system with numbers: M x'' = -B f(d, v) + w."""

    system: System
    coefficients: Floats
    masses: Floats

    @cached_property
    def _values(self) -> list[Floats]:
        """Per group its coefficients (names, links, 1), to broadcast against (links, K)."""
        return [
            self.coefficients[group.rows].reshape(len(group.law.coefficients), group.size, 1)
            for group in self.system.groups
        ]

    @cached_property
    def gain(self) -> Floats:
        """-M^-1 B (n, L): accelerations of masses by link forces."""
        return -self.system.incidence / self.masses[:, None]

    @cached_property
    def link_gain(self) -> Floats:
        """-B^T M^-1 B (L, L): accelerations of elongations by link forces."""
        return np.asarray(self.system.incidence.T @ self.gain)

    def force(self, d: Floats, v: Floats, out: Floats) -> None:
        """Link forces (L, K) at elongations and rates (L, K), written to `out`."""
        for group, values in zip(self.system.groups, self._values, strict=True):
            out[group.links] = group.force(d[group.links], v[group.links], *values)[0]

    def partials(self, d: Floats, v: Floats) -> ForcePartials:
        """Partials at elongations and rates (..., L, K)."""
        by_d, by_v = np.empty_like(d), np.empty_like(d)
        by_coefficient = np.empty((*d.shape[:-2], self.system.free_rows, d.shape[-1]))
        rows = 0
        for group, values in zip(self.system.groups, self._values, strict=True):
            here = (..., group.links, slice(None))
            found = group.partials(d[here], v[here], *values)
            by_d[here], by_v[here] = found[0], found[1]
            for slope in found[2:]:
                by_coefficient[..., rows : rows + group.size, :] = slope
                rows += group.size
        pairs = self.system.interactions
        by_parameter = np.empty((*d.shape[:-2], len(pairs), d.shape[-1]))
        for index, (_, _, terms) in enumerate(pairs):
            (row, factor), *rest = terms
            by_parameter[..., index, :] = factor * by_coefficient[..., row, :]
            for row, factor in rest:
                by_parameter[..., index, :] += factor * by_coefficient[..., row, :]
        return ForcePartials(by_d, by_v, by_parameter)


@lru_cache(maxsize=512)
def _force_program(law: Law) -> Program:
    return Program([law.expression], (*VARIABLES, *law.coefficients), wide=VARIABLES)


@lru_cache(maxsize=512)
def _slope_program(law: Law, free: tuple[str, ...]) -> Program:
    slopes = [differentiate(law.expression, name) for name in (*VARIABLES, *free)]
    return Program(slopes, (*VARIABLES, *law.coefficients), wide=VARIABLES)
