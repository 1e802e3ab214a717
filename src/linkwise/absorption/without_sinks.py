"""The same structure without its sinks, and what then drives it.

Removed: the masses of the sinks and all links on them are gone, as in the paper's Figs. 3 and 5. Locked: each sink is held
rigid at the elongation that it starts from, so that its mass moves with its host.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from linkwise.absorption.sinks import Sink
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Number, Symbol, add, substitute, to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.excitation import Excitation, Impulse, InputSignal, TimeFunction
from linkwise.model.law import Law
from linkwise.model.link import BASE, GROUND, Link, Mass
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class WithoutSinks:
    """A structure without its sinks and the excitation that is left for it."""

    structure: Structure
    excitation: Excitation


def without_sinks(
    structure: Structure, sinks: Sequence[Sink], excitation: Excitation, manner: str
) -> WithoutSinks:
    """The structure with its sinks "removed" or "locked".

    Removed: what would drive a sink's mass drives nothing. Locked: it drives the host, and a release keeps the momentum of
    both. Raises StructureError where that leaves no structure, SimulationError where nothing would drive it.
    """
    baseline = (_removed if manner == "removed" else _locked)(structure, sinks, excitation)
    left = baseline.excitation
    if not (any(left.release.values()) or left.impulses or left.drives):
        raise SimulationError(
            f"with the sinks {manner} nothing sets the structure in motion, so there is nothing to compare with: "
            + (
                "drive a primary mass, or compare with the sinks locked (--without locked)"
                if manner == "removed"
                else "give a release, an impulse, a force or a motion of the base"
            )
        )
    return baseline


def _removed(structure: Structure, sinks: Sequence[Sink], excitation: Excitation) -> WithoutSinks:
    gone = {sink.mass for sink in sinks if sink.mass is not None}
    names = {sink.link for sink in sinks}
    links = tuple(link for link in structure.links if link.name not in names and not gone & set(link.between))
    masses = tuple(mass for mass in structure.masses if mass.name not in gone)
    left = _built(structure, masses, links, "removed")
    return WithoutSinks(
        left,
        Excitation(
            {name: value for name, value in excitation.release.items() if name.partition(":")[2] not in gone},
            tuple(impulse for impulse in excitation.impulses if impulse.mass not in gone),
            {mass: force for mass, force in excitation.forces.items() if mass not in gone},
            excitation.base if left.base_incidence.any() else None,
        ),
    )


def _locked(structure: Structure, sinks: Sequence[Sink], excitation: Excitation) -> WithoutSinks:
    rider = {sink.mass: sink.host for sink in sinks if sink.mass is not None}
    fixed = next((sink for sink in sinks if sink.mass is None or sink.host in (GROUND, BASE)), None)
    if fixed is not None:
        raise StructureError(
            f"it holds on to the {fixed.host}: locked, it would hold its mass still; compare with the sinks removed",
            f'link "{fixed.link}"',
        )
    root = {name: _root(name, rider) for name in structure.mass_names}
    x = {name: excitation.release.get(f"x:{name}", 0.0) for name in structure.mass_names}
    ahead = {name: x[name] - x[root[name]] for name in root}  # of its root, as long as it is locked
    weight = dict(zip(structure.mass_names, structure.mass_values.tolist(), strict=True))
    joined = {
        name: sum(weight[each] for each in root if root[each] == name)
        for name in structure.mass_names
        if name not in rider
    }
    masses = tuple(
        Mass(mass.name, mass.mass if joined[mass.name] == weight[mass.name] else Coefficient.number(joined[mass.name]))
        for mass in structure.masses
        if mass.name in joined
    )  # fmt: skip
    links = tuple(moved for link in structure.links if (moved := _rehung(link, root, ahead)) is not None)
    left = _built(structure, masses, links, "locked")
    release = {f"x:{name}": x[name] for name in joined if x[name]}
    for name in joined:
        speeds = [
            (weight[each], excitation.release.get(f"v:{each}", 0.0)) for each in root if root[each] == name
        ]
        speed = sum(m * v for m, v in speeds) / joined[name]
        if speed:
            release[f"v:{name}"] = speed
    impulses = tuple(Impulse(root[blow.mass], blow.momentum, blow.time) for blow in excitation.impulses)
    return WithoutSinks(
        left, Excitation(release, impulses, _gathered(excitation.forces, root), excitation.base)
    )


def _root(name: str, rider: Mapping[str, str]) -> str:
    trail = [name]
    while trail[-1] in rider:
        trail.append(rider[trail[-1]])
        if trail[-1] in trail[:-1]:
            raise StructureError(
                f"the sinks carry one another in a circle ({', '.join(trail)}); name fewer sinks"
            )
    return trail[-1]


def _rehung(link: Link, root: Mapping[str, str], ahead: Mapping[str, float]) -> Link | None:
    """A link with its ends on the masses that are left; None where both ends are now one."""
    first, second = (root.get(end, end) for end in link.between)
    if first == second:
        return None
    shift = ahead.get(link.between[0], 0.0) - ahead.get(link.between[1], 0.0)
    law = link.law
    if shift:
        law = Law.parse(to_text(substitute(law.expression, {"d": add(Symbol("d"), Number(shift))})))
    return replace(link, between=(first, second), law=law)


def _gathered(forces: Mapping[str, InputSignal], root: Mapping[str, str]) -> dict[str, InputSignal]:
    """The forces on the masses that are left; those on one mass are added."""
    found: dict[str, InputSignal] = {}
    for mass, force in forces.items():
        place = root[mass]
        if place not in found:
            found[place] = force
            continue
        other = found[place]
        if not (isinstance(other, TimeFunction) and isinstance(force, TimeFunction)):
            raise SimulationError(
                f"a sampled force and another one act on {place} and a sink locked to it; add them up yourself, or compare "
                "with the sinks removed",
                mass=place,
            )
        found[place] = TimeFunction(f"({other.text}) + ({force.text})")
    return found


def _built(structure: Structure, masses: tuple[Mass, ...], links: tuple[Link, ...], manner: str) -> Structure:
    """The structure that is left; coefficients shared with a link that is gone keep their values."""
    plain = tuple(
        replace(
            link,
            coefficients={name: replace(each, same_as=None) for name, each in link.coefficients.items()},
        )
        for link in links
    )
    bodies = tuple(replace(mass, mass=replace(mass.mass, same_as=None)) for mass in masses)
    try:
        return Structure(f"{structure.name}, sinks {manner}", bodies, plain)
    except StructureError as error:
        raise StructureError(
            f"with the sinks {manner} it cannot stand: {error.message}", error.where
        ) from None
