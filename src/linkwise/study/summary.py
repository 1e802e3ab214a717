"""The summary of a study, cell by cell: statistics over the seeds of one structure, noise level and method, tables for other
programs, and success maps.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from linkwise.arrays import Floats, Indices, finite
from linkwise.display import JudgedView, align_columns, to_csv
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.model.structure import Structure
from linkwise.output import atomic_file
from linkwise.study.definition import Study
from linkwise.study.store import read_rows, stored_study
from linkwise.study.subject import Row, Subject
from linkwise.verdict import Verdict

SPREAD = (0.05, 0.95)  # quantiles over the seeds that figures show about a median


@dataclass(frozen=True)
class Cell:
    """All rows of one structure, noise level and method.

    In statistics a failed case counts as worse than any answer, so that a median may not exist.

    Attributes
    ----------
    structure, method : str
        Names of the structure and the method.
    masses : int
        The number of masses and modes.
    snr_db : float
        The noise level as a signal-to-noise ratio in dB.
    expected : int
        The number of cases that the study asks for.
    answers, failures : tuple of Row
        The rows with and without an answer.
    truth : mapping of str to float
        The true coefficients in SI units by full name, as far as they are known.

    Examples
    --------
    >>> import linkwise as lw
    >>> cell = lw.study.study_summary("results/mine").cells[0]
    >>> cell.structure, cell.method, cell.snr_db, cell.done
    ('bnes2', 'weak', 40.0, 2)
    >>> cell.low <= cell.nmse <= cell.high
    True
    """

    structure: str
    masses: int
    snr_db: float
    method: str
    expected: int
    answers: tuple[Row, ...]
    failures: tuple[Row, ...]
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """The number of cases that were run, failed ones included."""
        return len(self.answers) + len(self.failures)

    @cached_property
    def nmse(self) -> float | None:
        """The median NMSE in %; None if it does not exist."""
        return finite(np.median(self._errors)) if self.done else None

    @cached_property
    def low(self) -> float | None:
        """The 5 % quantile of the NMSE in %; None if it does not exist."""
        return self._quantile(SPREAD[0])

    @cached_property
    def high(self) -> float | None:
        """The 95 % quantile of the NMSE in %; None if it does not exist."""
        return self._quantile(SPREAD[1])

    @cached_property
    def seconds(self) -> float | None:
        """The median time of one estimate in s; None without answers."""
        return float(np.median([row.seconds for row in self.answers])) if self.answers else None

    @property
    def median_row(self) -> Row | None:
        """The row whose error is closest to the median, of equally close ones that of the first seed; None without one."""
        if self.nmse is None or not self.answers:
            return None
        median = self.nmse
        return min(self.answers, key=lambda row: (abs(_row_error(row) - median), row.seed))

    def share_above(self, value: float) -> float:
        """The part of the cases, failed ones included, whose error exceeds a value.

        Parameters
        ----------
        value : float
            NMSE in %.

        Returns
        -------
        float
            The part, from 0 to 1; NaN if no case was run.
        """
        return float(np.mean(self._errors > value)) if self.done else float("nan")

    @property
    def untrusted(self) -> int:
        """The number of answers that the method itself does not trust."""
        return sum(row.status != Verdict.CONVERGED.status for row in self.answers)

    @cached_property
    def exact(self) -> int | None:
        """The number of answers with all true terms and no other; None if no answer was judged by its terms."""
        judged = [row.exact for row in self.answers if row.exact is not None]
        return sum(judged) if judged else None

    @property
    def exact_share(self) -> float | None:
        """The part of the cases with exactly the true terms, from 0 to 1; a case without an answer has not.

        None if the method does not look for terms, or no case has an answer.
        """
        return None if self.exact is None else self.exact / self.done

    @cached_property
    def wrong_trusted(self) -> int | None:
        """The number of answers that are trusted though a term is missing or extra; None as for `exact`."""
        return None if self.exact is None else sum(row.exact is False for row in self._trusted)

    @cached_property
    def extra_trusted(self) -> int | None:
        """The number of answers that are trusted though a term is extra; None as for `exact`."""
        return None if self.exact is None else sum(row.terms.get("extra", 0) > 0 for row in self._trusted)

    @property
    def _trusted(self) -> list[Row]:
        return [row for row in self.answers if row.status == Verdict.CONVERGED.status]

    @cached_property
    def intervals(self) -> int:
        """The number of intervals of coefficients in the answers that are trusted."""
        return len(self._covered)

    @cached_property
    def coverage(self) -> float | None:
        """The part of these 95 % intervals that hold the true coefficient, from 0 to 1; None without intervals."""
        return float(np.mean(self._covered)) if self._covered else None

    @cached_property
    def _covered(self) -> list[bool]:
        return [
            abs(row.coefficients[name] - self.truth[name]) <= NORMAL_95 * error
            for row in self.answers
            for name, error in row.standard_errors.items()
            if name in self.truth
        ]

    @cached_property
    def reasons(self) -> tuple[tuple[str, int], ...]:
        """The reasons of failures and their numbers, the most frequent first."""
        return tuple(Counter(row.reason for row in self.failures).most_common())

    @cached_property
    def _errors(self) -> np.ndarray:
        return np.array([_row_error(row) for row in self.answers] + [np.inf] * len(self.failures))

    def _quantile(self, probability: float) -> float | None:
        return finite(np.quantile(self._errors, probability, method="inverted_cdf")) if self.done else None


_TERMS = ("exact", "wrong, trusted", "extra, trusted")


@dataclass(frozen=True, repr=False)
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
    >>> summary = lw.study.study_summary("results/mine")
    >>> summary.complete, summary.failed_cells, summary.trusted
    (True, (), True)
    """

    name: str
    cells: tuple[Cell, ...]

    @classmethod
    def of(cls, study: Study, rows: Iterable[Row]) -> StudySummary:
        """Summarise rows of a study.

        Parameters
        ----------
        study : Study
            The study.
        rows : iterable of Row
            Rows of its cases; those of other cases are left out.

        Returns
        -------
        StudySummary
            The cells of the study with these rows.
        """
        cases = list(study.cases())
        asked, expected = set(cases), Counter(case.cell for case in cases)
        gathered = _by_cell(sorted((row for row in rows if row.case in asked), key=lambda row: row.case))
        true = {subject.name: subject.true_structure for subject in study.subjects}
        cells = (_cell_of_rows(key, true[key[0]], count, gathered[key]) for key, count in expected.items())
        return cls(study.name, tuple(cells))

    @classmethod
    def of_rows(cls, rows: Iterable[Row]) -> StudySummary:
        """Summarise rows without a study, of which no case counts as missing.

        Parameters
        ----------
        rows : iterable of Row
            The rows.

        Returns
        -------
        StudySummary
            The cells in the order in which they appear.
        """
        cells = (
            Cell(structure, inside[0].masses, snr_db, method, len(inside), *_split_by_answer(inside))
            for (structure, snr_db, method), inside in _by_cell(rows).items()
        )
        return cls("", tuple(cells))

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What of the study was not run, and what has no answer."""
        failed = [cell for cell in self.cells if cell.failures]
        holds = {
            Verdict.STUDY_INCOMPLETE: self.missing > 0,
            Verdict.CELLS_WITHOUT_ANSWER: any(not cell.answers for cell in failed),
            Verdict.CASES_WITHOUT_ANSWER: any(cell.answers for cell in failed),
        }
        return tuple(verdict for verdict, applies in holds.items() if applies) or (Verdict.STUDY_COMPLETE,)

    @property
    def structures(self) -> tuple[str, ...]:
        """The names of the structures, fewest masses first."""
        return tuple(self.masses)

    @cached_property
    def masses(self) -> dict[str, int]:
        """The number of masses of each structure, fewest first."""
        return {cell.structure: cell.masses for cell in sorted(self.cells, key=lambda cell: cell.masses)}

    @property
    def decibels(self) -> tuple[float, ...]:
        """The noise levels in dB, least noise first."""
        return tuple(sorted({cell.snr_db for cell in self.cells}, reverse=True))

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods, in the order of the study."""
        return tuple(dict.fromkeys(cell.method for cell in self.cells))

    def cell(self, structure: str, snr_db: float, method: str) -> Cell | None:
        """One cell.

        Parameters
        ----------
        structure : str
            Name of its structure.
        snr_db : float
            Its noise level in dB.
        method : str
            Name of its method.

        Returns
        -------
        Cell or None
            The cell; None if it is not part of the study.
        """
        return self._index.get((structure, snr_db, method))

    @property
    def missing(self) -> int:
        """The number of cases that were not run."""
        return sum(cell.expected - cell.done for cell in self.cells)

    @property
    def failed(self) -> int:
        """The number of cases without an answer."""
        return sum(len(cell.failures) for cell in self.cells)

    @property
    def expected(self) -> int:
        """The number of cases of the study."""
        return sum(cell.expected for cell in self.cells)

    @cached_property
    def _index(self) -> dict[tuple[str, float, str], Cell]:
        return {(cell.structure, cell.snr_db, cell.method): cell for cell in self.cells}

    @property
    def complete(self) -> bool:
        """Whether every case was run."""
        return not self.missing

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
        counts = {"cases": self.expected, "done": self.expected - self.missing, "failed": self.failed}
        return {"study": self.name, **counts, **self._judgement(), "cells": cells}

    def __str__(self) -> str:
        lacks = [verdict.value for verdict in self.verdicts if verdict is not Verdict.STUDY_COMPLETE]
        done = self.expected - self.missing
        head = f"{self.name}: {done} of {self.expected} cases done, {self.failed} failed"
        blocks = ["\n".join([head, *lacks])]
        judged = any(cell.exact is not None for cell in self.cells)
        for (structure, level), group in groupby(self.cells, key=lambda cell: (cell.structure, cell.snr_db)):
            lines: list[tuple[str, ...]] = [
                ("method", "median %", "worst %", "failed", "untrusted", "of", "covered", "seconds")
                + (_TERMS if judged else ())
            ]
            lines += [_printed_row(cell_record(cell), judged) for cell in group]
            blocks.append("\n".join([f"{structure}, {level:g} dB", *align_columns(lines)]))
        reasons = [
            f"! {cell.structure}, {cell.snr_db:g} dB, {cell.method} failed {count} times: {reason}"
            for cell in self.cells
            for reason, count in cell.reasons[:1]
        ]
        return "\n\n".join([*blocks, *(["\n".join(reasons)] if reasons else [])])


