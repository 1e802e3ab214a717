"""The laws of links, evaluated on a record: functions of the noisy elongations, ready to meet a test function.

Atoms are one part of one law (`weakform.WeakPart`) at all the links that share it, evaluated in one go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import IdentificationError
from linkwise.law import Law
from linkwise.structure import Link, Mass, Structure
from linkwise.weakform import WeakPart, weak_law

Floats = NDArray[np.float64]
Places = NDArray[np.intp]


@dataclass(frozen=True)
class Unknowns:
    """Which coefficients are to be found: by place (link index, coefficient) the number of the parameter and its value."""

    places: dict[tuple[int, str], tuple[int, float | None]]
    names: tuple[str, ...]

    @classmethod
    def of(cls, structure: Structure, values: dict[str, float]) -> Unknowns:
        """The free parameters of `structure`, at `values` where given, else at their starts."""
        parameters = structure.parameters
        places = {
            member: (number, values.get(parameter.name, parameter.start))
            for number, parameter in enumerate(parameters)
            for member in parameter.members
        }
        return cls(places, tuple(parameter.name for parameter in parameters))

    def at(self, values: Floats) -> Unknowns:
        """The same parameters at `values` (p,)."""
        found = values.tolist()
        return Unknowns(
            {place: (number, found[number]) for place, (number, _) in self.places.items()}, self.names
        )

    def value(self, links: tuple[Link, ...], which: Iterable[int], name: str) -> Floats:
        """(m,): coefficient `name` of the links `which`, NaN where it is unknown and has no value."""
        found = []
        for index in which:
            place = self.places.get((index, name))
            value = links[index].coefficients[name].value if place is None else place[1]
            found.append(np.nan if value is None else value)
        return np.array(found)

    def mass(self, masses: tuple[Mass, ...], index: int) -> float:
        """That mass in kg, 0 where it is unknown and has no value."""
        place = self.places.get((-1 - index, "mass"))
        return float((masses[index].mass.value if place is None else place[1]) or 0.0)


@dataclass(frozen=True, eq=False)
class Atoms:
    """sign * int kernel h(d) of one `part` at each of `links` (m,); `chain` is [h, h', h'', ...].

    The chain holds arrays (m, N) over all samples, numbers where constant. At each link the part is multiplied by parameter
    number `parameter` (m,), none where that is -1, plus `fixed` (m,).
    """

    part: WeakPart
    links: Places
    chain: tuple[Floats | float, ...]
    parameter: Places
    fixed: Floats

    @property
    def slope(self) -> Floats | float:
        """h'."""
        return self.chain[1] if len(self.chain) > 1 else 0.0


def link_atoms(
    structure: Structure,
    links: Places,
    unknowns: Unknowns,
    *,
    elongations: Callable[[Places], Floats],
    rates: Callable[[Floats], Floats],
    variance: Callable[[Places], Floats],
) -> list[Atoms]:
    """The atoms of `links`: of their `elongations` (m, N), whose noise has `variance` (m,), and smoothed `rates` of those.

    Elongations and rates are only asked for where a law needs them. Raises IdentificationError for an unknown that enters its
    law nonlinearly and has no start.
    """
    atoms = []
    for (law, free), which in law_groups(structure, links, unknowns).items():
        weak = weak_law(law, free)
        at = np.array(which)
        values = {name: unknowns.value(structure.links, which, name)[:, None] for name in weak.inside}
        _require_starts(structure, law, which, values)
        d = elongations(at) if weak.curved else np.zeros((len(at), 1))
        v = rates(d) if weak.needs_rate else 0.0
        for part, chain in zip(weak.parts, weak.evaluate(d, v, variance(at)[:, None], values), strict=True):
            numbers = [_multiplier(structure.links[link], link, part, unknowns) for link in which]
            parameter, fixed = zip(*numbers, strict=True)
            atoms.append(Atoms(part, at, tuple(chain), np.array(parameter), np.array(fixed)))
    return atoms


def law_groups(
    structure: Structure, links: Places, unknowns: Unknowns
) -> dict[tuple[Law, frozenset[str]], list[int]]:
    """The `links` by their law and those of its nonlinear coefficients that are to be found."""
    groups: dict[tuple[Law, frozenset[str]], list[int]] = {}
    for index in links.tolist():
        law = structure.links[index].law
        free = frozenset(name for name in law.nonlinear if (index, name) in unknowns.places)
        groups.setdefault((law, free), []).append(index)
    return groups


def _require_starts(structure: Structure, law: Law, which: list[int], values: Mapping[str, Floats]) -> None:
    for name in (name for name in law.nonlinear if name in values):
        for lost in np.flatnonzero(np.isnan(values[name])):
            raise IdentificationError(
                f'link "{structure.links[which[lost]].name}": {name} enters the law {law.text} nonlinearly, so its search '
                f"needs a start: write {name} = {{ start = ... }} among its coefficients"
            )


def _multiplier(link: Link, index: int, part: WeakPart, unknowns: Unknowns) -> tuple[int, float]:
    if part.coefficient is None:
        return -1, 1.0
    place = unknowns.places.get((index, part.coefficient))
    if place is None:
        return -1, float(link.coefficients[part.coefficient].value or 0.0)
    return place[0], -float(place[1] or 0.0) if part.increment else 0.0
