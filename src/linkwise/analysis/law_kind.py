"""Classification of a force law over a range of elongations."""

from __future__ import annotations

import numpy as np

from linkwise.analysis.wells import wells
from linkwise.errors import StructureError
from linkwise.expression import differentiate, symbols
from linkwise.model.link import Link

DAMPER = "damper only"
CONSTANT = "constant force"
MEMORY = "memory"
LINEAR = "linear"
HARDENING = "hardening"
SOFTENING = "softening"
BISTABLE = "bistable"
ONE_SIDED = "one-sided"
UNEVEN = "uneven"
NEGATIVE = "negative stiffness"

_GRID = 65
# of the largest force: smaller forces, and smaller deviations from a straight line, count as zero
_NEGLIGIBLE = 1e-9


def law_kind(link: Link, reach: float) -> str:
    """The kind of a law with known coefficients, at rest and for elongations from -`reach` to `reach` in m.

    "constant force" where it depends on nothing; "damper only" without an elastic part; "bistable" with two wells ("3 wells"
    and so on with more); "linear"; "hardening" or "softening" where the force on both sides is larger or smaller than that of
    the stiffness at 0; "one-sided" where there is no force on one side; "uneven" where one side hardens and the other softens;
    "negative stiffness" without a well. Of a law with states the kind is that of its force at states of 0, as in "linear with
    memory", or "memory" where that is no spring.
    """
    kind = _kind_at_rest(link, reach)
    if not link.law.states:
        return kind
    return MEMORY if kind == DAMPER else f"{kind} with memory"


def _kind_at_rest(link: Link, reach: float) -> str:
    """The kind of the force at v = 0 and states of 0."""
    slope = differentiate(link.law.elastic, "d")
    if "d" not in symbols(link.law.elastic):
        constant = not link.law.states and "v" not in symbols(link.law.expression)
        return CONSTANT if constant and link.force(0.0, 0.0) != 0.0 else DAMPER
    count = _well_count(link, reach)
    if count >= 2:
        return BISTABLE if count == 2 else f"{count} wells"
    at_rest = float(link.stiffness(0.0))
    d = np.linspace(0.0, reach, _GRID)[1:]
    still = link.zero_states
    right, left = link.force(d, 0.0, still), -link.force(-d, 0.0, still)
    sizes = float(np.abs(right).max()), float(np.abs(left).max())
    deviation = max(float(np.abs(side - at_rest * d).max()) for side in (right, left))
    if "d" not in symbols(slope) or deviation <= _NEGLIGIBLE * max(sizes):
        return LINEAR if at_rest >= 0.0 else NEGATIVE
    if min(sizes) <= _NEGLIGIBLE * max(sizes):
        return ONE_SIDED
    hardens = [float(side[-1]) / reach > at_rest for side in (right, left)]
    if count == 0 and at_rest < 0.0:
        return NEGATIVE
    if all(hardens):
        return HARDENING
    return UNEVEN if any(hardens) else SOFTENING


def _well_count(link: Link, reach: float) -> int:
    try:
        return len(wells(link, -reach, reach))
    except StructureError:  # the force vanishes everywhere
        return 0
