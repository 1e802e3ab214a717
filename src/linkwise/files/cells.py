"""Lines of cells to columns of numbers: in one call where all are numbers, otherwise cell by cell."""

from __future__ import annotations

import csv
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.files.table import BadCell, Column

_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"})


@dataclass(frozen=True)
class Dialect:
    """How cells are separated: `delimiter`, None for white space, and whether the decimal mark is a comma."""

    delimiter: str | None
    decimal_comma: bool = False

    @classmethod
    def of(cls, header: str, body: list[str]) -> Dialect:
        """Tab before semicolon before comma before white space; a comma that is not the delimiter is a decimal comma."""
        plain = _without_units(header)
        delimiter = next((mark for mark in ("\t", ";", ",") if mark in plain), None)
        if delimiter is None and body:
            # one column, or several separated by a delimiter that the header does not need
            delimiter = next((mark for mark in ("\t", ";") if mark in body[0]), None)
        return cls(delimiter, delimiter != "," and any("," in line for line in body))

    def split(self, line: str) -> list[str]:
        """The cells of one line without quotes and surrounding spaces."""
        if '"' in line:
            cells = next(csv.reader([line], delimiter=self.delimiter or " ", skipinitialspace=True))
            return [cell.strip() for cell in cells]
        return [cell.strip() for cell in line.split(self.delimiter)]


def _without_units(header: str) -> str:
    """The header with quoted and bracketed text blanked out: a comma there is not a delimiter."""
    depth, quoted, blanked = 0, False, []
    for letter in header:
        quoted ^= letter == '"'
        depth += (letter in "[(") - (letter in "])")
        blanked.append(" " if quoted or depth > 0 else letter)
    return "".join(blanked)


def parse_number(cell: str) -> float | None:
    """The number in a cell, NaN for a marker of a missing value, None for other text."""
    if cell.lower() in _MISSING:
        return float("nan")
    try:
        return _number(cell.replace(",", "."))
    except ValueError:
        return None


def _number(cell: str) -> float:
    """The number that a cell says; ValueError for other text, and for digits in groups, as Python writes 1_000."""
    if "_" in cell:
        raise ValueError(cell)
    return float(cell)


def columns_of(
    body: list[str], lines: NDArray[np.int64], headers: list[str], dialect: Dialect, file: str
) -> tuple[Column, ...]:
    """One column per header from the lines `body` (N,), whose numbers in the file are `lines` (N,).

    A column with text keeps its first invalid cell. Raises RecordError for a line with too many or too few cells.
    """
    values = _all_numbers(body, len(headers), dialect)
    if values is not None:
        return tuple(Column(header, values[:, i]) for i, header in enumerate(headers))
    rows = [dialect.split(line) for line in body]
    _check_row_lengths(rows, lines, headers, dialect, file)
    return tuple(_column(header, [row[i] for row in rows], lines) for i, header in enumerate(headers))


def _all_numbers(body: list[str], count: int, dialect: Dialect) -> Floats | None:
    """(N, count) numbers; None unless every line has exactly `count` numbers."""
    plain = [line.replace(",", ".") for line in body] if dialect.decimal_comma else body
    try:
        values = np.loadtxt(plain, delimiter=dialect.delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return values if values.shape == (len(body), count) else None


def _check_row_lengths(
    rows: list[list[str]], lines: NDArray[np.int64], headers: list[str], dialect: Dialect, file: str
) -> None:
    """Raise RecordError for a line whose number of cells is not that of the header; empty extra cells are ignored."""
    count = len(headers)
    for row, line in zip(rows, lines, strict=True):
        if len(row) == count or (len(row) > count and not any(row[count:])):
            continue
        message = f"{len(row)} cell{'s' * (len(row) != 1)} where the header has {count}"
        if len(row) == 2 * count and dialect.delimiter == ",":
            message += "; with decimal commas, separate the cells by semicolons"
        elif line == lines[-1] and len(row) < count:
            message += "; was the file truncated in its last line?"
        else:
            message += "; is another line the header (`header`)?"
        raise RecordError(message, file, int(line), arguments=("header",))


def _column(header: str, cells: list[str], lines: NDArray[np.int64]) -> Column:
    """One column from its cells (N,)."""
    try:
        return Column(header, np.array([_number(cell) if cell else np.nan for cell in cells]))
    except ValueError:
        pass  # a marker of a missing value, a decimal comma, or text: parse one by one
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        value = parse_number(cell)
        if value is None:
            return Column(header, None, BadCell(cell, int(lines[i])))
        values[i] = value
    return Column(header, values)
