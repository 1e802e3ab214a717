"""Ends of links: each is a place of the structure or a support, and every mass has a link."""

from __future__ import annotations

from collections.abc import Sequence

from linkwise.display import near_miss
from linkwise.errors import StructureError
from linkwise.model.host_damping import is_between_modes
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.names import quoted


def check_ends(mass_names: Sequence[str], places: Sequence[str], links: Sequence[Link]) -> None:
    """Raise StructureError for an unknown end, or a mass without a link; `places` are masses that are no modes, and points."""
    links = [link for link in links if not is_between_modes(link.name)]
    supports = [link for link in links if set(link.between) <= {GROUND, BASE}]
    if supports and mass_names:
        first, second = supports[0].between
        raise StructureError(
            f'at least one end must be a mass, got "{first}" and "{second}"; a link between these needs a '
            "structure without masses, a rig",
            f'link "{supports[0].name}"',
        )
    names = {*mass_names, *places}
    linked: set[str] = set()
    for link in links:
        for end in link.between:
            if end not in names and end not in (GROUND, BASE):
                kinds = "masses" if names == set(mass_names) else "masses and points"
                raise StructureError(
                    f'unknown end "{end}"{near_miss(end, [*places, GROUND, BASE])}; an end is "ground", "base" or one of the '
                    f"{kinds} {quoted(places)}",
                    f'link "{link.name}"',
                )
        linked.update(link.between)
    loose = [name for name in mass_names if name not in linked]
    if loose:
        raise StructureError(
            "no link has it as an end; add a link or remove the mass", f"mass {quoted(loose)}"
        )
