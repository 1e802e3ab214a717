"""What does not take links with memory says so, instead of running without them."""

from __future__ import annotations

from collections.abc import Iterable

from linkwise.errors import StructureError
from linkwise.model.link import Link


def refuse_memory(links: Iterable[Link], feature: str) -> None:
    """Raise StructureError if one of the links has states, which `feature` does not take."""
    for link in links:
        if link.law.states:
            states = ", ".join(link.law.states)
            raise StructureError(
                f"the law has memory (state {states}), which is not supported in {feature}; use a law of d and v alone",
                f'link "{link.name}"',
            )
