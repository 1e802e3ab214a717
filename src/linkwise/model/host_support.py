"""What does not take hosts says so, instead of running without their points."""

from __future__ import annotations

from linkwise.errors import StructureError
from linkwise.model.structure import Structure


def refuse_hosts(structure: Structure, feature: str) -> None:
    """Raise StructureError if a structure has a host, which `feature` does not take."""
    if structure.hosts:
        raise StructureError(
            f"a host is not supported in {feature}; maximum likelihood takes it",
            f'host "{structure.hosts[0].name}"',
        )
