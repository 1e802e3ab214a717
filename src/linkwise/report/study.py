"""The report of a study into its folder: the page with the verdict, the paper's Table 2 with ours beside it, figures, and
what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

from matplotlib.figure import Figure

from linkwise.output import atomic_file
from linkwise.paper.figures import (
    figure_2,
    figure_3,
    figure_4,
    figure_5,
    figure_6,
    figure_7,
    figure_8,
    figure_9,
    motion_captions,
)
from linkwise.paper.tables import NEAR, Claim, PaperStudy, Table2, claims, explanation
from linkwise.plot.studies import accuracy_figure, success_figure
from linkwise.plot.style import save
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.report.result_folder import csv_table, embedded
from linkwise.report.result_page import rendered
from linkwise.sindy.conventions import MEANING
from linkwise.sindy.regression import REGRESSORS
from linkwise.study.definition import Study
from linkwise.study.store import read_rows, stored_study
from linkwise.study.subject import Row
from linkwise.study.summary import SPREAD, Cell, StudySummary, SuccessMap, covered, maps_of
from linkwise.verdict import Verdict, admit_intervals

_READING = {
    "coefficients": "the force read from the coefficients of the sink's own x and x³",
    "ends": "the force read from all monomials in the displacements of both ends",
    "displacements": "the force read from all monomials in the displacements",
}
_LISTED = 6  # cells that a failure names
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class StudyReport:
    """All that a page shows of a study."""

    study: Study
    table: StudySummary
    paper: PaperStudy
    comparison: Table2
    claims: Sequence[Claim]
    success: Sequence[SuccessMap] = ()

    @classmethod
    def of(cls, study: Study, rows: Iterable[Row]) -> StudyReport:
        """What `rows` show of `study`."""
        table, paper = StudySummary.of(study, rows), PaperStudy.of(study)
        comparison = Table2.of(table, paper)
        success = maps_of(study, table)
        return cls(study, table, paper, comparison, claims(table, paper, comparison), success)

    @property
    def beyond(self) -> list[tuple[str, float]]:
        """Structures and noise levels in dB that Table 2 does not have."""
        shown = {(cell.snr_db, name) for cell in self.comparison.cells for name in self.paper.masses}
        pairs = product(self.table.structures, self.table.decibels)
        return [(name, level) for name, level in pairs if (level, name) not in shown]

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        unmet = [claim for claim in self.claims if claim.met is False]
        open_ = [claim for claim in self.claims if claim.met is None]
        if unmet:
            do = "does" if len(unmet) == 1 else "do"
            return f"{len(unmet)} of {len(self.claims)} claims {do} not hold."
        if open_:
            return "No claim is contradicted so far, but there are too few results to decide all of them."
        if self.comparison.cells:
            return "The paper's results are reproduced, and surpassed."
        return "The study is complete."

    @property
    def trusted(self) -> bool:
        """Whether every claim holds, and no verdict on the study forbids trust."""
        return all(claim.met for claim in self.claims) and admit_intervals(self.table.verdicts)

    @property
    def lacks(self) -> list[str]:
        """What verdicts say against the study."""
        return [verdict.value for verdict in self.table.verdicts if verdict is not Verdict.STUDY_COMPLETE]


def study_page(report: StudyReport, illustrations: Mapping[str, Sequence[Mapping[str, str]]]) -> str:
    """The page as text: HTML that asks nobody for anything.

    `illustrations` are figures by the heading above them: name, title, caption, and the picture.
    """
    comparison, table = report.comparison, report.table
    return rendered(
        "study.html.jinja",
        report=report,
        study=report.study,
        methods=[method for method in table.methods if method not in comparison.classical],
        conventions=[(name, name.removeprefix("classical, ")) for name in comparison.classical],
        meanings={name: _meaning(report.study, name) for name in comparison.classical},
        percent=percent,
        reasons=_explanations(comparison),
        coverages=_coverages(table),
        illustrations=illustrations,
        missing=_missing_cells(table),
        failures=_cases_without_answer(table),
        seconds=sum(row.seconds for cell in table.cells for row in cell.answers),
        near=NEAR,
        spread=[round(100 * part) for part in SPREAD],
    )


def percent(value: float | None) -> str:
    """A number for a table: three digits, powers of ten written out, a dash for none."""
    if value is None:
        return "–"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"


def _explanations(comparison: Table2) -> list[tuple[str, str]]:
    best, classical = comparison.best, comparison.classical
    explained = [(cell.where, best and explanation(cell, best, classical)) for cell in comparison.cells]
    return [(where, text) for where, text in explained if text]


def _meaning(study: Study, method: str) -> str:
    """How a classical method was run, in words."""
    how = study.method(method).document()
    meaning = MEANING[how["convention"]]
    return f"{meaning}; {REGRESSORS.lookup(how['regressor']).title}; {_READING[how['reading']]}"


def _missing_cells(table: StudySummary) -> list[str]:
    """What was not run or not to the end, by noise level and method."""
    sentences = []
    for method in table.methods:
        for level in table.decibels:
            cells = [table.cell(name, level, method) for name in table.structures]
            lacking = [cell for cell in cells if cell is not None and cell.done < cell.expected]
            if lacking:
                listed = ", ".join(f"{cell.structure} ({cell.done} of {cell.expected})" for cell in lacking)
                sentences.append(f"{method} at {level:g} dB: {listed}")
    return sentences


def _cases_without_answer(table: StudySummary) -> list[str]:
    """Cases without an answer by method and reason: how many, and where."""
    failed: dict[tuple[str, str], list[tuple[Cell, int]]] = {}
    for cell in table.cells:
        for reason, count in cell.reasons:
            failed.setdefault((cell.method, reason), []).append((cell, count))
    sentences = []
    for (method, reason), cells in failed.items():
        where = "; ".join(f"{cell.structure}, {cell.snr_db:g} dB" for cell, _ in cells[:_LISTED])
        more = f" and {len(cells) - _LISTED} more cells" if len(cells) > _LISTED else ""
        times, why = sum(count for _, count in cells), reason or "the error is not a number"
        sentences.append(f"{method} gave no answer {times} times ({where}{more}): {why}")
    return sentences


def _coverages(table: StudySummary) -> list[tuple[str, float, Mapping[str, str]]]:
    """How many intervals hold the true value, by structure and noise level and by method, where there are any."""
    lines: dict[tuple[str, float], dict[str, str]] = {}
    stated = {cell.method for cell in table.cells if cell.intervals}
    methods = [method for method in table.methods if method in stated]
    for cell in table.cells:
        texts = lines.setdefault((cell.structure, cell.snr_db), dict.fromkeys(methods, "–"))
        if cell.intervals:
            texts[cell.method] = covered(cell.coverage, cell.intervals)
    return [(*key, texts) for key, texts in lines.items() if set(texts.values()) - {"–"}]


_MOST_NAMED = 12  # structures whose names fit below a panel; without names, numbers of masses fit
_AGAINST = "The error is shown against the largest force."
_SPREAD = "Medians, and the range of the cycles (5 to 95 %)."
_MOTIONS = {
    "figure_2": (figure_2, "Figure 2: responses of the chain of two masses"),
    "figure_3": (figure_3, "Figure 3: its primary mass with the sink and without"),
    "figure_4": (figure_4, "Figure 4: responses of the chain of eight masses"),
    "figure_5": (figure_5, "Figure 5: its primary masses with sinks and without"),
}
_FORCES = {
    "figure_6": (figure_6, "Figure 6: the force identified in the chain of two masses"),
    "figure_7": (figure_7, "Figure 7: the force identified in the chain of eight masses"),
}


@dataclass(frozen=True)
class StudyFigure:
    """A figure of the page under `heading`; `draw` returns None where the study lacks what it would show."""

    heading: str
    title: str
    draw: Callable[[], Figure | None]
    caption: str


def study_figures(report: StudyReport) -> dict[str, StudyFigure]:
    """The figures of a study by the names of their files, in the order of the page: those of the paper for its chains, the
    forces by the convention that reproduces it best.
    """
    table, paper, best = report.table, report.paper, report.comparison.best
    figures, heading = {}, "How the chains move"
    for name, (draw_motion, title) in _MOTIONS.items() if paper.masses else ():
        figures[name] = StudyFigure(heading, title, draw_motion, motion_captions()[name])
    draw: Callable[[], Figure | None]
    heading, cycle = "What force is found", "In the cycle whose error is the median of its cell."
    for name, (draw_force, title) in _FORCES.items():
        if best is not None:
            draw, caption = partial(draw_force, report.study, table, paper, best), f"{cycle} {_AGAINST}"
            figures[name] = StudyFigure(heading, title, draw, caption)
    if report.success:
        heading, draw = "Where the right links and terms are found", partial(success_figure, report.success)
        caption = (
            f"Per cent of {report.study.cycles} cycles in which a method has all true links and terms and no other. Below it "
            "in red, where there are any, the per cent that it trusts though a term is missing or extra. A case without an "
            "answer counts as neither, and empty cells were not run. A trusted discovery may name doubtful terms, which is "
            "not counted."
        )
        title = "Success maps: noise and samples a period"
        figures["success"] = StudyFigure(heading, title, draw, caption)
    heading = "Accuracy and time over structures"
    if report.comparison.cells:
        caption = f"{_SPREAD} The paper prints no times for its Figure 8d, nor which machine it ran on."
        title = "Figure 8: SINDy with all monomials up to the third order"
        draw = partial(figure_8, table, paper, best)
        figures["figure_8"] = StudyFigure(heading, title, draw, caption)
        title, draw = "Figure 9: physics-informed SINDy", partial(figure_9, table, paper)
        figures["figure_9"] = StudyFigure(heading, title, draw, _with_times(report))
    counts = list(table.masses.values())
    if report.beyond and (len(counts) <= _MOST_NAMED or len(set(counts)) == len(counts)):
        draw = partial(accuracy_figure, table)
        figures["accuracy"] = StudyFigure(heading, "All structures of the study", draw, _SPREAD)
    return figures


def _with_times(report: StudyReport) -> str:
    """The least and the greatest median time of linkwise's own estimators at the last noise level, and what is compared."""
    level = report.table.decibels[-1]
    ranges = []
    for method in (*report.paper.informed, *report.paper.weak, *report.paper.likelihood):
        cells = [report.table.cell(name, level, method) for name in report.paper.masses]
        times = [cell.seconds for cell in cells if cell is not None and cell.seconds is not None]
        if times:
            ranges.append(f"{method} {min(times):.2g} to {max(times):.2g}")
    measured = f"Seconds for one estimate here: {', '.join(ranges)}. " if ranges else ""
    unsaid = "The paper does not say whether its times are for one cycle or for all 100."
    return f"{measured}Medians, and the range of the cycles. {unsaid}"


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
    >>> lw.report.write_study_report("results/mine").name
    'report.html'
    """
    home = Path(folder)
    report = StudyReport.of(stored_study(home), read_rows(home))
    shown: dict[str, list[dict[str, str]]] = {}
    figures = study_figures(report)
    for number, (name, entry) in enumerate(figures.items()):
        progress(ProgressReport(number / len(figures), f"figure {name}"))
        figure = entry.draw()
        if figure is not None:
            png, svg = save(figure, home / "figures" / name)
            picture = embedded(png.read_bytes(), svg.read_bytes(), entry.title, figure.get_figwidth())
            own = {"name": name, "title": entry.title, "picture": picture, "caption": entry.caption}
            shown.setdefault(entry.heading, []).append(own)
    progress(ProgressReport(1.0, "page"))
    if report.comparison.cells:
        _write_table(report.comparison, report.table.methods, home / "table_2.csv")
    with atomic_file(home / "report.html") as page:
        page.write_text(study_page(report, shown), encoding="utf-8")
    return home / "report.html"


def _write_table(comparison: Table2, methods: tuple[str, ...], path: Path) -> None:
    """Table 2: the paper's value and, for every method, median and quantiles in %, median time in s, cycles and failures."""
    columns = ("percent", "low", "high", "ratio", "seconds", "cycles", "failed")
    lines = []
    for cell in comparison.cells:
        line: list[object] = [f"{cell.snr_db:g}", cell.masses, f"{cell.paper:g}"]
        for method in methods:
            own = cell.cells[method]
            numbers = (own.nmse, own.low, own.high, cell.ratio(method), own.seconds)
            line += ["" if value is None else f"{value:.6g}" for value in numbers]
            line += [own.done, len(own.failures)]
        lines.append(line)
    names = [f"{method}: {column}" for method in methods for column in columns]
    with atomic_file(path) as whole:
        csv_table(whole, ["snr_db", "masses", "paper: percent", *names], lines)
