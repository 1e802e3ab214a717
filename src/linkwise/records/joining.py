"""Records of instruments that were started together, as one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.errors import RecordError
from linkwise.records.record import Record

_SAME_RATE = 1e-6


def beside(record: Record, other: Record) -> Record:
    """Add the channels of a record that was started together with another.

    Sample is set beside sample from the first one on; what the longer record has more is left out. A delay between the
    instruments, of a part of a sample or more, is found by the diagnosis of `identify` and taken out by `without_delays`.

    Parameters
    ----------
    record : Record
        The record.
    other : Record
        Another one, with other channels and the same sampling rate.

    Returns
    -------
    Record
        The record with the channels of both, and the time of the first.

    Raises
    ------
    RecordError
        If rates differ, or both have a channel of the same name.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> lw.beside(record.select(["x:m1"]), record.select(["x:m2"]))
    Record of 501 samples at 1000 Hz, 0 to 0.5 s: x:m1, x:m2
    """
    if abs(record.rate - other.rate) > _SAME_RATE * record.rate:
        raise RecordError(
            f"records that are set beside each other need one sampling rate, got {record.rate:g} and {other.rate:g} Hz"
        )
    common = [name for name in other.channels if name in record.channels]
    if common:
        raise RecordError("is in both records that are set beside each other", channel=common[0])
    length = min(len(record), len(other))
    return replace(
        record,
        channels=(*record.channels, *other.channels),
        values=np.hstack([record.values[:length], other.values[:length]]),
        noise={**record.noise, **other.noise},
        interpolation={**record.interpolation, **other.interpolation},
        units={**record.units, **other.units},
        uncertainty={**other.uncertainty, **record.uncertainty},
        simulated=None,
        notes=tuple(dict.fromkeys((*record.notes, *other.notes))),
    )
