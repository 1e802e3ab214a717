"""The report of a study into its folder: figures, Table 2 and one page."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

from matplotlib.figure import Figure

from linkwise.atomic import atomic_file
from linkwise.paper.captions import motion_captions
from linkwise.paper.figures_2_to_5 import figure_2, figure_3, figure_4, figure_5
from linkwise.paper.figures_6_7 import figure_6, figure_7
from linkwise.paper.figures_8_9 import figure_8, figure_9
from linkwise.paper.table_2 import Table2
from linkwise.plot import save
from linkwise.plot.study_accuracy import accuracy_figure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.report.section_page import embedded
from linkwise.report.study_page import Illustration, StudyReport, study_page
from linkwise.study.store import read_rows, stored_study

MOTION, FORCE, ACCURACY = (
    "How the chains move",
    "What force is found",
    "Accuracy and time over degrees of freedom",
)
_MOTION = {"figure_2": figure_2, "figure_3": figure_3, "figure_4": figure_4, "figure_5": figure_5}
_FORCE = {"figure_6": figure_6, "figure_7": figure_7}
_TITLES = {
    "figure_2": "Figure 2: responses of the chain of two masses",
    "figure_3": "Figure 3: its primary mass with the sink and without",
    "figure_4": "Figure 4: responses of the chain of eight masses",
    "figure_5": "Figure 5: its primary masses with sinks and without",
    "figure_6": "Figure 6: the force identified in the chain of two masses",
    "figure_7": "Figure 7: the force identified in the chain of eight masses",
    "figure_8": "Figure 8: SINDy with all monomials up to the third order",
    "figure_9": "Figure 9: physics-informed SINDy",
}
_FIGURES = "figures"


def write_study_report(folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write report.html, figures/NAME.png and .svg and table_2.csv of the study in `folder`; returns the page's path.

    It may be called at any time, while the study runs too: what is missing is said. The paper's figures and table are there
    where the study has chains of the paper. `progress` is told the fraction done. Raises StudyError where there is no study.
    """
    home = Path(folder)
    told = StudyReport.of(stored_study(home), read_rows(home))
    plates = _plates(told)
    shown: dict[str, list[Illustration]] = {MOTION: [], FORCE: [], ACCURACY: []}
    for number, plate in enumerate(plates):
        progress(ProgressReport(number / len(plates), f"figure {plate.name}"))
        figure = plate.draw()
        if figure is not None:
            address = _keep(figure, home / _FIGURES, plate.name)
            shown[plate.heading].append(Illustration(plate.name, plate.title, plate.caption, address))
    progress(ProgressReport(1.0, "page"))
    if told.comparison.cells:
        _write_table(told.comparison, told.table.methods, home / "table_2.csv")
    with atomic_file(home / "report.html") as page:
        page.write_text(study_page(told, shown, version=version("linkwise")), encoding="utf-8")
    return home / "report.html"


@dataclass(frozen=True)
class FigureSpec:
    """A figure that the report may have: `draw` gives None where the study lacks what it would show."""

    heading: str
    name: str
    title: str
    caption: str
    draw: Callable[[], Figure | None]


def _plates(told: StudyReport) -> list[FigureSpec]:
    """All figures in the paper's order, then what the study has beyond the paper."""
    table, paper = told.table, told.paper
    plates: list[FigureSpec] = []
    if paper.masses:
        captions = motion_captions()
        plates += [
            FigureSpec(MOTION, name, _TITLES[name], captions[name], draw) for name, draw in _MOTION.items()
        ]
    if told.comparison.cells:
        best = told.comparison.best
        if best is not None:
            forces = "In the cycle whose error is the median of its cell. The error is shown against the largest force."
            plates += [
                FigureSpec(FORCE, name, _TITLES[name], forces, partial(draw, told.study, table, paper, best))
                for name, draw in _FORCE.items()
            ]
        methods = (
            "Medians, and the range of the cycles (5 to 95 %). The paper prints no times for its Figure 8d, nor which machine "
            "it ran on."
        )
        times = (
            f"{_times(told)}Medians, and the range of the cycles. The paper does not say whether its times are for one cycle "
            "or for all 100."
        )
        plates += [
            FigureSpec(
                ACCURACY, "figure_8", _TITLES["figure_8"], methods, partial(figure_8, table, paper, best)
            ),
            FigureSpec(ACCURACY, "figure_9", _TITLES["figure_9"], times, partial(figure_9, table, paper)),
        ]
    if told.beyond:
        caption = "Medians, and the range of the cycles (5 to 95 %)."
        title = "All structures of the study"
        plates.append(FigureSpec(ACCURACY, "accuracy", title, caption, partial(accuracy_figure, table)))
    return plates


def _times(told: StudyReport) -> str:
    """The least and the greatest median time of linkwise's own estimators at the last noise level, as a sentence."""
    level = told.table.decibels[-1]
    found = []
    for method in (*told.paper.informed, *told.paper.weak, *told.paper.likelihood):
        cells = [told.table.cell(name, level, method) for name in told.paper.masses]
        times = [cell.seconds for cell in cells if cell is not None and cell.seconds is not None]
        if times:
            found.append(f"{method} {min(times):.2g} to {max(times):.2g}")
    return f"Seconds for one estimate here: {', '.join(found)}. " if found else ""


def _keep(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as PNG and SVG into `folder`, each whole or not at all; returns the address that holds it."""
    scratch = folder / ".partial"
    shutil.rmtree(scratch, ignore_errors=True)  # of a run that was killed
    scratch.mkdir(parents=True)
    try:
        png, svg = save(figure, scratch / name)
        address = embedded(svg)
        for path in (png, svg):
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return address


def _write_table(comparison: Table2, methods: tuple[str, ...], path: Path) -> None:
    """Table 2: the paper's value and, for every method, median and quantiles in %, median time in s, cycles and failures."""
    columns = ("percent", "low", "high", "ratio", "seconds", "cycles", "failed")
    with atomic_file(path) as whole, whole.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = [f"{method}: {column}" for method in methods for column in columns]
        writer.writerow(["snr_db", "masses", "paper: percent", *names])
        for cell in comparison.cells:
            line: list[object] = [f"{cell.snr_db:g}", cell.masses, f"{cell.paper:g}"]
            for method in methods:
                found = cell.found[method]
                numbers = (found.nmse, found.low, found.high, cell.ratio(method), found.seconds)
                line += ["" if value is None else f"{value:.6g}" for value in numbers]
                line += [found.done, len(found.failures)]
            writer.writerow(line)
