"""CSV and its relatives: any delimiter, decimal point or comma, comments, text above the header."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from linkwise.errors import RecordError
from linkwise.files.cells import Dialect, columns_of, number
from linkwise.files.header import ColumnHeader
from linkwise.files.lines import read_lines
from linkwise.files.table import Table
from linkwise.records.record import Record

_COMMENTS = ("#", "%", "//")
_PREAMBLE = 100  # lines in which a header is looked for


def read_table(path: Path) -> Table:
    """The columns of a text file; see `files.read_record`."""
    lines = read_lines(path)
    header, first = _header(lines)
    kept = _data_lines(lines, first)
    if not len(kept):
        raise RecordError(
            "there is a header, but no line of data below it", path, None if header is None else header + 1
        )
    body = lines[first:] if len(kept) == len(lines) - first else [lines[i] for i in kept]
    opening = lines[first].strip() if header is None else _uncommented(lines[header])
    dialect = Dialect.of(opening, body)
    cells = dialect.split(opening)
    headers = [str(i + 1) for i in range(len(cells))] if header is None else cells
    if header is not None and not headers[-1] and len(dialect.split(body[0])) == len(headers) - 1:
        headers.pop()  # a delimiter at the end of the header alone
    columns = columns_of(body, kept + 1, headers, dialect, str(path))
    skipped = sum(not _is_blank_or_comment(line) for line in lines[: header or 0])
    notes = [f"Lines of text above the header that were skipped: {skipped}."] if skipped else []
    if dialect.decimal_comma:
        notes.append("Commas were read as decimal points.")
    return Table(
        columns,
        lines=kept + 1,
        header_line=None if header is None else header + 1,
        named=header is not None,
        opening=opening,
        notes=tuple(notes),
    )


def _is_blank_or_comment(line: str) -> bool:
    """True also for the line by which a spreadsheet tells the delimiter, `sep=;`."""
    line = line.lstrip()
    return not line or line.startswith(_COMMENTS) or line[:4].lower() == "sep="


def _uncommented(line: str) -> str:
    """The line without the mark of a comment: np.savetxt writes its header behind `# `."""
    line = line.strip()
    for mark in _COMMENTS:
        line = line.removeprefix(mark)
    return line.strip()


def _header(lines: list[str]) -> tuple[int | None, int]:
    """The index of the header (None without one) and that of the line from which data are looked for.

    The header is the first line above the first numbers in which a column is a time or a channel; where there is none, the
    last line of text above the numbers; where that does not exist either, there is no header.
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
        if not comment and cells and all(number(cell) is not None for cell in cells):
            found = named if named is not None else last
            return found, i if found is None else found + 1
        if named is None and any(map(_says_something, cells)):
            named = i
            if not comment:
                return named, i + 1
        if not comment:
            last = i
    header = named if named is not None else next(i for i, line in enumerate(lines) if line.strip())
    return header, header + 1


def _says_something(cell: str) -> bool:
    """True for the header of a time or a channel."""
    heading = ColumnHeader.parse(cell)
    return heading.is_time or heading.channel is not None


def _data_lines(lines: list[str], first: int) -> NDArray[np.int64]:
    """The indices of all lines from `first` on that are neither blank nor comments."""
    return np.array(
        [i for i in range(first, len(lines)) if not _is_blank_or_comment(lines[i])],
        dtype=np.int64,
    )


def write(record: Record, path: Path) -> None:
    """Times in s and channels in SI units, each number with all its digits, an empty cell where a sample is missing."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(["time", *record.channels])
    rows = np.column_stack([record.time, record.values]).tolist()
    if record.missing.any():
        body = [",".join("" if math.isnan(value) else repr(value) for value in row) for row in rows]
    else:
        body = [",".join(map(repr, row)) for row in rows]
    path.write_text(header.getvalue() + "\n".join(body) + "\n", encoding="utf-8", newline="\n")
