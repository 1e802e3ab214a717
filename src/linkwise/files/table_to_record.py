"""From a table to a record: assignment of columns to channels, conversion of units, and the sampling times.

Columns are assigned by the mapping of the user first, and then by their headers; a first mapping file guesses quantities from
units and names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.display import near_miss
from linkwise.errors import RecordError
from linkwise.files.mapping import RecordMapping, statement_of
from linkwise.files.table import Column, ColumnHeader, Table, si_factor
from linkwise.records.channel import BASE, COMMON, Channel, ClippedSamples, si_unit
from linkwise.records.record import Record
from linkwise.records.sample_checks import Rows, check_rate
from linkwise.records.sensor_statement import SensorStatement, StatedError, with_statements
from linkwise.records.timeline import JITTER, resample_evenly, sampled_columns

_SHOWN = 12  # columns listed in an error or a note


@dataclass(frozen=True)
class ColumnChoice:
    """Column number `column` (from 0) holds `name`, which is "time" or a channel, in `unit` ("" for SI)."""

    channel: Channel | None
    column: int
    unit: str

    @property
    def name(self) -> str:
        """The name of the channel, or "time"."""
        return self.channel or "time"

    @property
    def kind(self) -> str:
        """The kind of the channel, or "time"."""
        return self.channel.kind if self.channel else "time"


def choose(
    table: Table, channels: Mapping[str, str | int], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns of the record; see `files.read_record` for `channels` and `known_masses`.

    Raises RecordError for an invalid mapping, a channel that occurs twice, an unknown mass, and a table without channels.
    """
    given = mapped(table, channels)
    chosen = (*given, *recognised(table, given, known_masses))
    if all(choice.name == "time" for choice in chosen) and not table.named:
        raise table.error(
            f"there is no header: the file starts with {table.opening!r}. The first line must name the columns, as in "
            "`time,x:m1,x:m2`; or map columns by number, as in channels={'time': 1, 'x:m1': 2}",
            "channels",
            line=1,
        )
    if all(choice.name == "time" for choice in chosen):
        raise table.error(
            f"no channel is recognised; {listing(table)}. Channels are named KIND:MASS, such as x:m1 or a:m2[g]; "
            "map columns of other names, as in channels={'x:m1': 'laser'}",
            *("channels", "mapping"),
            line=table.header_line,
        )
    for channel in (choice.channel for choice in chosen if choice.channel and known_masses is not None):
        mass, masses = channel.place, known_masses or ()
        if not channel.at_place or mass in (BASE, *masses):
            continue
        near = get_close_matches(mass, masses, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}? " if near else ""
        message = f"the structure has no mass {mass!r}; {hint}it has {_listed_names(list(masses)) or 'none'}"
        raise table.error(message, "known_masses", line=table.header_line, channel=channel)
    return chosen


IGNORED = "Columns that are not channels were ignored: "


def ignored(table: Table, chosen: tuple[ColumnChoice, ...]) -> list[str]:
    """A note on the columns that are not used."""
    used = {choice.column for choice in chosen}
    unused = []
    for column in (own for i, own in enumerate(table.columns) if i not in used and own.header):
        remark = column.instead or _other_spelling(column)
        unused.append(f"{column.header} ({remark})" if remark else column.header)
    return [f"{IGNORED}{_listed_names(unused)}."] if unused else []


def _other_spelling(column: Column) -> str:
    """A question where a header is a channel but for capital letters, as "Force:m1" is; such a force must not go unseen."""
    leaf = ColumnHeader.parse(column.header).leaf
    kind, colon, mass = leaf.name.rpartition(":")
    meant = ColumnHeader(f"{kind.lower()}{colon}{mass}")
    return f"did you mean {meant.name}?" if leaf.channel is None and meant.channel is not None else ""


def units_over_headers(table: Table, chosen: tuple[ColumnChoice, ...]) -> list[str]:
    """A note for each column whose mapping states another unit than its header does."""
    return [
        f"{choice.name} is taken to be in {choice.unit}, as its mapping states; the header of its column, "
        f"{table.headers[choice.column]}, states {header}."
        for choice in chosen
        if (header := ColumnHeader.parse(table.headers[choice.column]).unit)
        and choice.unit not in ("", header)
    ]


