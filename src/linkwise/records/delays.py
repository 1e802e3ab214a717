"""Channels that show everything late: their delays taken out by band-limited interpolation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite

import numpy as np

from linkwise.argument_types import checked
from linkwise.errors import RecordError
from linkwise.model.input_signal import Sampled
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_BAND_LIMITED = 64  # samples from which a windowed sinc interpolates accurately


@checked
def without_delays(record: Record, delays: Mapping[str, float]) -> Record:
    """Take known delays out of channels.

    Parameters
    ----------
    record : Record
        The record.
    delays : mapping of str to float
        By channel the time in s by which it is late; negative for one that is early.

    Returns
    -------
    Record
        The record on its own clock, cut where a shifted channel has no samples. Interpolation between samples needs motions
        below half the sampling rate.

    Raises
    ------
    RecordError
        If a channel is not in the record or has missing samples, or a delay is not finite or longer than the record.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> lw.without_delays(record, {"x:m1": 0.0025})
    Record of 498 samples at 1000 Hz, 0 to 0.497 s: x:m1, x:m2
    """
    values, first, last = record.values.copy(), 0, len(record)
    for name, delay in delays.items():
        samples = record.channel(name)
        if not isfinite(delay) or abs(delay) >= record.duration:
            raise RecordError(
                f"a delay must be shorter than the record of {record.duration:g} s, got {delay:g} s",
                channel=name,
            )
        if np.isnan(samples).any():
            raise RecordError("samples are missing, and a delay cannot be taken out of gaps", channel=name)
        signal = Sampled(0.0, record.rate, samples, band_limited=len(samples) > _BAND_LIMITED)
        late = np.arange(len(record)) / record.rate + delay
        values[:, record.channels.index(name)] = signal.value(np.clip(late, 0.0, signal.end))
        first = max(first, int(np.ceil(-delay * record.rate)))
        last = min(last, len(record) - int(np.ceil(delay * record.rate)))
    if not delays:
        return record
    if last <= first:
        raise RecordError("the delays leave no sample that all channels have")
    listed = ", ".join(f"{delay:g} s in {Channel.parse(name)}" for name, delay in delays.items())
    note = f"Delays were taken out: {listed}. One that is found with the laws is what is left beside it."
    moved = replace(record, values=values, notes=(*record.notes, note))
    return moved[first:last]
