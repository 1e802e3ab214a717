"""Inspection of records before any model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from linkwise.argument_types import checked
from linkwise.errors import RecordError
from linkwise.inspection import text as _text  # noqa: F401  registers how an inspection prints itself
from linkwise.inspection.alert import Alert
from linkwise.inspection.checks import CHECKS
from linkwise.inspection.record_signals import RecordSignals
from linkwise.inspection.result import ChannelSummary, Inspection, labels
from linkwise.inspection.summary import summary
from linkwise.records.record import Record
from linkwise.records.sequence import record_list


@checked
def inspect(records: Record | Sequence[Record]) -> Inspection:
    """Look at the channels of records before any model.

    Parameters
    ----------
    records : Record or sequence of Record
        One record or several.

    Returns
    -------
    Inspection
        What each channel holds, and alerts of what is wrong with it, worst first.

    Raises
    ------
    RecordError
        If there is no record.
    TypeError
        If something else is given.

    Notes
    -----
    An alert says that something is wrong, the lack of one that nothing was seen. An error of gain in a channel without another
    one at the same mass, or of all channels alike, cannot be seen without a model.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> x = record.channel("x:m1")
    >>> clipped = {"x:m1": np.clip(x, -0.8 * x.max(), 0.8 * x.max()), "x:m2": record.channel("x:m2")}
    >>> found = lw.inspect(lw.Record.from_arrays(record.time, clipped))
    >>> [(alert.kind, alert.channel) for alert in found.alerts]
    [('clipped', 'x:m1')]
    """
    given = tuple(record_list(records, "records"))
    if not given:
        raise RecordError("there is no record to inspect")
    alerts: list[Alert] = []
    channels: list[ChannelSummary] = []
    for record, label in zip(given, labels(given), strict=True):
        signals = RecordSignals.of(record)
        channels += [summary(signal, label) for signal in signals.channels]
        alerts += [replace(alert, record=label) for check in CHECKS.values() for alert in check(signals)]
    worst_first = sorted(alerts, key=lambda alert: -alert.error)
    return Inspection(given, tuple(channels), tuple(worst_first))
