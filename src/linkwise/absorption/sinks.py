"""Which links are sinks, which mass each of them carries, what dissipates, and harvesters.

A sink is a link to a small mass that takes vibration away from the other, primary masses. A bistable one (paper Eq. 1)
has two stable wells.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import scipy

from linkwise.analysis.potential_wells import wells
from linkwise.errors import LawError, SimulationError, StructureError
from linkwise.expression import Expression, Program, parse, symbols, to_text
from linkwise.expression.dimensions import METRE, METRE_PER_SECOND, NEWTON, UnitConflict, infer
from linkwise.model.law import Law, unit_dimension
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.simulation.energy import LinkForces
from linkwise.simulation.simulate import SimulatedMotion


@dataclass(frozen=True)
class Sink:
    """A link that takes vibration away.

    Attributes
    ----------
    link : str
        The name of the link.
    mass : str or None
        The mass that it carries; None if it joins points, or holds a point or a primary mass to the ground or the base.
    host : str
        What the mass is linked to: another mass, a point, "ground" or "base".

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=1.0, release={"v:m1": 1.0})
    >>> result.sinks[0].sink
    Sink(link='nes1', mass='m2', host='m1')
    """

    link: str
    mass: str | None
    host: str


def find_sinks(structure: Structure, names: Sequence[str] = ()) -> tuple[Sink, ...]:
    """The sinks of a structure: the links called `names` or, without names, all links with more than one stable well.

    The mass of a sink is the end that has no other link, else the lighter one. Raises StructureError for a name that is not a
    link, a coefficient without a number, a structure without bistable links, and if every mass would be a sink's.
    """
    chosen = list(dict.fromkeys(names)) or _bistable_links(structure)
    sinks = tuple(_sink(structure, name) for name in chosen)
    if {sink.mass for sink in sinks} >= set(structure.mass_names):
        raise StructureError(
            f"every mass ({', '.join(structure.mass_names)}) would belong to a sink, so no primary mass is left; name fewer "
            "sinks"
        )
    return sinks


Places: TypeAlias = Mapping[str, Sequence[str]]
"""By link, the masses and points of hosts on which it may end."""


def placed(structure: Structure, places: Places) -> Iterator[tuple[dict[str, str], Structure]]:
    """Where links may be, each at one of its places, and the structure so; a link keeps the mass that it carries.

    Raises StructureError for a link or a place that does not exist.
    """
    hosts = {name: find_sinks(structure, (name,))[0].host for name in places}

    def moved(link: Link, where: Mapping[str, str]) -> Link:
        host = hosts.get(link.name)
        first, second = (where[link.name] if end == host else end for end in link.between)
        return replace(link, between=(first, second))

    for chosen in product(*places.values()):
        where = dict(zip(places, chosen, strict=True))
        yield where, replace(structure, links=tuple(moved(link, where) for link in structure.links))


def primary_masses(structure: Structure, sinks: Sequence[Sink]) -> tuple[str, ...]:
    """The points of hosts and the masses that no sink carries, in the order of the structure."""
    carried = {sink.mass for sink in sinks}
    return tuple(name for name in structure.places if name not in carried)


def _bistable_links(structure: Structure) -> list[str]:
    links = [link for link in structure.links if link.name not in structure.modes]
    bistable = [link.name for link in links if len(wells(link)) > 1]
    if not bistable:
        raise StructureError(
            f"no link of {structure.name or 'this structure'} has more than one stable well, so there is no sink to be found; "
            f"name the sinks among the links {', '.join(link.name for link in links)}",
            arguments=("sinks",),
        )
    return bistable


def _sink(structure: Structure, name: str) -> Sink:
    ends = structure.link(name).between
    masses = [end for end in ends if end in structure.mass_names]
    linked = {end: [link.between for link in structure.links if end in link.between] for end in masses}
    leaves = [end for end, pairs in linked.items() if all(set(pair) == set(ends) for pair in pairs)]
    if not masses:
        return Sink(name, None, ends[1] if ends[0] in structure.points else ends[0])
    if len(masses) == 1:
        host = ends[1] if masses[0] == ends[0] else ends[0]
        return Sink(name, masses[0] if leaves else None, host)
    candidates = leaves if len(leaves) == 1 else masses
    mass = min(candidates, key=lambda end: float(structure.mass_values[structure.mass_names.index(end)]))
    return Sink(name, mass, next(end for end in ends if end != mass))


def dissipators(structure: Structure) -> dict[str, list[int]]:
    """What dissipates, by name, with the numbers of its links: hosts by all their modes, then every other link."""
    numbers = {link.name: number for number, link in enumerate(structure.links)}
    hosts = {}
    for host in structure.hosts:
        name = host.name if host.name not in numbers else f"{host.name} (modes)"
        hosts[name] = [numbers[link.name] for link in host.parts()[1]]
    return hosts | {name: [number] for name, number in numbers.items() if name not in structure.modes}


SUFFIX = "-harvester"

Harvesters: TypeAlias = Mapping[str, float | str]
"""By link: the damping in N s/m of a damper in parallel, or the power in W that the link delivers, as "V**2/R"."""


def with_harvesters(structure: Structure, harvesters: Harvesters) -> Structure:
    """The structure with a damper in parallel to each link that `harvesters` gives a damping, as a link "NAME-harvester".

    Raises StructureError for a link that does not exist and for a damping that is not positive.
    """
    added = []
    for name, damping in harvesters.items():
        link = structure.link(name)
        if isinstance(damping, str):
            continue
        if not 0.0 < damping < np.inf:
            message = f"the damping of a harvester must be positive, got {damping!r} {damping_unit(link)}"
            raise StructureError(message, f'link "{name}"')
        added.append(Link(f"{name}{SUFFIX}", link.between, Law.parse("c*v"), {"c": damping}))
    return replace(structure, links=(*structure.links, *added)) if added else structure


def damping_unit(link: Link) -> str:
    """The SI unit of the damping of a harvester on a link."""
    return "N m s/rad" if link.law.angular else "N s/m"


def delivered_powers(structure: Structure, harvesters: Harvesters) -> dict[str, Expression]:
    """The power in W that links deliver, of each harvester that is given by an expression.

    It is an expression in d, v, the states and the coefficients of its link. Raises StructureError for a link that does not
    exist, a name that is none of these, and an expression whose unit is not that of a power.
    """
    given = ((name, text) for name, text in harvesters.items() if isinstance(text, str))
    return {name: _power(structure.link(name), text) for name, text in given}


def _power(link: Link, text: str) -> Expression:
    """The power of a link, checked."""
    where, law = f'harvester on link "{link.name}"', link.law
    names = (*law.variables, *law.coefficients)
    try:
        power = parse(text, law.variables)
    except LawError as error:
        raise StructureError(f"{text!r} is not a power: {error}", where) from None
    foreign = [name for name in symbols(power) if name not in names]
    if foreign:
        message = f"the power {text!r} contains {foreign[0]!r}; choose from {', '.join(names)}, as in V**2/R"
        raise StructureError(message, where)
    units = {**law.units, **law.state_units}
    known = {name: unit_dimension(unit) for name, unit in units.items() if unit != "?"}
    try:
        infer(power, {"d": METRE, "v": METRE_PER_SECOND}, NEWTON * METRE_PER_SECOND, known=known)
    except UnitConflict:
        given = ", ".join(f"{name} in {units[name] or '1'}" for name in symbols(power) if name in units)
        stated = f", with {given}" if given else ""
        raise StructureError(f"{text!r} is not a power in W{stated}", where) from None
    return power


def delivered_energy(motion: SimulatedMotion, powers: Mapping[str, Expression]) -> dict[str, float]:
    """The energy in J that links deliver over a whole motion, by the trapezoidal rule over its samples.

    Raises SimulationError where a power is not a finite number, as one with a division by zero.
    """
    if not powers:
        return {}
    schedule, structure = motion.schedule, motion.schedule.structure
    forces = LinkForces(structure, schedule.excitation)
    energies = {}
    for link, own in forces.variables(schedule.times, motion.displacement, motion.velocity, motion.states):
        if link.name not in powers:
            continue
        values: dict[str, Any] = {**own, **link.values}
        names = symbols(powers[link.name])
        with np.errstate(all="ignore"):
            power = Program([powers[link.name]], names)(*(values[name] for name in names))[0]
        power = np.broadcast_to(power, len(schedule.times))
        if not np.isfinite(power).all():
            first = schedule.times[np.flatnonzero(~np.isfinite(power))[0]]
            raise SimulationError(
                f"harvester on {link.name}: its power {to_text(powers[link.name])} is not a finite number at {first:g} s; "
                "look for a division by zero or the root of a negative number"
            )
        energies[link.name] = float(scipy.integrate.trapezoid(power, schedule.times))
    return energies
