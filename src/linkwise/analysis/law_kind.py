"""What kind of law a link has, in a word: what its force does over the elongations that were seen."""

from __future__ import annotations

import numpy as np

from linkwise.analysis.wells import wells
from linkwise.errors import StructureError
from linkwise.expression import differentiate, symbols
from linkwise.model.link import Link

DAMPER = "damper only"
LINEAR = "linear"
HARDENING = "hardening"
SOFTENING = "softening"
BISTABLE = "bistable"
ONE_SIDED = "one-sided"
UNEVEN = "uneven"
NEGATIVE = "negative stiffness"

_GRID = 65
_NOTHING = (
    1e-9  # of the largest force: a side that pulls less does not pull, a line that bends less is straight
)


def law_kind(link: Link, reach: float) -> str:
    """The kind of a law whose coefficients are numbers, judged at rest from -`reach` to `reach` m.

    "damper only" without an elastic part; "bistable" with two wells ("3 wells" and so on with more); "linear"; "hardening" or
    "softening" where both sides pull more or less than the stiffness at rest would; "one-sided" where one side does not pull;
    "uneven" where one is harder and the other softer; "negative stiffness" where nothing within reach restores.
    """
    slope = differentiate(link.law.elastic, "d")
    if "d" not in symbols(link.law.elastic):
        return DAMPER
    found = _wells(link, reach)
    if found >= 2:
        return BISTABLE if found == 2 else f"{found} wells"
    at_rest = float(link.stiffness(0.0))
    d = np.linspace(0.0, reach, _GRID)[1:]
    right, left = link.force(d), -link.force(-d)
    sizes = float(np.abs(right).max()), float(np.abs(left).max())
    bent = max(float(np.abs(side - at_rest * d).max()) for side in (right, left))
    if "d" not in symbols(slope) or bent <= _NOTHING * max(sizes):
        return LINEAR if at_rest >= 0.0 else NEGATIVE
    if min(sizes) <= _NOTHING * max(sizes):
        return ONE_SIDED
    harder = [float(side[-1]) / reach > at_rest for side in (right, left)]
    if found == 0 and at_rest < 0.0:
        return NEGATIVE
    if all(harder):
        return HARDENING
    return UNEVEN if any(harder) else SOFTENING


def _wells(link: Link, reach: float) -> int:
    try:
        return len(wells(link, -reach, reach))
    except StructureError:  # it vanishes everywhere
        return 0
