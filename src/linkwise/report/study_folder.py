"""The report of a study into its folder: figures, Table 2 and one page."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from matplotlib.figure import Figure

from linkwise.output import whole_file
from linkwise.plot import save
from linkwise.plot.paper_accuracy import figure_8, figure_9
from linkwise.plot.paper_force import figure_6, figure_7
from linkwise.plot.paper_motion import figure_2, figure_3, figure_4, figure_5
from linkwise.plot.study_accuracy import accuracy_figure
from linkwise.report.sheet import embedded
from linkwise.report.study_captions import motion_captions
from linkwise.report.study_comparison import Comparison
from linkwise.report.study_page import Illustration, Told, study_page
from linkwise.study.store import read_rows, stored_study

Progress = Callable[[float, str], object]

MOTION, FORCE, ACCURACY = (
    "How the chains move",
    "What force is found",
    "Accuracy and time over degrees of freedom",
)
_FIGURES = "figures"


def write_study_report(folder: str | Path, *, progress: Progress = lambda fraction, now: None) -> Path:
    """Write report.html, figures/NAME.png and .svg and table_2.csv of the study in `folder`; returns the page's path.

    It may be called at any time, while the study runs too: what is missing is said. The paper's figures and table are there
    where the study has chains of the paper. `progress` is told the fraction done. Raises StudyError where there is no study.
    """
    home = Path(folder)
    told = Told.of(stored_study(home), read_rows(home))
    plates = list(_plates(told))
    shown: dict[str, list[Illustration]] = {MOTION: [], FORCE: [], ACCURACY: []}
    captions = motion_captions() if told.paper.masses else {}
    for number, (heading, name, title, caption, draw) in enumerate(plates):
        progress(number / len(plates), f"figure {name}")
        figure = draw()
        if figure is not None:
            address = _keep(figure, home / _FIGURES, name)
            shown[heading].append(Illustration(name, title, captions.get(name, caption), address))
    progress(1.0, "page")
    if told.comparison.cells:
        _write_table(told.comparison, told.table.methods, home / "table_2.csv")
    with whole_file(home / "report.html") as partial:
        partial.write_text(study_page(told, shown, version=version("linkwise")), encoding="utf-8")
    return home / "report.html"


Plate = tuple[str, str, str, str, Callable[[], Figure | None]]


def _plates(told: Told) -> Iterator[Plate]:
    """Heading, file name, title, caption and maker of every figure."""
    study, table, paper, best = told.study, told.table, told.paper, told.comparison.best
    if paper.masses:
        yield MOTION, "figure_2", "Figure 2: responses of the chain of two masses", "", figure_2
        yield MOTION, "figure_3", "Figure 3: its primary mass with the sink and without", "", figure_3
        yield MOTION, "figure_4", "Figure 4: responses of the chain of eight masses", "", figure_4
        yield MOTION, "figure_5", "Figure 5: its primary masses with sinks and without", "", figure_5
        if best is not None:
            forces = "In the cycle whose error is the median of its cell. The error is shown against the largest force."
            title = "Figure 6: the force identified in the chain of two masses"
            yield FORCE, "figure_6", title, forces, lambda: figure_6(study, table, paper, best)
            title = "Figure 7: the force identified in the chain of eight masses"
            yield FORCE, "figure_7", title, forces, lambda: figure_7(study, table, paper, best)
        caption = (
            "Medians, and the range of the cycles (5 to 95 %). The paper prints no times for its Figure 8d, nor which machine "
            "it ran on."
        )
        title = "Figure 8: SINDy with all monomials up to the third order"
        yield ACCURACY, "figure_8", title, caption, lambda: figure_8(table, paper, best)
        caption = (
            "Medians, and the range of the cycles. The paper does not say whether its times are for one cycle or for all 100; "
            "ours are for one."
        )
        yield (
            ACCURACY,
            "figure_9",
            "Figure 9: physics-informed SINDy",
            caption,
            lambda: figure_9(table, paper),
        )
    if set(table.structures) - set(paper.masses) or not paper.masses:
        caption = "Medians, and the range of the cycles (5 to 95 %)."
        yield ACCURACY, "accuracy", "All structures of the study", caption, lambda: accuracy_figure(table)


def _keep(figure: Figure, folder: Path, name: str) -> str:
    """Write a figure as PNG and SVG into `folder`, each whole or not at all; returns the address that holds it."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".") as scratch:
        png, svg = save(figure, Path(scratch) / name)
        address = embedded(svg)
        for path in (png, svg):
            path.replace(folder / path.name)
    return address


def _write_table(comparison: Comparison, methods: tuple[str, ...], path: Path) -> None:
    """Table 2: the paper's value and, for every method, median and quantiles in %, median time in s, cycles and failures."""
    columns = ("percent", "low", "high", "ratio", "seconds", "cycles", "failed")
    with whole_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
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
