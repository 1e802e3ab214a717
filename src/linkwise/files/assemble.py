"""From a table to a record: units, and the times at which the samples were taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import RecordError
from linkwise.files.columns import ColumnChoice, choose, ignored, listing
from linkwise.files.header import si_factor
from linkwise.files.table import Table
from linkwise.records.record import Record
from linkwise.records.resampling import resample_evenly
from linkwise.records.timeline import JITTER


@dataclass(frozen=True)
class ReadOptions:
    """How a file is to be read; see `files.read_record`."""

    channels: Mapping[str, str | int]
    rate: float | None = None
    resample: float | None = None
    known_masses: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class _Grid:
    """The moments (N,) in s; `rate` is set where they are even by statement, from `start` on."""

    time: NDArray[Any]
    start: float = 0.0
    rate: float | None = None

    @classmethod
    def even(cls, start: float, rate: float, count: int) -> _Grid:
        """`count` moments, `rate` Hz from `start` in s."""
        return cls(start + np.arange(count) / rate, start, rate)


def to_record(table: Table, file: str, options: ReadOptions) -> Record:
    """The record in a table. Raises RecordError with file, line and channel."""
    chosen = choose(table, file, options.channels, options.known_masses)
    columns = {choice.name: _in_si(table, file, choice) for choice in chosen if choice.name != "time"}
    notes = [*table.notes, *ignored(table, chosen)]
    clock = next((choice for choice in chosen if choice.name == "time"), None)
    if clock is not None and options.rate is not None:
        notes.append(f"The time column was ignored for the given rate of {options.rate:g} Hz.")
        clock = None
    time = None if clock is None else _in_si(table, file, clock)
    count = len(next(iter(columns.values())))
    grid, lines = _grid(table, file, time, options.rate, count), table.lines
    if options.resample is not None:
        notes.append(
            f"Resampled from {len(grid.time)} samples to {options.resample:g} Hz by quintic splines; "
            "the noise of neighbouring samples is no longer independent."
        )
        start, columns = resample_evenly(grid.time, columns, options.resample, file=file, lines=lines)
        grid, lines = _Grid.even(start, options.resample, len(next(iter(columns.values())))), None
    record = Record.from_arrays(
        grid.time,
        columns,
        noise={name: sigma for name, sigma in table.noise.items() if name in columns},
        source=table.source or file,
        notes=notes,
        file=file,
        lines=lines,
    )
    if grid.rate is None:
        return record
    return replace(record, start=grid.start, rate=grid.rate)


def _grid(table: Table, file: str, time: NDArray[Any] | None, rate: float | None, count: int) -> _Grid:
    """The stated grid where it is the only one or agrees with the time column, which else decides."""
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise RecordError(f"a rate of {rate!r} Hz cannot be; it is a number above 0", file)
    stated = table.rate if rate is None else rate
    if stated is not None and np.isfinite(stated) and stated > 0.0:
        even = _Grid.even(table.start if rate is None else 0.0, float(stated), count)
        if time is None or (len(time) == count and np.all(np.abs(time - even.time) <= JITTER / stated)):
            return even
    if time is not None:
        return _Grid(time)
    raise RecordError(
        f"there is no time column; {listing(table)}. Call it `time` (in s, or time[ms]), map it with "
        "--channel time=COLUMN, or give the sampling rate with --rate HZ",
        file,
        table.header_line,
    )


def _in_si(table: Table, file: str, choice: ColumnChoice) -> NDArray[Any]:
    """(N,) values of a chosen column in SI units; whole numbers without a unit stay whole, so that they are noted."""
    column = table.columns[choice.column]
    if column.values is None:
        advice = "leave the cell of a missing sample empty"
        if choice.name == "time":
            advice = "times are seconds; for clock times give the rate instead (--rate HZ)"
        text, line = (column.bad.text, column.bad.line) if column.bad else ("", None)
        raise RecordError(f"{text!r} is no number; {advice}", file, line, choice.name)
    if not choice.unit:
        return column.values
    factor = si_factor(choice.unit, choice.kind, file=file, line=table.header_line, channel=choice.name)
    values = column.values.astype(np.float64)
    # 12 mm are 12 / 1000, rounded once; 12 * 1e-3 is rounded twice, and a time in ms would not lie on its grid
    whole = round(1.0 / factor)
    return values / whole if factor < 1.0 and 1.0 / whole == factor else values * factor
