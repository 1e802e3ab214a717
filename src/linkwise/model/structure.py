"""The structure: masses, links, and the incidence matrix, the only place of signs and of action = reaction.

    d = B'x + e x_base,   M x'' = -B f(d, d') + w(t)        (METHODS section 1)

B is `Structure.incidence`, e is `Structure.base_incidence`, f holds the laws of the links.

`Topology` is the structure as arrays: the one numbering of masses, points, ground and base, and the links grouped by law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from linkwise.arrays import Floats, Indices
from linkwise.display import NotebookView, align_columns, near_miss
from linkwise.errors import StructureError, expect
from linkwise.expression import Expression
from linkwise.model.coefficient import (
    MASS,
    Coefficient,
    Name,
    Text,
    as_coefficient,
    check_unique,
    index_of,
    quoted,
)
from linkwise.model.host import Host, is_between_modes, rotations_of, with_modes
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass, in_units_of_ends
from linkwise.model.parameters import (
    CoefficientSlot,
    Parameter,
    chosen_names,
    coefficient_slots,
    free_parameters,
    replace_shapes,
    resolve_sharing,
)

GROUND_INDEX = -1
BASE_INDEX = -2
FIRST_POINT = -3
"""The number of the first point of a host; those of others go down from there."""

Weights = tuple[tuple[int, float], ...]
"""How a place moves: numbers of masses or modes, and their parts in it."""


class LinkShape(NamedTuple):
    """What the equations of motion of a link are compiled from.

    Attributes
    ----------
    weights : tuple of (int, float)
        Numbers of the masses and modes in its elongation, and their weights: the column of the incidence.
    base : float
        Weight of the base in its elongation.
    law : Expression
        The law, parsed.
    rates : tuple of (str, Expression)
        The rate of each state of a link with memory, by name.
    signals : tuple of str
        The recorded signals that the law or a rate names.

    Examples
    --------
    >>> import linkwise as lw
    >>> masses, shapes = lw.bnes_chain(2).shape_key
    >>> masses, shapes[1].weights, shapes[1].states
    (2, ((1, 1.0), (0, -1.0)), ())
    """

    weights: Weights
    base: float
    law: Expression
    rates: tuple[tuple[str, Expression], ...] = ()
    signals: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(name for name, _ in self.rates)


@dataclass(frozen=True, eq=False)
class Topology:
    """Which links join which masses, by number.

    Attributes
    ----------
    index : mapping of str to int
        The number of each mass by name, from 0; that of "ground" is -1, of "base" -2, of points of hosts from -3 down.
    ends : array of int, shape (L, 2)
        Numbers of the first and the second end of each link.
    by_law : tuple of (Law, array of int)
        Each law with the numbers (m,) of its links, in order of first appearance.
    states : tuple of (int, str)
        The states (S,) of links with memory, each as number of the link and name.
    points : tuple of tuple of (int, float)
        For each point of a host the numbers of its modes and their shapes there; then modes in the other direction.

    Examples
    --------
    >>> import linkwise as lw
    >>> topology = lw.bnes_chain(4).topology
    >>> topology.size, topology.ends.tolist()
    (4, [[0, -1], [1, 0], [2, 0], [3, 2]])
    """

    index: Mapping[str, int]
    ends: Indices
    by_law: tuple[tuple[Law, Indices], ...]
    states: tuple[tuple[int, str], ...] = ()
    points: tuple[Weights, ...] = ()

    @classmethod
    def of(cls, mass_names: Sequence[str], links: Sequence[Link], hosts: Sequence[Host] = ()) -> Topology:
        """Number the masses and links of a structure.

        Parameters
        ----------
        mass_names : sequence of str
            The n masses, in order.
        links : sequence of Link
            The L links.
        hosts : sequence of Host, optional
            The hosts, whose modes are among the masses.

        Returns
        -------
        Topology
            The numbering.

        Raises
        ------
        StructureError
            If no motion of a host stretches a link.
        """
        index = {name: number for number, name in enumerate(mass_names)}
        index |= {GROUND: GROUND_INDEX, BASE: BASE_INDEX}
        parts = {point: host.shape(point).items() for host in hosts for point in host.points}
        shapes = {
            point: tuple((index[mode], part) for mode, part in own if part) for point, own in parts.items()
        }
        shapes |= {place: ((index[mode], -1.0),) for host in hosts for place, mode in host.negated.items()}
        index |= {point: FIRST_POINT - number for number, point in enumerate(shapes)}
        ends = np.array([[index[end] for end in link.between] for link in links], dtype=np.intp)
        ends = ends.reshape(-1, 2)
        ends.flags.writeable = False
        members: dict[Law, list[int]] = {}
        for number, link in enumerate(links):
            members.setdefault(link.law, []).append(number)
        by_law = tuple((law, np.array(numbers, dtype=np.intp)) for law, numbers in members.items())
        states = tuple((number, name) for number, link in enumerate(links) for name in link.law.states)
        topology = cls(index, ends, by_law, states, tuple(shapes.values()))
        for link, column in zip(links, topology.columns, strict=True) if hosts else ():
            if not column:
                message = (
                    f"both ends, {' and '.join(link.between)}, move alike in every mode: nothing stretches it"
                )
                raise StructureError(message, f'link "{link.name}"')
        return topology

    @property
    def dimension(self) -> int:
        """Number of displacements, velocities and states of links, 2n + S."""
        return 2 * self.size + len(self.states)

    @property
    def size(self) -> int:
        """Number of masses and modes."""
        return len(self.index) - 2 - len(self.points)

    def weights(self, number: int) -> Weights:
        """How a mass, a point or a support moves.

        Parameters
        ----------
        number : int
            Its number.

        Returns
        -------
        tuple of (int, float)
            Numbers of masses and modes, and their parts in its motion; none for the ground and the base.
        """
        if number >= 0:
            return ((number, 1.0),)
        return self.points[FIRST_POINT - number] if number <= FIRST_POINT else ()

    def row(self, name: str) -> Floats:
        """How a mass or a point moves, as an array.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        array of shape (n,)
            The parts of masses and modes in its motion.
        """
        row = np.zeros(self.size)
        for number, part in self.weights(self.index[name]):
            row[number] = part
        return row

    @cached_property
    def columns(self) -> tuple[Weights, ...]:
        """For each link the masses and modes in its elongation, and their weights."""
        columns = []
        for first, second in self.ends.tolist():
            column = dict(self.weights(first))
            for number, part in self.weights(second):
                column[number] = column.get(number, 0.0) - part
            columns.append(tuple((number, part) for number, part in column.items() if part))
        return tuple(columns)

    @cached_property
    def incidence(self) -> scipy.sparse.csr_array:
        """Incidence matrix B of masses and modes, sparse, shape (n, L)."""
        parts = [(row, link, part) for link, column in enumerate(self.columns) for row, part in column]
        rows, links, weights = zip(*parts, strict=True) if parts else ((), (), ())
        return scipy.sparse.csr_array((weights, (rows, links)), shape=(self.size, len(self.ends)))

    @cached_property
    def base_incidence(self) -> Floats:
        """Incidence e of the base, shape (L,)."""
        on_base = self.ends == BASE_INDEX
        incidence: Floats = on_base[:, 0].astype(float) - on_base[:, 1]
        incidence.flags.writeable = False
        return incidence


_MOST = 40  # masses or links that are shown

__all__ = ["BASE", "GROUND", "Coefficient", "Link", "Mass", "Parameter", "Structure"]


@dataclass(frozen=True, repr=False)
class Structure(NotebookView):
    """Masses joined by links; immutable, every change returns a new structure.

    Parameters
    ----------
    name : str
        Title of the structure.
    masses : tuple of Mass
        The n masses, in the order of all arrays.
    links : tuple of Link
        The L links, in the order of all arrays.
    hosts : tuple of Host, optional
        Linear structures known by modes. Their modes come before the other masses and links, with names such as
        ``"wing.mode1"``; their points, such as ``"wing.tip"``, may be ends of links.

    Raises
    ------
    StructureError
        If a name is used twice, an end of a link is not a mass, a mass has no link, or a shared coefficient does not exist.

    Examples
    --------
    >>> import linkwise as lw
    >>> coefficients = {"k": 400.0, "c": lw.Coefficient.unknown()}
    >>> spring = lw.Link("spring", ("m1", lw.model.GROUND), lw.Law.parse("k*d + c*v"), coefficients)
    >>> structure = lw.Structure("oscillator", (lw.Mass("m1", 1.0),), (spring,))
    >>> [parameter.name for parameter in structure.parameters]
    ['spring.c']
    """

    name: str
    masses: tuple[Mass, ...]
    links: tuple[Link, ...]
    hosts: tuple[Host, ...] = ()

    def __post_init__(self) -> None:
        for parts, kind in (("masses", Mass), ("links", Link), ("hosts", Host)):
            for number, part in enumerate(getattr(self, parts)):
                expect(f'structure "{self.name}": {parts}[{number}]', part, kind)
        object.__setattr__(self, "hosts", tuple(self.hosts))
        check_unique(tuple(host.name for host in self.hosts), "host")
        masses, links = with_modes(tuple(self.masses), tuple(self.links), self.hosts)
        vars(self).update(masses=masses, links=links)
        if not (self.masses or self.links):
            raise StructureError('a structure needs at least one mass, host, or link from "base" to "ground"')
        check_unique((*self.points, *self.mass_names), "mass")
        check_unique(tuple(link.name for link in self.links), "link")
        self._check_ends()
        for link in self.links:
            for name, unit in link.law.signal_units:
                if unit != self.signals[name]:
                    message = (
                        f'signal {name} is in "{unit}" here, and in "{self.signals[name]}" in another link'
                    )
                    raise StructureError(message, f'link "{link.name}"')
        object.__setattr__(self, "links", in_units_of_ends(self.links, self.rotations))
        if self.leaders:
            given = {name: slot.coefficient for name, slot in self._slots.items()}
            pairs = {name: (given[name], given[leader]) for name, leader in self.leaders.items()}
            resolved = {name: replace(leader, same_as=own.same_as) for name, (own, leader) in pairs.items()}
            masses, links = self._parts(resolved)
            vars(self).update(masses=masses, links=links)
            del self.__dict__["_slots"]  # cached from the coefficients before their sharing was resolved

    def _check_ends(self) -> None:
        """Raise StructureError for an unknown end, or a mass without a link."""
        mass_names, places = self.mass_names, self.places
        links = [link for link in self.links if not is_between_modes(link.name)]
        supports = [link for link in links if set(link.between) <= {GROUND, BASE}]
        if supports and mass_names:
            first, second = supports[0].between
            raise StructureError(
                f'at least one end must be a mass, got "{first}" and "{second}"; a link between these needs a '
                "structure without masses, a rig",
                f'link "{supports[0].name}"',
            )
        names = {*mass_names, *places}
        linked: set[str] = set()
        for link in links:
            for end in link.between:
                if end not in names and end not in (GROUND, BASE):
                    kinds = "masses" if names == set(mass_names) else "masses and points"
                    raise StructureError(
                        f'unknown end "{end}"{near_miss(end, [*places, GROUND, BASE])}; an end is "ground", "base" or one of '
                        f"the {kinds} {quoted(places)}",
                        f'link "{link.name}"',
                    )
            linked.update(link.between)
        loose = [name for name in mass_names if name not in linked]
        if loose:
            problem = "no link has it as an end; add a link or remove the mass"
            raise StructureError(problem, f"mass {quoted(loose)}")

    @cached_property
    def _slots(self) -> dict[str, CoefficientSlot]:
        return coefficient_slots(self.masses, self.links, self.hosts)

    @cached_property
    def leaders(self) -> dict[str, str]:
        """The coefficient that each shared one is equal to in the end, by full names."""
        return resolve_sharing(self._slots)

    @property
    def size(self) -> int:
        """Number of masses and modes, n."""
        return len(self.masses)

    @cached_property
    def mass_names(self) -> tuple[str, ...]:
        """Names of the masses, in the order of all arrays."""
        return tuple(mass.name for mass in self.masses)

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Names of the masses that are no modes, and of the points of hosts: where links end and sensors sit."""
        return (*self.points, *(name for name in self.mass_names if name not in self.modes))

    @cached_property
    def modes(self) -> frozenset[str]:
        """Names of the masses and links that are modes of hosts, such as ``"wing.mode1"``, and of dampers between them."""
        return frozenset(part.name for host in self.hosts for parts in host.parts() for part in parts)

    @property
    def on_rig(self) -> bool:
        """Whether links stand alone on a rig, between the base and the ground: there is no mass."""
        return not self.masses

    @property
    def contents(self) -> str:
        """How many hosts, modes, masses and links there are, such as "2 masses, 2 links"; modes are not counted twice."""
        modes = sum(len(host.modes) for host in self.hosts)
        links = len(self.links) - sum(len(host.parts()[1]) for host in self.hosts)
        counts = [(len(self.hosts), "host", "hosts"), (modes, "mode", "modes")] if self.hosts else []
        counts += [(self.size - modes, "mass", "masses"), (links, "link", "links")]
        return ", ".join(
            f"{count} {singular if count == 1 else plural}" for count, singular, plural in counts
        )

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the points of hosts, such as ``"wing.tip"``."""
        return tuple(point for host in self.hosts for point in host.points)

    @cached_property
    def signals(self) -> dict[str, str]:
        """Units of the recorded signals that the laws name, such as ``{"u": "V"}``."""
        return {name: unit for link in self.links for name, unit in link.law.signal_units}

    @cached_property
    def rotations(self) -> tuple[str, ...]:
        """Names of the points and masses whose displacement is a rotation in rad; links between them are moments in N m."""
        return rotations_of(self.hosts, self.masses)

    @cached_property
    def mass_values(self) -> Floats:
        """Masses in kg (kg m^2), shape (n,); the start value of an unknown. Raises StructureError if there is neither."""
        for mass in self.masses:
            if mass.mass.value is None:
                message = "is unknown and has no start value; give it a number, or identify it first"
                raise StructureError(message, f'mass "{mass.name}"')
        values = np.array([mass.mass.value for mass in self.masses], dtype=float)
        values.flags.writeable = False
        return values

    @cached_property
    def _mass_index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.mass_names)}

    @cached_property
    def _link_index(self) -> dict[str, int]:
        return {link.name: index for index, link in enumerate(self.links)}

    def __str__(self) -> str:
        masses = [
            (mass.name, "unknown" if mass.mass.value is None else f"{mass.mass.value:g} {mass.mass_unit}")
            for mass in self.masses[:_MOST]
        ]
        links = [(link.name, " - ".join(link.between), link.law.equations) for link in self.links[:_MOST]]
        count = f"{len(self.masses)} masses, {len(self.links)} links"
        lines = [f"{self.name or 'structure'}: {count}", *align_columns([("mass", ""), *masses])]
        if links:
            lines += align_columns([("link", "between", "law"), *links])
        left_out = max(len(self.masses), len(self.links)) - _MOST
        return "\n".join([*lines, *([f"... and {left_out} more"] if left_out > 0 else [])])

    def mass(self, name: str) -> Mass:
        """Look up a mass.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Mass
            The mass.

        Raises
        ------
        StructureError
            If there is no mass of this name.
        """
        return self.masses[index_of(self._mass_index, name, "mass", "masses")]

    def link(self, name: str) -> Link:
        """Look up a link.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Link
            The link.

        Raises
        ------
        StructureError
            If there is no link of this name.
        """
        return self.links[index_of(self._link_index, name, "link", "links")]

    @cached_property
    def incidence(self) -> scipy.sparse.csr_array:
        """Incidence matrix B, sparse, (n, L): +1 for the first end of a link, -1 for the second; of a mode its shape there."""
        return self.topology.incidence

    @cached_property
    def base_incidence(self) -> Floats:
        """Incidence e of the base, shape (L,): +1 where it is the first end of a link, -1 where it is the second, else 0."""
        return self.topology.base_incidence

    def elongations(self, x: ArrayLike, base: ArrayLike | None = None) -> Floats:
        """Elongations of the links, ``B'x + e x_base``; from velocities, their rates.

        Parameters
        ----------
        x : array of shape (N, n) or (n,)
            Displacements of the masses in m, or velocities in m/s.
        base : array of shape (N,) or float, optional
            Displacement of the base in m, or its velocity in m/s; needed if a link has the base as an end.

        Returns
        -------
        array of shape (N, L) or (L,)
            Elongations in m, or rates in m/s.

        Raises
        ------
        StructureError
            If the number of displacements is not n, or the motion of the base is missing.

        Examples
        --------
        >>> import linkwise as lw
        >>> lw.bnes_chain(2).elongations([0.5, 0.75])
        array([0.5 , 0.25])
        """
        x = np.asarray(x, dtype=float)
        if x.ndim not in (1, 2) or x.shape[-1] != self.size:
            raise StructureError(f"x must have the shape (N, {self.size}) or ({self.size},), got {x.shape}")
        d = np.ascontiguousarray((self.incidence.T @ x.T).T)
        on_base = np.flatnonzero(self.base_incidence)
        if on_base.size == 0:
            return d
        if base is None:
            message = "has the base as an end, but the motion of the base is not given"
            raise StructureError(message, f'link "{self.links[on_base[0]].name}"')
        d[..., on_base] += np.asarray(base, dtype=float)[..., None] * self.base_incidence[on_base]
        return d

    def coefficient(self, name: str) -> Coefficient:
        """Look up a coefficient.

        Parameters
        ----------
        name : str
            Its full name, such as ``"nes1.alpha"``, ``"m1.mass"`` or ``"wing.mode1.shape.tip"``.

        Returns
        -------
        Coefficient
            The coefficient; of a shared one its leader.

        Raises
        ------
        StructureError
            If there is no coefficient of this name.
        """
        slot = index_of(self._slots, name, "coefficient", "coefficients")
        return self._slots[self.leaders[name]].coefficient if name in self.leaders else slot.coefficient

    def unit_of(self, name: str) -> str:
        """Look up the SI unit of a coefficient.

        Parameters
        ----------
        name : str
            Its full name.

        Returns
        -------
        str
            The unit; ``"?"`` where the law does not determine it.

        Raises
        ------
        StructureError
            If there is no coefficient of this name.
        """
        return index_of(self._slots, name, "coefficient", "coefficients").unit

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters: those of the links, then those of the masses; shared ones once."""
        return free_parameters(self._slots, self.leaders)

    def unknown(self, *which: str) -> Structure:
        """Make coefficients unknown. Values and start values are dropped; bounds, also of named laws, are kept.

        Parameters
        ----------
        *which : str
            Each is ``"all"`` (every link), the name of a link, a prefix of link names (``"nes"``), ``"link.coefficient"``
            (with a prefix too), ``"mass:NAME"``, or ``"HOST.mode1.shape.POINT"``, which stays its start. Or their leader.

        Returns
        -------
        Structure
            The structure with unknowns.

        Raises
        ------
        StructureError
            If nothing is given, or a name does not exist.

        Examples
        --------
        >>> import linkwise as lw
        >>> len(lw.bnes_chain(4).unknown("nes", "spring1.k").parameters)
        7
        """
        if not which:
            choices = '"all", a link, a prefix of link names, or "mass:NAME"'
            raise StructureError(f"expected at least one of {choices}")
        chosen = {name for selector in which for name in self._chosen(selector)}
        freed = {name: self._slots[name].freed for name in {self.leaders.get(name, name) for name in chosen}}
        return self.with_coefficients(freed)

    def with_values(self, values: Mapping[Text, float]) -> Structure:
        """Set coefficients to known values.

        Coefficients that share a changed one change with it; if an unknown is set, shared ones with a value become numbers.

        Parameters
        ----------
        values : mapping of str to float
            Value in SI units by full name, such as ``"nes1.alpha"`` or ``"m1.mass"``.

        Returns
        -------
        Structure
            The structure with the values.

        Raises
        ------
        StructureError
            If a name does not exist, or coefficients that share a value are given different ones.

        Examples
        --------
        >>> import linkwise as lw
        >>> lw.bnes_chain(2).with_values({"nes1.alpha": -50.0}).coefficient("nes1.alpha").value
        -50.0
        """
        if not values:
            return self
        changes: dict[str, Coefficient] = {}
        identified = any(not self.coefficient(name).known for name in values)
        for name, value in values.items():
            leader = self.leaders.get(name, name)
            change = as_coefficient(value, name)
            if changes.setdefault(leader, change) != change:
                raise StructureError(f'is equal to "{leader}", for which another value is given', name)
        changed = self.with_coefficients(changes)
        if not identified:
            return changed
        plain = {
            name: replace(changed._slots[name].coefficient, same_as=None)
            for name in changed.leaders
            if changed._slots[name].coefficient.known and not is_between_modes(name)
        }
        return changed.with_coefficients(plain) if plain else changed

    def with_coefficients(self, changes: Mapping[str, Coefficient]) -> Structure:
        """Replace coefficients.

        Parameters
        ----------
        changes : mapping of str to Coefficient
            New coefficients by full name; those that share a changed one change with it.

        Returns
        -------
        Structure
            The structure with these.

        Examples
        --------
        >>> import linkwise as lw
        >>> within = lw.Coefficient.unknown(-100.0, sigma=1.0)
        >>> lw.bnes_chain(2).with_coefficients({"nes1.alpha": within}).parameters[0].sigma
        1.0
        """
        return Structure(self.name, *self._parts(changes), replace_shapes(self.hosts, changes))

    def _parts(self, changes: Mapping[str, Coefficient]) -> tuple[tuple[Mass, ...], tuple[Link, ...]]:
        """Masses and links with some coefficients, given by full name, replaced."""
        masses, links = list(self.masses), list(self.links)
        by_link: dict[int, dict[str, Coefficient]] = {}
        for name, coefficient in changes.items():
            slot = self._slots[name]
            if slot.index >= 0:
                by_link.setdefault(slot.index, {})[slot.name.key] = coefficient
            elif not slot.name.is_shape:
                masses[-1 - slot.index] = replace(masses[-1 - slot.index], mass=coefficient)
        for index, new in by_link.items():
            links[index] = replace(links[index], coefficients={**links[index].coefficients, **new})
        return tuple(masses), tuple(links)

    def _chosen(self, selector: str) -> list[str]:
        """Full names that one argument of `unknown` selects. Raises StructureError if there are none."""
        if not selector.startswith("mass:"):
            return chosen_names(selector, self._link_index, self._slots)
        name = Name(self.mass(selector.removeprefix("mass:")).name, MASS)
        self.coefficient(name)  # a mode has none
        return [name]

    @cached_property
    def topology(self) -> Topology:
        """Numbering of masses, ground and base, ends of the links, and links by law."""
        return Topology.of(self.mass_names, self.links, self.hosts)

    @cached_property
    def shape_key(self) -> tuple[int, tuple[LinkShape, ...]]:
        """Number of masses and, for each link, weights and law; equal for structures that share compiled code."""
        topology = self.topology
        return self.size, tuple(
            LinkShape(column, float(base), link.law.expression, link.law.named_rates, link.law.signals)
            for column, base, link in zip(topology.columns, topology.base_incidence, self.links, strict=True)
        )


def refuse_hosts(structure: Structure, feature: str) -> None:
    """Raise StructureError if a structure has a host, which `feature` does not take."""
    if structure.hosts:
        message = f"a host is not supported in {feature}; maximum likelihood takes it"
        raise StructureError(message, f'host "{structure.hosts[0].name}"')


def refuse_rig(structure: Structure, feature: str) -> None:
    """Raise StructureError for a structure without a mass, which `feature` does not take."""
    if structure.on_rig:
        message = (
            f"there is no mass: links alone on a rig are not supported in {feature}; add the mass that moves"
        )
        raise StructureError(message, f'link "{structure.links[0].name}"')
