"""The states of links with memory: rates as written by a user, and as parsed with the law that they belong to."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from linkwise.argument_types import checked_class
from linkwise.errors import LinkwiseError, StructureError
from linkwise.expression import FUNCTIONS, Expression
from linkwise.expression.dimensions import NAMED, NONE, Dimension
from linkwise.units import base_exponents

_NAME = re.compile(r"[A-Za-z]\w*")
_RESERVED = {
    "d": "the elongation",
    "v": "the rate of elongation",
    "pi": "a constant",
    "x": "not used",
    "t": "time",
}


@checked_class
@dataclass(frozen=True)
class LinkState:
    """A state of a link with memory: a slip, an internal force, a voltage or a current.

    Parameters
    ----------
    rate : str
        Its time derivative: an expression in d, v, the states of the link and its coefficients.
    initial : float or None, optional
        Value at the start of a simulation in SI units, 0 by default; None if it is unknown. An identification by maximum
        likelihood estimates the state at the start of each record, as it does displacements and velocities.
    unit : str, optional
        Its unit, such as ``"V"``; needed only where the law and the rates leave it open.

    Raises
    ------
    StructureError
        If the initial value is not a finite number, or the unit is not a unit.

    Examples
    --------
    >>> import linkwise as lw
    >>> slip = lw.LinkState("v - abs(v)*z/z0", initial=None)
    >>> law = lw.Law.parse("k*z", {"z": slip})
    >>> law.units["z0"], law.state_units["z"]
    ('m', 'm')
    """

    rate: str
    initial: float | None = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        if self.initial is not None:
            number = isinstance(self.initial, int | float) and not isinstance(self.initial, bool)
            if not number or not math.isfinite(self.initial):
                raise StructureError(
                    f"the initial value of a state must be a finite number, or None if it is unknown, got {self.initial!r}"
                )
            object.__setattr__(self, "initial", float(self.initial))
        if self.unit:
            unit_dimension(self.unit)


@dataclass(frozen=True)
class StateRate:
    """The rate of a state, parsed.

    Attributes
    ----------
    name : str
        The state.
    text : str
        Its rate as written.
    expression : Expression
        The parsed rate, in the unit of the state per s.
    unit : str
        The unit stated for the state; empty where none is.

    Examples
    --------
    >>> import linkwise as lw
    >>> dahl = lw.named_law("dahl")
    >>> rate = lw.Law.parse(dahl.law, states=dahl.states).rates[0]
    >>> rate.name, rate.text
    ('q', 'sigma*(v - abs(v)*q/Fc)')
    """

    name: str
    text: str
    expression: Expression
    unit: str = ""


def as_link_states(given: Mapping[str, LinkState | str]) -> dict[str, LinkState]:
    """States by name, a text being a rate. Raises StructureError for a name that cannot be that of a state."""
    states = {}
    for name, state in given.items():
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise StructureError(
                f"{name!r} is not a valid name of a state: letters, digits and _ after a letter"
            )
        if name in _RESERVED or name in FUNCTIONS:
            meaning = _RESERVED.get(name, "a function")
            raise StructureError(
                f"a state cannot be named {name!r}, which is {meaning} in laws; choose another name"
            )
        if not isinstance(state, LinkState | str):
            raise StructureError(f"state {name}: expected its rate as text or a LinkState, got {state!r}")
        states[name] = LinkState(state) if isinstance(state, str) else state
    return states


def unit_dimension(unit: str) -> Dimension:
    """The dimension of a unit such as "V". Raises StructureError for what is not a unit of mechanics or electricity."""
    if not unit:
        return NONE
    for dimension, name in NAMED.items():  # without a library of units, which takes long to load
        if unit == name:
            return dimension
    try:
        return Dimension(*base_exponents(unit))
    except LinkwiseError as error:
        raise StructureError(str(error)) from None
