"""Delimited text (CSV and the like): any delimiter, decimal point or comma, comments, text above the header."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import RecordError
from linkwise.files.cells import Dialect, columns_of, parse_number
from linkwise.files.header import ColumnHeader
from linkwise.files.lines import read_lines
from linkwise.files.table import Table
from linkwise.records.record import Record
from linkwise.units import is_unit

_COMMENTS = ("#", "%", "//")
_NO_UNIT = ("", "-", "1", "none")
_PREAMBLE = 100  # lines searched for a header


def read_table(path: Path) -> Table:
    """The columns of a text file; see `files.read_record`."""
    return table_of(read_lines(path), path)


def table_of(
    lines: list[str],
    path: Path,
    *,
    rate: float | None = None,
    notes: tuple[str, ...] = (),
    lines_before: int = 0,
) -> Table:
    """The columns of a text of these lines, which `lines_before` others precede in the file `path`.

    `rate` in Hz is what the file states besides, and `notes` is what was assumed so far.
    """
    header, first = _header(lines)
    kept = _data_lines(lines, first)
    if not len(kept):
        line = None if header is None else header + 1 + lines_before
        raise RecordError("there are no data below the header", path, line)
    body = lines[first:] if len(kept) == len(lines) - first else [lines[i] for i in kept]
    opening = lines[first].strip() if header is None else _uncommented(lines[header])
    dialect = Dialect.of(opening, body)
    cells = dialect.split(opening)
    headers = [str(i + 1) for i in range(len(cells))] if header is None else cells
    if header is not None and not headers[-1] and len(dialect.split(body[0])) == len(headers) - 1:
        headers.pop()  # a trailing delimiter in the header only
    kept += lines_before
    units = None if header is None else _units(dialect.split(body[0]), headers)
    if units is not None and len(body) > 1:
        headers, body, kept = units, body[1:], kept[1:]
    columns = columns_of(body, kept + 1, headers, dialect, str(path))
    skipped = sum(not _is_blank_or_comment(line) for line in lines[: header or 0])
    found = [f"Lines of text skipped above the header: {skipped}."] if skipped else []
    if units is not None:
        found.append("The line below the header was read as the units of the columns.")
    if dialect.decimal_comma:
        found.append("Commas were read as decimal points.")
    return Table(
        columns,
        lines=kept + 1,
        header_line=None if header is None else header + 1 + lines_before,
        named=header is not None,
        opening=opening,
        rate=rate,
        notes=(*notes, *found),
    )


def _units(cells: list[str], headers: list[str]) -> list[str] | None:
    """The headers with the units that a line of `cells` below them states; None where it states none."""
    if (
        len(cells) != len(headers)
        or not any(cells)
        or any(parse_number(cell) is not None for cell in cells if cell)
    ):
        return None
    bare = [cell.strip("[]()") for cell in cells]
    if not all(is_unit(unit) for unit in bare if unit not in _NO_UNIT):
        return None
    return [
        header if unit in _NO_UNIT or ColumnHeader.parse(header).unit else f"{header}[{unit}]"
        for header, unit in zip(headers, bare, strict=True)
    ]


def _is_blank_or_comment(line: str) -> bool:
    """True also for `sep=;`, the line by which a spreadsheet states the delimiter."""
    line = line.lstrip()
    return not line or line.startswith(_COMMENTS) or line[:4].lower() == "sep="


def _uncommented(line: str) -> str:
    """The line without a leading comment mark: np.savetxt writes its header after `# `."""
    line = line.strip()
    for mark in _COMMENTS:
        line = line.removeprefix(mark)
    return line.strip()


def _header(lines: list[str]) -> tuple[int | None, int]:
    """Index of the header line, None without one, and of the first line that may hold data.

    The header is the first line above the numbers with a column that names the time or a channel; otherwise the last line of
    text above the numbers; otherwise there is none.
    """
    named: int | None = None
    last: int | None = None
    for i, line in enumerate(lines[:_PREAMBLE]):
        text = _uncommented(line)
        if not text or text.lower().startswith("sep="):
            continue
        dialect = Dialect.of(text, [text])
        cells = [cell for cell in dialect.split(text) if cell]
        comment = line.lstrip().startswith(_COMMENTS)
        if not comment and cells and all(parse_number(cell) is not None for cell in cells):
            header = named if named is not None else last
            return header, i if header is None else header + 1
        if named is None and any(map(_is_channel_or_time, cells)):
            named = i
            if not comment:
                return named, i + 1
        if not comment:
            last = i
    header = named if named is not None else next(i for i, line in enumerate(lines) if line.strip())
    return header, header + 1


def _is_channel_or_time(cell: str) -> bool:
    """Whether a header names the time or a channel."""
    header = ColumnHeader.parse(cell)
    return header.is_time or header.channel is not None


def _data_lines(lines: list[str], first: int) -> NDArray[np.int64]:
    """Indices of the lines from `first` on that are neither blank nor comments."""
    return np.array(
        [i for i in range(first, len(lines)) if not _is_blank_or_comment(lines[i])],
        dtype=np.int64,
    )


def write(record: Record, path: Path) -> None:
    """Write times in s and channels in SI units with all digits; a missing sample is an empty cell."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(["time", *record.channels])
    rows = np.column_stack([record.time, record.values]).tolist()
    if record.missing.any():
        body = [",".join("" if math.isnan(value) else repr(value) for value in row) for row in rows]
    else:
        body = [",".join(map(repr, row)) for row in rows]
    path.write_text(header.getvalue() + "\n".join(body) + "\n", encoding="utf-8", newline="\n")
