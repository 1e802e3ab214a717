"""Conversion of values with units to SI; the only module that uses pint."""

from __future__ import annotations

import math
import re
import tokenize
from fractions import Fraction
from functools import cache
from numbers import Real
from typing import TYPE_CHECKING, Any

from linkwise.errors import LinkwiseError
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    import pint
else:
    pint = lazy_module("pint")  # a third of a second, and most files are in SI units

_GRAVITY = "standard_gravity"
_SPELLINGS = str.maketrans({"·": "*", "⋅": "*", "×": "*", "²": "**2", "³": "**3", "−": "-"})
_UNITLESS = ("", "?")  # dimensions for which a number needs no unit
_WHOLE = re.compile(r"(?<![\w.])\d+(?![\w.])")
_JOINED_MOMENT = re.compile(r"(?<![^\W\d_])([kMmµμ]?N)([mc]?m)(?!\w|\s*(?:\*\*|\^))")  # Nm, but not Nm^2
_REVOLUTION = re.compile(r"(?<![^\W\d_])rev(?![^\W\d_])")
_LONGEST = 200  # characters of a quantity
_SHOWN = 60  # characters of it in a message
_UNREADABLE = (
    tokenize.TokenError, ValueError, TypeError, AttributeError, ArithmeticError, AssertionError,
)  # fmt: skip


def to_si(given: object, dimension: str) -> float:
    """Convert a value to SI units.

    Parameters
    ----------
    given : float or str
        A number, which is in SI units already, or a text with a unit such as ``"30 kN/m"``.
    dimension : str
        The SI unit expected, written as in `Law.units`: ``"N/m^3"``, ``"N s/m"``, ``"kg"``, ``""`` for a pure number,
        ``"?"`` for any unit.

    Returns
    -------
    float
        The value in SI units.

    Raises
    ------
    LinkwiseError
        If `given` is not a finite number, cannot be read as a quantity, or has another dimension.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.files.to_si("30 kN/m", "N/m")
    30000.0
    >>> lw.files.to_si("1 g", "m/s^2")
    9.80665
    """
    expected = "a number"
    if dimension not in _UNITLESS:
        expected += f" in {dimension} or a text with a unit such as '1 {dimension}'"
    if not isinstance(given, str):
        if isinstance(given, bool) or not isinstance(given, Real):
            raise LinkwiseError(f"{_shown(given)} is not a value: expected {expected}.")
        try:
            return _finite(float(given), given)
        except OverflowError:  # of a large integer
            return _finite(math.inf, given)
    quantity = _read(given, dimension, expected)
    if quantity.unitless and dimension not in _UNITLESS:
        raise LinkwiseError(
            f"{_shown(given)} has no unit: add one, as in '{quantity.magnitude:g} {dimension}', "
            f"or remove the quotes if it is in {dimension} already."
        )
    return _converted(quantity, given, dimension, expected)


def factor_to_si(unit: str, dimension: str) -> float:
    """The factor that converts a number in `unit` to the SI unit `dimension`: 0.001 for "mm" and "m".

    "g" is standard gravity where an acceleration is expected. Raises LinkwiseError for a unit that is unknown or has
    another dimension.
    """
    expected = f"a unit that converts to {dimension}" if dimension not in _UNITLESS else "a unit"
    quantity = _read(unit, dimension, expected)
    if quantity.magnitude != 1 or (quantity.unitless and dimension not in _UNITLESS):
        raise LinkwiseError(f"{_shown(unit)} is not a unit: expected {expected}.")
    return _converted(quantity, unit, dimension, expected)


def converts(unit: str, dimension: str) -> bool:
    """Whether a text is a unit that converts to the SI unit `dimension`."""
    try:
        factor_to_si(unit, dimension)
    except LinkwiseError:
        return False
    return True


def base_exponents(unit: str) -> tuple[Fraction, Fraction, Fraction, Fraction]:
    """Exponents of kilogram, metre, second and ampere in the unit of a text: of "30 kN/m" 1, 0, -2, 0.

    Raises LinkwiseError for what is not a unit, and for one of temperature, substance or light.
    """
    quantity = _read(unit, "?", "a unit")
    exponents: dict[str, Any] = dict(quantity.dimensionality)
    shares = [
        Fraction(exponents.pop(name, 0)).limit_denominator(12)
        for name in ("[mass]", "[length]", "[time]", "[current]")
    ]
    if exponents:
        raise LinkwiseError(f"{_shown(unit)} is not a unit of mechanics or electricity.")
    return shares[0], shares[1], shares[2], shares[3]


def is_unit(text: str) -> bool:
    """Whether a text is a unit, without a number before it."""
    try:
        quantity = _read(text, "?", "a unit")
    except LinkwiseError:
        return False
    return bool(quantity.magnitude == 1) and not quantity.unitless


def _finite(value: float, given: object) -> float:
    if not math.isfinite(value):
        raise LinkwiseError(f"{_shown(given)} is not finite.")
    return value


def _read(text: str, dimension: str, expected: str) -> pint.Quantity[float]:
    """`text` as a quantity; "m/s2" means m/s^2, "Nm" N m, "rev" a turn, "g" gravity where an acceleration is expected."""
    unreadable = LinkwiseError(f"{_shown(text)} cannot be read as a quantity: expected {expected}.")
    if len(text) > _LONGEST:
        raise unreadable
    spelled = re.sub(r"(?<![\w.])([^\W\d_]+)(-?\d)(?![\w.])", r"\1**\2", text.strip().translate(_SPELLINGS))
    spelled = _JOINED_MOMENT.sub(r" (\1*\2)", _REVOLUTION.sub("revolution", spelled))
    if dimension == "m/s^2":
        spelled = re.sub(r"(?<![^\W_])(m?)g(_?n|_0)?$", rf"\1{_GRAVITY}", spelled)
    try:
        quantity: pint.Quantity[float] = _registry().Quantity(_in_floats(spelled))
        quantity = _registry().Quantity(float(quantity.magnitude), quantity.units)
        quantity.to_root_units()  # a unit raised to a power may have a factor that overflows
        return quantity
    except (pint.PintError, *_UNREADABLE):
        raise unreadable from None


def _in_floats(text: str) -> str:
    """`text` with integers as floats, except exponents of units: 9**9**9 in integers would never finish."""

    def spelled(match: re.Match[str]) -> str:
        before, after = text[: match.start()].rstrip(" +-"), text[match.end() :].lstrip()
        raised = after.startswith(("**", "^"))
        return match[0] if before.endswith(("**", "^")) and not raised else f"{match[0]}.0"

    return _WHOLE.sub(spelled, text)


def _shown(given: object) -> str:
    text = repr(given)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _converted(quantity: pint.Quantity[float], given: str, dimension: str, expected: str) -> float:
    if dimension == "?":
        return _finite(float(quantity.to_base_units().magnitude), given)
    try:
        unit = _registry().Unit(dimension)
    except (pint.PintError, *_UNREADABLE):
        message = f'dimension must be a unit, such as "kg" or "m/s^2", got {_shown(dimension)}'
        raise LinkwiseError(message) from None
    try:
        return _finite(float(quantity.to(unit).magnitude), given)
    except pint.DimensionalityError:
        got = "has no unit" if quantity.unitless else f"is in {quantity.units:~C}"
        raise LinkwiseError(f"{_shown(given)} {got}: expected {expected}.") from None


@cache
def _registry() -> pint.UnitRegistry[float]:
    """Built on first use: filling it takes longer than most commands run."""
    return pint.UnitRegistry()
