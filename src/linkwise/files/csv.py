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
from linkwise.files.header import ColumnHeader, headers
from linkwise.files.lines import read_lines
from linkwise.files.table import Table
from linkwise.records.record import Record
from linkwise.units import is_unit

_COMMENTS = ("#", "%", "//")
_NO_UNIT = ("", "-", "1", "none")
_PREAMBLE = 100  # lines searched for a header


def read_table(path: Path, header: str | int | None = None) -> Table:
    """The columns of a text file; see `files.read_record`."""
    return table_of(read_lines(path), path, named_header=header)


def table_of(
    lines: list[str],
    path: Path,
    *,
    rate: float | None = None,
    notes: tuple[str, ...] = (),
    lines_before: int = 0,
    named_header: str | int | None = None,
) -> Table:
    """The columns of a text of these lines, which `lines_before` others precede in the file `path`.

    `rate` in Hz is what the file states besides, `notes` is what was assumed so far, and `named_header` the header line as of
    `files.read_record`.
    """
    header, first = _header(lines) if named_header is None else _named(lines, named_header, path)
    data_lines = _data_lines(lines, first)
    if not len(data_lines):
        line = None if header is None else header + 1 + lines_before
        raise RecordError("there are no data below the header", path, line)
    body = lines[first:] if len(data_lines) == len(lines) - first else [lines[i] for i in data_lines]
    opening = lines[first].strip() if header is None else _uncommented(lines[header])
    dialect = Dialect.of(opening, body)
    cells = dialect.split(opening)
    headers = [str(i + 1) for i in range(len(cells))] if header is None else cells
    if header is not None and not headers[-1] and len(dialect.split(body[0])) == len(headers) - 1:
        headers.pop()  # a trailing delimiter in the header only
    data_lines += lines_before
    units = None if header is None else _units(dialect.split(body[0]), headers)
    if units is not None and len(body) > 1:
        headers, body, data_lines = units, body[1:], data_lines[1:]
    columns = columns_of(body, data_lines + 1, headers, dialect, str(path))
    skipped = sum(not _is_blank_or_comment(line) for line in lines[: header or 0])
    assumptions = [f"Lines of text skipped above the header: {skipped}."] if skipped else []
    if units is not None:
        assumptions.append("The line below the header was read as the units of the columns.")
    if dialect.decimal_comma:
        assumptions.append("Commas were read as decimal points.")
    return Table(
        columns,
        lines=data_lines + 1,
        header_line=None if header is None else header + 1 + lines_before,
        named=header is not None,
        opening=opening,
        rate=rate,
        notes=(*notes, *assumptions),
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
    text above the numbers that is not a line of units; otherwise there is none.
    """
    named: int | None = None
    texts: list[int] = []
    for i, line in enumerate(lines[:_PREAMBLE]):
        cells = _cells(line)
        if not any(cells):
            continue
        comment = line.lstrip().startswith(_COMMENTS)
        if not comment and all(parse_number(cell) is not None for cell in cells if cell):
            header = named if named is not None else _above_units(lines, texts)
            return header, i if header is None else header + 1
        if named is None and _names_columns(cells):
            named = i
            if not comment:
                return named, i + 1
        if not comment:
            texts.append(i)
    header = named if named is not None else next(i for i, line in enumerate(lines) if line.strip())
    return header, header + 1


def _cells(line: str) -> list[str]:
    """The cells of a line by its own delimiter; none of a line that states the delimiter."""
    text = _uncommented(line)
    return [] if text.lower().startswith("sep=") else Dialect.of(text, [text]).split(text)


def _above_units(lines: list[str], texts: list[int]) -> int | None:
    """The last line of text; the one above it where the last states the units of its columns."""
    if len(texts) > 1:
        above, below = _cells(lines[texts[-2]]), _cells(lines[texts[-1]])
        if _units(below, above) is not None and _units(above, above) is None:
            return texts[-2]
    return texts[-1] if texts else None


def _named(lines: list[str], header: str | int, path: Path) -> tuple[int, int]:
    """Index of the header line that is named by its number or a text in it, and of the next one."""
    if isinstance(header, int):
        if not 1 <= header < len(lines):
            raise RecordError(
                f"line {header} cannot be the header: the file has {len(lines)} lines, and data follow the header",
                path,
                arguments=("header",),
            )
        return header - 1, header
    index = next((number for number, line in enumerate(lines) if header in line), None)
    if index is None:
        raise RecordError(f"no line contains {header!r}", path, arguments=("header",))
    return index, index + 1


def _names_columns(cells: list[str]) -> bool:
    """Whether cells are a header that names the time or a channel; `Time;13:55:01` above a header states when it was."""
    headers = [ColumnHeader.parse(cell) for cell in cells if cell]
    return any(header.is_time or header.channel is not None for header in headers) and not any(
        header.name[:1].isdigit() for header in headers
    )


def _data_lines(lines: list[str], first: int) -> NDArray[np.int64]:
    """Indices of the lines from `first` on that are neither blank nor comments."""
    return np.array(
        [i for i in range(first, len(lines)) if not _is_blank_or_comment(lines[i])],
        dtype=np.int64,
    )


def write(record: Record, path: Path) -> None:
    """Write times in s and channels in SI units with all digits; a missing sample is an empty cell."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(["time", *headers(record)])
    rows = np.column_stack([record.time, record.values]).tolist()
    if record.missing.any():
        body = [",".join("" if math.isnan(value) else repr(value) for value in row) for row in rows]
    else:
        body = [",".join(map(repr, row)) for row in rows]
    path.write_text(header.getvalue() + "\n".join(body) + "\n", encoding="utf-8", newline="\n")
