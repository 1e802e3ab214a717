"""An answer as a table for spreadsheets, in which no text is run as a formula."""

from __future__ import annotations

from dataclasses import astuple
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

from linkwise.display import on_one_line, to_csv
from linkwise.errors import OutputError
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.export.answer import ExportedAnswer
from linkwise.model.link import ANGLE, LENGTH
from linkwise.model.parameters import SHAPE_UNITS

_HEADER = ("of", "coefficient", "value", "unit", "standard error", "lower", "upper", "law")


def write_csv(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the coefficients as CSV; `name` is not needed in it."""
    to_csv(path, _table(answer), encoding="utf-8-sig")


def write_xlsx(answer: ExportedAnswer, path: Path, name: str) -> None:
    """Write the coefficients and their covariance as two sheets; `name` is not needed in it.

    Raises OutputError where openpyxl is not installed.
    """
    if find_spec("openpyxl") is None:
        raise OutputError(
            f"{name}.xlsx: Excel files need the library openpyxl, which the extra 'files' installs: "
            "pip install 'linkwise[files]'; or export a .csv file"
        )
    book = import_module("openpyxl").Workbook()
    _fill(book.active, "coefficients", _table(answer))
    covariance = [[name, *row] for name, row in zip(answer.names, answer.covariance.tolist(), strict=True)]
    _fill(book.create_sheet(), "covariance", [["", *answer.names], *covariance])
    content = BytesIO()
    # closed: one that was not written whole complains when forgotten
    with ZipFile(content, "w", ZIP_DEFLATED) as archive:
        import_module("openpyxl.writer.excel").ExcelWriter(book, archive).save()
    path.write_bytes(content.getvalue())


def _rows(answer: ExportedAnswer) -> list[list[Any]]:
    """A row for each mass and coefficient: its interval of 95 %, and the law of its link; None where there is nothing.

    Then one for the shape of each mode at each point of its host.
    """
    laws = {link.name: link.law.text for link in answer.structure.links}
    rows: list[list[Any]] = []
    for coefficient in answer.coefficients:
        law = laws.get(coefficient.owner) if coefficient.name != "mass" else None
        half = None if coefficient.error is None else NORMAL_95 * coefficient.error
        ends = [None, None] if half is None else [coefficient.value - half, coefficient.value + half]
        rows.append([*astuple(coefficient), *ends, law])
    for point, parts in answer.points.items():
        unit = SHAPE_UNITS[ANGLE if point in answer.structure.rotations else LENGTH]
        rows += [[mode, f"shape at {point}", part, unit, *[None] * 4] for mode, part in parts.items()]
    return rows


def _table(answer: ExportedAnswer) -> list[list[Any]]:
    """The header and the rows; where the answer is not trusted all of them say so, since rows are sorted and copied.

    Texts have one line each: sheets take no control characters, which a law may have as spaces.
    """
    table = [list(_HEADER), *_rows(answer)]
    if remark := answer.basis.remark:
        table = [[*row, remark if number else "note"] for number, row in enumerate(table)]
    return [[on_one_line(cell) if isinstance(cell, str) else cell for cell in row] for row in table]


def _fill(sheet: Any, title: str, rows: list[list[Any]]) -> None:
    sheet.title = title
    for number, row in enumerate(rows, start=1):
        for column, value in enumerate(row, start=1):
            cell = sheet.cell(number, column, value)
            if isinstance(value, str):
                cell.data_type = "s"  # also of a text that begins as a formula does
