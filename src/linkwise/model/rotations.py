"""Places of a structure that turn about an axis, whose displacement is in rad, and points in oblique directions such as
"0.6*12x + 0.8*12z".

A link between places that turn is a moment (N m) by an angle (rad). Everything is computed as along lines; only units
differ.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

from linkwise.errors import LinkwiseError, StructureError
from linkwise.model.coefficient import index_of
from linkwise.model.host import Host
from linkwise.model.link import ANGLE, GROUND, LENGTH, MASS_UNITS, Link, Mass
from linkwise.units import to_si

_TRANSLATION = re.compile(r"(-?\d+)[xyz]")
_ROTATION = re.compile(r"-?\d+r[xyz]")
_ROUNDED = 1e-3  # of the length of a direction: cosines of three digits
_NUMBER = r"\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?"
_TERM = re.compile(rf"\s*([+-]?)\s*(?:({_NUMBER})\s*\*\s*)?([^\s*+-]+)\s*")


def row_weights(text: str) -> dict[str, float]:
    """Factors of degrees of freedom by name, of a name or a sum of names with factors; the text itself with 1 where it is
    no such sum.
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
    """Check that a point moves, and that a direction of one node has the length 1: else StructureError, as forces and
    stiffnesses there would be wrong by the length and its square.
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


def with_units(
    host: Host, units: Mapping[str, str], directions: Mapping[str, int | str] = MappingProxyType({})
) -> Host:
    """A host with the units "rad" or "m" of the displacement of some points.

    `directions` are what points are in a finite-element model, by default their names: that of a node, such as "21ry", has
    one unit. StructureError if there is no such point, or another unit, or one that is not of the direction.
    """
    shape, rotations = host.modes[0].shape, set(host.modes[0].rotations)
    for point, unit in units.items():
        index_of(shape, point, "point", "points")
        direction = str(directions.get(point, point))
        if unit_of_direction(direction) not in (None, unit):
            raise StructureError(
                f'units: the point "{point}" is the direction {direction}, which is in {unit_of_direction(direction)}, not in '
                f"{unit}"
            )
        if unit not in (ANGLE, LENGTH):
            raise StructureError(
                f'units: the point "{point}" is displaced in "rad" or "m", got {unit!r}; a record may be in other units, such '
                f"as x:{host.name}.{point}[deg]"
            )
        (rotations.add if unit == ANGLE else rotations.discard)(point)
    if rotations == host.modes[0].rotations:
        return host
    return replace(host, modes=tuple(replace(mode, rotations=frozenset(rotations)) for mode in host.modes))


def in_units_of_ends(links: tuple[Link, ...], rotations: Collection[str]) -> tuple[Link, ...]:
    """Links whose laws are moments where their ends are among the `rotations`.

    Raises StructureError for a link between a rotation and what does not turn.
    """
    if not rotations and not any(link.law.angular for link in links):
        return links
    in_units = []
    for link in links:
        turning = [end for end in link.between if end in rotations]
        if differ_in_unit(link.between, rotations):
            other = next(end for end in link.between if end not in turning)
            raise StructureError(
                f'the end "{turning[0]}" turns, in rad, and "{other}" moves in m: no law joins them; link two rotations, or '
                "a rotation to the ground",
                f'link "{link.name}"',
            )
        angular = bool(turning)
        same = link.law.angular == angular
        in_units.append(link if same else replace(link, law=replace(link.law, angular=angular)))
    return tuple(in_units)


def differ_in_unit(ends: tuple[str, str], rotations: Collection[str]) -> bool:
    """Whether one of two ends turns and the other moves along a line."""
    turning = [end for end in ends if end in rotations]
    return bool(turning) and any(end not in (*turning, GROUND) for end in ends)


def rotations_of(hosts: Iterable[Host], masses: Iterable[Mass]) -> tuple[str, ...]:
    """The points of hosts and the masses that turn."""
    points = [point for host in hosts for point in host.rotations]
    return (*points, *[mass.name for mass in masses if mass.unit == ANGLE])


def mass_in_si(given: float | str) -> tuple[float, str]:
    """A mass in kg and "m", or where its text is a moment of inertia in kg m^2 and "rad"; a number is in kg."""
    unit = ANGLE if is_inertia(given) else LENGTH
    return to_si(given, MASS_UNITS[unit]), unit


def is_inertia(given: object) -> bool:
    """Whether a mass is a moment of inertia: a text such as "20 g m^2", or a table with one."""
    if isinstance(given, Mapping):
        return any(is_inertia(value) for value in given.values())
    if not isinstance(given, str) or not any(character.isdigit() for character in given):
        return False
    try:
        to_si(given, MASS_UNITS[ANGLE])
    except LinkwiseError:
        return False
    return True
