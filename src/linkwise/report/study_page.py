"""The page of a study: verdict first, then the paper's table with ours beside it, the figures, and what is missing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from linkwise.paper.claims import Claim, claims
from linkwise.paper.subset import PaperStudy
from linkwise.paper.table_2 import NEAR, Table2, explanation
from linkwise.report.templates import TEMPLATES
from linkwise.sindy.conventions import MEANING
from linkwise.sindy.regression import REGRESSORS
from linkwise.study.cells import SPREAD, Cell, StudyTable
from linkwise.study.definition import Study
from linkwise.study.row import Row
from linkwise.study.success_map import SuccessMap, maps_of
from linkwise.study.summary import covered
from linkwise.verdict import Verdict, is_trusted

_READING = {
    "coefficients": "the force read from the coefficients of the sink's own x and x³",
    "ends": "the force read from all monomials in the displacements of both ends",
    "displacements": "the force read from all monomials in the displacements",
}
_LISTED = 6  # cells that a failure names
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Illustration:
    """A figure on the page: `address` holds it."""

    name: str
    title: str
    caption: str
    address: str


@dataclass(frozen=True)
class StudyReport:
    """All that a page shows of a study."""

    study: Study
    table: StudyTable
    paper: PaperStudy
    comparison: Table2
    claims: Sequence[Claim]
    success: Sequence[SuccessMap] = ()

    @classmethod
    def of(cls, study: Study, rows: Iterable[Row]) -> StudyReport:
        """What `rows` show of `study`."""
        table, paper = StudyTable.of(study, rows), PaperStudy.of(study)
        comparison = Table2.of(table, paper)
        success = maps_of(study, table)
        return cls(study, table, paper, comparison, claims(table, paper, comparison), success)

    @property
    def beyond(self) -> list[tuple[str, float]]:
        """Structures and noise levels in dB that Table 2 does not have."""
        shown = {(cell.snr_db, name) for cell in self.comparison.cells for name in self.paper.masses}
        return [
            (name, level)
            for name in self.table.structures
            for level in self.table.decibels
            if (level, name) not in shown
        ]

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        unmet = [claim for claim in self.claims if claim.met is False]
        open_ = [claim for claim in self.claims if claim.met is None]
        if unmet:
            return (
                f"{len(unmet)} of {len(self.claims)} claims {'does' if len(unmet) == 1 else 'do'} not hold."
            )
        if open_:
            return "No claim is contradicted so far, but there are too few results to decide all of them."
        if self.comparison.cells:
            return "The paper's results are reproduced, and surpassed."
        return "The study is complete."

    @property
    def trusted(self) -> bool:
        """Whether every claim holds, and no verdict on the study forbids trust."""
        return all(claim.met for claim in self.claims) and is_trusted(self.table.verdicts)

    @property
    def lacks(self) -> list[str]:
        """What verdicts say against the study."""
        return [verdict.value for verdict in self.table.verdicts if verdict is not Verdict.STUDY_COMPLETE]


def study_page(
    report: StudyReport, illustrations: Mapping[str, Sequence[Illustration]], *, version: str
) -> str:
    """The page as text: HTML that asks nobody for anything. `illustrations` are figures by the heading above them."""
    comparison, table = report.comparison, report.table
    return TEMPLATES.get_template("study.html.jinja").render(
        report=report,
        study=report.study,
        methods=[method for method in table.methods if method not in comparison.classical],
        conventions=[(name, name.removeprefix("classical, ")) for name in comparison.classical],
        meanings={name: _meaning(report.study, name) for name in comparison.classical},
        rows=[_row(report, number) for number in range(len(comparison.cells))],
        reasons=_reasons(comparison),
        exact=[_exact(success) for success in report.success],
        others=_others(report),
        coverages=_coverages(table),
        illustrations=illustrations,
        missing=_missing(table),
        failures=_failures(table),
        seconds=sum(row.seconds for cell in table.cells for row in cell.answers),
        near=NEAR,
        spread=[round(100 * part) for part in SPREAD],
        version=version,
    )


def percent(value: float | None) -> str:
    """A number for a table: three digits, powers of ten written out, a dash for none."""
    if value is None:
        return "–"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"


@dataclass(frozen=True)
class TableRow:
    """A line of Table 2 on the page; `values` by method, `spreads` what stands on them when pointed at."""

    first: bool
    snr_db: float
    masses: int
    paper: str
    ratio: str
    near: bool
    values: Mapping[str, str]
    spreads: Mapping[str, str]


def _row(report: StudyReport, number: int) -> TableRow:
    cells, best = report.comparison.cells, report.comparison.best
    cell = cells[number]
    ratio = None if best is None else cell.ratio(best)
    return TableRow(
        first=number == 0 or cells[number - 1].snr_db != cell.snr_db,
        snr_db=cell.snr_db,
        masses=cell.masses,
        paper=f"{cell.paper:g}",
        ratio="–" if ratio is None else f"{ratio:.2g}",
        near=best is not None and cell.near(best),
        values={method: percent(cell.nmse(method)) for method in report.table.methods},
        spreads={method: _spread(study_cell) for method, study_cell in cell.cells.items()},
    )


def _spread(cell: Cell) -> str:
    low, high = percent(cell.low), percent(cell.high)
    return (
        f"{low} to {high} % over {cell.done} of {cell.expected} cycles, {len(cell.failures)} without answer"
    )


def _reasons(comparison: Table2) -> list[tuple[str, str]]:
    best = comparison.best
    if best is None:
        return []
    explanations = [(cell.where, explanation(cell, best, comparison.classical)) for cell in comparison.cells]
    return [(where, text) for where, text in explanations if text]


def _meaning(study: Study, method: str) -> str:
    """How a classical method was run, in words."""
    how = study.method(method).document()
    meaning = MEANING[how["convention"]]
    return f"{meaning}; {REGRESSORS.lookup(how['regressor']).title}; {_READING[how['reading']]}"


def _missing(table: StudyTable) -> list[str]:
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


def _failures(table: StudyTable) -> list[str]:
    """Cases without an answer by method and reason: how many, and where."""
    failed: dict[tuple[str, str], list[Cell]] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for cell in table.cells:
        for reason, count in cell.reasons:
            failed.setdefault((cell.method, reason), []).append(cell)
            counts[cell.method, reason] += count
    sentences = []
    for (method, reason), cells in failed.items():
        where = "; ".join(f"{cell.structure}, {cell.snr_db:g} dB" for cell in cells[:_LISTED])
        more = f" and {len(cells) - _LISTED} more cells" if len(cells) > _LISTED else ""
        why = reason or "the error is not a number"
        sentences.append(f"{method} gave no answer {counts[method, reason]} times ({where}{more}): {why}")
    return sentences


def _exact(success: SuccessMap) -> tuple[str, str, int, Mapping[str, str]]:
    """A line of the table of right terms: structure, method, cases, and parts of them in %."""
    cases = int(success.cases.sum())
    counts = {
        "exact": success.exact,
        "wrong, trusted": success.wrong_trusted,
        "extra, trusted": success.extra_trusted,
    }
    return (
        success.name,
        success.method,
        cases,
        {
            name: percent(100.0 * float(count.sum()) / cases if cases else None)
            for name, count in counts.items()
        },
    )


def _others(report: StudyReport) -> list[tuple[str, float, Mapping[str, str]]]:
    """What Table 2 does not have: the medians of all methods."""
    return [
        (
            name,
            level,
            {method: percent(_nmse(report.table, name, level, method)) for method in report.table.methods},
        )
        for name, level in report.beyond
    ]


def _nmse(table: StudyTable, name: str, level: float, method: str) -> float | None:
    cell = table.cell(name, level, method)
    return None if cell is None else cell.nmse


def _coverages(table: StudyTable) -> list[tuple[str, float, Mapping[str, str]]]:
    """How many intervals hold the true value, by structure and noise level, where there are any."""
    lines: dict[tuple[str, float], dict[str, str]] = {}
    for cell in table.cells:
        texts = lines.setdefault((cell.structure, cell.snr_db), dict.fromkeys(table.methods, "–"))
        if cell.intervals:
            texts[cell.method] = covered(cell.coverage, cell.intervals)
    return [(*key, texts) for key, texts in lines.items() if set(texts.values()) != {"–"}]
