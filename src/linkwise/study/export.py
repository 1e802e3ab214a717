"""The rows of a study and their summary by cell as tables for other programs."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from linkwise.argument_types import checked
from linkwise.display import csv_cell
from linkwise.output import atomic_file
from linkwise.study.row import Row
from linkwise.study.store import read_rows
from linkwise.study.summary import cell_record, study_summary

ROWS, SUMMARY, PARQUET = "rows.csv", "summary.csv", "rows.parquet"


@checked
def export_study(folder: str | Path) -> tuple[Path, ...]:
    """Write the tables of a study, finished or not, into its folder.

    Parameters
    ----------
    folder : str or path
        The folder of the study.

    Returns
    -------
    tuple of pathlib.Path
        rows.csv, summary.csv and, if pyarrow is installed, rows.parquet; each appears whole or not at all.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> [path.name for path in lw.export_study("results/mine")][:2]
    ['rows.csv', 'summary.csv']
    """
    folder = Path(folder)
    rows = read_rows(folder)
    cells = study_summary(folder).cells
    with atomic_file(folder / ROWS) as path:
        _write_csv(path, list(_EMPTY), [row_record(row) for row in rows])
    with atomic_file(folder / SUMMARY) as path:
        summary = [cell_record(cell) for cell in cells]
        _write_csv(path, list(summary[0]), summary)
    written = [folder / ROWS, folder / SUMMARY]
    if rows and find_spec("pyarrow") is not None:
        with atomic_file(folder / PARQUET) as path:
            import_module("linkwise.study.parquet").write([row_record(row) for row in rows], path)
        written.append(folder / PARQUET)
    return tuple(written)


def row_record(row: Row) -> dict[str, Any]:
    """A row as a table line: NMSE in % (`nmse` is the median over its links), mappings as JSON."""
    return {
        "structure": row.structure,
        "masses": row.masses,
        "snr_db": row.snr_db,
        "method": row.method,
        "seed": row.seed,
        "status": row.status,
        "nmse": row.nmse,
        "worst": row.worst,
        "seconds": row.seconds,
        "links": json.dumps(dict(row.links)),
        "coefficients": json.dumps(dict(row.coefficients)),
        "standard_errors": json.dumps(dict(row.standard_errors)),
        "reason": row.reason,
        "exact": row.exact,
        "terms": json.dumps(dict(row.terms)),
    }


_EMPTY = row_record(Row("", 0, 0.0, "", 0, ""))


def _write_csv(path: Path, names: Sequence[str], records: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: csv_cell(value) for name, value in record.items()} for record in records)
