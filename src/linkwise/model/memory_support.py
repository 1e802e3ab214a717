"""What does not take links with memory says so, instead of running without them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from linkwise.errors import StructureError
from linkwise.model.link import Link

COMPARISON = "the comparison with a truth"  # of terms and forces of d and v


def require_rest_at_zero(links: Iterable[Link], feature: str) -> None:
    """Raise StructureError if the states of one of the links do not rest at 0 while its ends rest, as `feature` needs."""
    elongations = np.concatenate([-np.logspace(-9, 0, 10), [0.0], np.logspace(-9, 0, 10)])
    for link in links:
        if not link.law.states:
            continue
        with np.errstate(all="ignore"):
            rates = link.law.state_rates(elongations, 0.0, {**link.values, **link.zero_states})
        moving = [name for name, rate in zip(link.law.states, rates, strict=True) if np.any(rate != 0.0)]
        if moving:
            raise StructureError(
                f"the state {moving[0]} does not rest at 0 while the ends of the link are at rest, which is not "
                f"supported in {feature}",
                f'link "{link.name}"',
            )


def refuse_memory(links: Iterable[Link], feature: str, instead: str = "use a law of d and v alone") -> None:
    """Raise StructureError if one of the links has states, which `feature` does not take, and say what to do `instead`."""
    for link in links:
        if link.law.states:
            states = ", ".join(link.law.states)
            raise StructureError(
                f"the law has memory (state {states}), which is not supported in {feature}; {instead}",
                f'link "{link.name}"',
            )
