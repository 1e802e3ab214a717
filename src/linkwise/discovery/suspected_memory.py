"""Memory that residuals show: in which link, and starting values for laws that have it, from the size of the force."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from linkwise.discovery.selection import Selection, link_motions
from linkwise.estimates.causes import Cause
from linkwise.likelihood.tests.score_test import MEMORY_TERMS

_YIELDS = 0.3  # of the deviation of the elongation, where a slider yields
_OF_SLIDER, _OF_RELAXING = (
    0.8,
    0.7,
)  # root mean square of a state over that of a sign, and over that of the elongation


@dataclass(frozen=True)
class SuspectedMemory:
    """The memory in a `link` that would explain most of what a fit leaves, and how far the link moves.

    `size` is the root mean square of its force in N, with a sign; `elongation` in m and `rate` in m/s are those of the link.
    """

    link: str
    size: float
    elongation: float
    rate: float

    def start(self, law: str) -> Mapping[str, float]:
        """Values of the coefficients of the part with memory of a named law; none where they are not known."""
        return _STARTS[law](self) if law in _STARTS else {}

    @property
    def slip(self) -> float:
        """The force in N at which a slider yields."""
        return abs(self.size) / _OF_SLIDER

    @property
    def reach(self) -> float:
        """The elongation in m over which it does."""
        return _YIELDS * self.elongation

    @property
    def branch(self) -> float:
        """The stiffness in N/m of a spring that relaxes."""
        return abs(self.size) / (_OF_RELAXING * self.elongation)


_STARTS: Mapping[str, Callable[[SuspectedMemory], Mapping[str, float]]] = {
    "bouc-wen": lambda own: {"F": own.slip, "x0": own.reach, "s": 0.5},
    "dahl": lambda own: {"Fc": own.slip, "sigma": own.slip / own.reach},
    "zener": lambda own: {"k1": own.branch, "c1": own.branch * own.elongation / own.rate},
}


def suspected_memory(selection: Selection, cause: Cause | None) -> SuspectedMemory | None:
    """What a cause says of memory in a link of a selection; None where it says nothing of it."""
    motions = link_motions(selection)
    if cause is None or cause.term not in MEMORY_TERMS or cause.where not in motions:
        return None
    d, v = motions[cause.where]
    elongation, rate = float(np.std(d)), float(np.std(v))
    if not min(elongation, rate) > 0.0:
        return None
    return SuspectedMemory(cause.where, cause.size, elongation, rate)
