"""Inspection of records before any model, by a table of checks: a new one is a function and a line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from linkwise.errors import RecordError
from linkwise.inspection.channel_signal import ChannelSignal, RecordSignals
from linkwise.inspection.levels.quantities import labels
from linkwise.inspection.relations import delay, drift, drift_at_rest, gain, offset, offset_at_rest
from linkwise.inspection.result import Alert, ChannelSummary, Inspection
from linkwise.inspection.samples import (
    clipped,
    dead,
    doubled,
    dropped,
    equal,
    lost,
    quantised,
    spikes,
    without_spikes,
)
from linkwise.inspection.spectra import aliasing, coloured, few_samples, hum, short, unit
from linkwise.records.joining import record_list
from linkwise.records.record import Record
from linkwise.registry import Registry

Check = Callable[[RecordSignals], Iterable[Alert]]

CHECKS: Registry[Check] = Registry(
    "check",
    {
        "dead": dead,
        "equal": equal,
        "unit": unit,
        "clipped": clipped,
        "dropped": dropped,
        "lost": lost,
        "doubled": doubled,
        "quantised": quantised,
        "spikes": spikes,
        "delay": delay,
        "gain": gain,
        "offset": offset,
        "offset at rest": offset_at_rest,
        "drift": drift,
        "drift at rest": drift_at_rest,
        "hum": hum,
        "aliasing": aliasing,
        "coloured": coloured,
        "few-samples": few_samples,
        "short": short,
    },
)
"""Functions of the signals of a record that give alerts."""


_LARGEST_RATIO = 1e12  # of motion to noise: below it lies the rounding of numbers


def summary(signal: ChannelSignal, record: str) -> ChannelSummary:
    """The summary of a channel of the record that is labelled `record`."""
    values = signal.observed
    span = float(values.max() - values.min()) if values.size else 0.0
    noise = None if np.isnan(signal.sigma) or signal.is_constant else float(signal.sigma)
    motion = None if noise is None else float(np.mean(values**2)) - noise**2
    audible = noise is not None and noise > signal.rms / _LARGEST_RATIO and motion is not None and motion > 0
    highest = None if signal.is_constant else without_spikes(signal).highest or None
    return ChannelSummary(
        name=signal.channel,
        unit=signal.unit,
        record=record,
        samples=len(values),
        missing=len(signal.values) - len(values),
        rate=signal.rate,
        minimum=float(values.min()) if values.size else None,
        maximum=float(values.max()) if values.size else None,
        rms=signal.rms if values.size else None,
        noise=noise,
        snr_db=float(10.0 * np.log10(motion / noise**2)) if audible and noise and motion else None,
        step=signal.step or None,
        bits=float(np.log2(span / signal.step + 1.0)) if signal.step else None,
        highest_frequency=highest,
        samples_per_period=None if highest is None else signal.rate / highest,
    )


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
    given = tuple(record_list(records, "inspect(records): records"))
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
