"""The laws of all links, evaluated on a record: functions of the noisy elongations, ready to meet a test function.

An atom is one part of one law (`weakform.WeakPart`) at one link. Links that share a law are evaluated in one go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import IdentificationError
from linkwise.expression import Symbol
from linkwise.law import Law
from linkwise.structure import Link, Structure
from linkwise.weakform import WeakLaw, WeakPart, weak_law

Floats = NDArray[np.float64]

_ELONGATION = Symbol("d")


@dataclass(frozen=True, eq=False)
class Atom:
    """sign * int kernel h(d) at link `link`; `chain` is [h, h', h'', ...] on all samples, numbers where constant.

    It is multiplied by parameter number `parameter` (None: none) plus `fixed`. `plain` says that h is d itself.
    """

    link: int
    kernel: int
    sign: float
    chain: tuple[Floats | float, ...]
    plain: bool
    parameter: int | None
    fixed: float

    @property
    def slope(self) -> Floats | float:
        """h'."""
        return self.chain[1] if len(self.chain) > 1 else 0.0


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


def link_atoms(
    structure: Structure, d: Floats, variance: Floats, rates: Floats | None, unknowns: Unknowns
) -> list[Atom]:
    """The atoms of all links from elongations `d` (L, N) with noise `variance` (L,); `rates` (L, N) smoothed, or None.

    Raises IdentificationError for an unknown that enters its law nonlinearly and has no start.
    """
    atoms: list[Atom] = []
    for (law, free), links in _groups(structure, unknowns).items():
        which = np.array(links)
        weak = weak_law(law, free)
        values = {name: _values(structure.links, links, name, unknowns) for name in law.coefficients}
        v = 0.0 if rates is None else rates[which]
        chains = weak.evaluate(d[which], v, variance[which, None], values)
        for part, chain in zip(weak.parts, chains, strict=True):
            for row, link in enumerate(links):
                here = tuple(each if isinstance(each, float) else each[row] for each in chain)
                parameter, fixed = _multiplier(structure.links[link], link, part, unknowns)
                atoms.append(
                    Atom(link, part.kernel, part.sign, here, part.function == _ELONGATION, parameter, fixed)
                )
    return atoms


def needs_rates(structure: Structure, unknowns: Unknowns) -> bool:
    """Whether some law has a part that wants a smoothed v (v**2, tanh(v/s))."""
    return any(weak_law(law, free).needs_rate for law, free in _groups(structure, unknowns))


def _groups(structure: Structure, unknowns: Unknowns) -> dict[tuple[Law, frozenset[str]], list[int]]:
    groups: dict[tuple[Law, frozenset[str]], list[int]] = {}
    for index, link in enumerate(structure.links):
        free = frozenset(name for name in link.law.nonlinear if (index, name) in unknowns.places)
        groups.setdefault((link.law, free), []).append(index)
    return groups


def _values(links: tuple[Link, ...], which: list[int], name: str, unknowns: Unknowns) -> Floats:
    """(links, 1): what coefficient `name` is inside the functions of the law."""
    found = []
    for index in which:
        place = unknowns.places.get((index, name))
        value = links[index].coefficients[name].value if place is None else place[1]
        if value is None and name in links[index].law.nonlinear:
            raise IdentificationError(
                f'link "{links[index].name}": {name} enters the law {links[index].law.text} nonlinearly, so its search '
                f"needs a start: write {name} = {{ start = ... }} among its coefficients"
            )
        found.append(np.nan if value is None else value)
    return np.array(found)[:, None]


def _multiplier(link: Link, index: int, part: WeakPart, unknowns: Unknowns) -> tuple[int | None, float]:
    if part.coefficient is None:
        return None, 1.0
    place = unknowns.places.get((index, part.coefficient))
    if place is None:
        return None, float(link.coefficients[part.coefficient].value or 0.0)
    return place[0], -float(place[1] or 0.0) if part.increment else 0.0


__all__ = ["Atom", "Unknowns", "WeakLaw", "link_atoms", "needs_rates"]
