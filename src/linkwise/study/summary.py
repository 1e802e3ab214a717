"""The summary of a study, cell by cell."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated, DeprecatedAttribute
from linkwise.display import JudgedView, align_columns
from linkwise.study.cells import Cell, StudyTable
from linkwise.study.store import read_rows, stored_study
from linkwise.verdict import Verdict

_TERMS = ("exact", "wrong, trusted", "extra, trusted")


@dataclass(frozen=True)
class StudySummary(JudgedView):
    """The summary of a study; printed, a table for each structure and noise level.

    Attributes
    ----------
    name : str
        The name of the study.
    cells : tuple of Cell
        The cells in the order of the study: by structure, noise level and method.

    Examples
    --------
    >>> import linkwise as lw
    >>> summary = lw.study_summary("results/mine")
    >>> summary.complete, summary.failed_cells, summary.trusted
    (True, (), True)
    """

    name: str
    cells: tuple[Cell, ...]

    hopeless = DeprecatedAttribute(Deprecated("failed_cells", since="0.2.0", until="0.4.0"))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What of the study was not run, and what has no answer."""
        return StudyTable(self.cells).verdicts

    @property
    def complete(self) -> bool:
        """Whether every case was run."""
        return all(cell.done == cell.expected for cell in self.cells)

    @property
    def failed_cells(self) -> tuple[Cell, ...]:
        """The cells in which every case failed."""
        return tuple(cell for cell in self.cells if cell.done and not cell.answers)

    def to_dict(self) -> dict[str, Any]:
        """The summary as plain data: numbers of cases, and the cells as in summary.csv.

        Returns
        -------
        dict
            "study", "cases", "done", "failed", "verdicts", "trusted" and "cells".
        """
        cells = [cell_record(cell) for cell in self.cells]
        return {"study": self.name, **self._counts(), **self._judgement(), "cells": cells}

    def __str__(self) -> str:
        counts = self._counts()
        lacks = [verdict.value for verdict in self.verdicts if verdict is not Verdict.STUDY_COMPLETE]
        head = "{}: {done} of {cases} cases done, {failed} failed".format(self.name, **counts)
        blocks = ["\n".join([head, *lacks])]
        judged = any(cell.exact is not None for cell in self.cells)
        for (structure, level), group in groupby(self.cells, key=lambda cell: (cell.structure, cell.snr_db)):
            lines: list[tuple[str, ...]] = [
                ("method", "median %", "worst %", "failed", "untrusted", "of", "covered", "seconds")
                + (_TERMS if judged else ())
            ]
            lines += [_line(cell_record(cell), judged) for cell in group]
            blocks.append("\n".join([f"{structure}, {level:g} dB", *align_columns(lines)]))
        reasons = [
            f"! {cell.structure}, {cell.snr_db:g} dB, {cell.method} failed {count} times: {reason}"
            for cell in self.cells
            for reason, count in cell.reasons[:1]
        ]
        return "\n\n".join([*blocks, *(["\n".join(reasons)] if reasons else [])])

    def _counts(self) -> dict[str, int]:
        return {
            "cases": sum(cell.expected for cell in self.cells),
            "done": sum(cell.done for cell in self.cells),
            "failed": sum(len(cell.failures) for cell in self.cells),
        }


@checked
def study_summary(folder: str | Path) -> StudySummary:
    """Summarise a study.

    Parameters
    ----------
    folder : str or path
        The folder of the study, finished or not.

    Returns
    -------
    StudySummary
        Statistics over the seeds of each structure, noise level and method.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> summary = lw.study_summary("results/mine")
    >>> print(str(summary).splitlines()[0])
    mine: 2 of 2 cases done, 0 failed
    """
    study = stored_study(folder)
    return StudySummary(study.name, StudyTable.of(study, read_rows(folder)).cells)


def cell_record(cell: Cell) -> dict[str, Any]:
    """A cell as a table line.

    NMSE in %: median and 5 and 95 % quantiles over the seeds, a failed one counting as worst, and the worst of those with an
    answer. `untrusted` counts answers that the method itself does not trust; `coverage` is the part of the 95 % `intervals` of
    coefficients in the others that hold the true value. Of methods that look for terms, `exact` counts the answers with the
    true terms and no other, and `wrong_trusted` those that are trusted with a term missing or extra, `extra_trusted` those
    with one extra.
    """
    errors = [row.nmse for row in cell.answers if row.nmse is not None]
    return {
        "structure": cell.structure,
        "masses": cell.masses,
        "snr_db": cell.snr_db,
        "method": cell.method,
        "cases": cell.expected,
        "done": cell.done,
        "failed": len(cell.failures),
        "untrusted": cell.untrusted,
        "median": cell.nmse,
        "low": cell.low,
        "high": cell.high,
        "worst": max(errors, default=None),
        "coverage": cell.coverage,
        "intervals": cell.intervals,
        "seconds": cell.seconds,
        "exact": cell.exact,
        "wrong_trusted": cell.wrong_trusted,
        "extra_trusted": cell.extra_trusted,
    }


def _line(record: dict[str, Any], judged: bool) -> tuple[str, ...]:
    """A line of the table; where methods are `judged` by their terms, with how many answers have the true ones."""
    counts = (record["exact"], record["wrong_trusted"], record["extra_trusted"]) if judged else ()
    return (
        record["method"],
        *("-" if record[key] is None else f"{record[key]:.3g}" for key in ("median", "worst")),
        *(str(record[key]) for key in ("failed", "untrusted", "done")),
        covered(record["coverage"], record["intervals"]),
        "-" if record["seconds"] is None else f"{record['seconds']:.3g}",
        *("-" if count is None else str(count) for count in counts),
    )


def covered(coverage: float | None, intervals: int) -> str:
    """How many intervals hold the true value, such as "94 % of 250"; a dash without intervals."""
    return "-" if coverage is None else f"{100.0 * coverage:.3g} % of {intervals}"
