"""Rows of the paper's study that nobody had to compute: errors as a test wants them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import sqrt
from pathlib import Path

from linkwise.paper.tables import TABLE_2
from linkwise.study.definition import Study, read_study
from linkwise.study.store import open_store
from linkwise.study.subject import Case, Row

CYCLES = 3
SPREAD = (0.5, 1.0, 2.0)  # of the errors of the three cycles
BEST = "classical, differenced"


def paper_study() -> Study:
    """The study that ships with linkwise, with three cycles."""
    return replace(read_study("paper"), cycles=CYCLES)


def error(case: Case, masses: int) -> float:
    """Median NMSE in %: one convention within 10 % of the paper, the others 50 times off, ours far below."""
    if case.method.startswith("classical"):
        return TABLE_2[masses, case.snr_db] * (1.1 if case.method == BEST else 50.0)
    return {"physics-informed": 0.4, "weak": 1e-2, "ml": 1e-4}[case.method]


def paper_rows(study: Study, median: Callable[[Case, int], float] = error) -> list[Row]:
    """A row a case; its links and coefficients are off by what makes its NMSE."""
    return [_row(study, case, median) for case in study.cases()]


def _row(study: Study, case: Case, median: Callable[[Case, int], float]) -> Row:
    subject = study.subject(case.structure)
    masses = subject.structure.size
    nmse = median(case, masses) * SPREAD[case.seed - study.first_seed]
    factor = 1.0 + sqrt(nmse / 100.0)  # NMSE is 100 % of the square, where the force has no mean
    off = {
        f"{link}.{name}": value * factor
        for link in subject.judged_links
        for name, value in (("alpha", -100.0), ("beta", 1e6))
    }
    links = dict.fromkeys(subject.judged_links, nmse)
    row = Row(case.structure, masses, case.snr_db, case.method, case.seed, status="converged", links=links)
    return replace(row, coefficients=off, seconds=0.01 * masses)


def stored(folder: Path, study: Study, rows: Sequence[Row]) -> Path:
    """A study folder that holds the rows."""
    with open_store(folder, study) as store:
        store.add(rows)
    return folder
