"""Columns under their headers: what every format is read into before headers are interpreted.

The header of a column: `time`, `x:m1`, or either with a unit, `time[ms]`, `x:m1 (mm)`, `x:m1 / mm`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import LinkwiseError, RecordError
from linkwise.records.channel import KINDS, Channel, is_angular
from linkwise.records.record import Record
from linkwise.records.sample_checks import Rows
from linkwise.units import base_exponents, converts, factor_to_si, is_unit

_SHOWN = 60  # characters of a cell that a message quotes


@dataclass(frozen=True)
class BadCell:
    """The first cell of a column that is not a number: its text, and its line (None where the format has no lines)."""

    text: str
    line: int | None = None


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file.

    `values` (N,) are real numbers, NaN where missing, or None where `bad` is a cell that is not a number, or `instead` says
    what is there in place of a row of numbers. `meaning` is the channel that a header stands for where the format cannot
    spell it (`x_m1` for x:m1 in MATLAB), and `path` the place of the values in a file that states their name elsewhere.
    `attributes` are what the file states of the sensor, as of `SensorStatement.of`.
    """

    header: str
    values: NDArray[Any] | None
    bad: BadCell | None = None
    meaning: str = ""
    path: str = ""
    instead: str = ""
    attributes: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of(cls, header: str, values: NDArray[Any], meaning: str = "") -> Column:
        """A column from an array of any type; one that is not real numbers keeps its first cell as the reason."""
        if values.dtype.kind == "b":
            values = values.astype(np.int8)
        if values.dtype.kind == "f":
            # limits of doubles are infinite in single precision
            values = values.astype(np.float64, copy=False)
        if values.dtype.kind in "iuf":
            return cls(header, values, meaning=meaning)
        return cls(header, None, BadCell(str(values.flat[0])[:_SHOWN] if values.size else ""), meaning)


@dataclass(frozen=True, eq=False)
class Table:
    """All columns of a `file`, in its order.

    `named` is False where the file has no header and columns have numbers; `opening` is then its first line. `lines` (N,) and
    `header_line` count from 1, None where the format has no lines. `start` in s and `rate` in Hz are set where the file
    states them besides or instead of a time column. `stored` holds attributes of channels, such as the noise, by attribute and
    channel. `sensors` is what the file states of sensors by channel, beside the
    attributes of columns.
    """

    columns: tuple[Column, ...]
    file: str = ""
    lines: NDArray[np.int64] | None = None
    header_line: int | None = None
    named: bool = True
    opening: str = ""
    start: float = 0.0
    rate: float | None = None
    notes: tuple[str, ...] = ()
    source: str = ""
    stored: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    sensors: Mapping[str, Mapping[str, object]] = field(default_factory=dict)

    def error(
        self, message: str, *arguments: str, line: int | None = None, channel: str | None = None
    ) -> RecordError:
        """An error of the file, of which `arguments` of `files.read_record` are the way out."""
        return RecordError(message, self.file, line, channel, arguments=arguments)

    @property
    def rows(self) -> Rows:
        """Where the samples stand."""
        return Rows(self.file, self.lines)

    @property
    def headers(self) -> tuple[str, ...]:
        """The headers as written in the file."""
        return tuple(column.header for column in self.columns)


_UNIT = re.compile(r"^(.*?)\s*(?:\[([^\[\]]*)\]|\(([^():,]*)\))$", re.DOTALL)
# as DIN 1313 writes a quantity: over its unit, or in it
_QUOTIENT = re.compile(r"^(.*\S) (?:/|in) (\S+)$", re.DOTALL)


@dataclass(frozen=True)
class ColumnHeader:
    """A column header: `name` without its unit, and `unit` as written ("" without one)."""

    name: str
    unit: str = ""

    @classmethod
    def parse(cls, text: str) -> ColumnHeader:
        """Split a header; a text that does not end with a unit is all name."""
        text = text.strip().strip("\"'").strip()
        match = _UNIT.match(text)
        if match is not None and match[1]:
            return cls(match[1].strip(), (match[2] if match[2] is not None else match[3]).strip())
        quotient = _QUOTIENT.match(text)
        return cls(*quotient.groups()) if quotient is not None and is_unit(quotient[2]) else cls(text)

    @property
    def is_time(self) -> bool:
        """Whether the name is `time` or `t`, in upper or lower case; T in another unit than of time is a temperature."""
        name = self.name.lower()
        return name == "time" or (name == "t" and converts(self.unit or "s", "s"))

    @property
    def channel(self) -> Channel | None:
        """The channel of this name; None if it is not the name of a channel."""
        try:
            return self.stated_channel()
        except RecordError:
            return None

    def stated_channel(self) -> Channel:
        """The same; RecordError if it is not the name of a channel."""
        return Channel.parse(":".join(part.strip() for part in self.name.split(":")))

    @property
    def leaf(self) -> ColumnHeader:
        """The header without the groups above it: `run1/x:m1[mm]` is x:m1 in mm."""
        return ColumnHeader(self.name.rpartition("/")[2], self.unit)


def si_factor(unit: str, kind: str, *, file: str, line: int | None, channel: str) -> float:
    """Factor from `unit` to the SI unit of `kind` (a kind of channel, or "time"); that of a rotation for an angular unit.

    For an acceleration, `g` is standard gravity. Raises RecordError for a unit that is unknown or of another quantity.
    """
    dimension, quantity = ("s", "time") if kind == "time" else (KINDS[kind].unit, KINDS[kind].quantity)
    if not unit or (unit == dimension and kind != "time"):
        return 1.0
    if is_angular(unit, kind):
        return factor_to_si(unit, KINDS[kind].angular_unit)
    try:
        if kind == "signal":
            base_exponents(unit)  # of what units of coefficients are made of
        return factor_to_si(unit, dimension)
    except LinkwiseError as error:
        dimension = dimension.replace("?", "1")
        message = (
            f"{unit!r} is not a unit of {quantity}; expected {dimension} or a unit that converts to it. Correct the header, "
            f"or map the column with its unit, as in channels={{'{channel}[{dimension}]': 'NAME'}}"
        )
        raise RecordError(message, file, line, channel, arguments=("channels",)) from error


def headers(record: Record) -> tuple[str, ...]:
    """The headers under which a file holds the channels in SI units: those of places that turn state their unit."""
    units = zip(record.channels, map(record.unit, record.channels), strict=True)
    return tuple(name if unit == name.unit else f"{name}[{unit}]" for name, unit in units)
