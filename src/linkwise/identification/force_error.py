"""How far an identified force is from the true one, where there is one."""

from __future__ import annotations

import numpy as np

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.errors import RecordError
from linkwise.model.memory_support import refuse_memory
from linkwise.model.structure import BASE, GROUND, Link
from linkwise.records.record import Record


@deprecated_keyword("found", Deprecated("estimated", since="0.2.0", until="0.4.0"))
@checked
def nmse(true: Link, estimated: Link, record: Record) -> float:
    """Compute the normalised mean square error of an identified force.

    It is the mean square of the difference of both stiffness forces (v = 0) over the variance of the true one, at the
    elongations of a record: the true ones of a simulated record, those of the displacements of a measured one.

    Parameters
    ----------
    true : Link
        The link with its true law.
    estimated : Link
        The link with the identified law.
    record : Record
        The motion over which both are compared.

    Returns
    -------
    float
        The error in %.

    Raises
    ------
    RecordError
        If an end of the link has no displacement in the record, or the true force does not vary.

    References
    ----------
    The paper, Eq. 8.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> weaker = lw.bnes_chain(2, alpha=-99.0)
    >>> bool(0.0 < lw.nmse(chain.link("nes1"), weaker.link("nes1"), record) < 0.1)
    True
    """
    d = _elongation(true, record)
    refuse_memory([true, estimated], "errors of forces over d")
    force = true.force(d)
    variance = float(np.var(force))
    if variance == 0.0:
        raise RecordError(
            f'the true force of link "{true.name}" does not vary over the record, so no relative error exists'
        )
    return float(100.0 * np.mean((force - estimated.force(d)) ** 2) / variance)


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
