"""A structure as arrays: topology, laws by group, and the linear map from parameters to coefficients and masses.

The batch of segments is the LAST axis of arrays, (links, K) or (masses, K): links are then contiguous, a group of links
with one law is a slice, and B^T x is one matrix product for all segments. Links are sorted by law; `System.order` has their
indices in the structure. `System.at` puts in numbers for the parameters: a `NumericSystem` has forces and their partial
derivatives, also by states of links with memory and by shapes of hosts that are parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.expression import Operation, Program, differentiate
from linkwise.likelihood.starts.kalman import is_linear
from linkwise.model.coefficient import MASS, SHAPE, Name
from linkwise.model.host import Host
from linkwise.model.law import VARIABLES, Law
from linkwise.model.named_laws import slider_parts, smooth_rates
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel


@dataclass(frozen=True)
class LawGroup:
    """Links with one law.

    Attributes
    ----------
    law : Law
        The law.
    links : slice
        Their positions on the link axis.
    first : int
        Position of their first coefficient in the vector of coefficients.
    first_state : int
        Position of their first state on the state axis: state by state, link by link.
    signals : tuple of int
        Positions of the signals that the law names on the state axis, where signals follow the states.
    free : tuple of str
        Coefficients that are unknown in one of these links at least.
    lag : float or None
        Time in s by which a slider may lag behind its corner, which is rounded; None takes rates as they are written.
    """

    law: Law
    links: slice
    first: int
    first_state: int
    signals: tuple[int, ...]
    free: tuple[str, ...]
    lag: float | None = None

    @cached_property
    def size(self) -> int:
        """Number of links."""
        return int(self.links.stop - self.links.start)

    @cached_property
    def force(self) -> Program:
        """Program for the force and the rates of the states from d, v, the states, the signals and the coefficients."""
        return _program(self.law, self.lag)

    @cached_property
    def partials(self) -> Program:
        """Program for the partial derivatives of the force with respect to d, v, the unknown coefficients and the states, and
        then of each rate.
        """
        return _program(self.law, self.lag, (*VARIABLES, *self.free, *self.law.states))

    @property
    def rows(self) -> slice:
        """Positions of the coefficients of these links in the vector of coefficients: name by name, link by link."""
        return slice(self.first, self.first + len(self.law.coefficients) * self.size)

    def of_states(self, values: Floats) -> list[Floats]:
        """The parts (..., m, K) of an array over all states (..., S, K), one for each state of the law."""
        firsts = (self.first_state + number * self.size for number in range(len(self.law.states)))
        return [values[..., first : first + self.size, :] for first in firsts]

    def state(self, number: int, link: int) -> int:
        """Position on the state axis of a state of the law, by its number, in one of these links."""
        return self.first_state + number * self.size + link

    def inside(self, d: Floats, v: Floats, values: Floats) -> list[Floats]:
        """What their laws take: elongations and rates (..., m, K) out of (..., L, K), the parts of `of_states`, and the
        signals (..., 1, K) that the law names, which follow the states in `values` (..., S + U, K).
        """
        signals = [values[..., place : place + 1, :] for place in self.signals]
        return [d[..., self.links, :], v[..., self.links, :], *self.of_states(values), *signals]

    def row(self, name: str) -> slice:
        """Positions of one coefficient of these links.

        Parameters
        ----------
        name : str
            Name of the coefficient.

        Returns
        -------
        slice
            Its positions in the vector of coefficients.
        """
        start = self.first + self.law.coefficients.index(name) * self.size
        return slice(start, start + self.size)


@lru_cache(maxsize=512)
def _program(law: Law, lag: float | None, by: tuple[str, ...] = ()) -> Program:
    """Program for the force of a link and the rates of its states, or for their partial derivatives `by` some names."""
    rates = [rate.expression for rate in law.rates] if lag is None else smooth_rates(law, lag)
    trees = [law.expression, *rates]
    if by:
        trees = [differentiate(tree, name) for tree in trees for name in by]
    return Program(trees, (*law.variables, *law.coefficients), wide=law.variables)


@dataclass(frozen=True, eq=False)
class ShapeParameters:
    """h parameters that are shapes of modes at points.

    Attributes
    ----------
    columns, points, modes : array of int, shape (h,)
        Which parameters they are, the numbers of the points from 0, and the numbers of the modes among the masses.
    start : array of shape (k, n)
        How points move with the shapes that the structure states.
    sides : array of shape (k, L)
        1 where a point is the first end of a link, -1 where it is the second; links in the order of the system.
    """

    columns: Indices
    points: Indices
    modes: Indices
    start: Floats
    sides: Floats

    @classmethod
    def of(cls, structure: Structure, order: Indices) -> ShapeParameters | None:
        """The shapes among the parameters of a structure, `order` (L,) being that of the links; None without any."""
        hosts = [name.partition(".")[0] for name in structure.mass_names]
        shapes = [
            (column, structure.points.index(f"{hosts[-1 - index]}.{key.removeprefix(SHAPE)}"), -1 - index)
            for column, parameter in enumerate(structure.parameters)
            for index, key in parameter.members
            if index < 0 and key.startswith(SHAPE)
        ]
        if not shapes:
            return None
        columns, points, modes = np.array(shapes, dtype=int).T
        ends = [structure.links[number].between for number in order.tolist()]
        sides = [[float(a == point) - float(b == point) for a, b in ends] for point in structure.points]
        start = np.array([structure.topology.row(name) for name in structure.points])
        return cls(columns, points, modes, start, np.array(sides))

    def change(self, theta: Floats) -> Floats:
        """(k, n) by which the rows of points differ from `start` at parameters theta (p,)."""
        change = np.zeros_like(self.start)
        change[self.points, self.modes] = theta[self.columns] - self.start[self.points, self.modes]
        return change


def held_where_unseen(structure: Structure, channels: Sequence[Channel]) -> Structure:
    """The structure with shapes known at points that have no link, force or sensor: nothing determines them.

    Parameters
    ----------
    structure : Structure
        The structure.
    channels : sequence of Channel
        Channels of the record.

    Returns
    -------
    Structure
        The structure; the same where every uncertain shape is at a point that is used.
    """
    used = {end for link in structure.links for end in link.between}
    used |= {channel.place for channel in channels}

    def held(host: Host) -> Host:
        seen = {point for point in host.modes[0].shape if f"{host.name}.{point}" in used}
        modes = (
            replace(mode, shape_sigma={key: mode.shape_sigma[key] for key in mode.shape_sigma if key in seen})
            for mode in host.modes
        )
        return replace(host, modes=tuple(modes))

    hosts = tuple(map(held, structure.hosts))
    return structure if hosts == structure.hosts else replace(structure, hosts=hosts)


@dataclass(frozen=True, eq=False)
class Parameters:
    """Parameters theta (p,): coefficients = constant + map @ theta, masses = mass_constant + mass_map @ theta.

    Attributes
    ----------
    names, units : tuple of Name, of str
        Names of the parameters and their SI units.
    constant, map : array of shape (c,), (c, p)
        Map to the c coefficients.
    mass_constant, mass_map : array of shape (n,), (n, p)
        Map to the masses.
    stated_masses : array of shape (n,)
        Values of the masses in the structure, 0 of those without one.
    lower, upper : array of shape (p,)
        Bounds.
    """

    names: tuple[Name, ...]
    units: tuple[str, ...]
    constant: Floats
    map: Floats
    mass_constant: Floats
    mass_map: Floats
    stated_masses: Floats
    lower: Floats
    upper: Floats

    @cached_property
    def size(self) -> int:
        """Number of parameters p."""
        return len(self.names)

    @classmethod
    def of(cls, structure: Structure, groups: list[LawGroup], order: Indices, rows: int) -> Parameters:
        """Those of a structure whose links, in this `order`, have `rows` coefficients in the groups."""
        row_of = {
            (index, name): group.row(name).start + offset
            for group in groups
            for offset, index in enumerate(order[group.links].tolist())
            for name in group.law.coefficients
        }
        free = structure.parameters
        map_, mass_map = np.zeros((rows, len(free))), np.zeros((structure.size, len(free)))
        for column, parameter in enumerate(free):
            for index, name in parameter.members:
                if index < 0 and name == MASS:
                    mass_map[-1 - index, column] = 1.0
                elif index >= 0:
                    map_[row_of[index, name], column] = 1.0
        constant = np.zeros(rows)
        for (index, name), row in row_of.items():
            constant[row] = 0.0 if map_[row].any() else structure.links[index].coefficients[name].value or 0.0
        masses = np.array([mass.mass.value or 0.0 for mass in structure.masses])
        return cls(
            names=tuple(parameter.name for parameter in free),
            units=tuple(parameter.unit for parameter in free),
            constant=constant,
            map=map_,
            mass_constant=np.where(mass_map.any(axis=1), 0.0, masses),
            mass_map=mass_map,
            stated_masses=masses,
            lower=np.array([parameter.lower for parameter in free]),
            upper=np.array([parameter.upper for parameter in free]),
        )


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

    @cached_property
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
        by_law, names = structure.topology.by_law, list(structure.signals)
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
            which = slice(links, links + len(indices))
            inputs = tuple(len(structure.topology.states) + names.index(name) for name in law.signals)
            groups.append(LawGroup(law, which, rows, len(states), inputs, free, lag))
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

    @cached_property
    def slider_states(self) -> Indices:
        """Rows (s,) of the states of sliders among all 2n + S: those that are held within a largest size."""
        owners = [group.links for group in self.groups if slider_parts(group.law) is not None]
        held = [
            state
            for state, link in enumerate(self.state_links)
            if any(o.start <= link < o.stop for o in owners)
        ]
        return 2 * len(self.incidence) + np.array(held, dtype=int)

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


Cross: TypeAlias = tuple[int, int, Floats]


@dataclass(frozen=True, eq=False)
class ForcePartials:
    """Partial derivatives of the link forces and of the rates of their S states.

    Attributes
    ----------
    by_d, by_v : array of shape (..., L, K)
        Of forces with respect to elongations and rates.
    by_parameter : array of shape (..., E, K)
        Of forces with respect to parameters, one row for each of `System.interactions`.
    by_state : array of shape (..., S, K)
        Of the force of a state's link with respect to the state.
    rate_by_d, rate_by_v : array of shape (..., S, K)
        Of the rates of states with respect to elongation and rate of the link.
    rate_by_state, rate_by_parameter : list of (int, int, array)
        Of the rate of a state (first) with respect to a state or a parameter (second), (..., K).
    """

    by_d: Floats
    by_v: Floats
    by_parameter: Floats
    by_state: Floats
    rate_by_d: Floats
    rate_by_v: Floats
    rate_by_state: list[Cross]
    rate_by_parameter: list[Cross]


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
        states : array of shape (..., S + U, K)
            States of links, and signals that laws name.
        out : array of shape (..., L, K)
            The forces in N, overwritten.
        rates : array of shape (..., S, K)
            The rates of the states, overwritten.
        """
        with np.errstate(all="ignore"):
            for operation in self.force_operations(d, v, states, out, rates):
                operation()

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
            shown = [out[..., group.links, :], *group.of_states(rates)]
            operations += group.force.into([*group.inside(d, v, states), *values], shown)
        return operations

    def partials(self, d: Floats, v: Floats, states: Floats) -> ForcePartials:
        """Partial derivatives of the link forces.

        Parameters
        ----------
        d, v : array of shape (..., L, K)
            Elongations in m and rates in m/s.
        states : array of shape (..., S + U, K)
            States of links, and signals that laws name.

        Returns
        -------
        ForcePartials
            The derivatives.
        """
        system, of_states = self.system, states[..., : len(self.system.states), :]
        by_d, by_v = np.empty_like(d), np.empty_like(d)
        by_state, rate_by_d, rate_by_v = (np.empty_like(of_states) for _ in range(3))
        by_coefficient, among_states, by_others = list[Floats](), list[Cross](), list[Cross]()
        for group, values in zip(system.groups, self._values, strict=True):
            slopes = group.partials(*group.inside(d, v, states), *values)
            count, free = len(group.law.states), len(group.free)
            width = 2 + free + count
            of_force, *of_rates = (slopes[at : at + width] for at in range(0, len(slopes), width))
            by_d[..., group.links, :], by_v[..., group.links, :], *others = of_force
            by_coefficient += [slope[..., k, :] for slope in others[:free] for k in range(group.size)]
            for own, slope in zip(group.of_states(by_state), others[free:], strict=True):
                own[...] = slope
            for number, (own_by_d, own_by_v, *others) in enumerate(of_rates):
                group.of_states(rate_by_d)[number][...] = own_by_d
                group.of_states(rate_by_v)[number][...] = own_by_v
                for k in range(group.size):
                    state, *sources = (group.state(source, k) for source in (number, *range(count)))
                    for source, slope in zip(sources, others[free:], strict=True):
                        among_states.append((state, source, slope[..., k, :]))
                    for name, slope in zip(group.free, others, strict=False):
                        factors = system.parameters.map[group.row(name).start + k]
                        for column in np.flatnonzero(factors).tolist():
                            by_others.append((state, column, factors[column] * slope[..., k, :]))
        by_parameter = np.empty((*d.shape[:-2], len(system.interactions), d.shape[-1]))
        for index, (_, _, terms) in enumerate(system.interactions):
            by_parameter[..., index, :] = sum(factor * by_coefficient[row] for row, factor in terms)
        return ForcePartials(
            by_d, by_v, by_parameter, by_state, rate_by_d, rate_by_v, among_states, by_others
        )

    def by_signal(self, signal: int, d: Floats, v: Floats, states: Floats) -> Floats:
        """Partial derivatives (..., L, K) of the link forces with respect to the signal at a position behind the states."""
        slopes = np.zeros_like(d)
        for group, values in zip(self.system.groups, self._values, strict=True):
            if signal in group.signals:
                name = group.law.signals[group.signals.index(signal)]
                slope = _program(group.law, group.lag, (name,))
                slopes[..., group.links, :] = slope(*group.inside(d, v, states), *values)[0]
        return slopes