def _by_cell(rows: Iterable[Row]) -> dict[tuple[str, float, str], list[Row]]:
    gathered: dict[tuple[str, float, str], list[Row]] = defaultdict(list)
    for row in rows:
        gathered[row.case.cell].append(row)
    return gathered


def _cell_of_rows(key: tuple[str, float, str], true: Structure, expected: int, rows: Sequence[Row]) -> Cell:
    structure, snr_db, method = key
    answers, failures = _split_by_answer(rows)
    names = {name for row in answers for name in row.standard_errors}
    values = {name: true.coefficient(name).value for name in names}
    truth = {name: value for name, value in values.items() if value is not None}
    return Cell(structure, true.size, snr_db, method, expected, answers, failures, truth)


def _split_by_answer(rows: Sequence[Row]) -> tuple[tuple[Row, ...], tuple[Row, ...]]:
    """The rows with and without an answer: an error of forces, or terms that were judged."""
    judged = [(np.isfinite(_row_error(row)) or row.exact is not None, row) for row in rows]
    return tuple(row for yes, row in judged if yes), tuple(row for yes, row in judged if not yes)


def _row_error(row: Row) -> float:
    """The error of a row in %, infinite if there is none."""
    return float("inf") if row.failed or row.nmse is None or np.isnan(row.nmse) else row.nmse


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
    >>> summary = lw.study.study_summary("results/mine")
    >>> print(str(summary).splitlines()[0])
    mine: 2 of 2 cases done, 0 failed
    """
    study = stored_study(folder)
    return StudySummary.of(study, read_rows(folder))


@dataclass(frozen=True, eq=False)
class SuccessMap:
    """How often a method has the true terms of a structure in records of one length.

    Counts have a row for each sampling rate and a column for each noise level. A case without an answer is not exact.

    Attributes
    ----------
    name : str
        The structure and the length, as the study names them.
    method : str
        The name of the method.
    snr_db : array of shape (D,)
        Signal-to-noise ratios in dB, rising.
    rates : array of shape (S,)
        Samples a second in Hz, rising.
    frequency : float or None
        The frequency in Hz by which samples a period are counted, if the study states one.
    cases : array of int, shape (S, D)
        The cases that were run.
    exact : array of int, shape (S, D)
        Answers with all true terms and no other.
    wrong_trusted : array of int, shape (S, D)
        Answers that are trusted though a term is missing or extra.
    extra_trusted : array of int, shape (S, D)
        Answers that are trusted though a term is extra.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.study.success_maps("results/mine")  # its methods are told the terms
    ()
    """

    name: str
    method: str
    snr_db: Floats
    rates: Floats
    frequency: float | None
    cases: Indices
    exact: Indices
    wrong_trusted: Indices
    extra_trusted: Indices

    @property
    def samples(self) -> Floats:
        """(S,) samples a period, or a second where the study states no frequency."""
        return self.rates / (self.frequency or 1.0)

    @property
    def exact_share(self) -> Floats:
        """(S, D) the part of the cases that are exact, from 0 to 1; NaN where none was run."""
        return _share(self.exact, self.cases)

    @property
    def wrong_trusted_share(self) -> Floats:
        """(S, D) the part of the cases that are wrong and trusted, from 0 to 1; NaN where none was run."""
        return _share(self.wrong_trusted, self.cases)


def success_maps(folder: str | Path) -> tuple[SuccessMap, ...]:
    """Count how often each method of a study that looks for terms has exactly the true ones.

    Parameters
    ----------
    folder : str or path
        The folder of the study, finished or not.

    Returns
    -------
    tuple of SuccessMap
        One for each structure and length of the records, as they follow in the study, and each such method.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> for success in lw.study.success_maps("results/mine"):
    ...     print(success.name, success.method, success.exact_share)
    """
    study = stored_study(folder)
    return maps_of(study, StudySummary.of(study, read_rows(folder)))


def maps_of(study: Study, table: StudySummary) -> tuple[SuccessMap, ...]:
    """The maps of all methods of `study` that look for terms, structure by structure, from its `table`.

    A method without any answer is never exact.
    """
    judged = {cell.method for cell in table.cells if cell.exact is not None}
    answered = {cell.method for cell in table.cells if cell.answers}
    run = {cell.method for cell in table.cells if cell.done}
    judged |= {method.name for method in study.methods if method.looks_for_terms} & (run - answered)
    names = [method.name for method in study.methods if method.name in judged]
    return tuple(_map(subjects, name, table) for subjects in _alike(study.subjects) for name in names)


def _alike(subjects: Sequence[Subject]) -> list[tuple[Subject, ...]]:
    """Subjects that differ in name and sampling rate alone, together by rising rate."""
    groups: list[tuple[dict[str, object], dict[float, Subject]]] = []
    for subject in subjects:
        document = {key: value for key, value in subject.document().items() if key not in ("name", "rate")}
        open_ = (rates for known, rates in groups if known == document and subject.rate not in rates)
        group = next(open_, {})
        if not group:
            groups.append((document, group))
        group[subject.rate] = subject
    return [tuple(rates[rate] for rate in sorted(rates)) for _, rates in groups]


def _map(subjects: Sequence[Subject], method: str, table: StudySummary) -> SuccessMap:
    decibels = table.decibels[::-1]
    cells = [[table.cell(subject.name, level, method) for level in decibels] for subject in subjects]

    def counts(name: str) -> Indices:
        return np.array([[getattr(cell, name, None) or 0 for cell in line] for line in cells], dtype=np.intp)

    return SuccessMap(
        name=_common_name([subject.name for subject in subjects]),
        method=method,
        snr_db=np.array(decibels),
        rates=np.array([subject.rate for subject in subjects]),
        frequency=subjects[0].frequency,
        cases=counts("done"),
        exact=counts("exact"),
        wrong_trusted=counts("wrong_trusted"),
        extra_trusted=counts("extra_trusted"),
    )


def _common_name(names: Sequence[str]) -> str:
    """The parts between commas with which all names begin; the first name where they begin with nothing in common."""
    together = zip(*(name.split(", ") for name in names), strict=False)
    common = takewhile(lambda parts: len(set(parts)) == 1, together)
    return ", ".join(parts[0] for parts in common) or names[0]


def _share(count: Indices, cases: Indices) -> Floats:
    return np.where(cases > 0, count / np.maximum(cases, 1), np.nan)


_OF_CELL = (
    "structure", "masses", "snr_db", "method", "cases", "done", "failed", "untrusted", "median", "low", "high", "worst",
    "coverage", "intervals", "seconds", "exact", "wrong_trusted", "extra_trusted",
)  # fmt: skip


def cell_record(cell: Cell) -> dict[str, Any]:
    """A cell as a table line.

    NMSE in %: median and 5 and 95 % quantiles over the seeds, a failed one counting as worst, and the worst of those with an
    answer. `untrusted` counts answers that the method itself does not trust; `coverage` is the part of the 95 % `intervals` of
    coefficients in the others that hold the true value. Of methods that look for terms, `exact` counts the answers with the
    true terms and no other, and `wrong_trusted` those that are trusted with a term missing or extra, `extra_trusted` those
    with one extra.
    """
    errors = [row.nmse for row in cell.answers if row.nmse is not None]
    other = {"cases": cell.expected, "failed": len(cell.failures), "median": cell.nmse}
    other["worst"] = max(errors, default=None)
    return {name: other[name] if name in other else getattr(cell, name) for name in _OF_CELL}


def _printed_row(record: dict[str, Any], judged: bool) -> tuple[str, ...]:
    """A line of the table; where methods are `judged` by their terms, with how many answers have the true ones."""
    counts = (record["exact"], record["wrong_trusted"], record["extra_trusted"]) if judged else ()
    median, worst, seconds = (
        "-" if record[key] is None else f"{record[key]:.3g}" for key in ("median", "worst", "seconds")
    )
    numbers = (str(record[key]) for key in ("failed", "untrusted", "done"))
    last = (covered(record["coverage"], record["intervals"]), seconds)
    terms = ("-" if count is None else str(count) for count in counts)
    return record["method"], median, worst, *numbers, *last, *terms


def covered(coverage: float | None, intervals: int) -> str:
    """How many intervals hold the true value, such as "94 % of 250"; a dash without intervals."""
    return "-" if coverage is None else f"{100.0 * coverage:.3g} % of {intervals}"


ROWS, SUMMARY = "rows.csv", "summary.csv"


def export_study(folder: str | Path) -> tuple[Path, ...]:
    """Write the tables of a study, finished or not, into its folder.

    Parameters
    ----------
    folder : str or path
        The folder of the study.

    Returns
    -------
    tuple of pathlib.Path
        rows.csv and summary.csv; each appears whole or not at all.

    Raises
    ------
    StudyError
        If the folder does not hold a study.

    Examples
    --------
    >>> import linkwise as lw
    >>> [path.name for path in lw.study.export_study("results/mine")]
    ['rows.csv', 'summary.csv']
    """
    folder = Path(folder)
    rows = read_rows(folder)
    cells = study_summary(folder).cells
    with atomic_file(folder / ROWS) as path:
        to_csv(path, [_EMPTY, *(row_record(row).values() for row in rows)])
    with atomic_file(folder / SUMMARY) as path:
        to_csv(path, [_OF_CELL, *(cell_record(cell).values() for cell in cells)])
    return folder / ROWS, folder / SUMMARY


# first, then as they come
_COLUMNS = ("structure", "masses", "snr_db", "method", "seed", "status", "nmse", "worst")


def row_record(row: Row) -> dict[str, Any]:
    """A row as a table line: NMSE in % (`nmse` is the median over its links), mappings as JSON."""
    values = {**msgspec.to_builtins(row), "nmse": row.nmse, "worst": row.worst, "exact": row.exact}
    plain = {name: json.dumps(value) if isinstance(value, dict) else value for name, value in values.items()}
    return {**{name: plain[name] for name in _COLUMNS}, **plain}


_EMPTY = row_record(Row("", 0, 0.0, "", 0, status=""))
