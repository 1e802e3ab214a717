"""LVM, the text format of LabVIEW measurements: a header of keys, then tab-separated columns."""

from __future__ import annotations

from pathlib import Path

from linkwise.errors import RecordError
from linkwise.files.csv import table_of
from linkwise.files.header import ColumnHeader
from linkwise.files.lines import read_lines
from linkwise.files.table import Table

_END = "***End_of_Header***"
_TIME = "X_Value"


def read_table(path: Path) -> Table:
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
    keys = _keys(lines[: ends[-1]], separator)
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
    rows = [
        _row(line.split(separator), len(headers), multiple=clocks == "multi") for line in lines[first + 1 :]
    ]
    body = ["\t".join(row) for row in rows]
    steps = [float(step.replace(",", ".")) for step in keys.get("delta_x", []) if _is_number(step)]
    rate = 1.0 / steps[0] if clocks == "no" and steps and steps[0] > 0.0 and len(set(steps)) == 1 else None
    return table_of(["\t".join(headers), *body], path, rate=rate, lines_before=first)


def _keys(lines: list[str], separator: str) -> dict[str, list[str]]:
    """Values by key of the header, in lower case."""
    cells = [line.split(separator) for line in lines]
    return {row[0].strip().lower(): [cell.strip() for cell in row[1:]] for row in cells if len(row) > 1}


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


def _row(cells: list[str], count: int, *, multiple: bool) -> list[str]:
    """The cells of the named columns; those of further clocks are left out."""
    if multiple:
        cells = [cell for index, cell in enumerate(cells) if index % 2 or index == 0]
    return [cell.strip() for cell in cells[:count]]


def _require_one_clock(lines: list[str], separator: str, path: Path, line: int) -> None:
    """RecordError where the channels of a row were not sampled at the same time."""
    for number, cells in enumerate((row.split(separator) for row in lines), start=line):
        times = {cell.strip() for cell in cells[0:-1:2] if cell.strip()}
        if len(times) > 1:
            raise RecordError(
                "the channels have clocks of their own: export them on one clock, or as files of their own",
                path,
                number,
            )


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
