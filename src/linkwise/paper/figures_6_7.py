"""Figures 6 and 7 of the paper: the sink's force in the cycle whose error is the median of its cell."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from linkwise.model.structure import Link
from linkwise.paper.published import DECIBELS
from linkwise.paper.subset import PaperStudy
from linkwise.plot import force_comparison_figure
from linkwise.plot.palette import IDENTIFIED, SERIES
from linkwise.study.cells import StudyTable
from linkwise.study.definition import Study
from linkwise.study.row import Row
from linkwise.study.subject import Subject

_LEVELS = dict(zip(DECIBELS, (SERIES[2], SERIES[5], SERIES[1]), strict=True))


def figure_6(study: Study, table: StudyTable, paper: PaperStudy, classical: str) -> Figure | None:
    """The chain of two masses: a the force found at 20 dB by the method `classical`, b its error at 40, 30 and 20 dB.

    The maximum likelihood at 20 dB stands beside it. None where the study has no such answer.
    """
    return _figure(study, table, paper, 2, classical, shown=DECIBELS[-1:])


def figure_7(study: Study, table: StudyTable, paper: PaperStudy, classical: str) -> Figure | None:
    """The same for the chain of eight masses; a shows all three noise levels."""
    return _figure(study, table, paper, 8, classical, shown=DECIBELS)


def _figure(
    study: Study, table: StudyTable, paper: PaperStudy, masses: int, classical: str, shown: tuple[float, ...]
) -> Figure | None:
    subject_name = paper.named(masses)
    rows = {level: _middle(table, subject_name, level, classical) for level in DECIBELS}
    judged = next((row for level in reversed(DECIBELS) if (row := rows[level]) is not None), None)
    if judged is None or subject_name is None:
        return None
    subject = study.subject(subject_name)
    structure = subject.structure
    link = _median_link(judged)  # one link for all curves: each has its own range of motion
    forces: dict[str, Link] = {}
    styles: dict[str, dict[str, Any]] = {}
    errors: list[str] = []
    for level, row in rows.items():
        if row is not None:
            name = f"SINDy, {level:g} dB"
            forces[name] = structure.with_values(row.coefficients).link(link)
            styles[name] = {"color": _LEVELS[level], "linestyle": (0, (4, 2))}
            errors.append(f"{row.links[link]:.3g} % at {level:g} dB")
    for method in paper.likelihood[:1]:
        ours = _middle(table, subject_name, DECIBELS[-1], method)
        if ours is not None:
            name = f"{method}, {DECIBELS[-1]:g} dB"
            forces[name] = structure.with_values(ours.coefficients).link(link)
            styles[name] = {"color": IDENTIFIED}
            errors.append(f"{method} {ours.links[link]:.3g} % at {DECIBELS[-1]:g} dB")
    return force_comparison_figure(
        structure.link(link),
        forces,
        _visited(subject, link),
        styles=styles,
        only_errors=[f"SINDy, {level:g} dB" for level in DECIBELS if level not in shown],
        title=f"{link}; SINDy: {classical}; cycles of median error\nNMSE: {', '.join(errors)}",
    )


def _visited(subject: Subject, link: str) -> tuple[float, float]:
    """The least and the greatest elongation of a link in m along the true motion."""
    truth = subject.simulate().simulated
    assert truth is not None  # of a simulation it is there
    structure = subject.structure
    d = structure.elongations(truth.displacement, truth.base)[:, structure.links.index(structure.link(link))]
    return float(d.min()), float(d.max())


def _median_link(row: Row) -> str:
    """Of the judged links the one whose error comes closest to the row's."""
    error = row.nmse or 0.0
    return min(row.links, key=lambda link: abs(row.links[link] - error))


def _middle(table: StudyTable, name: str | None, level: float, method: str) -> Row | None:
    """The row that stands for a cell, None where none has coefficients."""
    cell = None if name is None else table.cell(name, level, method)
    row = None if cell is None else cell.median_row
    return row if row is not None and row.coefficients else None
