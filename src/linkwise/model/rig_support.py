"""What does not take links alone on a rig says so."""

from __future__ import annotations

from linkwise.errors import StructureError
from linkwise.model.structure import Structure


def refuse_rig(structure: Structure, feature: str) -> None:
    """Raise StructureError for a structure without a mass, which `feature` does not take."""
    if structure.on_rig:
        raise StructureError(
            f"there is no mass: links alone on a rig are not supported in {feature}; add the mass that moves",
            f'link "{structure.links[0].name}"',
        )
