"""Units of what turns: which texts are units of an angle, its rate, its acceleration or a moment."""

from __future__ import annotations

import re

from linkwise.errors import LinkwiseError
from linkwise.records.channel import ANGULAR_UNITS, UNITS
from linkwise.units import factor_to_si

_ANGLE = re.compile(r"(?<![a-z])([munµμ]?rad|deg|°|rev|turn|rpm|arcmin|arcsec|m?grad|m?gon)|(radian|degree)")
_MOMENT = re.compile(r"N\s*[*·⋅ ]?\s*[mcd]?m$|(lbf|ozf|kgf|newton)[ *·]|[ *·](lbf|ozf|kgf)$")
_NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?\s*")


def is_angular(unit: str, kind: str) -> bool:
    """Whether a channel of a kind in a unit is that of a rotation: an angle, its rate, or a moment.

    Parameters
    ----------
    unit : str
        The unit, as written.
    kind : str
        The kind of channel, such as ``"x"``.

    Returns
    -------
    bool
        Whether it is.
    """
    words = _MOMENT if kind in ("force", "f") else _ANGLE
    return kind in ANGULAR_UNITS and bool(words.search(unit)) and _converts(unit, ANGULAR_UNITS[kind])


def si_unit(unit: str, kind: str) -> str:
    """The SI unit of a channel of `kind` that is stated in `unit`."""
    return ANGULAR_UNITS[kind] if is_angular(unit, kind) else UNITS[kind]


def unit_behind(quantity: str) -> str:
    """The unit of a quantity, such as "deg" of "0.3 deg"; empty where there is none."""
    return _NUMBER.sub("", quantity, count=1).strip()


def _converts(unit: str, dimension: str) -> bool:
    try:
        return bool(factor_to_si(unit, dimension))
    except LinkwiseError:
        return False
