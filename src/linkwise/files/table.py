"""Columns under their headers: what every format is read into before headers are interpreted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    spell it (`x_m1` for x:m1 in MATLAB). `attributes` are what the file states of the sensor, as of
    `SensorStatement.of`.
    """

    header: str
    values: NDArray[Any] | None
    bad: BadCell | None = None
    meaning: str = ""
    instead: str = ""
    attributes: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of(cls, header: str, values: NDArray[Any], meaning: str = "") -> Column:
        """A column from an array of any type; one that is not real numbers keeps its first cell as the reason."""
        if values.dtype.kind == "b":
            values = values.astype(np.int8)
        if values.dtype.kind == "f":
            values = values.astype(
                np.float64, copy=False
            )  # limits of doubles are infinite in single precision
        if values.dtype.kind in "iuf":
            return cls(header, values, meaning=meaning)
        return cls(header, None, BadCell(str(values.flat[0])[:_SHOWN] if values.size else ""), meaning)


@dataclass(frozen=True, eq=False)
class Table:
    """All columns of a file, in its order.

    `named` is False where the file has no header and columns have numbers; `opening` is then its first line. `lines` (N,) and
    `header_line` count from 1, None where the format has no lines. `start` in s and `rate` in Hz are set where the file
    states them besides or instead of a time column. `stored` holds attributes of channels, such as the noise, by attribute and
    channel. `sensors` is what the file states of sensors by channel, beside the
    attributes of columns.
    """

    columns: tuple[Column, ...]
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

    @property
    def headers(self) -> tuple[str, ...]:
        """The headers as written in the file."""
        return tuple(column.header for column in self.columns)
