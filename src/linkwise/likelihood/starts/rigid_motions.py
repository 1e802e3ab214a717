"""Rigid motions of hosts that nothing holds, and whose place no sensor tells."""

from __future__ import annotations

import numpy as np

from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.model.link import GROUND, Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record


def require_placed(record: Record, structure: Structure) -> None:
    """Raise IdentificationError if rigid motions have a place that neither a link to the ground nor a displacement tells.

    Accelerations and velocities, and forces between points that move alike, are the same wherever a free structure is.
    """
    rigid = [
        number
        for number, name in enumerate(structure.mass_names)
        if name in structure.modes and _is_rigid(structure, name)
    ]
    if not rigid:
        return
    rows = [structure.topology.row(channel.place) for channel in record.responses if channel.kind == "x"]
    rows += [
        structure.incidence[:, [number]].toarray().ravel()
        for number, link in enumerate(structure.links)
        if GROUND in link.between and link.name not in structure.modes and _acts_by_place(link)
    ]
    placed = np.array(rows)[:, rigid] if rows else np.zeros((1, len(rigid)))
    if np.linalg.matrix_rank(placed) == len(rigid):
        return
    names = ", ".join(structure.mass_names[number] for number in rigid)
    raise IdentificationError(
        f"nothing tells the place of rigid motions at 0 Hz ({names}), neither a link to the ground nor a channel: record a "
        "displacement (x:HOST.POINT) for each, or state the frequency at which a suspension holds the structure, such as "
        "frequency = 0.5"
    )


def _acts_by_place(link: Link) -> bool:
    """Whether a force depends on the elongation; that of a damper does not."""
    return bool(link.law.states) or "d" in symbols(link.law.expression)


def _is_rigid(structure: Structure, mode: str) -> bool:
    frequency = structure.link(mode).coefficients["frequency"]
    return frequency.known and frequency.value == 0.0
