"""How far an identified force is from the true one, where there is one."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.model.structure import BASE, GROUND, Link
from linkwise.records.record import Record


def nmse(true: Link, found: Link, record: Record) -> float:
    """The paper's Eq. (8) in %: mean square of the difference of both forces over the variance of the true one.

    The forces are the stiffness forces (v = 0) at the elongations of `record`; of a simulated record the true elongations are
    taken, of a measured one the displacements as they are. Raises RecordError where an end of the link has no displacement,
    and where the true force does not vary.
    """
    d = _elongation(true, record)
    force = true.force(d)
    variance = float(np.var(force))
    if variance == 0.0:
        raise RecordError(
            f'the true force of link "{true.name}" does not vary over the record, so no relative error exists'
        )
    return float(100.0 * np.mean((force - found.force(d)) ** 2) / variance)


def _elongation(link: Link, record: Record) -> Floats:
    """(N',) elongations of one link at the samples where both ends were seen."""
    ends = [_displacement(end, record) for end in link.between]
    d = np.asarray(ends[0] - ends[1])
    return d[np.isfinite(d)]


def _displacement(end: str, record: Record) -> Floats:
    truth = record.simulated
    if end == GROUND:
        return np.zeros(len(record))
    if truth is not None and end == BASE and truth.base is not None:
        return truth.base
    if truth is not None and end in truth.structure.mass_names:
        return np.asarray(truth.displacement[:, truth.structure.mass_names.index(end)])
    return record.channel(f"x:{end}")
