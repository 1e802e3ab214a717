"""Inspection of records before any model, by a table of checks: a new one is a function and a line. Samples that show a fault
of the sensor or the logger in place of the motion are marked as missing; other alerts are left to an answer to allow for.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from linkwise.arrays import Bools, Floats, stretches
from linkwise.errors import RecordError
from linkwise.inspection.channel_faults import delay, drift, drift_at_rest, gain, offset, offset_at_rest
from linkwise.inspection.channel_signal import ChannelSignal, RecordSignals
from linkwise.inspection.result import Alert, ChannelSummary, Inspection
from linkwise.inspection.sample_faults import (
    BUFFER,
    clipped,
    clipped_readings,
    clipped_samples,
    copied,
    copies,
    dead,
    doubled,
    dropped,
    equal,
    long_stays,
    lost,
    may_be_copied,
    quantised,
    spiked_samples,
    spikes,
    without_spikes,
)
from linkwise.inspection.spectrum_faults import aliasing, coloured, few_samples, hum, short, unit
from linkwise.records.channel import ClippedSamples
from linkwise.records.joining import labels, record_list
from linkwise.records.record import Record
from linkwise.registry import Registry

Check = Callable[[RecordSignals], Iterable[Alert]]

CHECKS: tuple[Check, ...] = (
    dead, equal, unit, clipped, dropped, lost, doubled, copied, quantised, spikes, delay, gain, offset, offset_at_rest, drift,
    drift_at_rest, hum, aliasing, coloured, few_samples, short,
)  # fmt: skip
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
        alerts += [replace(alert, record=label) for check in CHECKS for alert in check(signals)]
    worst_first = sorted(alerts, key=lambda alert: -alert.error)
    return Inspection(given, tuple(channels), tuple(worst_first))


FAULTY_SAMPLES: Registry[Callable[[ChannelSignal], Bools]] = Registry(
    "fault of samples", {"clipped": clipped_samples, "spikes": spiked_samples}, RecordError
)
"""Functions of the signal of a channel that give which of its samples (N,) have the fault."""

_MARKED = "samples were marked as missing"


def mark_missing(record: Record, faults: str | Sequence[str] = ("clipped", "spikes")) -> Record:
    """Mark samples that show a fault in place of the motion as missing.

    Other estimators than maximum likelihood use the samples that are left. Maximum likelihood takes clipped samples as
    bounds: their probability is that of a reading at the end of the range or beyond. Neither pulls stiffness and damping.

    Parameters
    ----------
    record : Record
        The record.
    faults : str or sequence of {"clipped", "spikes"}, optional
        Which samples: those at an end of the range of a sensor that was overloaded, with those beside them that noise alone
        may have held inside, and single samples far from their neighbours; both as `inspect` sees them, which needs several
        samples at the end of the range.

    Returns
    -------
    Record
        The record with these samples of its responses missing and a note of how many; `record` itself where there are none.
        Inputs stay as they are: what moves the structure must be known at all times. Clipped readings are kept beside the
        channels, `Record.clipped`, until these are changed; not where a sensor stays at an end for longer than two periods of
        the motion, as it does while it recovers from an overload, of which a note says when.

    Raises
    ------
    RecordError
        If a fault is not one of those.

    See Also
    --------
    inspect : What is wrong with the channels of a record.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> x = record.channel("x:m1")
    >>> peak = 0.8 * np.abs(x).max()
    >>> overloaded = {"x:m1": np.clip(x, -peak, peak), "x:m2": record.channel("x:m2")}
    >>> lw.inspection.mark_missing(lw.Record.from_arrays(record.time, overloaded)).notes
    ('x:m1: 49 samples were marked as missing (clipped).',)
    """
    names = (faults,) if isinstance(faults, str) else tuple(faults)
    functions = {name: FAULTY_SAMPLES.lookup(name) for name in names}
    values, notes = record.values.copy(), []
    clipped: dict[str, ClippedSamples] = {}
    for signal in RecordSignals.of(record).responses:
        column = record.channels.index(signal.channel)
        marked = {name: faulty for name, of in functions.items() if (faulty := of(signal)).any()}
        for name, faulty in marked.items():
            values[faulty, column] = np.nan
            notes.append(f"{signal.channel}: {int(faulty.sum())} {_MARKED} ({name}).")
        stays = long_stays(signal, marked.get("clipped", np.zeros(0, dtype=bool)))
        notes += [_why_no_bounds(signal, stay) for stay in stays]
        if (beyond := _clipped_samples(record, signal, marked, values[:, column].copy(), stays)) is not None:
            clipped[signal.channel] = beyond
    if not notes:
        return record
    return replace(record, values=values, notes=(*record.notes, *notes), clipped=clipped)


def _why_no_bounds(signal: ChannelSignal, stay: slice) -> str:
    first, last = (signal.start + number / signal.rate for number in (stay.start, stay.stop - 1))
    return (
        f"{signal.channel}: its readings at the end of the range from {first:.6g} s to {last:.6g} s tell nothing of the "
        "motion: they stay there for longer than two of its periods, as those of a sensor that recovers from an overload."
    )


def _clipped_samples(
    record: Record,
    signal: ChannelSignal,
    marked: Mapping[str, Bools],
    samples: Floats,
    stays: Sequence[slice],
) -> ClippedSamples | None:
    """What a channel, of which `samples` (N,) are left, read where it was clipped; spikes that were clipped tell nothing."""
    before = record.clipped.get(signal.channel)
    before = None if before is None else before.of(signal.values)
    if "clipped" not in marked:
        return None if before is None else replace(before, samples=samples)
    telling = marked["clipped"] & ~spiked_samples(signal)
    for stay in stays:
        telling[stay] = False
    readings, sides = clipped_readings(signal, telling)
    if before is not None:
        old = np.isfinite(before.readings)
        readings, sides = np.where(old, before.readings, readings), np.where(old, before.sides, sides)
    return ClippedSamples(samples, readings, sides) if np.isfinite(readings).any() else None


def without_copies(record: Record) -> tuple[list[Record], dict[str, list[slice]]]:
    """The parts of a record before and behind samples that were there before, and which these are, by response."""
    repeated = any(may_be_copied(record.channel(name)) for name in record.responses)
    signals = RecordSignals.of(record).responses if repeated else ()
    there: dict[str, list[slice]] = {
        signal.channel: [copy for _, copy in found] for signal in signals if (found := copies(signal))
    }
    again = np.zeros(len(record), dtype=bool)
    for copy in chain.from_iterable(there.values()):
        again[copy] = True
    parts = [part for part in stretches(~again) if part.stop - part.start > BUFFER]
    return [record[part] for part in parts] if there else [record], there


def marked_samples(record: Record) -> dict[str, int]:
    """How many samples `mark_missing` marked, by the channels of which it marked any, as the notes of the record say."""
    counts: dict[str, int] = {}
    for note in record.notes:
        channel, _, rest = note.rpartition(": ")
        if _MARKED in rest and channel in record.channels:
            counts[channel] = counts.get(channel, 0) + int(rest.split()[0])
    return counts


# turns by which a stated hum may differ from the line at the end of a record: a tone beside it leaves most of the line
_TURN = 0.25
_TOLD = 0.01  # Hz to which an alert names the line


class EstimatedError(NamedTuple):
    """An error of a sensor that is estimated with the coefficients.

    Attributes
    ----------
    kind : str
        As of an `Alert`.
    channel : str
        The channel.
    frequency : float or None
        In Hz, of a hum.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.inspection.EstimatedError("hum", "a:m1", 50.0).frequency
    50.0
    """

    kind: str
    channel: str
    frequency: float | None = None


def unanswered_alerts(
    records: Sequence[Record], estimated: Collection[EstimatedError] = ()
) -> tuple[Alert, ...]:
    """Alerts of records, as of `inspect`, that an answer does not allow for, worst first: neither those of errors that are
    `estimated` with the coefficients, nor of samples marked as missing.
    """
    of_label = dict(zip(labels(tuple(records)), records, strict=True))
    return tuple(
        alert
        for alert in inspect(records).alerts
        if not _is_answered(alert, of_label[alert.record], estimated)
    )


def _is_answered(alert: Alert, record: Record, estimated: Collection[EstimatedError]) -> bool:
    """Whether what an alert of a record names is estimated, all of its lines where it is a hum, or its channel lacks no more
    samples than were marked as missing.
    """
    channel, near = alert.channel, _TURN / record.duration + _TOLD
    if alert.is_of_gaps and np.isnan(record.channel(channel)).sum() <= marked_samples(record).get(
        channel, -1
    ):
        return True
    stated = [error.frequency for error in estimated if (error.kind, error.channel) == (alert.kind, channel)]
    return bool(stated) and all(
        any(frequency is not None and abs(line - frequency) < near for frequency in stated)
        for line in alert.frequencies
    )
