"""Links that start on the top of the barrier between two wells, where a structure rests but for the least disturbance."""

from __future__ import annotations

import numpy as np

from linkwise.analysis.potential_wells import wells
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.link import Link
from linkwise.model.structure import Structure

_GRID = 65  # elongations between the outer wells, among which the force is largest
_AT_REST = 1e-6  # of the largest force between the wells: less is none


def hilltop_finding(structure: Structure, x: Floats) -> str:
    """A sentence on links that start on a hilltop at the displacements `x` (n,) of masses, and which start them in wells.

    Empty where there are none. The base is taken to start at 0.
    """
    places = {"ground": 0.0, "base": 0.0} | dict(zip(structure.mass_names, map(float, x), strict=True))
    d = {
        link.name: places[link.between[0]] - places[link.between[1]]
        for link in structure.links
        if set(link.between) <= set(places)
    }
    tops = [link for link in structure.links if link.name in d and _is_hilltop(link, d[link.name])]
    releases = {}
    for link in tops:
        moved = _moved_mass(structure, link)
        if moved is None:
            continue
        bottoms = np.array(wells(link))[::-1]
        well = float(bottoms[np.argmin(np.abs(bottoms - d[link.name]))])
        first, second = link.between
        places[moved] = places[second] + well if moved == first else places[first] - well
        releases[moved] = places[moved]
    if not releases:
        return ""
    names = ", ".join(link.name for link in tops)
    starts = ", ".join(f"x:{mass}={place:.4g}" for mass, place in releases.items())
    several = len(tops) > 1
    return (
        f"{names} start{'' if several else 's'} on the top of {'their barriers' if several else 'its barrier'} between two "
        f"wells, where the least disturbance decides what follows; to start in {'wells' if several else 'a well'}, add the "
        f"release {starts}."
    )


def _is_hilltop(link: Link, d: float) -> bool:
    """Whether a link has no force at an elongation in m between two of its wells, and none of these is there."""
    try:
        places = wells(link)
    except StructureError:  # a periodic law, or one whose coefficients have no values
        return False
    if len(places) < 2 or not places[0] < d < places[-1]:
        return False
    force = np.abs(link.force(np.linspace(places[0], places[-1], _GRID), states=link.zero_states)).max()
    near = min(abs(d - place) for place in places) < _AT_REST * (places[-1] - places[0])
    return not near and bool(abs(link.force(d, states=link.zero_states)) < _AT_REST * force)


def _moved_mass(structure: Structure, link: Link) -> str | None:
    """The mass that a release moves: that of fewer links, else the lighter one."""
    weights = dict(zip(structure.mass_names, structure.mass_values, strict=True))
    ends = [end for end in link.between if end in weights]
    count = {end: sum(end in other.between for other in structure.links) for end in ends}
    return min(ends, key=lambda end: (count[end], float(weights[end])), default=None)
