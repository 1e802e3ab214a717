"""Success maps of a study: how often a method has exactly the true links and terms, over noise and samples a period."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.study.definition import Study
from linkwise.study.store import read_rows, stored_study
from linkwise.study.subject import Subject
from linkwise.study.summary import Cell, StudySummary


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
        return np.array([[_count(cell, name) for cell in line] for line in cells], dtype=np.intp)

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


def _count(cell: Cell | None, name: str) -> int:
    return 0 if cell is None else getattr(cell, name) or 0


def _common_name(names: Sequence[str]) -> str:
    """The parts between commas with which all names begin; the first name where they begin with nothing in common."""
    together = zip(*(name.split(", ") for name in names), strict=False)
    common = takewhile(lambda parts: len(set(parts)) == 1, together)
    return ", ".join(parts[0] for parts in common) or names[0]


def _share(count: Indices, cases: Indices) -> Floats:
    return np.where(cases > 0, count / np.maximum(cases, 1), np.nan)