def listing(table: Table) -> str:
    """The columns of the table as a sentence."""
    if not table.named:
        return f"the file has no header and {len(table.columns)} columns, numbered from 1"
    return f"the columns are {_listed_names([header or '(no name)' for header in table.headers])}"


def _listed_names(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def mapped(table: Table, channels: Mapping[str, str | int]) -> tuple[ColumnChoice, ...]:
    """The columns that the user mapped."""
    chosen: dict[str, ColumnChoice] = {}
    for key, column in channels.items():
        header = ColumnHeader.parse(key)
        try:
            channel = None if header.is_time else header.stated_channel()
        except RecordError as error:
            raise table.error(f"in `channels`: {error.message}", "channels") from error
        name = channel or "time"
        if name in chosen:
            raise table.error("is mapped twice in `channels`", "channels", channel=name)
        index = find_column(table, key, column)
        unit = header.unit or ColumnHeader.parse(table.headers[index]).unit
        chosen[name] = ColumnChoice(channel, index, unit)
    return tuple(chosen.values())


def find_column(table: Table, key: str, column: str | int) -> int:
    """Index of a column given by its header, its header without unit, the last part of its path, or its number from 1."""
    wanted = str(column).strip()
    headers = [ColumnHeader.parse(header) for header in table.headers]
    for names in (
        list(table.headers),
        [header.name for header in headers],
        [header.leaf.name for header in headers],
        [column.path for column in table.columns],
    ):
        if (times := names.count(wanted)) > 1:
            message = f"{key} is mapped to {wanted!r}, the name of {times} columns; give the number of the column instead"
            raise table.error(message, "channels")
        if wanted in names:
            return names.index(wanted)
    if wanted.isdecimal() and 1 <= int(wanted) <= len(table.columns):
        return int(wanted) - 1
    message = f"{key} is mapped to column {wanted!r}, which does not exist{near_miss(wanted, table.headers)}; {listing(table)}"
    raise table.error(
        message, *(("channels",) if table.lines is None else ("channels", "header")), line=table.header_line
    )


def recognised(
    table: Table, mapped: tuple[ColumnChoice, ...], known_masses: tuple[str, ...] | None
) -> tuple[ColumnChoice, ...]:
    """The columns whose headers name a channel or the time, except what the user has mapped."""
    mapped_names = {choice.name for choice in mapped}
    used = {choice.column for choice in mapped}
    recognised: dict[str, ColumnChoice] = {}
    for index, column in enumerate(table.columns):
        header = _meant_header(column, known_masses)
        if header is None or index in used:
            continue
        channel = None if header.is_time else header.channel
        name = channel or "time"
        if name in mapped_names:
            continue
        if name in recognised:
            first, second = table.columns[recognised[name].column].header, column.header
            paths = f" ({first} and {second})" if first != second else ""
            raise table.error(
                f"columns {recognised[name].column + 1} and {index + 1} both have this name{paths}; rename one, "
                "or map the channel to one of them (`channels`)",
                "channels",
                line=table.header_line,
                channel=name,
            )
        recognised[name] = ColumnChoice(channel, index, header.unit)
    return tuple(recognised.values())


def _meant_header(column: Column, known_masses: tuple[str, ...] | None) -> ColumnHeader | None:
    """The header that a column stands for; None for a column that names neither a channel nor the time.

    A spelling that only resembles a channel (`a_1` in MATLAB) does not count if it would name an unknown mass.
    """
    leaf = ColumnHeader.parse(column.header).leaf
    if leaf.is_time or leaf.channel is not None:
        return leaf
    meant = ColumnHeader(column.meaning, leaf.unit)
    if meant.channel is None:
        return None
    if known_masses is None:
        return None if column.instead else meant
    return meant if meant.channel.place in (*known_masses, BASE) else None


_OVERLOAD, _NO_NUMBER = 9.899e37, 9.911e37
"""Around 9.9e37, infinity to instruments, and 9.91e37, which is no number to them (SCPI-99, volume 1, numeric data)."""


def to_record(
    table: Table, mapping: RecordMapping, known_masses: tuple[str, ...] | None, *, informative: bool
) -> Record:
    """The record in a table, see `files.read_record`; RecordError names file, line and channel."""
    chosen = choose(table, mapping.channels, known_masses)
    columns = {choice.channel: _in_si(table, choice) for choice in chosen if choice.channel}
    columns, sides, overloads = _without_overloads(table, columns)
    notes = [*table.notes, *ignored(table, chosen), *units_over_headers(table, chosen), *overloads]
    time_column = next((choice for choice in chosen if choice.name == "time"), None)
    if time_column is not None and mapping.rate is not None:
        notes.append(f"The time column was ignored in favour of the given rate of {mapping.rate:g} Hz.")
        time_column = None
    time = None if time_column is None else _in_si(table, time_column)
    count = len(next(iter(columns.values())))
    (start, rate), times, rows = *_grid(table, time, mapping.rate, count), table.rows
    if mapping.resample is not None:
        rate = mapping.resample
        start, columns, note = resample_evenly(times, columns, rate, rows)
        notes.append(note)
        times, rows, sides = start + np.arange(len(next(iter(columns.values())))) / rate, Rows(table.file), {}
    timeline, values, remarks = sampled_columns(times, columns, rows, informative=informative)
    stated, unread = _statements(table, chosen, mapping)
    stored: dict[str, Any] = {
        kind: {name: value for name, value in of_channels.items() if name in columns}
        for kind, of_channels in table.stored.items()
    }
    record = Record(
        timeline.start if rate is None else start,
        rate or timeline.rate,
        tuple(columns),
        values,
        source=table.source or table.file,
        notes=(*notes, *remarks, *unread),
        units={
            choice.name: choice.unit if choice.kind == "state" else si_unit(choice.unit, choice.kind)
            for choice in chosen
            if choice.unit and choice.channel
        },
        clipped={
            name: _bounds(values[:, tuple(columns).index(name)], timeline.index, side)
            for name, side in sides.items()
        },
        **stored,
    )
    record = with_statements(record, stated, table.file)
    return record if mapping.decimate is None else record.decimate(mapping.decimate)


def _statements(
    table: Table, chosen: tuple[ColumnChoice, ...], mapping: RecordMapping
) -> tuple[dict[str, SensorStatement], tuple[str, ...]]:
    """What the mapping states of the sensors, and what the file states beside it, with remarks on that."""
    stated: dict[str, SensorStatement] = {}
    unread: tuple[str, ...] = ()
    for choice in (choice for choice in chosen if choice.name != "time"):
        attributes, of_file = table.columns[choice.column].attributes, table.sensors.get(choice.name)
        if attributes or of_file:
            of_column, more = statement_of(attributes, choice.name)
            stated[choice.name] = SensorStatement.of(of_file or {}, choice.name, table.file).over(of_column)
            unread += more
    if COMMON in table.sensors:
        stated[COMMON] = SensorStatement.of(table.sensors[COMMON], COMMON, table.file)
    for name, sensor in mapping.sensors.items():
        stated[name] = sensor.over(stated.get(name, SensorStatement()))
    if mapping.calibration is not None:
        general = SensorStatement(gain=StatedError(1.0, mapping.calibration))
        for name in (choice.channel for choice in chosen if choice.channel):
            if not name.is_input:
                stated[name] = stated.get(name, SensorStatement()).over(general)
    return stated, unread


def _grid(
    table: Table, time: NDArray[Any] | None, rate: float | None, count: int
) -> tuple[tuple[float, float | None], NDArray[Any]]:
    """Start in s and rate in Hz of the stated even grid if there is no time column or it agrees, and the times (N,) in s;
    otherwise no rate, and those of the column.
    """
    stated = table.rate if rate is None else rate
    if stated is not None and (rate is not None or 0.0 < stated < np.inf):
        check_rate(float(stated), table.file)
        start = table.start if rate is None else 0.0
        even = start + np.arange(count) / float(stated)
        if time is None or (len(time) == count and np.all(np.abs(time - even) <= JITTER / stated)):
            return (start, float(stated)), even
    if time is not None:
        return (0.0, None), time
    headers = [ColumnHeader.parse(header).leaf for header in table.headers]
    in_seconds = [f", as time={header.name}" for header in headers if header.unit in ("s", "ms")]
    raise table.error(
        f"there is no time column; {listing(table)}. Name it `time` (in s, or `time[ms]`), map a column to it"
        f"{''.join(in_seconds[:1])} (`channels`), or give the sampling rate (`rate`)",
        *("channels", "rate"),
        line=table.header_line,
    )


def _refuse_overloads(table: Table, name: str, values: NDArray[Any]) -> None:
    """Raise RecordError for numbers that instruments write in place of a reading, in whatever unit."""
    overloads = np.flatnonzero((np.abs(values) > _OVERLOAD) & (np.abs(values) < _NO_NUMBER))
    if len(overloads):
        reading = (
            f"the value is {values[overloads[0]]:.3g}, which instruments write for an overload or no reading"
        )
        raise table.rows.error(f"{reading}; leave such cells empty", int(overloads[0]), name)


def _without_overloads(
    table: Table, columns: dict[Channel, NDArray[Any]]
) -> tuple[dict[Channel, NDArray[Any]], dict[Channel, NDArray[Any]], list[str]]:
    """Columns (N,) of a text with NaN where a response is infinite, on which side it is, 0 elsewhere, and notes on these."""
    finite, sides, notes = dict(columns), {}, []
    for name, values in columns.items():
        infinite = np.isinf(values)
        if table.lines is None or name.is_input or not infinite.any() or not np.isfinite(values).any():
            continue
        finite[name] = np.where(infinite, np.nan, values)
        sides[name] = np.where(infinite, np.sign(values), 0.0)
        lowest, highest = np.nanmin(finite[name]), np.nanmax(finite[name])
        notes.append(
            f"{name}: {int(infinite.sum())} samples were marked as missing (infinite, as oscilloscopes write what is out of "
            f"their range; the extreme readings {lowest:.4g} and {highest:.4g} are bounds of the motion there)."
        )
    return finite, sides, notes


def _bounds(samples: NDArray[Any], index: NDArray[np.int64], side: NDArray[Any]) -> ClippedSamples:
    """The largest readings of `samples` (N,) as bounds of those at `index` (M,) that are on a `side` (M,) of them."""
    sides = np.zeros(len(samples))
    sides[index] = side
    readings = np.select([sides > 0.0, sides < 0.0], [np.nanmax(samples), np.nanmin(samples)], np.nan)
    return ClippedSamples(samples, readings, sides)


def numbers(table: Table, choice: ColumnChoice) -> NDArray[Any]:
    """(N,) values of a chosen column in its unit; RecordError where it holds anything but real numbers."""
    column = table.columns[choice.column]
    if column.instead:
        message = f"is {column.instead}, not a row of real numbers; leave the channel out"
        raise table.error(message, line=table.header_line, channel=choice.name)
    if column.values is None:
        advice = "leave the cell of a missing sample empty"
        if choice.name == "time":
            advice = "times are in seconds; for clock times give the sampling rate instead (`rate`)"
        arguments = ("rate",) if choice.name == "time" else ()
        text, line = (column.bad.text, column.bad.line) if column.bad else ("", None)
        if text == column.header:
            advice, arguments = "the header stands there again: keep the lines of one record in the file", ()
        raise table.error(f"{text!r} is not a number; {advice}", *arguments, line=line, channel=choice.name)
    _refuse_overloads(table, choice.name, column.values)
    return column.values


def _in_si(table: Table, choice: ColumnChoice) -> NDArray[Any]:
    """The same in SI units; integers without a unit stay integers, so that a note mentions them."""
    values = numbers(table, choice)
    if not choice.unit:
        return values
    factor = si_factor(choice.unit, choice.kind, file=table.file, line=table.header_line, channel=choice.name)
    values = values.astype(np.float64)
    # 12 mm are 12 / 1000, rounded once; 12 * 1e-3 is rounded twice, and a time in ms would not lie on its grid
    divisor = round(1.0 / factor)
    return values / divisor if factor < 1.0 and 1.0 / divisor == factor else values * factor
