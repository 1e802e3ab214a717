"""Excel workbooks: the first sheet with numbers, read as a text file with the same cells would be."""

from __future__ import annotations

from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import openpyxl

from linkwise.errors import RecordError
from linkwise.files.table import Table
from linkwise.files.text import table_of


def read_table(path: Path, header: str | int | None = None) -> Table:
    """The columns of a sheet; see `files.read_record`. A note names sheets with numbers that were not read."""
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        names = book.sheetnames
        sheets = {name: list(map(list, book[name].iter_rows(values_only=True))) for name in names}
    finally:
        book.close()
    filled = [name for name, rows in sheets.items() if any(_is_number(cell) for row in rows for cell in row)]
    if not filled:
        raise RecordError("no sheet of the workbook holds numbers", path)
    rows = sheets[filled[0]]
    width = max(number + 1 for row in rows for number, cell in enumerate(row) if cell is not None)
    lines = ["\t".join(_text(cell) for cell in row[:width]) for row in rows]
    others = ", ".join(filled[1:])
    notes = (f"Sheet {filled[0]} was read; {others} was not.",) if others else ()
    return table_of(lines, path, notes=notes, named_header=header)


def _is_number(cell: Any) -> bool:
    return isinstance(cell, int | float) and not isinstance(cell, bool)


def _text(cell: Any) -> str:
    """A cell as text that holds all digits of a number."""
    if cell is None:
        return ""
    if _is_number(cell):
        return repr(float(cell))
    if isinstance(cell, datetime | date | time):
        return cell.isoformat()
    return str(cell).replace("\t", " ").replace("\n", " ")
