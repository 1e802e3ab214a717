"""Rotations: places of a structure that turn about an axis, whose displacement is in rad, and the links between them.

A link between places that turn is a moment (N m) by an angle (rad). Everything is computed as along lines; only units
differ.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

from linkwise.errors import LinkwiseError, StructureError
from linkwise.model.host import Host
from linkwise.model.link import ANGLE, GROUND, LENGTH, MASS_UNITS, Link, Mass
from linkwise.model.names import index_of
from linkwise.model.row_weights import unit_of_direction
from linkwise.units import to_si


def with_units(
    host: Host, units: Mapping[str, str], directions: Mapping[str, int | str] = MappingProxyType({})
) -> Host:
    """A host with the units of the displacement of some points.

    Parameters
    ----------
    host : Host
        The host.
    units : mapping of str to str
        ``"rad"`` or ``"m"`` by the name of the point.
    directions : mapping of str to int or str, optional
        What points are in a finite-element model; that of a node, such as ``"21ry"``, has one unit. By default their names.

    Returns
    -------
    Host
        The host.

    Raises
    ------
    StructureError
        If there is no such point, or another unit, or one that is not of the direction.
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
    return tuple(_in_unit_of_ends(link, rotations) for link in links)


def _in_unit_of_ends(link: Link, rotations: Collection[str]) -> Link:
    turning = [end for end in link.between if end in rotations]
    if differ_in_unit(link.between, rotations):
        others = [end for end in link.between if end not in turning]
        raise StructureError(
            f'the end "{turning[0]}" turns, in rad, and "{others[0]}" moves in m: no law joins them; link two rotations, or a '
            "rotation to the ground",
            f'link "{link.name}"',
        )
    if link.law.angular == bool(turning):
        return link
    return replace(link, law=replace(link.law, angular=bool(turning)))


def differ_in_unit(ends: tuple[str, str], rotations: Collection[str]) -> bool:
    """Whether one of two ends turns and the other moves along a line."""
    turning = [end for end in ends if end in rotations]
    return bool(turning) and any(end not in (*turning, GROUND) for end in ends)


def rotations_of(hosts: Iterable[Host], masses: Iterable[Mass]) -> tuple[str, ...]:
    """The points of hosts and the masses that turn."""
    points = [point for host in hosts for point in host.rotations]
    return (*points, *[mass.name for mass in masses if mass.unit == ANGLE])


def mass_in_si(given: float | str) -> tuple[float, str]:
    """A mass in kg, or in kg m^2 where its text is a moment of inertia, and the unit of its displacement.

    Parameters
    ----------
    given : float or str
        A number, which is in kg, or a text with a unit.

    Returns
    -------
    tuple of float and str
        The mass, and ``"m"`` or ``"rad"``.

    Raises
    ------
    LinkwiseError
        If it is neither a number nor a quantity with a unit of mass or of inertia.
    """
    unit = ANGLE if is_inertia(given) else LENGTH
    return to_si(given, MASS_UNITS[unit]), unit


def is_inertia(given: object) -> bool:
    """Whether a mass is a moment of inertia: a text such as "20 g m^2", or a table with one.

    Parameters
    ----------
    given : object
        A number, a text or a table of these.

    Returns
    -------
    bool
        Whether it is.
    """
    if isinstance(given, Mapping):
        return any(is_inertia(value) for value in given.values())
    if not isinstance(given, str) or not any(character.isdigit() for character in given):
        return False
    try:
        to_si(given, MASS_UNITS[ANGLE])
    except LinkwiseError:
        return False
    return True
