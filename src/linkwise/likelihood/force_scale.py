"""Whether anything sets the scales of forces and motion: the motion alone tells only ratios of masses and coefficients."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.model.link import Link
from linkwise.model.names import MASS
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.units import base_exponents
from linkwise.weak.fit import NO_FORCE_SCALE

_OF_FORCE = re.compile(r"\b(N|kg)\b")
_TRIED = np.array([-0.7, -0.2, 0.3, 0.9])  # elongations and rates
_UNITLESS = ("", "?")
_ANY, _FACTOR = 0.5, 2.0  # value of an unknown, and what it is multiplied by


def require_force_scale(
    records: Sequence[Record], structure: Structure, unknown_gains: Sequence[str] = ()
) -> None:
    """Raise IdentificationError where one factor to all masses and coefficients would not change the motion.

    Forces of `unknown_gains`, of which nothing is known, would change with them. Where every channel has such a gain, a factor
    to forces and motion together must change what is known, too.
    """
    if structure.hosts or structure.topology.states:
        return
    _require_scale_of_motion(records, structure, unknown_gains)
    channels = dict.fromkeys(name for record in records for name in record.channels)
    forces = [name for name in channels if name.kind in ("force", "f")]
    if not set(forces) <= set(unknown_gains):
        return
    if any(parameter.sigma < np.inf for parameter in structure.parameters):
        return
    free = {member for parameter in structure.parameters for member in parameter.members}
    if all((-1 - index, MASS) in free for index in range(len(structure.masses))) and all(
        _scales(link, {name for index, name in free if index == number})
        for number, link in enumerate(structure.links)
    ):
        if not forces:
            raise IdentificationError(NO_FORCE_SCALE)
        raise IdentificationError(
            f"nothing tells the gain of {', '.join(forces)}: every mass and coefficient is unknown, and a larger force on "
            "larger ones makes the same motion. Give one mass or coefficient a number, or state how well the gain is known, "
            "by a calibration",
            arguments=("calibration",),
        )


def _require_scale_of_motion(
    records: Sequence[Record], structure: Structure, unknown_gains: Sequence[str]
) -> None:
    """Raise IdentificationError where every channel has an unknown gain, and larger forces make a larger motion alike."""
    channels = dict.fromkeys(name for record in records for name in record.channels)
    if not channels or not set(channels) <= set(unknown_gains):
        return
    free = {
        member
        for parameter in structure.parameters
        if parameter.sigma == np.inf
        for member in parameter.members
    }
    if all(
        _grows(link, {name for index, name in free if index == number})
        for number, link in enumerate(structure.links)
    ):
        raise IdentificationError(
            f"the records do not tell the gain of {', '.join(channels)}: every channel has an unknown one, and a larger "
            "motion by larger forces is as likely. "
            f"Leave {'it' if len(channels) == 1 else 'one of them'} out, or state how well it is known, by a calibration",
            arguments=("calibration",),
        )


def _grows(link: Link, free: set[str]) -> bool:
    """Whether the force of a link grows as its motion, if lengths in the units of its `free` coefficients do."""
    values = {name: _ANY if own.value is None else own.value for name, own in link.coefficients.items()}
    law_units = replace(link.law, angular=False).units  # an angle grows as a length does
    units = {name: law_units[name] for name in free}
    lengths = {name: float(base_exponents(unit)[1]) for name, unit in units.items() if unit not in _UNITLESS}
    larger = {name: value * _FACTOR ** lengths.get(name, 0.0) for name, value in values.items()}
    force = link.law.force(_TRIED, _TRIED[::-1], values)
    more = link.law.force(_FACTOR * _TRIED, _FACTOR * _TRIED[::-1], larger)
    return bool(np.allclose(more, _FACTOR * force, rtol=1e-9, atol=0.0))


def _scales(link: Link, free: set[str]) -> bool:
    """Whether the force of a link is proportional to those of its `free` coefficients that have a unit of force or mass."""
    scaled = {name for name in free if _OF_FORCE.search(link.law.units[name])}
    values = {name: _ANY if own.value is None else own.value for name, own in link.coefficients.items()}
    larger = {name: value * (_FACTOR if name in scaled else 1.0) for name, value in values.items()}
    force, more = (link.law.force(_TRIED, _TRIED[::-1], of) for of in (values, larger))
    return bool(np.allclose(more, _FACTOR * force, rtol=1e-9, atol=0.0))
