"""The structure: masses, links, and the incidence that carries sign and action = reaction for everybody.

    d = B'x + e x_base,   M x'' = -B f(d, d') + w(t)        (METHODS section 1)

B is `Structure.incidence`, e is `Structure.base_incidence`, f holds the laws of the links.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import BASE, GROUND, Link, Mass, near_miss
from linkwise.model.parameters import CoefficientSlot, Parameter, leaders, parameters, slots

__all__ = ["BASE", "GROUND", "Coefficient", "Link", "Mass", "Parameter", "Structure"]


@dataclass(frozen=True)
class Structure:
    """Masses joined by links, validated when built; every change returns a new structure.

    Raises StructureError for duplicate names, an end that is no mass, a mass that nothing holds, and bad sharing.
    """

    name: str
    masses: tuple[Mass, ...]
    links: tuple[Link, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "masses", tuple(self.masses))
        object.__setattr__(self, "links", tuple(self.links))
        if not self.masses:
            raise StructureError("a structure needs at least one mass")
        _check_unique(self.mass_names, "mass")
        _check_unique(tuple(link.name for link in self.links), "link")
        self._check_ends()
        places = self._slots
        follows = leaders(places)
        if follows:
            resolved = {
                name: places[name].coefficient.following(places[leader].coefficient)
                for name, leader in follows.items()
            }
            masses, links = _replaced(self.masses, self.links, places, resolved)
            object.__setattr__(self, "masses", masses)
            object.__setattr__(self, "links", links)
            del self.__dict__["_slots"]  # it was read off the coefficients before they followed their leaders

    def _check_ends(self) -> None:
        names = set(self.mass_names)
        held: set[str] = set()
        for link in self.links:
            for end in link.between:
                if end not in names and end not in (GROUND, BASE):
                    raise StructureError(
                        f'"{end}" is neither a mass nor "ground" nor "base"'
                        f"{near_miss(end, [*self.mass_names, GROUND, BASE])}; the masses are {_quoted(self.mass_names)}",
                        f'link "{link.name}"',
                    )
            held.update(link.between)
        loose = [name for name in self.mass_names if name not in held]
        if loose:
            raise StructureError(
                "nothing holds it: no link has it as an end; add a link or remove the mass",
                f"mass {_quoted(loose)}",
            )

    @cached_property
    def _slots(self) -> dict[str, CoefficientSlot]:
        return slots(self.masses, self.links)

    @cached_property
    def _leaders(self) -> dict[str, str]:
        return leaders(self._slots)

    @property
    def size(self) -> int:
        """The number of masses, n."""
        return len(self.masses)

    @cached_property
    def mass_names(self) -> tuple[str, ...]:
        """The names of the masses, in the order of all arrays."""
        return tuple(mass.name for mass in self.masses)

    @cached_property
    def mass_values(self) -> Floats:
        """(n,) masses in kg, the start where one is unknown. Raises StructureError where there is neither."""
        for mass in self.masses:
            if mass.mass.value is None:
                raise StructureError(
                    "it is unknown and has no start; give it a number, or identify it first",
                    f'mass "{mass.name}"',
                )
        values = np.array([mass.mass.value for mass in self.masses], dtype=float)
        values.flags.writeable = False
        return values

    @cached_property
    def _mass_index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.mass_names)}

    @cached_property
    def _link_index(self) -> dict[str, int]:
        return {link.name: index for index, link in enumerate(self.links)}

    def mass(self, name: str) -> Mass:
        """The mass of that name; StructureError lists the names there are."""
        return self.masses[_index(self._mass_index, name, "mass", "masses")]

    def link(self, name: str) -> Link:
        """The link of that name; StructureError lists the names there are."""
        return self.links[_index(self._link_index, name, "link", "links")]

    @cached_property
    def incidence(self) -> scipy.sparse.csr_array:
        """B, (n, L): +1 where a mass is the first end of a link, -1 where it is the second."""
        rows, columns, signs = [], [], []
        for column, link in enumerate(self.links):
            for end, sign in zip(link.between, (1.0, -1.0), strict=True):
                if end in self._mass_index:
                    rows.append(self._mass_index[end])
                    columns.append(column)
                    signs.append(sign)
        return scipy.sparse.csr_array((signs, (rows, columns)), shape=(self.size, len(self.links)))

    @cached_property
    def base_incidence(self) -> Floats:
        """e, (L,): +1 where the base is the first end of a link, -1 where it is the second, else 0."""
        ends = np.array([(link.between[0] == BASE) - float(link.between[1] == BASE) for link in self.links])
        ends.flags.writeable = False
        return ends

    def elongations(self, x: ArrayLike, base: ArrayLike | None = None) -> Floats:
        """(N, L) elongations of the links from displacements `x` (N, n), or (L,) from (n,); rates from velocities alike.

        `base` is the motion of the base, (N,) or a number; StructureError where a link needs it and it is None.
        """
        x = np.asarray(x, dtype=float)
        if x.shape[-1] != self.size:
            raise StructureError(f"{x.shape[-1]} displacements were given for {self.size} masses")
        d = np.ascontiguousarray((self.incidence.T @ x.T).T)
        held = np.flatnonzero(self.base_incidence)
        if held.size == 0:
            return d
        if base is None:
            raise StructureError(
                "it hangs on the base, whose motion is not given: give it, or let the link hold on to the ground",
                f'link "{self.links[held[0]].name}"',
            )
        d[..., held] += np.asarray(base, dtype=float)[..., None] * self.base_incidence[held]
        return d

    def coefficient(self, name: str) -> Coefficient:
        """The coefficient "nes1.alpha", or "m1.mass"; of a shared one the coefficient that it follows."""
        if name not in self._slots:
            raise StructureError(
                f'there is no coefficient "{name}"{near_miss(name, self._slots)}; they are {_quoted(self._slots)}'
            )
        return self._slots[self._leaders.get(name, name)].coefficient

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free unknowns: those of the links, then those of the masses, shared ones once."""
        return parameters(self._slots, self._leaders)

    def unknown(self, *which: str) -> Structure:
        """The structure with coefficients made unknown, values and starts dropped so that nothing leaks; bounds stay.

        Each of `which` is "all" (every link), a link, the beginning of link names ("nes"), "link.coefficient" (the beginning
        of names serves there too), or "mass:NAME". A shared coefficient frees the one that it follows.
        """
        if not which:
            raise StructureError(
                'say what is unknown: "all", a link, the beginning of link names, or "mass:NAME"'
            )
        chosen = {name for selector in which for name in self._chosen(selector)}
        freed = {
            name: self._slots[name].coefficient.freed()
            for name in {self._leaders.get(name, name) for name in chosen}
        }
        return self._with(freed)

    def with_values(self, values: Mapping[str, float]) -> Structure:
        """The structure with these values, by full name ("nes1.alpha", "m1.mass"), known from now on.

        What follows a changed coefficient changes with it. Where an unknown is filled in, the result is an answer: every
        shared coefficient that has a value becomes a plain number. StructureError for a name that is not there.
        """
        changes: dict[str, Coefficient] = {}
        answered = False
        for name, value in values.items():
            answered = answered or not self.coefficient(name).known
            leader = self._leaders.get(name, name)
            try:
                change = Coefficient.number(value)
            except StructureError as error:
                raise StructureError(error.message, name) from None
            if changes.setdefault(leader, change) != change:
                raise StructureError(f'it is the same as "{leader}", which is given another value', name)
        changed = self._with(changes)
        return changed._without_sharing() if answered else changed

    def _without_sharing(self) -> Structure:
        plain = {
            name: replace(self._slots[name].coefficient, same_as=None)
            for name in self._leaders
            if self._slots[name].coefficient.known
        }
        return self._with(plain) if plain else self

    def _with(self, changes: Mapping[str, Coefficient]) -> Structure:
        masses, links = _replaced(self.masses, self.links, self._slots, changes)
        return Structure(self.name, masses, links)

    def _chosen(self, selector: str) -> list[str]:
        """The full names that one argument of `unknown` chooses; StructureError if none."""
        if selector.startswith("mass:"):
            return [f"{self.mass(selector.removeprefix('mass:')).name}.mass"]
        if selector == "all":
            return [name for name, slot in self._slots.items() if slot.index >= 0]
        links = _beginning(self._link_index, selector)
        if links:
            return [f"{name}.{key}" for name in links for key in self.link(name).coefficients]
        head, _, key = selector.rpartition(".")
        chosen = [f"{name}.{key}" for name in (_beginning(self._link_index, head) if head else ())]
        chosen = [name for name in chosen if name in self._slots]
        if not chosen:
            raise StructureError(
                f'"{selector}" is no link, no beginning of link names and no coefficient'
                f"{near_miss(selector, [*self._link_index, *self._slots])}; the links are {_quoted(self._link_index)}"
            )
        return chosen

    @cached_property
    def shape_key(self) -> Hashable:
        """Equal for structures of one topology and the same laws, whatever their values: they share compiled code."""
        ends = {**self._mass_index, GROUND: -1, BASE: -2}
        return self.size, tuple(
            (ends[link.between[0]], ends[link.between[1]], link.law.expression) for link in self.links
        )


