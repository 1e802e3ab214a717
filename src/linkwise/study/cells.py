"""The rows of a study, told as cells: what many seeds of one structure, noise and method come to."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.study.definition import Study
from linkwise.study.row import Case, Row

SPREAD = (0.05, 0.95)  # quantiles of the seeds that figures show about a median


@dataclass(frozen=True)
class Cell:
    """All rows of one structure, noise in dB and method.

    `nmse` is the median over seeds in %, `low` and `high` the quantiles `SPREAD`, a failed case counting as worse than any
    answer; each is None where so many failed, or none was run, that it is no number. `seconds` is the median time of one
    estimate, None where none was run. `expected` counts the cases that the study asks for. `median_row` is the row whose error
    comes closest to the median.
    """

    structure: str
    masses: int
    snr_db: float
    method: str
    expected: int
    answers: tuple[Row, ...]
    failures: tuple[Row, ...]

    @property
    def done(self) -> int:
        """Cases that were run, failed ones too."""
        return len(self.answers) + len(self.failures)

    @cached_property
    def nmse(self) -> float | None:
        """Median NMSE in %."""
        return _number(np.median(self._errors)) if self.done else None

    @cached_property
    def low(self) -> float | None:
        """The lower quantile of `SPREAD`, in %."""
        return self._quantile(SPREAD[0])

    @cached_property
    def high(self) -> float | None:
        """The upper quantile of `SPREAD`, in %."""
        return self._quantile(SPREAD[1])

    @cached_property
    def seconds(self) -> float | None:
        """Median time of an estimate."""
        return float(np.median([row.seconds for row in self.answers])) if self.answers else None

    @property
    def median_row(self) -> Row | None:
        """The answer that stands for the cell; of equally close ones the first seed's."""
        if self.nmse is None or not self.answers:
            return None
        median = self.nmse
        return min(self.answers, key=lambda row: (abs(_error(row) - median), row.seed))

    def share_above(self, value: float) -> float:
        """The part of the seeds, failed ones included, whose error is above `value` in %; NaN where none was run."""
        return float(np.mean(self._errors > value)) if self.done else float("nan")

    @cached_property
    def reasons(self) -> tuple[tuple[str, int], ...]:
        """Why cases failed and how many for each reason, the most frequent first."""
        return tuple(Counter(row.reason for row in self.failures).most_common())

    @cached_property
    def _errors(self) -> np.ndarray:
        return np.array([_error(row) for row in self.answers] + [np.inf] * len(self.failures))

    def _quantile(self, part: float) -> float | None:
        return _number(np.quantile(self._errors, part, method="inverted_cdf")) if self.done else None


@dataclass(frozen=True)
class StudyTable:
    """The cells of a study, and the orders in which its structures, noise levels and methods stand."""

    cells: tuple[Cell, ...]

    @classmethod
    def of(cls, study: Study, rows: Iterable[Row]) -> StudyTable:
        """The cells that `study` asks for, filled from `rows`; rows that it does not ask for are left out."""
        expected: dict[tuple[str, float, str], set[Case]] = defaultdict(set)
        for case in study.cases():
            expected[case.structure, case.snr_db, case.method].add(case)
        found: dict[tuple[str, float, str], list[Row]] = defaultdict(list)
        for row in sorted(rows, key=lambda row: row.case):
            key = row.structure, row.snr_db, row.method
            if row.case in expected.get(key, ()):
                found[key].append(row)
        return cls(
            tuple(
                _cell(key, study.subject(key[0]).structure.size, len(cases), found[key])
                for key, cases in expected.items()
            )
        )

    @classmethod
    def of_rows(cls, rows: Iterable[Row]) -> StudyTable:
        """The cells that `rows` fill, in the order in which they first appear; every case counts as run."""
        found: dict[tuple[str, float, str], list[Row]] = defaultdict(list)
        for row in rows:
            found[row.structure, row.snr_db, row.method].append(row)
        return cls(tuple(_cell(key, inside[0].masses, len(inside), inside) for key, inside in found.items()))

    @property
    def structures(self) -> tuple[str, ...]:
        """Names of the structures, fewest masses first."""
        return tuple(self.masses)

    @cached_property
    def masses(self) -> dict[str, int]:
        """The number of masses of each structure, fewest first."""
        return {cell.structure: cell.masses for cell in sorted(self.cells, key=lambda cell: cell.masses)}

    @property
    def decibels(self) -> tuple[float, ...]:
        """Noise levels, least noise first."""
        return tuple(sorted({cell.snr_db for cell in self.cells}, reverse=True))

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods in the study's order."""
        return tuple(dict.fromkeys(cell.method for cell in self.cells))

    def cell(self, structure: str, snr_db: float, method: str) -> Cell | None:
        """One cell, None where the study does not ask for it."""
        return self._index.get((structure, snr_db, method))

    @property
    def missing(self) -> int:
        """Cases that were not run."""
        return sum(cell.expected - cell.done for cell in self.cells)

    @property
    def failed(self) -> int:
        """Cases without an answer."""
        return sum(len(cell.failures) for cell in self.cells)

    @property
    def expected(self) -> int:
        """Cases that the study asks for."""
        return sum(cell.expected for cell in self.cells)

    @cached_property
    def _index(self) -> dict[tuple[str, float, str], Cell]:
        return {(cell.structure, cell.snr_db, cell.method): cell for cell in self.cells}


def _cell(key: tuple[str, float, str], masses: int, expected: int, rows: Sequence[Row]) -> Cell:
    structure, snr_db, method = key
    answers = tuple(row for row in rows if np.isfinite(_error(row)))
    failures = tuple(row for row in rows if not np.isfinite(_error(row)))
    return Cell(structure, masses, snr_db, method, expected, answers, failures)


def _error(row: Row) -> float:
    """The row's error in %, infinite where there is none."""
    return float("inf") if row.failed or row.nmse is None or np.isnan(row.nmse) else row.nmse


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
