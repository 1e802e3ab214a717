"""The text of a law, or of the rate of a state, checked: what it may name, and that it is finite at rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkwise.errors import LawError
from linkwise.expression import Expression, Power, Program, Symbol, parse_with_positions, symbols
from linkwise.expression.parser import Parsed

VARIABLES = ("d", "v")

_MISUSED = {
    "x": "The variables of a law are the elongation d = x_first - x_second of its link and its rate v: write d for x.",
    "t": "A law does not depend on time; a force that does is an excitation.",
}


def checked_expression(text: str, variables: tuple[str, ...]) -> Expression:
    """The expression of a law or a rate. Raises LawError for an invalid one."""
    parsed = parse_with_positions(text, variables)
    for name, advice in _MISUSED.items():
        place = parsed.position(Symbol(name))
        if place is not None:
            raise LawError(f"Unknown variable {name!r} in a law.", text, place, advice)
    _check_rest(text, parsed, variables)
    return parsed.expression


def _check_rest(text: str, parsed: Parsed, variables: tuple[str, ...]) -> None:
    """Raise LawError for a law that is not finite at d = v = 0, neither with coefficients of 1 nor with others."""
    names = dict.fromkeys(
        name for part, _ in parsed.positions for name in symbols(part)
    )  # of folded parts too
    ones = dict.fromkeys(names, 1.0)
    others = {name: 0.1 + (index * 0.618034) % 0.9 for index, name in enumerate(names)}
    ones |= dict.fromkeys(variables, 0.0)
    others |= dict.fromkeys(variables, 0.0)
    if any(np.isfinite(_at_rest(parsed.expression, values)) for values in (ones, others)):
        return
    expression, position = next(
        place for place in parsed.positions if not np.isfinite(_at_rest(place[0], others))
    )
    reason, advice = "No finite value", "Check the argument of this function, and the constants."
    if isinstance(expression, Power):
        reason, advice = "Division by zero", "Keep the divisor away from 0, as in d/(1 + abs(d)/s)."
    raise LawError(f"{reason} at rest (d = 0, v = 0), where a law must be finite.", text, position, advice)


def _at_rest(expression: Expression, values: Mapping[str, float]) -> float:
    names = symbols(expression)
    return float(Program([expression], names)(*(values[name] for name in names))[0])
