"""The coefficients of a structure by full name: which of them are shared, and which are free parameters.

Every coefficient has a full name: "nes1.alpha" for that of a link, "m1.mass" for a mass, "wing.mode1.shape.tip" for the shape
of a mode of a host at a point. A shared coefficient refers to its leader, the coefficient that it is equal to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from linkwise.display import near_miss
from linkwise.errors import StructureError
from linkwise.model.coefficient import MASS, SHAPE, Coefficient, Name, matching, quoted
from linkwise.model.host import Host
from linkwise.model.law import Law
from linkwise.model.link import ANGLE, LENGTH, MASS_UNITS, Link, Mass
from linkwise.model.named_laws import named_law_of

SHAPE_UNITS = {LENGTH: "1/sqrt(kg)", ANGLE: "rad/(m sqrt(kg))"}
"""Units of shapes by that of the displacement of their point."""
_ANY_UNIT = "?"  # unit of a coefficient that its law does not determine


@dataclass(frozen=True)
class CoefficientSlot:
    """A coefficient in its place: link `index`, or -1 - i for mass or mode i, under its full `name`.

    Its unit is that of its law, or `own_unit` of a mass or a shape.
    """

    index: int
    name: Name
    law: Law | None
    coefficient: Coefficient
    own_unit: str = ""

    @property
    def freed(self) -> Coefficient:
        """The coefficient as an unknown without value, start or prior, within its bounds or those of a named law."""
        freed = self.coefficient.freed()
        named = None if self.law is None else named_law_of(self.law)
        return freed if named is None else named.within_bounds(self.name.key, freed)

    @property
    def unit(self) -> str:
        """SI unit. Inferred on access, since a simulation never needs it."""
        return self.own_unit if self.law is None else self.law.units[self.name.key]


@dataclass(frozen=True)
class Parameter:
    """A free parameter of a structure: an unknown coefficient and all coefficients that share its value.

    Attributes
    ----------
    name : Name
        Full name, such as ``"nes1.alpha"`` or ``"m1.mass"``.
    unit : str
        SI unit; ``"?"`` where the law does not determine it.
    start : float or None
        Start value of its search; None without one.
    lower, upper : float
        Bounds.
    members : tuple of (int, str)
        Coefficients that take its value: index of the link, or -1 - i for mass or mode i, and name of the coefficient there:
        "mass", or "shape." and a point.
    sigma : float
        Standard deviation of a Gaussian prior about `start`; infinite without one.

    Examples
    --------
    >>> import linkwise as lw
    >>> [parameter.name for parameter in lw.bnes_chain(2).unknown("nes").parameters]
    ['nes1.alpha', 'nes1.beta', 'nes1.c']
    """

    name: Name
    unit: str
    start: float | None
    lower: float
    upper: float
    members: tuple[tuple[int, str], ...]
    sigma: float = math.inf


def coefficient_slots(
    masses: Sequence[Mass], links: Sequence[Link], hosts: Sequence[Host] = ()
) -> dict[str, CoefficientSlot]:
    """Every coefficient by its full name, links first, in the order of the file. The mass of a mode, 1 kg, is none.

    Raises StructureError where a mass and a link of the same name make a full name ambiguous.
    """
    slots: dict[str, CoefficientSlot] = {}
    for index, link in enumerate(links):
        for key, coefficient in link.coefficients.items():
            name = Name(link.name, key)
            slots[name] = CoefficientSlot(index, name, link.law, coefficient)
    modes = {name: mode for host in hosts for name, mode in zip(host.coordinates, host.modes, strict=True)}
    for index, mass in enumerate(masses):
        if mass.name in modes:
            continue
        name = Name(mass.name, MASS)
        if name in slots:
            both = f'"{name}" names both a mass and a coefficient of a link'
            raise StructureError(f"{both}; rename the mass or the link")
        slots[name] = CoefficientSlot(-1 - index, name, None, mass.mass, MASS_UNITS[mass.unit])
    for index, mass in enumerate(masses if modes else ()):
        if mass.name in modes:
            mode = modes[mass.name]
            for point in mode.shape:
                name = Name(mass.name, f"{SHAPE}{point}")
                unit = SHAPE_UNITS[ANGLE if point in mode.rotations else LENGTH]
                slots[name] = CoefficientSlot(-1 - index, name, None, mode.shape_value(point), unit)
    return slots


def resolve_sharing(slots: Mapping[str, CoefficientSlot]) -> dict[str, str]:
    """For every shared coefficient its leader, followed to the end of the chain.

    Raises StructureError for a leader that does not exist, a circular chain, and a leader in another unit.
    """
    leaders = {}
    for name, slot in slots.items():
        if slot.coefficient.same_as is None:
            continue
        chain = [name]
        while (leader := slots[chain[-1]].coefficient.same_as) is not None:
            if leader not in slots:
                hint = near_miss(leader, slots)
                raise StructureError(f'"={leader}" refers to an unknown coefficient{hint}', chain[-1])
            if leader in chain:
                circle = " = ".join([*chain[chain.index(leader) :], leader])
                raise StructureError(f"circular sharing, {circle}: give one of them a number", name)
            chain.append(leader)
        unit, of_leader = slot.unit or "1", slots[chain[-1]].unit or "1"
        if unit != of_leader and _ANY_UNIT not in (unit, of_leader):
            raise StructureError(f'is in {unit} and cannot be equal to "{chain[-1]}" in {of_leader}', name)
        leaders[name] = chain[-1]
    return leaders


def free_parameters(
    slots: Mapping[str, CoefficientSlot], leaders: Mapping[str, str]
) -> tuple[Parameter, ...]:
    """The free parameters in the order of `slots`, each with all coefficients that share it."""
    members: dict[str, list[tuple[int, str]]] = {
        name: [(slot.index, slot.name.key)]
        for name, slot in slots.items()
        if slot.coefficient.same_as is None and not slot.coefficient.known
    }
    units = {name: slots[name].unit for name in members}
    for name, leader in leaders.items():
        if leader in members:
            members[leader].append((slots[name].index, slots[name].name.key))
            if units[leader] == _ANY_UNIT:
                units[leader] = slots[name].unit
    parameters = []
    for name, sharing in members.items():
        own = slots[name].coefficient
        of_mass = any(index < 0 and key == MASS for index, key in sharing)
        lower = max(own.lower, 0.0) if of_mass else own.lower
        within = lower, own.upper, tuple(sharing), own.sigma
        parameters.append(Parameter(slots[name].name, units[name], own.value, *within))
    return tuple(parameters)


def chosen_names(selector: str, links: Mapping[str, int], slots: Mapping[str, CoefficientSlot]) -> list[str]:
    """Full names that one argument of `Structure.unknown` selects, `links` being numbers by name. Raises StructureError."""
    if selector == "all":
        return [name for name, slot in slots.items() if slot.index >= 0]
    asked = Name.parse(selector)
    if asked.is_shape and asked in slots:
        return [asked]
    numbers = {links[name] for name in matching(links, selector)}
    if numbers:
        return [name for name, slot in slots.items() if slot.index in numbers]
    owners = matching(links, asked.owner) if asked.owner else ()
    chosen = [str(name) for owner in owners if (name := Name(owner, asked.key)) in slots]
    if not chosen:
        raise StructureError(
            f'"{selector}" is not a link, a prefix of link names or a coefficient'
            f"{near_miss(selector, [*links, *slots])}; the links are {quoted(links)}"
        )
    return chosen


def replace_shapes(hosts: tuple[Host, ...], changes: Mapping[str, Coefficient]) -> tuple[Host, ...]:
    """Hosts with some shapes, given by full name, replaced."""
    by_mode: dict[str, dict[str, Coefficient]] = {}
    for name, coefficient in changes.items():
        if (asked := Name.parse(name)).is_shape:
            by_mode.setdefault(asked.owner, {})[asked.key.removeprefix(SHAPE)] = coefficient
    if not by_mode:
        return hosts
    changed = []
    for host in hosts:
        named = zip(host.coordinates, host.modes, strict=True)
        modes = tuple(mode.with_shape(by_mode.get(name, {})) for name, mode in named)
        changed.append(replace(host, modes=modes))
    return tuple(changed)
