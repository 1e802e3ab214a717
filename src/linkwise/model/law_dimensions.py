"""Dimensions of the coefficients and states of a law, for motion along a line or about an axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from linkwise.errors import LawError
from linkwise.expression import Expression, parse_with_positions
from linkwise.expression.dimensions import (
    METRE,
    METRE_PER_SECOND,
    NEWTON,
    NONE,
    RADIAN,
    SECOND,
    Dimension,
    UnitConflict,
    infer,
)
from linkwise.model.law_text import VARIABLES
from linkwise.model.link_state import StateRate

_LINEAR = ({"d": METRE, "v": METRE_PER_SECOND},)
_ANGULAR = ({"d": RADIAN, "v": RADIAN / SECOND}, {"d": NONE, "v": NONE / SECOND})
"""An angle is a number where a law needs one, as in `k*sin(d)`."""


def law_dimensions(
    text: str,
    expression: Expression,
    states: Sequence[StateRate],
    known: Mapping[str, Dimension],
    *,
    angular: bool = False,
) -> dict[str, Dimension | None]:
    """Dimension of each coefficient and state of a law, given some; None where any is consistent.

    Raises LawError if none are consistent; it has the place where they disagree.
    """
    rates = {rate.name: rate.expression for rate in states}
    force = NEWTON * METRE if angular else NEWTON
    conflicts = []
    for variables in _ANGULAR if angular else _LINEAR:
        try:
            return infer(expression, variables, force, rates=rates, known=known)
        except UnitConflict as error:
            conflicts.append(error)
    first = conflicts[0]
    faulty = (text, *(rate.text for rate in states))[first.equation]
    place = parse_with_positions(faulty, (*VARIABLES, *rates)).position(first.part)
    raise LawError(first.reason, faulty, place, "Give each term a coefficient of its own.") from None
