"""Text files in any common encoding: any delimiter, decimal point or comma, comments, text above the header.

LVM, the text format of LabVIEW measurements, is a header of keys, and then columns.
"""

from __future__ import annotations

import codecs
import csv
import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.files.table import BadCell, Column, ColumnHeader, Table, headers
from linkwise.records.record import Record
from linkwise.units import is_unit

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
    """The number in a cell, infinite where a signal left the range, NaN for a missing value, None for other text."""
    try:
        plain = cell.replace(",", ".").replace("\N{INFINITY}", "inf").replace("\N{MINUS SIGN}", "-")
        return None if "_" in cell else float(plain)  # Python reads 1_000
    except ValueError:
        return float("nan") if cell.lower() in _MISSING else None


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
        elif len(row) < count and any(len(others) == count for others in rows):
            message += "; leave the cell of a missing reading empty, and keep the delimiters"
            raise RecordError(message, file, int(line))
        else:
            message += "; is another line the header (`header`)?"
        raise RecordError(message, file, int(line), arguments=("header",))


def _column(header: str, cells: list[str], lines: NDArray[np.int64]) -> Column:
    """One column from its cells (N,)."""
    values = [parse_number(cell) for cell in cells]
    if None in values:
        bad = values.index(None)
        return Column(header, None, BadCell(cells[bad], int(lines[bad])))
    return Column(header, np.array(values, dtype=float))


