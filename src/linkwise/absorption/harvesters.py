"""Harvesters: dampers in parallel to links, whose dissipated power could be used."""

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
    """The structure with a damper in N s/m in parallel to each link named in `dampings`, as a link "NAME-harvester".

    Raises StructureError for a link that does not exist and for a damping that is not positive.
    """
    added = []
    for name, damping in dampings.items():
        link = structure.link(name)
        if not (np.isfinite(damping) and damping > 0.0):
            raise StructureError(
                f"the damping of a harvester must be positive, got {damping!r} N s/m", f'link "{name}"'
            )
        added.append(
            Link(f"{name}{SUFFIX}", link.between, Law.parse("c*v"), {"c": Coefficient.number(damping)})
        )
    return Structure(structure.name, structure.masses, (*structure.links, *added)) if added else structure
