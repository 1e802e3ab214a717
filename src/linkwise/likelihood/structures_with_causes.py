"""Structures with what a diagnosis names: a missing term or link, or an unknown for a stated value that is off."""

from __future__ import annotations

from dataclasses import replace

from linkwise.estimates.causes import Cause
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.names import SHAPE
from linkwise.model.structure import Structure

FREED = {
    "mass": "mass:{where}",
    "frequency": "{where}.frequency",
    "shape": f"{{source}}.{SHAPE}{{point}}",
}
"""What `Structure.unknown` frees where a stated value is off, by the kind of the cause."""


def with_cause(structure: Structure, cause: Cause) -> Structure:
    """The structure with a missing term or link of unknown size, or with an unknown for a stated value that is off.

    Parameters
    ----------
    structure : Structure
        The structure.
    cause : Cause
        A cause of the kind "term", "link", "mass", "frequency" or "shape".

    Returns
    -------
    Structure
        The structure with it.
    """
    links = structure.links
    if cause.kind in FREED:
        point = cause.where.partition(".")[2]  # after the name of its host, which has no dot
        which = FREED[cause.kind].format(where=cause.where, source=cause.source, point=point)
        return _with_own_value(structure, cause).unknown(which)
    if cause.kind == "link":
        name = cause.where.replace("-", "_")
        while any(link.name == name for link in links):
            name += "_"
        law, coefficients = Law.parse(f"size*({cause.term})"), {"size": Coefficient.unknown(start=0.0)}
        return replace(structure, links=(*links, Link(name, ends_of(structure, cause), law, coefficients)))
    return replace(
        structure,
        links=tuple(_with_term(link, cause.term) if link.name == cause.where else link for link in links),
    )


def _with_own_value(structure: Structure, cause: Cause) -> Structure:
    """The structure in which the mass or the frequency of a cause is equal to no other's, as its score takes it alone."""
    name = f"{cause.where}.{cause.kind}"

    def apart(coefficient: Coefficient, own: str) -> Coefficient:
        is_shared = own == name or coefficient.same_as == name
        return replace(coefficient, same_as=None) if coefficient.known and is_shared else coefficient

    masses = (replace(mass, mass=apart(mass.mass, f"{mass.name}.mass")) for mass in structure.masses)
    links = (
        replace(
            link, coefficients={key: apart(c, f"{link.name}.{key}") for key, c in link.coefficients.items()}
        )
        for link in structure.links
    )
    return replace(structure, masses=tuple(masses), links=tuple(links))


def ends_of(structure: Structure, cause: Cause) -> tuple[str, str]:
    """The two ends of a missing link, which a cause has in one word.

    Parameters
    ----------
    structure : Structure
        The structure.
    cause : Cause
        A cause of the kind "link".

    Returns
    -------
    tuple of (str, str)
        The places that it joins.
    """
    places = list(structure.topology.index)
    return next(
        (first, second) for first in places for second in places if f"{first}-{second}" == cause.where
    )


def _with_term(link: Link, term: str) -> Link:
    name = "added"
    while name in link.coefficients or name in link.states:
        name += "_"
    declared = dict(link.law.declared)
    if declared:  # as of a mode, whose law has numbers with units
        declared |= Law.parse(f"{name}*({term})").units
    law = Law.parse(f"{link.law.text} + {name}*({term})", link.states, units=declared)
    return replace(link, law=law, coefficients={**link.coefficients, name: Coefficient.unknown(start=0.0)})
