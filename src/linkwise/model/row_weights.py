"""A point of matrices as a sum of degrees of freedom with factors, such as "0.6*12x + 0.8*12z" for an oblique direction."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from linkwise.errors import StructureError

_TRANSLATION = re.compile(r"(-?\d+)[xyz]")
_ROTATION = re.compile(r"-?\d+r[xyz]")
_ROUNDED = 1e-3  # of the length of a direction: cosines of three digits
_NUMBER = r"\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?"
_TERM = re.compile(rf"\s*([+-]?)\s*(?:({_NUMBER})\s*\*\s*)?([^\s*+-]+)\s*")


def row_weights(text: str) -> dict[str, float]:
    """Factors of degrees of freedom by their names.

    Parameters
    ----------
    text : str
        A name, or a sum of names with factors.

    Returns
    -------
    dict of str to float
        The factors; the text itself with 1 where it is no such sum.
    """
    weights: dict[str, float] = {}
    place = 0
    while place < len(text):
        term = _TERM.match(text, place)
        if term is None or (place > 0 and not term[1]):
            return {text: 1.0}
        sign, factor, name = term.groups()
        weights[name] = weights.get(name, 0.0) + (-1.0 if sign == "-" else 1.0) * float(factor or 1.0)
        place = term.end()
    return weights or {text: 1.0}


def turns_throughout(text: str) -> bool:
    """Whether a point is a rotation, or a sum of rotations; with translations, rotations times a lever are one."""
    return all(_ROTATION.fullmatch(name) for name in row_weights(text))


def unit_of_direction(name: str) -> str | None:
    """Unit of the displacement of a node and a direction, such as "21ry"; None for another name."""
    if _ROTATION.fullmatch(name):
        return "rad"
    return "m" if _TRANSLATION.fullmatch(name) else None


def require_direction(point: str, weights: Mapping[str, float]) -> None:
    """Check that a point moves, and that a direction of one node has the length 1.

    Parameters
    ----------
    point : str
        Name of the point.
    weights : mapping of str to float
        Factors of degrees of freedom by their names.

    Raises
    ------
    StructureError
        If it does not: forces and stiffnesses there would be wrong by the length and its square.
    """
    length = math.hypot(*weights.values())
    if length == 0.0:
        raise StructureError(f'the point "{point}" does not move: its factors cancel')
    nodes = {match[1] if (match := _TRANSLATION.fullmatch(name)) else "" for name in weights}
    if len(weights) > 1 and len(nodes) == 1 and "" not in nodes and abs(length - 1.0) > _ROUNDED:
        cosines = " ".join(f"{weight / length:+.4f}*{name}" for name, weight in weights.items())
        raise StructureError(
            f'the factors of the point "{point}" are no direction of node {nodes.pop()}: their squares add up to '
            f'{length**2:.4g}, not 1; write "{cosines}"'
        )
