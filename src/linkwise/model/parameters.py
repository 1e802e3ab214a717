"""Which coefficients are one and the same, and which of them are free to be found.

Every coefficient has a full name: "nes1.alpha" for a link's, "m1.mass" for a mass. A shared one follows another by that name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link, Mass, near_miss

KILOGRAM = "kg"
_UNDETERMINED = "?"  # what a law says of a coefficient whose unit does not follow from it


@dataclass(frozen=True)
class CoefficientSlot:
    """The place of one coefficient: `index` is that of its link, or -1 - i for mass i; `key` its name there."""

    index: int
    key: str
    law: Law | None
    coefficient: Coefficient

    @property
    def unit(self) -> str:
        """As the law tells it; kg for a mass. It is worked out only when asked for: a simulation never does."""
        return KILOGRAM if self.law is None else self.law.units[self.key]


@dataclass(frozen=True)
class Parameter:
    """A free unknown. `members` are the places (link index, or -1 - mass index; coefficient) that take its value."""

    name: str
    unit: str
    start: float | None
    lower: float
    upper: float
    members: tuple[tuple[int, str], ...]


def slots(masses: Sequence[Mass], links: Sequence[Link]) -> dict[str, CoefficientSlot]:
    """Every coefficient by its full name, links first, in the order of the file.

    Raises StructureError where a mass and a link of one name make a full name ambiguous.
    """
    found: dict[str, CoefficientSlot] = {}
    for index, link in enumerate(links):
        for key, coefficient in link.coefficients.items():
            found[f"{link.name}.{key}"] = CoefficientSlot(index, key, link.law, coefficient)
    for index, mass in enumerate(masses):
        name = f"{mass.name}.mass"
        if name in found:
            raise StructureError(
                f'"{name}" is a mass and a coefficient of the link of that name; rename one of them'
            )
        found[name] = CoefficientSlot(-1 - index, "mass", None, mass.mass)
    return found


def leaders(places: Mapping[str, CoefficientSlot]) -> dict[str, str]:
    """For every shared coefficient the one that it follows in the end.

    Raises StructureError for a leader that does not exist, a circle, and a leader of another unit.
    """
    found = {}
    for name, slot in places.items():
        if slot.coefficient.same_as is None:
            continue
        trail = [name]
        while (following := places[trail[-1]].coefficient.same_as) is not None:
            if following not in places:
                raise StructureError(
                    f'"={following}" names no coefficient of this structure{near_miss(following, places)}',
                    trail[-1],
                )
            if following in trail:
                circle = " = ".join([*trail[trail.index(following) :], following])
                raise StructureError(
                    f"coefficients share each other in a circle, {circle}: give one of them a number", name
                )
            trail.append(following)
        _check_units(name, slot.unit, trail[-1], places[trail[-1]].unit)
        found[name] = trail[-1]
    return found


def parameters(places: Mapping[str, CoefficientSlot], follows: Mapping[str, str]) -> tuple[Parameter, ...]:
    """The free unknowns in the order of `places`, each with all the places that follow it."""
    members: dict[str, list[tuple[int, str]]] = {
        name: [(slot.index, slot.key)]
        for name, slot in places.items()
        if slot.coefficient.same_as is None and not slot.coefficient.known
    }
    units = {name: places[name].unit for name in members}
    for name, leader in follows.items():
        if leader in members:
            members[leader].append((places[name].index, places[name].key))
            if units[leader] == _UNDETERMINED:
                units[leader] = places[name].unit
    return tuple(_parameter(name, units[name], places[name], tuple(sites)) for name, sites in members.items())


def _parameter(
    name: str, unit: str, slot: CoefficientSlot, members: tuple[tuple[int, str], ...]
) -> Parameter:
    coefficient = slot.coefficient
    lower = max(coefficient.lower, 0.0) if any(index < 0 for index, _ in members) else coefficient.lower
    return Parameter(name, unit, coefficient.value, lower, coefficient.upper, members)


def _check_units(name: str, unit: str, leader: str, leader_unit: str) -> None:
    if unit != leader_unit and _UNDETERMINED not in (unit, leader_unit):
        raise StructureError(
            f'it is in {unit or "1"} and cannot equal "{leader}" in {leader_unit or "1"}', name
        )
