"""Structures with what laws lack: a term, a link, an unknown for a stated value that is off, or a force that saturates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from linkwise.estimates.causes import Cause
from linkwise.estimates.estimate import Estimate
from linkwise.expression import symbols
from linkwise.likelihood.starts.kalman import with_starts
from linkwise.likelihood.tests.score_test import MEMORY_TERMS
from linkwise.model.coefficient import SHAPE, Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link, with_term
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
        pairs = product(structure.topology.index, repeat=2)
        ends = next((first, second) for first, second in pairs if f"{first}-{second}" == cause.where)
        return replace(structure, links=(*links, Link(name, ends, law, coefficients)))
    return _with_force(
        structure, cause.where, f"{{0}}*({cause.term})", {"added": Coefficient.unknown(start=0.0)}
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


def _with_force(
    structure: Structure, where: str, form: str, unknowns: Mapping[str, Coefficient]
) -> Structure:
    """The structure with a force in a link, as of `with_term`."""
    links = (with_term(link, form, unknowns) if link.name == where else link for link in structure.links)
    return replace(structure, links=tuple(links))


def dissipates(term: str) -> bool:
    """Whether a missing term is a force that depends on the rate, or on its past."""
    return term in MEMORY_TERMS or (bool(term) and "v" in symbols(Law.parse(f"a*{term}").expression))


def with_saturation(
    structure: Structure, cause: Cause, answer: Estimate, part: float
) -> tuple[Structure, str] | None:
    """The structure with a force like tanh in the link of a missing term, and the form of that force.

    Parameters
    ----------
    structure : Structure
        The structure.
    cause : Cause
        A cause of the kind "term": the force is one of the rate of the elongation where that dissipates, else of
        the elongation.
    answer : Estimate
        The answer to the structure, from which its unknowns start.
    part : float
        Where the force starts to saturate, in standard deviations of that motion.

    Returns
    -------
    tuple of (Structure, str) or None
        The structure, with the size of the force and a factor on the motion as unknowns; None where the link does not move.
    """
    number = [link.name for link in structure.links].index(cause.where)
    state, motion = ("v", answer.motion.v) if dissipates(cause.term) else ("d", answer.motion.d)
    spread = float(np.std(motion[:, number]))
    if not spread > 0.0:
        return None
    factor = 1.0 / (part * spread)
    form = f"tanh({factor:.4g}*{state})"
    found = {str(p.name): float(x) for p, x in zip(answer.parameters, answer.values, strict=True)}
    unknown = {
        "added": Coefficient.unknown(start=abs(cause.size)),
        "saturates": Coefficient.unknown(start=factor),
    }
    return _with_force(
        with_starts(structure, found), cause.where, f"{{0}}*(tanh({{1}}*{state}))", unknown
    ), form