_BYTE_ORDER_MARKS = (  # the longer first: that of UTF-32 begins with that of UTF-16
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_PROBE = 4096  # bytes from which the encoding is inferred


def read_lines(path: Path) -> list[str]:
    """The lines of a text file without line ends (LF, CRLF or CR).

    A byte order mark decides the encoding. Without one it is UTF-16 where every other byte is zero, else UTF-8 if the content
    is valid, else Windows 1252, in which older instruments write µ and ². Raises RecordError for a binary file.
    """
    content = path.read_bytes()
    try:
        text = content.decode(_encoding(content, path))
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise RecordError(f"is not valid {error.encoding} text; save it as UTF-8", path, line) from error
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RecordError("the file contains only blank lines", path)
    return lines


def _encoding(content: bytes, path: Path) -> str:
    for mark, encoding in _BYTE_ORDER_MARKS:
        if content.startswith(mark):
            return encoding
    head = content[:_PROBE]
    if b"\0" in head:
        if head[1::2].count(0) > 0.8 * len(head[1::2]) and not head[::2].count(0):
            return "utf-16-le"
        if head[::2].count(0) > 0.8 * len(head[::2]) and not head[1::2].count(0):
            return "utf-16-be"
        raise RecordError("is a binary file, not text; its suffix may be wrong", path)
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


_COMMENTS = ("#", "%", "//")
_NO_UNIT = ("", "-", "1", "none", "unit", "units", "einheit", "einheiten")
_PREAMBLE = 100  # lines searched for a header


def read_text(path: Path, header: str | int | None = None) -> Table:
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
    header, first = _header(lines) if named_header is None else _header_line(lines, named_header, path)
    below = [i for i in range(first, len(lines)) if not _is_blank_or_comment(lines[i])]
    data_lines = np.array(below, dtype=np.int64)
    if not len(data_lines):
        line = None if header is None else header + 1 + lines_before
        raise RecordError("there are no data below the header", path, line)
    body = lines[first:] if len(data_lines) == len(lines) - first else [lines[i] for i in data_lines]
    opening = lines[first].strip() if header is None else _uncommented(lines[header])
    dialect = Dialect.of(opening, body)
    cells = dialect.split(opening)
    headers = [str(i + 1) for i in range(len(cells))] if header is None else list(map(_bracketed, cells))
    if header is not None and not headers[-1] and len(dialect.split(body[0])) == len(headers) - 1:
        headers.pop()  # a trailing delimiter in the header only
    data_lines += lines_before
    units = None if header is None else _unit_row(dialect.split(body[0]), headers)
    if units is not None and len(body) > 1:
        headers, body, data_lines = units, body[1:], data_lines[1:]
    columns = columns_of(body, data_lines + 1, headers, dialect, str(path))
    if header is not None:  # a column is found as the file spells it, too
        columns = tuple(replace(column, path=cell) for column, cell in zip(columns, cells, strict=False))
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


def _bracketed(header: str) -> str:
    """The header with its unit in brackets where it stands below a stroke without spaces, as in s1/mm; not that of v m/s."""
    name, stroke, unit = header.partition("/")
    words = name.split()
    quotient = len(words) > 1 and is_unit(words[-1])
    return (
        f"{name}[{unit}]"
        if words and stroke and "(" not in name and is_unit(unit) and not quotient
        else header
    )


def _unit_row(cells: list[str], headers: list[str]) -> list[str] | None:
    """The headers with the units that a line of `cells` below them states; None where it states none."""
    numbers = any(parse_number(cell) is not None for cell in cells if cell)
    if numbers or len(cells) != len(headers) or not any(cells):
        return None
    bare = ["" if cell.lower() in _NO_UNIT else cell.strip("[]() ") for cell in cells]
    if not any(bare) or not all(is_unit(unit) for unit in bare if unit not in _NO_UNIT):
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

    The header is the last line above the numbers with a column that names the time or a channel, a comment only where no
    other does; otherwise the last line of text that is not a line of units; otherwise there is none.
    """
    named: int | None = None
    texts: list[int] = []
    for i, line in enumerate(lines[:_PREAMBLE]):
        cells = _cells_of_line(line)
        if not any(cells):
            continue
        comment = line.lstrip().startswith(_COMMENTS)
        if not comment and all(parse_number(cell) is not None for cell in cells if cell):
            header = named if named is not None else _above_units(lines, texts)
            return header, i if header is None else header + 1
        if _names_columns(cells) and not (comment and named is not None):
            named = i
        if not comment:
            texts.append(i)
    header = named if named is not None else next(i for i, line in enumerate(lines) if line.strip())
    return header, header + 1


def _cells_of_line(line: str) -> list[str]:
    """The cells of a line by its own delimiter; none of a line that states the delimiter."""
    text = _uncommented(line)
    return [] if text.lower().startswith("sep=") else Dialect.of(text, [text]).split(text)


def _above_units(lines: list[str], texts: list[int]) -> int | None:
    """The last line of text; the one above it where the last states the units of its columns."""
    if len(texts) > 1:
        above, below = _cells_of_line(lines[texts[-2]]), _cells_of_line(lines[texts[-1]])
        if _unit_row(below, above) is not None and _unit_row(above, above) is None:
            return texts[-2]
    return texts[-1] if texts else None


def _header_line(lines: list[str], header: str | int, path: Path) -> tuple[int, int]:
    """Index of the header line that is named by its number or a text in it, and of the next one."""
    if isinstance(header, int):
        if not 1 <= header < len(lines):
            message = f"line {header} cannot be the header: the file has {len(lines)} lines, and data follow the header"
            raise RecordError(message, path, arguments=("header",))
        return header - 1, header
    index = next((number for number, line in enumerate(lines) if header in line), None)
    if index is None:
        raise RecordError(f"no line contains {header!r}", path, arguments=("header",))
    return index, index + 1


def _names_columns(cells: list[str]) -> bool:
    """Whether cells are a header that names the time or a channel; `Time;13:55:01` above a header states when it was."""
    headers = [ColumnHeader.parse(cell) for cell in cells if cell]
    named = any(header.is_time or header.channel is not None for header in headers)
    return named and not any(
        header.name[:1].isdigit() or parse_number(header.name) is not None for header in headers
    )


def write_csv(record: Record, path: Path) -> None:
    """Write times in s and channels in SI units with all digits; a missing sample is an empty cell."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(["time", *headers(record)])
    rows = np.column_stack([record.time, record.values]).tolist()
    body = [",".join(map(repr, row)).replace("nan", "") for row in rows]
    path.write_text(header.getvalue() + "\n".join(body) + "\n", encoding="utf-8", newline="\n")


_END = "***End_of_Header***"
_TIME = "X_Value"


def read_lvm(path: Path) -> Table:
    """The columns of the only segment of measurements; see `files.read_record`.

    Raises RecordError for a file without such a header, or with several segments, which have clocks of their own.
    """
    lines = read_lines(path)
    ends = [number for number, line in enumerate(lines) if line.strip().startswith(_END)]
    if not ends:
        raise RecordError(f"is not an LVM file: the line {_END} is missing", path)
    if len(ends) > 2:
        raise RecordError(
            f"holds {len(ends) - 1} segments of measurements, each with a clock of its own: export them as files of their own",
            path,
            ends[2] + 1,
        )
    separator = "," if any(line.startswith("Separator,") for line in lines[: ends[0]]) else "\t"
    above = [line.split(separator) for line in lines[: ends[-1]]]
    keys = {row[0].strip().lower(): [cell.strip() for cell in row[1:]] for row in above if len(row) > 1}
    first = next((n for n in range(ends[-1] + 1, len(lines)) if lines[n].strip()), len(lines))
    if first == len(lines):
        raise RecordError("there are no measurements below the header", path, len(lines))
    names = [name.strip() for name in lines[first].split(separator)]
    clocks = keys.get("x_columns", ["one"])[0].lower()
    if clocks == "multi":
        _require_one_clock(lines[first + 1 :], separator, path, first + 2)
        names = [name for index, name in enumerate(names) if name != _TIME or index == 0]
    units = [unit.strip() for unit in keys.get("y_unit_label", [])]
    headers = _headers(names, units, timed=clocks != "no")
    body = []
    for line in lines[first + 1 :]:
        cells = [cell.strip() for cell in line.split(separator)]
        own = [cells[0], *cells[1::2]] if clocks == "multi" else cells  # without those of further clocks
        body.append("\t".join(own[: len(headers)]))
    steps = {step for cell in keys.get("delta_x", []) if cell and (step := parse_number(cell))}
    rate = 1.0 / min(steps) if clocks == "no" and len(steps) == 1 and min(steps) > 0.0 else None
    return table_of(["\t".join(headers), *body], path, rate=rate, lines_before=first)


def _headers(names: list[str], units: list[str], *, timed: bool) -> list[str]:
    """The names of the columns with their units, without the column of comments."""
    named = [name for name in names if name.lower() != "comment"]
    headers, channel = [], 0
    for name in named:
        if name == _TIME:
            headers.append("time[s]" if timed else name)
            continue
        unit = units[channel] if channel < len(units) else ""
        headers.append(f"{name}[{unit}]" if unit and not ColumnHeader.parse(name).unit else name)
        channel += 1
    return headers


def _require_one_clock(lines: list[str], separator: str, path: Path, line: int) -> None:
    """RecordError where the channels of a row were not sampled at the same time."""
    for number, cells in enumerate((row.split(separator) for row in lines), start=line):
        times = {cell.strip() for cell in cells[0:-1:2] if cell.strip()}
        if len(times) > 1:
            message = (
                "the channels have clocks of their own: export them on one clock, or as files of their own"
            )
            raise RecordError(message, path, number)
