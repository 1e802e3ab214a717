"""Harvesters: dampers in parallel to links, and the power that links with memory deliver, as to the resistor of a piezo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import scipy

from linkwise.errors import LawError, SimulationError, StructureError
from linkwise.expression import Expression, Program, parse, symbols, to_text
from linkwise.expression.dimensions import METRE, METRE_PER_SECOND, NEWTON, UnitConflict, infer
from linkwise.model.law import Law, unit_dimension
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.simulation.batch import SimulatedMotion
from linkwise.simulation.energy import LinkForces

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
        if not (np.isfinite(damping) and damping > 0.0):
            raise StructureError(
                f"the damping of a harvester must be positive, got {damping!r} {damping_unit(structure.link(name))}",
                f'link "{name}"',
            )
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
    return {
        name: _power(structure.link(name), text) for name, text in harvesters.items() if isinstance(text, str)
    }


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
        raise StructureError(
            f"the power {text!r} contains {foreign[0]!r}; choose from {', '.join(names)}, as in V**2/R", where
        )
    units = {**law.units, **law.state_units}
    known = {name: unit_dimension(unit) for name, unit in units.items() if unit != "?"}
    try:
        infer(power, {"d": METRE, "v": METRE_PER_SECOND}, NEWTON * METRE_PER_SECOND, known=known)
    except UnitConflict:
        given = ", ".join(f"{name} in {units[name] or '1'}" for name in symbols(power) if name in units)
        raise StructureError(
            f"{text!r} is not a power in W{f', with {given}' if given else ''}", where
        ) from None
    return power


def delivered_energy(motion: SimulatedMotion, powers: Mapping[str, Expression]) -> dict[str, float]:
    """The energy in J that links deliver over a whole motion, by the trapezoidal rule over its samples.

    Raises SimulationError where a power is not a finite number, as one with a division by zero.
    """
    if not powers:
        return {}
    schedule, structure = motion.schedule, motion.schedule.structure
    d, v = LinkForces(structure, schedule.excitation).elongations(
        schedule.times, motion.displacement, motion.velocity
    )
    columns = {key: column for column, key in enumerate(structure.topology.states)}
    energies = {}
    for number, link in enumerate(structure.links):
        if link.name not in powers:
            continue
        states = {name: motion.states[:, columns[number, name]] for name in link.law.states}
        values: dict[str, Any] = {"d": d[:, number], "v": v[:, number], **states, **link.values}
        names = symbols(powers[link.name])
        with np.errstate(all="ignore"):
            power = Program([powers[link.name]], names)(*(values[name] for name in names))[0]
        power = np.broadcast_to(power, len(d))
        if not np.isfinite(power).all():
            first = schedule.times[np.flatnonzero(~np.isfinite(power))[0]]
            raise SimulationError(
                f"harvester on {link.name}: its power {to_text(powers[link.name])} is not a finite number at {first:g} s; "
                "look for a division by zero or the root of a negative number"
            )
        energies[link.name] = float(scipy.integrate.trapezoid(power, schedule.times))
    return energies