def _replaced(
    masses: tuple[Mass, ...],
    links: tuple[Link, ...],
    places: Mapping[str, CoefficientSlot],
    changes: Mapping[str, Coefficient],
) -> tuple[tuple[Mass, ...], tuple[Link, ...]]:
    """Masses and links with some coefficients, by full name, exchanged."""
    new_masses, new_links = list(masses), list(links)
    by_link: dict[int, dict[str, Coefficient]] = {}
    for name, coefficient in changes.items():
        slot = places[name]
        if slot.index < 0:
            new_masses[-1 - slot.index] = replace(masses[-1 - slot.index], mass=coefficient)
        else:
            by_link.setdefault(slot.index, {})[slot.key] = coefficient
    for index, new in by_link.items():
        new_links[index] = replace(links[index], coefficients={**links[index].coefficients, **new})
    return tuple(new_masses), tuple(new_links)


def _beginning(names: Iterable[str], typed: str) -> list[str]:
    """The name `typed` alone if it is there, else all names that begin with it."""
    names = list(names)
    return [typed] if typed in names else [name for name in names if typed and name.startswith(typed)]


def _check_unique(names: tuple[str, ...], kind: str) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        count = names.count(twice[0])
        raise StructureError(
            f"the name is used {count} times; each {kind} needs its own", f'{kind} "{twice[0]}"'
        )


def _index(indices: Mapping[str, int], name: str, kind: str, kinds: str) -> int:
    if name not in indices:
        raise StructureError(
            f'there is no {kind} "{name}"{near_miss(name, indices)}; the {kinds} are {_quoted(indices)}'
        )
    return indices[name]


def _quoted(names: Iterable[str]) -> str:
    """The names in quotes, the middle left out when there are many."""
    listed = [f'"{name}"' for name in names]
    shown = listed if len(listed) <= 12 else [*listed[:10], "...", listed[-1]]
    return ", ".join(shown) if shown else "none"
