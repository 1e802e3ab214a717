"""Several records as one, or taken together: side by side, by time, one after the other, each a measurement of its own,
without known delays.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError, expect
from linkwise.records.channel import OF_CHANNELS, ClippedSamples, interpolated
from linkwise.records.record import Record


def without_delays(
    record: Record, delays: Mapping[str, float], *, clocks: Mapping[str, float] = MappingProxyType({})
) -> Record:
    """Take known delays out of channels, and known ratios of their clocks.

    Parameters
    ----------
    record : Record
        The record.
    delays : mapping of str to float
        By channel the time in s by which it is late; negative for one that is early.
    clocks : mapping of str to float, optional
        By channel the ppm by which the clock of its device runs fast: it is late by as much of the time from the middle of the
        record, beside its delay.

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
    >>> lw.records.without_delays(record, {"x:m1": 0.0025})
    Record of 498 samples at 1000 Hz, 0 to 0.497 s: x:m1, x:m2
    """
    values, first, last = record.values.copy(), 0, len(record)
    for name in dict.fromkeys((*delays, *(name for name, ratio in clocks.items() if ratio))):
        delay, slip = delays.get(name, 0.0), 0.5e-6 * clocks.get(name, 0.0) * record.duration
        samples = record.channel(name)
        if not isfinite(delay) or abs(delay) >= record.duration:
            message = f"a delay must be shorter than the record of {record.duration:g} s, got {delay:g} s"
            raise RecordError(message, channel=name)
        if np.isnan(samples).any():
            raise RecordError("samples are missing, and a delay cannot be taken out of gaps", channel=name)
        signal = interpolated(0.0, record.rate, samples)
        late = np.arange(len(record)) / record.rate + delay + slip * np.linspace(-1.0, 1.0, len(record))
        values[:, record.channels.index(name)] = signal.value(np.clip(late, 0.0, signal.end))
        first = max(first, int(np.ceil((slip - delay) * record.rate)))
        last = min(last, len(record) - int(np.ceil((slip + delay) * record.rate)))
    if not delays and not any(clocks.values()):
        return record
    if last <= first:
        raise RecordError("the delays leave no sample that all channels have")
    taken = [f"{delay:g} s in {name}" for name, delay in delays.items()]
    taken += [f"{ratio:g} ppm in the clock of {name}" for name, ratio in clocks.items() if ratio]
    note = f"Delays were taken out: {', '.join(taken)}. One that is found with the laws is what is left beside it."
    moved = replace(record, values=values, notes=(*record.notes, note))
    return moved[first:last]


def record_list(records: Record | Iterable[Record], argument: str) -> list[Record]:
    """The records of a public function that takes one or several; raises `ArgumentTypeError` for what is no record."""
    if isinstance(records, Record):
        return [records]
    if isinstance(records, str | Mapping) or not isinstance(records, Iterable):
        expect(argument, records, Record)
    listed = list(records)
    for number, record in enumerate(listed):
        expect(f"{argument}[{number}]", record, Record)
    return listed


def check_distinct(records: Sequence[Record]) -> None:
    """Raise RecordError if two records are the same measurement, which would halve the variance of every estimate.

    Two are the same if they hold the same samples in all responses that both have, and have as many samples.
    """
    for (first, first_record), (second, second_record) in combinations(enumerate(records, start=1), 2):
        shared = [name for name in first_record.responses if name in second_record.responses]
        pairs = ((first_record.channel(name), second_record.channel(name)) for name in shared)
        if shared and all(np.array_equal(*pair, equal_nan=True) for pair in pairs):
            source = f" ({first_record.source})" if first_record.source else ""
            message = f"records {first} and {second}{source} hold the same samples; give each record once"
            raise RecordError(message)


def joined_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """The notes of all records, each once."""
    return tuple(dict.fromkeys(note for record in records for note in record.notes))


_LARGEST = 10.0  # times the root mean square of samples that hold the noise: chance does not make it twice


def check_stated_noise(records: Sequence[Record]) -> None:
    """Raise RecordError where the noise stated of a response is far more than its samples, which hold it, could be."""
    for record in records:
        for name in set(record.noise).intersection(record.responses):
            samples = record.channel(name)
            samples = samples[np.isfinite(samples)]
            size, sigma = float(np.sqrt(np.mean(samples**2))) if len(samples) else 0.0, record.noise[name]
            if 0.0 < size < sigma / _LARGEST:
                unit = record.unit(name)
                raise RecordError(
                    f"its noise is stated as {sigma:g} {unit}, but its samples, which hold that noise, have a root mean "
                    f"square of {size:.3g} {unit}; check the number and its unit",
                    channel=name,
                )


_SAME_RATE = 1e-6
_ALIGNED = 1e-3  # of a step: clocks that agree to this need no interpolation
_OFF_GRID = 0.02  # of a step: how far off the times of a record the next part of it may go on


def beside(record: Record, other: Record) -> Record:
    """Add the channels of a record that was started together with another.

    Sample is set beside sample from the first one on; what the longer record has more is left out. Where times that overlap
    say otherwise, a note tells that they were not used (`joined_by_time` uses them). A delay between the
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
    >>> lw.records.beside(record.select(["x:m1"]), record.select(["x:m2"]))
    Record of 501 samples at 1000 Hz, 0 to 0.5 s: x:m1, x:m2
    """
    _require_same_rate(record, other, "records that are set beside each other")
    _refuse_common(record, other)
    joined = _side_by_side(record, other)
    late = other.start - record.start
    if not 1.5 / record.rate < abs(late) < min(record.duration, other.duration):
        return joined
    note = (
        f"{', '.join(other.channels)}: by the times of both records they start {abs(late):.6g} s "
        f"{'later' if late > 0.0 else 'earlier'} than {', '.join(record.channels)}; samples were set beside each other from "
        "the first one on, as of instruments that were started together, not by these times."
    )
    return replace(joined, notes=(*joined.notes, note))


def joined_by_time(record: Record, other: Record) -> Record:
    """Add the channels of a record with the same clock, by the times of the samples.

    Of two rates the higher is reduced to the lower by a whole factor, and samples between those of the first record are
    interpolated as band-limited, which leaves white noise white.

    Parameters
    ----------
    record : Record
        The record.
    other : Record
        Another one, with other channels, over times that overlap with those of the first.

    Returns
    -------
    Record
        The channels of both over the times that both have.

    Raises
    ------
    RecordError
        If both have a channel of the same name, times do not overlap, the one rate is no multiple of the other, or samples are
        missing where they must be interpolated.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> lw.records.joined_by_time(record.select(["x:m1"]), record.select(["x:m2"])[100:])
    Record of 401 samples at 1000 Hz, 0.1 to 0.5 s: x:m1, x:m2
    """
    _refuse_common(record, other)
    slower, faster = sorted((record.rate, other.rate))
    factor = round(faster / slower)
    if abs(factor * slower / faster - 1.0) > _SAME_RATE:
        raise RecordError(
            f"records that are joined need rates of which one is a multiple of the other, got {record.rate:g} and "
            f"{other.rate:g} Hz: resample one of them before"
        )
    if record.rate > other.rate:
        record = record.decimate(factor)
    else:
        other = other.decimate(factor)
    shift = (other.start - record.start) * record.rate
    part = round(shift) - shift
    if abs(part) > _ALIGNED:
        step = part / record.rate
        moved = without_delays(other, dict.fromkeys(other.channels, step))
        other = replace(moved, start=moved.start + step, notes=other.notes)
    first = round((other.start - record.start) * record.rate)
    last = min(len(record), first + len(other))
    if last <= max(first, 0):
        raise RecordError(
            f"does not overlap in time with the first file: {_span(record)} and {_span(other)}; instruments that were started "
            "together are joined from their first samples on (beside)",
            other.source or None,
        )
    start = max(first, 0)
    overlap = _side_by_side(record[start:last], other[start - first : last - first])
    return replace(overlap, notes=(*overlap.notes, f"{', '.join(other.channels)} were joined by time."))


def continued(record: Record, other: Record) -> Record:
    """Join two parts of one record that were measured one after the other.

    Parameters
    ----------
    record, other : Record
        The parts, with the same channels and the same clock. A clock that begins anew in the second part says nothing of a
        gap: that part then follows at the next sample, with a note.

    Returns
    -------
    Record
        Both, with missing samples between them where there is a gap.

    Raises
    ------
    RecordError
        If channels, rates, or what both state of a channel differ, the parts overlap, the second does not go on at a time of
        the first, or the gap is longer than both.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> lw.records.continued(record[:200], record[210:])
    Record of 501 samples at 1000 Hz, 0 to 0.5 s: x:m1, x:m2; 20 samples missing
    """
    if set(record.channels) != set(other.channels):
        message = f"the parts of a record need the same channels: {', '.join(record.channels)} and {', '.join(other.channels)}"
        raise RecordError(message, other.source or None)
    _require_same_rate(record, other, "the parts of a record")
    for kind, attribute in OF_CHANNELS.items():
        first, second = getattr(record, kind), getattr(other, kind)
        for name in () if attribute.of_samples else first:
            if name in second and first[name] != second[name]:
                raise RecordError(
                    f"states another {attribute.label} of its sensor than the first part of the record; state the same of "
                    "both, for instance in a mapping file",
                    other.source or None,
                    channel=name,
                )
    exact = (other.start - record.start) * record.rate - len(record)
    following = other.select(record.channels).values
    if anew := _begins_anew(record, other, following):
        exact = 0.0
    gap = round(exact)
    if gap < 0:
        raise RecordError(f"overlaps in time: {_span(record)} and {_span(other)}", other.source or None)
    if abs(exact - gap) > _OFF_GRID:
        raise RecordError(
            f"goes on {exact / record.rate:.6g} s after {_span(record)}, which is not a whole number of steps of "
            f"{record.step:.6g} s: identify from the two as records of their own",
            other.source or None,
        )
    if gap > len(record) + len(other):
        raise RecordError(
            f"begins {gap / record.rate:.6g} s after {_span(record)}, a gap longer than both parts: identify from the two as "
            "records of their own",
            other.source or None,
        )
    clipped = {}
    for name in dict.fromkeys((*record.clipped, *other.clipped)):
        before, after = (
            part.clipped.get(name) or ClippedSamples(part.channel(name), *np.full((2, len(part)), np.nan))
            for part in (record, other)
        )
        clipped[name] = before.followed_by(after, gap)
    missing = np.full((gap, len(record.channels)), np.nan)
    after_gap = f", after a gap of {gap} samples" if gap else ""
    note = f"The record continues in {other.source or 'a second part'}{anew}{after_gap}."
    return replace(
        record,
        values=np.vstack([record.values, missing, following]),
        **_stated_by_both(record, other),
        clipped=clipped,
        simulated=None,
        notes=(*joined_notes((record, other)), note),
    )


def _begins_anew(record: Record, other: Record, following: Floats) -> str:
    """A remark on a part with the samples `following` whose clock begins as the first one did; a copy has none."""
    is_copy = np.array_equal(record.values[: len(other)], following, equal_nan=True)
    if is_copy or abs(other.start - record.start) >= record.step:
        return ""
    return (
        f", whose clock begins anew at {other.start:.6g} s: its first sample was taken to follow the last one before; if any "
        "were lost in between, identify from the two as records of their own"
    )


def _span(record: Record) -> str:
    return f"{record.start:.6g} to {record.start + record.duration:.6g} s"


def _refuse_common(record: Record, added: Record) -> None:
    common = [name for name in added.channels if name in record.channels]
    if common:
        raise RecordError("is in both records that are joined", channel=common[0])


def _require_same_rate(record: Record, added: Record, subject: str) -> None:
    if abs(record.rate - added.rate) > _SAME_RATE * record.rate:
        raise RecordError(f"{subject} need one sampling rate, got {record.rate:g} and {added.rate:g} Hz")


def _side_by_side(record: Record, added: Record) -> Record:
    length = min(len(record), len(added))
    parts = [(name, clipped) for part in (record, added) for name, clipped in part.clipped.items()]
    return replace(
        record,
        channels=(*record.channels, *added.channels),
        values=np.hstack([record.values[:length], added.values[:length]]),
        **_stated_by_both(record, added),
        clipped={name: clipped.rows(slice(length)) for name, clipped in parts},
        simulated=None,
        notes=joined_notes((record, added)),
    )


def _stated_by_both(record: Record, added: Record) -> dict[str, Any]:
    """The attributes of channels of either, by field of `Record`."""
    stated = (kind for kind, attribute in OF_CHANNELS.items() if not attribute.of_samples)
    return {kind: {**getattr(added, kind), **getattr(record, kind)} for kind in stated}


def labels(records: Sequence[Record], kind: str = "record") -> tuple[str, ...]:
    """A name for each record: its source, or its kind and number where it has none or shares it."""
    sources = [record.source for record in records]
    return tuple(
        source if source and sources.count(source) == 1 else f"{kind} {number}"
        for number, source in enumerate(sources, start=1)
    )
