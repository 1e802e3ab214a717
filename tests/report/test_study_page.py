"""The report of a study: the right verdict, the paper's table with ours beside it, and nothing missing that is not said."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import pytest
from paper_rows import BEST, error, paper_rows, paper_study, stored
from present import some
from reach_rows import reach_rows, reach_study

import linkwise as lw
from linkwise.paper.tables import TABLE_2, Table2, explanation
from linkwise.report.study import StudyReport, study_figures, study_page
from linkwise.study.definition import parse_study, read_study
from linkwise.study.subject import FAILED, Row

pytestmark = pytest.mark.usefixtures("unrendered")

STUDY = paper_study()
MINE = """
name = "mine"
snr_db = [50, 20]
cycles = 3
structure = [{ name = "short", bnes = 2, duration = 1.0, rate = 1000.0, release = { "v:m1" = 1.0 } }]
method = [{ kind = "weak" }, { kind = "ml", name = "most likely" }]
"""
FIGURES = {f"figure_{number}" for number in range(2, 10)}


def judged(rows: list[Row]) -> tuple[Table2, dict[str, bool | None]]:
    """The comparison of rows with the paper, and their claims."""
    report = StudyReport.of(STUDY, rows)
    return report.comparison, {claim.text: claim.met for claim in report.claims}


def claim(rows: list[Row], start: str) -> tuple[str, bool | None]:
    """The one claim on the rows that begins so."""
    (found,) = [pair for pair in judged(rows)[1].items() if pair[0].startswith(start)]
    return found


def body(text: str) -> str:
    """A page without its pictures, on one line."""
    text = re.sub(r'src="data:[^"]*"', 'src=""', text).partition("<body>")[2]
    return " ".join(text.replace("&#39;", "'").replace("&#34;", '"').split())


def test_the_best_convention_is_found_and_its_closeness_told() -> None:
    rows = paper_rows(STUDY)
    comparison, _ = judged(rows)
    assert len(comparison.cells) == 15 and comparison.best == BEST
    assert comparison.within(BEST) == 15 and comparison.within("classical, states") == 0
    assert comparison.typical_factor(BEST) == pytest.approx(1.1, rel=1e-12)
    text, met = claim(rows, "Table 2")
    assert met is True and "median factor is 1.1." in text
    assert f'"{BEST}" (of 4 ways to run SINDy): 15 of 15 cells within a factor 3' in text
    few = paper_rows(STUDY, lambda case, masses: error(case, masses) * (10.0 if masses > 6 else 1.0))
    text, met = claim(few, "Table 2")
    assert met is False and "9 of 15 cells" in text and "12 were asked for" in text
    comparison, _ = judged(few)
    off = [cell for cell in comparison.cells if explanation(cell, BEST, comparison.classical)]
    assert {cell.masses for cell in off} == {8, 10}


def test_figures_and_table_are_written(paper_report: Path) -> None:
    assert {path.name for path in (paper_report / "figures").iterdir()} == {
        f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg")
    }
    with (paper_report / "table_2.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [(float(line["snr_db"]), int(line["masses"])) for line in lines] == [(d, m) for m, d in TABLE_2]
    for line in some(lines):
        paper = TABLE_2[int(line["masses"]), float(line["snr_db"])]
        assert float(line["paper: percent"]) == paper
        assert float(line[f"{BEST}: ratio"]) == pytest.approx(1.1, rel=1e-5)  # six printed digits
        assert float(line["ml: percent"]) == 1e-4 and line["ml: cycles"] == "3"


def test_the_page_tells_the_story_verdict_first_and_needs_nothing_else(paper_report: Path) -> None:
    text = (paper_report / "report.html").read_text(encoding="utf-8")
    page = body(text)
    places = [
        page.index("The paper's results are reproduced, and surpassed."),
        page.index("Table 2: error of the sinks' force"),
        *(page.index(f'<figure id="figure_{number}">') for number in range(2, 10)),
        page.index("How it was found"),
    ]
    assert places == sorted(places)
    assert page.count("✓") == 6 and "✗" not in page and "What is missing" not in page
    assert "<td>63.0856</td>" in page and "1.0·10⁻⁴" in page
    assert "Cells that differ" not in page
    assert page.count("<figure id=") == page.count("<img ") + page.count("<svg role=") == 8
    addresses = re.findall(r'(?:src|href)="([^"]{0,30})', text)
    assert all(address.startswith(("data:image/png;base64,", "#")) for address in addresses)
    assert "<script" not in text and len(text) < 1.5e6


def test_a_partial_study_says_what_is_missing() -> None:
    rows = [
        row
        for row in paper_rows(STUDY)
        if row.structure == "2 masses" and row.seed < 1002 and row.method != "weak"
    ]
    rows[0] = replace(
        rows[0], status=FAILED, links={}, coefficients={}, reason="a step <size> became too small"
    )
    page = body(study_page(StudyReport.of(STUDY, rows), {}))
    assert "1 of 5 claims does not hold." in page
    assert "36 of 315 cases were run; 87 of 105 cells are empty" in page and "1 gave no answer" in page
    missing = page.partition("What is missing")[2]
    assert "<li>ml at 20 dB: 2 masses (2 of 3), 4 masses (0 of 3), " in missing
    assert "<li>weak at 40 dB: 2 masses (0 of 3), " in missing
    expected = "classical, displacement gave no answer 1 times (2 masses, 40 dB): a step &lt;size&gt; became too small"
    assert expected in missing


def test_an_empty_study_has_a_report(tmp_path: Path) -> None:
    reports: list[float] = []
    folder = stored(tmp_path / "empty", STUDY, [])
    page = lw.report.write_study_report(folder, progress=lambda report: reports.append(report.fraction))
    assert reports == sorted(reports) and reports[0] == 0.0 and reports[-1] == 1.0
    text = body(page.read_text(encoding="utf-8"))
    assert "0 of 315 cases were run" in text and "Figure 2" in text and "Figure 6" not in text
    assert {path.stem for path in (folder / "figures").iterdir()} == FIGURES - {"figure_6", "figure_7"}


def test_a_study_of_ones_own_has_its_table_and_figure(tmp_path: Path) -> None:
    study = parse_study(MINE, "mine.toml", tmp_path)
    rows = [
        Row(c.structure, 2, c.snr_db, c.method, c.seed, status="converged", links={"nes1": 0.25}, seconds=0.1)
        for c in study.cases()
    ]
    folder = stored(tmp_path / "mine", study, rows)
    page = body(lw.report.write_study_report(folder).read_text(encoding="utf-8"))
    assert "<h1>Study mine</h1>" in page and "The study is complete." in page and "Table 2" not in page
    assert page.count("<td>0.25</td>") == 4 and "<th>most likely</th>" in page
    assert {path.name for path in (folder / "figures").iterdir()} == {"accuracy.png", "accuracy.svg"}
    assert not (folder / "table_2.csv").exists()


def test_a_study_of_terms_has_their_table_and_its_maps(tmp_path: Path) -> None:
    """Of 24 cases a length, `discover` is exact in 11, and wrong and trusted in 5."""
    study = reach_study()
    folder = stored(tmp_path / "reach", study, reach_rows(study))
    page = body(lw.report.write_study_report(folder).read_text(encoding="utf-8"))
    assert "<h2>Right links and terms</h2>" in page
    titles = ("structure", "method", "cases", "exact", "wrong, trusted", "extra, trusted")
    assert f"<tr>{''.join(f'<th>{title}</th>' for title in titles)}</tr>" in page
    line = "<td>chain, 1 s</td><td>discover</td><td>24</td><td>45.8</td><td>20.8</td><td>0</td>"
    assert line in page and "<td>sindy, links</td><td>24</td><td>0</td><td>100</td><td>100</td>" in page
    assert '<figure id="success">' in page and "Success maps: noise and samples a period" in page
    assert "Per cent of 4 cycles in which a method has all true links and terms and no other." in page
    assert {path.stem for path in (folder / "figures").iterdir()} == {"success", "accuracy"}
    many = StudyReport.of(read_study("reach"), [])  # 32 structures, whose names do not fit below a panel
    assert many.beyond and "accuracy" not in study_figures(many)
