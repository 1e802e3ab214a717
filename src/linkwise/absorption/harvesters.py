"""Harvesters: dampers put in parallel to links, whose heat is the power that could be used."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure

SUFFIX = "-harvester"


def with_harvesters(structure: Structure, dampings: Mapping[str, float]) -> Structure:
    """The structure with a damper of so many N s/m in parallel to each link that is named, as a link "NAME-harvester".

    Raises StructureError for a link that is not there and for a damping that is not positive.
    """
    added = []
    for name, damping in dampings.items():
        link = structure.link(name)
        if not (np.isfinite(damping) and damping > 0.0):
            raise StructureError(
                f"a harvester's damping of {damping!r} N s/m cannot be; it is a number above 0",
                f'link "{name}"',
            )
        added.append(
            Link(f"{name}{SUFFIX}", link.between, Law.parse("c*v"), {"c": Coefficient.number(damping)})
        )
    return Structure(structure.name, structure.masses, (*structure.links, *added)) if added else structure
