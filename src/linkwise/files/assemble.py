"""From a table to a record: conversion of units, and the sampling times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import RecordError
from linkwise.files.columns import ColumnChoice, choose, ignored, listing, units_over_headers
from linkwise.files.header import si_factor
from linkwise.files.mapping import RecordMapping
from linkwise.files.sensor_attributes import statement_of
from linkwise.files.table import Table
from linkwise.records.channel import check_rate, si_unit
from linkwise.records.record import Record
from linkwise.records.sensor_statement import SensorStatement, StatedError, with_statements
from linkwise.records.sensor_uncertainty import COMMON
from linkwise.records.timeline import JITTER, resample_evenly, sampled_columns

_OVERLOAD, _NO_NUMBER = 9.899e37, 9.911e37
"""Around 9.9e37, infinity to instruments, and 9.91e37, which is no number to them (SCPI-99, volume 1, numeric data)."""


@dataclass(frozen=True)
class ReadOptions:
    """Arguments of `files.read_record`."""

    mapping: RecordMapping
    known_masses: tuple[str, ...] | None = None
    informative: bool = True


@dataclass(frozen=True, eq=False)
class _Grid:
    """Sampling times (N,) in s; `rate` in Hz and `start` in s where the file or the user states an even grid."""

    time: NDArray[Any]
    start: float = 0.0
    rate: float | None = None

    @classmethod
    def even(cls, start: float, rate: float, count: int) -> _Grid:
        """`count` times at `rate` in Hz, the first at `start` in s."""
        return cls(start + np.arange(count) / rate, start, rate)


def to_record(table: Table, file: str, options: ReadOptions) -> Record:
    """The record in a table; RecordError names file, line and channel."""
    mapping = options.mapping
    chosen = choose(table, file, mapping.channels, options.known_masses)
    columns = {choice.channel: _in_si(table, file, choice) for choice in chosen if choice.channel}
    notes = [*table.notes, *ignored(table, chosen), *units_over_headers(table, chosen)]
    time_column = next((choice for choice in chosen if choice.name == "time"), None)
    if time_column is not None and mapping.rate is not None:
        notes.append(f"The time column was ignored in favour of the given rate of {mapping.rate:g} Hz.")
        time_column = None
    time = None if time_column is None else _in_si(table, file, time_column)
    count = len(next(iter(columns.values())))
    grid, lines = _grid(table, file, time, mapping.rate, count), table.lines
    if mapping.resample is not None:
        even = resample_evenly(grid.time, columns, mapping.resample, file=file, lines=lines)
        columns = even.columns
        notes.append(even.note)
        grid, lines = _Grid.even(even.start, mapping.resample, len(next(iter(columns.values())))), None
    timeline, values, remarks = sampled_columns(
        grid.time, columns, file, lines, informative=options.informative
    )
    stored: dict[str, Any] = {
        kind: {name: value for name, value in of_channels.items() if name in columns}
        for kind, of_channels in table.stored.items()
    }
    record = Record(
        timeline.start if grid.rate is None else grid.start,
        timeline.rate if grid.rate is None else grid.rate,
        tuple(columns),
        values,
        source=table.source or file,
        notes=(*notes, *remarks),
        units=_stated_units(chosen),
        **stored,
    )
    stated, unread = _statements(table, file, chosen, mapping)
    record = with_statements(replace(record, notes=(*record.notes, *unread)), stated, file)
    return record if mapping.decimate is None else record.decimate(mapping.decimate)


def _stated_units(chosen: tuple[ColumnChoice, ...]) -> dict[str, str]:
    """Units of states, and in SI those of places, each of which may turn, where the file states them."""
    units = {}
    for choice in (choice for choice in chosen if choice.unit and choice.channel):
        if choice.kind == "state":
            units[choice.name] = choice.unit
        else:
            units[choice.name] = si_unit(choice.unit, choice.kind)
    return units


def _statements(
    table: Table, file: str, chosen: tuple[ColumnChoice, ...], mapping: RecordMapping
) -> tuple[dict[str, SensorStatement], tuple[str, ...]]:
    """What the mapping states of the sensors, and what the file states beside it, with remarks on that."""
    stated: dict[str, SensorStatement] = {}
    unread: tuple[str, ...] = ()
    for choice in (choice for choice in chosen if choice.name != "time"):
        attributes, of_file = table.columns[choice.column].attributes, table.sensors.get(choice.name)
        if attributes or of_file:
            of_column, more = statement_of(attributes, choice.name)
            stated[choice.name] = SensorStatement.of(of_file or {}, choice.name, file).over(of_column)
            unread += more
    if COMMON in table.sensors:
        stated[COMMON] = SensorStatement.of(table.sensors[COMMON], COMMON, file)
    for name, own in mapping.sensors.items():
        stated[name] = own.over(stated.get(name, SensorStatement()))
    if mapping.calibration is not None:
        general = SensorStatement(gain=StatedError(1.0, mapping.calibration))
        for name in (choice.channel for choice in chosen if choice.channel):
            if not name.is_input:
                stated[name] = stated.get(name, SensorStatement()).over(general)
    return stated, unread


def _grid(table: Table, file: str, time: NDArray[Any] | None, rate: float | None, count: int) -> _Grid:
    """The stated even grid if there is no time column or it agrees; otherwise the times of the column."""
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise RecordError(f"rate must be positive, got {rate!r} Hz", file, arguments=("rate",))
    stated = table.rate if rate is None else rate
    if stated is not None and np.isfinite(stated) and stated > 0.0:
        check_rate(float(stated), file)
        even = _Grid.even(table.start if rate is None else 0.0, float(stated), count)
        if time is None or (len(time) == count and np.all(np.abs(time - even.time) <= JITTER / stated)):
            return even
    if time is not None:
        return _Grid(time)
    raise RecordError(
        f"there is no time column; {listing(table)}. Name it `time` (in s, or `time[ms]`), map a column to it "
        "(`channels`), or give the sampling rate (`rate`)",
        file,
        table.header_line,
        arguments=("channels", "rate"),
    )


def _refuse_overloads(table: Table, file: str, name: str, values: NDArray[Any]) -> None:
    """Raise RecordError for numbers that instruments write in place of a reading, in whatever unit."""
    overloads = np.flatnonzero((np.abs(values) > _OVERLOAD) & (np.abs(values) < _NO_NUMBER))
    if len(overloads):
        row = int(overloads[0])
        line = None if table.lines is None else int(table.lines[row])
        where = "" if line else f" (sample {row})"
        raise RecordError(
            f"the value is {values[row]:.3g}{where}, which instruments write for an overload or no reading; leave such cells "
            "empty",
            file,
            line,
            name,
        )


def _in_si(table: Table, file: str, choice: ColumnChoice) -> NDArray[Any]:
    """(N,) values of a chosen column in SI units; integers without a unit stay integers, so that a note mentions them."""
    column = table.columns[choice.column]
    if column.instead:
        raise RecordError(
            f"is {column.instead}, not a row of real numbers; leave the channel out",
            file,
            table.header_line,
            choice.name,
        )
    if column.values is None:
        advice = "leave the cell of a missing sample empty"
        arguments: tuple[str, ...] = ()
        if choice.name == "time":
            advice, arguments = (
                "times are in seconds; for clock times give the sampling rate instead (`rate`)",
                ("rate",),
            )
        text, line = (column.bad.text, column.bad.line) if column.bad else ("", None)
        raise RecordError(f"{text!r} is not a number; {advice}", file, line, choice.name, arguments=arguments)
    _refuse_overloads(table, file, choice.name, column.values)
    if not choice.unit:
        return column.values
    factor = si_factor(choice.unit, choice.kind, file=file, line=table.header_line, channel=choice.name)
    values = column.values.astype(np.float64)
    # 12 mm are 12 / 1000, rounded once; 12 * 1e-3 is rounded twice, and a time in ms would not lie on its grid
    divisor = round(1.0 / factor)
    return values / divisor if factor < 1.0 and 1.0 / divisor == factor else values * factor
