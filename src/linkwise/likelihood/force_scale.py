"""Whether anything sets the scale of the forces: the motion alone tells only ratios of masses and coefficients."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.model.link import Link
from linkwise.model.parameters import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.weak.fit import NO_FORCE_SCALE

_OF_FORCE = re.compile(r"\b(N|kg)\b")
_TRIED = np.array([-0.7, -0.2, 0.3, 0.9])  # elongations and rates
_ANY, _FACTOR = 0.5, 2.0  # value of an unknown, and what it is multiplied by


def require_force_scale(
    records: Sequence[Record], structure: Structure, unknown_gains: Sequence[str] = ()
) -> None:
    """Raise IdentificationError where one factor to all masses and coefficients would not change the motion.

    Forces of `unknown_gains`, of which nothing is known, would change with them.
    """
    if structure.hosts or structure.topology.states:
        return
    channels = dict.fromkeys(name for record in records for name in record.channels)
    forces = [name for name in channels if Channel.parse(name).kind in ("force", "f")]
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


def _scales(link: Link, free: set[str]) -> bool:
    """Whether the force of a link is proportional to those of its `free` coefficients that have a unit of force or mass."""
    scaled = {name for name in free if _OF_FORCE.search(link.law.units[name])}
    values = {name: _ANY if own.value is None else own.value for name, own in link.coefficients.items()}
    larger = {name: value * (_FACTOR if name in scaled else 1.0) for name, value in values.items()}
    force, more = (link.law.force(_TRIED, _TRIED[::-1], of) for of in (values, larger))
    return bool(np.allclose(more, _FACTOR * force, rtol=1e-9, atol=0.0))
