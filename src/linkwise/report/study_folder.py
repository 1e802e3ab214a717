"""The report of a study into its folder: figures, Table 2 and one page."""

from __future__ import annotations

import csv
import shutil
from importlib.metadata import version
from pathlib import Path

from matplotlib.figure import Figure

from linkwise.argument_types import checked
from linkwise.display import csv_cell
from linkwise.output import atomic_file
from linkwise.paper.table_2 import Table2
from linkwise.plot import save
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.report.section import embedded
from linkwise.report.study_figures import STUDY_FIGURES
from linkwise.report.study_page import Illustration, StudyReport, study_page
from linkwise.study.store import read_rows, stored_study

_FIGURES = "figures"


@checked
def write_study_report(folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write the report of a study into its folder: report.html, figures/NAME.png, figures/NAME.svg and table_2.csv.

    It may be called at any time, also while the study runs: the page states what is missing. It has the paper's figures and
    table if the study has chains of the paper.

    Parameters
    ----------
    folder : path-like
        The folder of the study, as `run_study` was given it.
    progress : Progress
        Called with a `ProgressReport` before each figure.

    Returns
    -------
    pathlib.Path
        The page, report.html.

    Raises
    ------
    StudyError
        If there is no study in the folder.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.write_study_report("results/mine").name
    'report.html'
    """
    home = Path(folder)
    report = StudyReport.of(stored_study(home), read_rows(home))
    shown: dict[str, list[Illustration]] = {}
    for number, (name, entry) in enumerate(STUDY_FIGURES.items()):
        progress(ProgressReport(number / len(STUDY_FIGURES), f"figure {name}"))
        figure = entry.draw(report)
        if figure is not None:
            address = _keep(figure, home / _FIGURES, name)
            illustration = Illustration(name, entry.title, entry.caption(report), address)
            shown.setdefault(entry.heading, []).append(illustration)
    progress(ProgressReport(1.0, "page"))
    if report.comparison.cells:
        _write_table(report.comparison, report.table.methods, home / "table_2.csv")
    with atomic_file(home / "report.html") as page:
        page.write_text(study_page(report, shown, version=version("linkwise")), encoding="utf-8")
    return home / "report.html"


def _keep(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as PNG and SVG into `folder`, each whole or not at all; returns the address that holds it."""
    scratch = folder / ".partial"
    shutil.rmtree(scratch, ignore_errors=True)  # of a run that was killed
    scratch.mkdir(parents=True)
    try:
        png, svg = save(figure, scratch / name)
        address = embedded(svg.read_bytes())
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
        writer.writerow(["snr_db", "masses", "paper: percent", *map(csv_cell, names)])
        for cell in comparison.cells:
            line: list[object] = [f"{cell.snr_db:g}", cell.masses, f"{cell.paper:g}"]
            for method in methods:
                study_cell = cell.cells[method]
                numbers = (
                    study_cell.nmse,
                    study_cell.low,
                    study_cell.high,
                    cell.ratio(method),
                    study_cell.seconds,
                )
                line += ["" if value is None else f"{value:.6g}" for value in numbers]
                line += [study_cell.done, len(study_cell.failures)]
            writer.writerow(line)
