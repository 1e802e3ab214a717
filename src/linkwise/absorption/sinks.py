"""Which links are sinks, and which mass each of them carries.

A sink is a link with a small mass at its far end that takes vibration away from the rest, the primary masses. A bistable one
(paper Eq. 1) has two stable wells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from linkwise.analysis.wells import wells
from linkwise.errors import StructureError
from linkwise.model.structure import Structure


@dataclass(frozen=True)
class Sink:
    """A link that takes vibration away: `mass` hangs by it on `host`, a mass or "ground" or "base".

    `mass` is None where the link holds a primary mass to the ground or the base and carries none of its own.
    """

    link: str
    mass: str | None
    host: str


def find_sinks(structure: Structure, names: Sequence[str] = ()) -> tuple[Sink, ...]:
    """The sinks of a structure: the links of these `names` or, without names, all links with more than one stable well.

    The mass of a sink is the end on which nothing else hangs, else the lighter one. Raises StructureError for a name that is
    no link, a coefficient without a number, where no link has two wells, and where nothing but sinks is there.
    """
    chosen = list(dict.fromkeys(names)) or _bistable(structure)
    found = tuple(_sink(structure, name) for name in chosen)
    if {sink.mass for sink in found} >= set(structure.mass_names):
        raise StructureError(
            f"every mass ({', '.join(structure.mass_names)}) would be the mass of a sink, so there is nothing whose vibration "
            "could be absorbed; name fewer sinks"
        )
    return found


def primary_masses(structure: Structure, sinks: Sequence[Sink]) -> tuple[str, ...]:
    """The masses that no sink carries, in the order of the structure."""
    carried = {sink.mass for sink in sinks}
    return tuple(name for name in structure.mass_names if name not in carried)


def _bistable(structure: Structure) -> list[str]:
    found = [link.name for link in structure.links if len(wells(link)) > 1]
    if not found:
        raise StructureError(
            f"no link of {structure.name or 'this structure'} has more than one stable well, so none is taken for a sink; "
            f"name those that are (--sink NAME); the links are {', '.join(link.name for link in structure.links)}"
        )
    return found


def _sink(structure: Structure, name: str) -> Sink:
    ends = structure.link(name).between
    masses = [end for end in ends if end in structure.mass_names]
    alone = [
        end for end in masses if _neighbours(structure, end) == {other for other in ends if other != end}
    ]
    if len(masses) == 1:
        host = ends[1] if masses[0] == ends[0] else ends[0]
        return Sink(name, masses[0] if alone else None, host)
    candidates = alone if len(alone) == 1 else masses
    mass = min(candidates, key=lambda end: float(structure.mass_values[structure.mass_names.index(end)]))
    return Sink(name, mass, next(end for end in ends if end != mass))


def _neighbours(structure: Structure, mass: str) -> set[str]:
    """What hangs on a mass."""
    joined = [link.between for link in structure.links if mass in link.between]
    return {end for between in joined for end in between if end != mass}
