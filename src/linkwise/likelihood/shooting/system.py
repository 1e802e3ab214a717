"""A structure as arrays: topology, laws by group and the linear map from parameters to coefficients and masses.

The batch of segments is the LAST axis of arrays, (links, K) or (masses, K): links are then contiguous, a group of links
with one law is a slice, and B^T x is one matrix product for all segments. Links are sorted by law; `System.order` has their
indices in the structure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.expression import Operation
from linkwise.likelihood.shooting.law_group import LawGroup
from linkwise.likelihood.shooting.parameters import Parameters
from linkwise.likelihood.shooting.rate_partials import MemorySlopes, RatePartials
from linkwise.likelihood.shooting.shape_parameters import ShapeParameters
from linkwise.likelihood.starts.linear_part import is_linear
from linkwise.model.slider_corners import slider_parts
from linkwise.model.structure import Structure

MANY = 12  # masses from which the parts of a structure are handled apart


@dataclass(frozen=True, eq=False)
class System:
    """Topology, laws and parameters of a structure.

    Attributes
    ----------
    incidence : array of shape (n, L)
        B, links sorted by law, with the shapes of hosts that the structure states.
    base : array of shape (L,)
        Incidence of the base.
    groups : tuple of LawGroup
        The links by law.
    parameters : Parameters
        The parameters.
    order : array of int, shape (L,)
        Indices of the links in the structure.
    state_links : array of int, shape (S,)
        Position of the link of each state.
    states : tuple of (int, str)
        Each state as index of its link in the structure and name.
    points : array of shape (k, n)
        How each point of a host moves, in the order of their numbers, -3 first, with the shapes that the structure states.
    shapes : ShapeParameters or None
        The shapes among the parameters.
    base_error : int or None
        Number among the S states of the error of the recorded displacement of the base, which the links there lack.
    """

    incidence: Floats
    base: Floats
    groups: tuple[LawGroup, ...]
    parameters: Parameters
    order: Indices
    state_links: Indices
    states: tuple[tuple[int, str], ...]
    points: Floats
    shapes: ShapeParameters | None = None
    base_error: int | None = None

    @property
    def dimension(self) -> int:
        """Displacements, velocities and states of links, 2n + S."""
        return 2 * len(self.incidence) + len(self.states)

    @classmethod
    def of(cls, structure: Structure, *, lag: float | None = None) -> System:
        """The system of a structure.

        Parameters
        ----------
        structure : Structure
            The structure.
        lag : float, optional
            Time in s by which sliders may lag behind their corners, which are rounded then; by default rates are as they are
            written.

        Returns
        -------
        System
            Its system, with `structure.parameters` as parameters.
        """
        by_law = structure.topology.by_law
        order = np.concatenate([indices for _, indices in by_law])
        unknown = {member for parameter in structure.parameters for member in parameter.members}
        groups, links, rows = [], 0, 0
        states: list[tuple[int, str]] = []
        owners: list[int] = []
        for law, indices in by_law:
            free = tuple(
                name
                for name in law.coefficients
                if any((index, name) in unknown for index in indices.tolist())
            )
            groups.append(LawGroup(law, slice(links, links + len(indices)), rows, len(states), free, lag))
            states += [(index, name) for name in law.states for index in indices.tolist()]
            owners += [links + number for _ in law.states for number in range(len(indices))]
            links, rows = links + len(indices), rows + len(indices) * len(law.coefficients)
        return cls(
            incidence=structure.incidence.toarray()[:, order],
            base=structure.base_incidence[order],
            groups=tuple(groups),
            parameters=Parameters.of(structure, groups, order, rows),
            order=order,
            state_links=np.array(owners, dtype=int),
            states=tuple(states),
            points=np.array([structure.topology.row(name) for name in structure.points]).reshape(
                -1, structure.size
            ),
            shapes=ShapeParameters.of(structure, order),
        )

    def at(self, theta: Floats) -> NumericSystem:
        """The system with values of the parameters.

        Parameters
        ----------
        theta : array of shape (p,)
            The values.

        Returns
        -------
        NumericSystem
            The system in numbers.
        """
        parameters = self.parameters
        return NumericSystem(
            self,
            parameters.constant + parameters.map @ theta,
            parameters.mass_constant + parameters.mass_map @ theta,
            None if self.shapes is None else self.shapes.change(theta),
        )

    def without_parameters(self, theta: Floats) -> System:
        """The system whose parameters are known: none is left. Shapes of hosts must not be among them.

        Parameters
        ----------
        theta : array of shape (p,)
            Their values.

        Returns
        -------
        System
            The system without parameters.
        """
        assert self.shapes is None
        numbers = self.at(theta)
        known = self.parameters.known(numbers.coefficients, numbers.masses)
        groups = tuple(replace(group, free=()) for group in self.groups)
        return replace(self, groups=groups, parameters=known)

    @cached_property
    def slider_states(self) -> Indices:
        """Rows (s,) of the states of sliders among all 2n + S: those that are held within a largest size."""
        first = 2 * len(self.incidence)
        rows = [
            np.arange(group.states.start, group.states.stop)
            for group in self.groups
            if slider_parts(group.law) is not None
        ]
        return first + np.concatenate([np.empty(0, dtype=int), *rows])

    @cached_property
    def linear_links(self) -> Indices:
        """Links whose laws are linear in motion, without states, and whose ends move by known shapes."""
        linear = np.zeros(self.incidence.shape[1], dtype=bool)
        for group in self.groups:
            linear[group.links] = is_linear(group.law)
        if self.shapes is not None:
            linear &= ~self.shapes.sides.any(axis=0)
        return np.flatnonzero(linear)

    @cached_property
    def interactions(self) -> tuple[tuple[int, int, tuple[tuple[int, float], ...]], ...]:
        """Each pair of a link and a parameter of its law, with the rows of coefficients and the factors to sum for it."""
        factors: dict[tuple[int, int], list[tuple[int, float]]] = {}
        rows = 0
        for group in self.groups:
            for name in group.free:
                for offset in range(group.size):
                    coefficient = group.row(name).start + offset
                    for column in np.flatnonzero(self.parameters.map[coefficient]):
                        pair = (group.links.start + offset, int(column))
                        factor = float(self.parameters.map[coefficient, column])
                        factors.setdefault(pair, []).append((rows + offset, factor))
                rows += group.size
        return tuple((link, column, tuple(terms)) for (link, column), terms in factors.items())

    @property
    def wholly_unknown(self) -> Bools:
        """(L,) links of which every coefficient is a parameter."""
        known = np.zeros(self.incidence.shape[1], dtype=bool)
        for group in self.groups:
            fixed = ~self.parameters.map[group.rows].any(axis=1)
            known[group.links] = fixed.reshape(-1, group.size).any(axis=0)
        return ~known

    @cached_property
    def free_rows(self) -> int:
        """Number of rows of partial derivatives with respect to coefficients in `NumericSystem.partials`."""
        return sum(len(group.free) * group.size for group in self.groups)


@dataclass(frozen=True, eq=False)
class ForcePartials:
    """Partial derivatives of the link forces.

    Attributes
    ----------
    by_d, by_v : array of shape (..., L, K)
        With respect to elongations and rates.
    by_parameter : array of shape (..., E, K)
        With respect to parameters, one row for each of `System.interactions`.
    memory : RatePartials
        Those that states have.
    """

    by_d: Floats
    by_v: Floats
    by_parameter: Floats
    memory: RatePartials


@dataclass(frozen=True, eq=False)
class NumericSystem:
    """A system in numbers: M x'' = -B f(d, v) + w.

    Attributes
    ----------
    system : System
        The system.
    coefficients : array of shape (c,)
        The coefficients in SI units.
    masses : array of shape (n,)
        The masses in kg.
    shape_change : array of shape (k, n) or None
        By how much points of hosts move more with each mode than with the shapes that the structure states.
    """

    system: System
    coefficients: Floats
    masses: Floats
    shape_change: Floats | None = None

    @cached_property
    def _values(self) -> list[Floats]:
        """Per group its coefficients (names, links, 1), to broadcast against (links, K)."""
        return [
            self.coefficients[group.rows].reshape(len(group.law.coefficients), group.size, 1)
            for group in self.system.groups
        ]

    @cached_property
    def points(self) -> Floats:
        """(k, n) how each point of a host moves."""
        return self.system.points if self.shape_change is None else self.system.points + self.shape_change

    @cached_property
    def incidence(self) -> Floats:
        """B (n, L)."""
        if self.system.shapes is None or self.shape_change is None:
            return self.system.incidence
        return self.system.incidence + self.shape_change.T @ self.system.shapes.sides

    @cached_property
    def gain(self) -> Floats:
        """-M^-1 B (n, L): accelerations of masses by link forces."""
        return -self.incidence / self.masses[:, None]

    @cached_property
    def link_gain(self) -> Floats:
        """-B^T M^-1 B (L, L): accelerations of elongations by link forces."""
        return np.asarray(self.incidence.T @ self.gain)

    def force(self, d: Floats, v: Floats, states: Floats, out: Floats, rates: Floats) -> None:
        """Link forces, and rates of states.

        Parameters
        ----------
        d, v : array of shape (..., L, K)
            Elongations in m and rates in m/s.
        states : array of shape (..., S, K)
            States of links.
        out : array of shape (..., L, K)
            The forces in N, overwritten.
        rates : array of shape (..., S, K)
            The rates of the states, overwritten.
        """
        for group, values in zip(self.system.groups, self._values, strict=True):
            which, inside = group.which, group.of_states(states)
            force, *slopes = group.force(d[which], v[which], *inside, *values)
            out[which] = force
            for own, slope in zip(group.of_states(rates), slopes, strict=True):
                own[...] = slope

    def force_operations(
        self, d: Floats, v: Floats, states: Floats, out: Floats, rates: Floats
    ) -> list[Operation]:
        """What `force` does, as operations that do it again and again on what the arrays hold by then.

        Parameters
        ----------
        d, v, states, out, rates : arrays
            As for `force`; `out` and `rates` share no memory with the others.

        Returns
        -------
        list of callables
            To be called in this order, where floating-point warnings are ignored.
        """
        operations = []
        for group, values in zip(self.system.groups, self._values, strict=True):
            given = (d[group.which], v[group.which], *group.of_states(states), *values)
            operations += group.force.into(given, [out[group.which], *group.of_states(rates)])
        return operations

    def partials(self, d: Floats, v: Floats, states: Floats) -> ForcePartials:
        """Partial derivatives of the link forces.

        Parameters
        ----------
        d, v : array of shape (..., L, K)
            Elongations in m and rates in m/s.
        states : array of shape (..., S, K)
            States of links.

        Returns
        -------
        ForcePartials
            The derivatives.
        """
        by_d, by_v = np.empty_like(d), np.empty_like(d)
        by_coefficient = np.empty((*d.shape[:-2], self.system.free_rows, d.shape[-1]))
        rows = 0
        memory = MemorySlopes(self.system.parameters.map, states)
        for group, values in zip(self.system.groups, self._values, strict=True):
            which, inside = group.which, group.of_states(states)
            by_d[which], by_v[which], *slopes = group.partials(d[which], v[which], *inside, *values)
            for slope in slopes[: len(group.free)]:
                by_coefficient[..., rows : rows + group.size, :] = slope
                rows += group.size
            memory.take(group, slopes[len(group.free) :])
        pairs = self.system.interactions
        by_parameter = np.empty((*d.shape[:-2], len(pairs), d.shape[-1]))
        for index, (_, _, terms) in enumerate(pairs):
            (row, factor), *rest = terms
            by_parameter[..., index, :] = factor * by_coefficient[..., row, :]
            for row, factor in rest:
                by_parameter[..., index, :] += factor * by_coefficient[..., row, :]
        return ForcePartials(by_d, by_v, by_parameter, memory.partials())

    def slopes(self, d: Floats, v: Floats, states: Floats) -> tuple[Floats, Floats]:
        """Partial derivatives (..., L, K) of the link forces with respect to elongations and rates; as `partials`."""
        by_d, by_v = np.empty_like(d), np.empty_like(d)
        for group, values in zip(self.system.groups, self._values, strict=True):
            which = group.which
            by_d[which], by_v[which], *_ = group.slopes(d[which], v[which], *group.of_states(states), *values)
        return by_d, by_v
