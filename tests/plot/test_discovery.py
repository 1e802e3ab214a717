"""What a discovery looks like: printed, drawn, and as a folder that is complete in itself."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from structures import link, with_links

import linkwise as lw
from linkwise.plot.discovery_graph import graph_figure
from linkwise.plot.style import MEASURED


def in_doubt(discovery: lw.Discovery, name: str, **changes: Any) -> lw.Discovery:
    """The same with one decision that is hardly one."""
    terms = tuple(replace(t, margin=1.5, **changes) if t.name == name else t for t in discovery.terms)
    return replace(discovery, terms=terms)


def test_verdict_comes_first_then_links_by_certainty(discovered: lw.Discovery) -> None:
    lines = str(discovered).splitlines()
    assert lines[0] == "2 masses, 2 links with 5 terms: can be trusted"
    first = lines.index("m1-ground, linear: k*d + c*v")
    assert first < lines.index("m2-m1, bistable: k*d + k3*d**3 + c*v")
    assert discovered.certainty("m1-ground") > discovered.certainty("m2-m1")
    stiffness = discovered.estimate.coefficient("m1-ground.k")
    assert f"{stiffness.value:.1f}" in lines[first + 1] and lines[first + 1].endswith("N/m")


def test_one_doubt_is_marked_and_the_others_are_not(discovered: lw.Discovery) -> None:
    sure = replace(discovered, terms=tuple(term for term in discovered.terms if term.certain))
    assert "Every decision is certain." in str(sure) and "in doubt" not in str(sure)
    text = str(in_doubt(sure, "m2-m1.k3"))
    assert "In doubt: 1 of the terms kept." in text and "N/m^3  in doubt" in text
    assert "(in doubt)" not in text  # the link itself stands by its other terms
    assert "(in doubt)" in str(in_doubt(in_doubt(sure, "m1-ground.k"), "m1-ground.c"))
    name = next(term.name for term in discovered.terms if not term.kept)
    assert "not identifiable" in str(in_doubt(discovered, name, identifiable=False))


@pytest.mark.slow
def test_stated_links_are_certain_whatever_their_terms(chain: lw.Structure, discovered: lw.Discovery) -> None:
    spring = link("spring1", "m1-ground", "k*d", k=30000.0)
    known = lw.discover(discovered.estimate.record, with_links(chain.unknown("nes"), spring))
    assert known.certainty("spring1") == known.certainty("nes1") == float("inf")
    assert "stated" in str(known) and "given" in str(known)
    assert "spring1.c" in [term.name for term in known.kept]
    doubted = in_doubt(known, "spring1.c")
    text = str(doubted)
    assert doubted.in_doubt == () and doubted.decision("spring1") is lw.discovery.Decision.CERTAIN
    assert text.splitlines()[0].endswith(": can be trusted") and "spring1 (in doubt)" not in text
    assert "--" not in line_styles(graph_figure(doubted))
    assert "linear?" in words(graph_figure(doubted)) and "  in doubt" in text  # the term is, and says so


def words(figure: Figure) -> set[str]:
    """Every text in the axes of a figure."""
    return {text.get_text() for axes in figure.axes for text in axes.texts}


def line_styles(figure: Figure) -> list[str]:
    return [str(line.get_linestyle()) for line in figure.axes[0].lines]


def test_graph_shows_masses_kinds_and_kilograms(discovered: lw.Discovery) -> None:
    figure = graph_figure(discovered)
    assert words(figure) == {"m1", "m2", "1 kg", "10 g", "linear", "bistable"}
    assert set(line_styles(figure)) == {"-", "None"}  # lines and the circles of the masses
    spring, sink = figure.axes[0].lines[:2]
    assert spring.get_linewidth() > sink.get_linewidth()


def test_graph_draws_doubt(discovered: lw.Discovery) -> None:
    doubted = in_doubt(discovered, "m2-m1.k3")
    assert "bistable?" in words(graph_figure(doubted)) and "--" not in line_styles(graph_figure(doubted))
    gone = in_doubt(in_doubt(doubted, "m2-m1.k"), "m2-m1.c")
    assert line_styles(graph_figure(gone)).count("--") == 1
    dropped = in_doubt(discovered, "m2-ground.k3")
    faint = [line for line in graph_figure(dropped).axes[0].lines if line.get_linestyle() == ":"]
    assert [to_hex(line.get_color()).upper() for line in faint] == [MEASURED]


@pytest.mark.slow
def test_folder_is_that_of_identify_and_more(discovery_folder: Path, discovered: lw.Discovery) -> None:
    pictures = "graph path evidence fit residuals force_m1-ground force_m2-m1"
    figures = {f"{name}.png" for name in pictures.split()}
    tables = {"terms.csv", "covariance.csv", "force_m1-ground.csv", "force_m2-m1.csv"}
    files = {"structure.toml", "report.html", *figures, *tables}
    assert {path.name for path in discovery_folder.iterdir()} == {"result.json", *files}
    assert json.loads((discovery_folder / "result.json").read_text())["files"] == sorted(files)
    written = lw.read_structure(discovery_folder / "structure.toml")
    assert written.parameters == () and written == discovered.structure


def test_result_json_holds_the_discovery(discovery_folder: Path, discovered: lw.Discovery) -> None:
    result = json.loads((discovery_folder / "result.json").read_text())
    assert result["status"] == "converged" and result["settled"] is True
    assert result["version"] == lw.__version__
    assert [term["name"] for term in result["terms"]] == [term.name for term in discovered.terms]
    assert {"path", "runners_up", "remarks", "links", "noise", "fit"} <= set(result)
    assert result["truth"]["missing"] == result["truth"]["extra"] == [] and len(result["truth"]["right"]) == 5
    assert set(result["nmse_percent"]) == {"m1-ground", "m2-m1"}
    alone = lw.report.result_of(discovered)
    assert "truth" not in alone and "nmse_percent" not in alone


def test_terms_csv_has_every_tested_candidate(discovery_folder: Path, discovered: lw.Discovery) -> None:
    rows = list(csv.DictReader((discovery_folder / "terms.csv").read_text().splitlines()))
    columns = (
        "name link term unit kept told reliable value standard_error z margin first second certain price"
    )
    # as version 0.1.0 wrote them, and what came later behind them: keys of files stay
    assert list(rows[0]) == [*columns.split(), "possible_share"]
    assert [row["name"] for row in rows] == [term.name for term in discovered.terms]
    assert [row["kept"] == "true" for row in rows] == [term.kept for term in discovered.terms]
    margins = [float(row["margin"]) for row in rows]
    # ten printed digits
    assert margins == pytest.approx([term.margin for term in discovered.terms], rel=1e-9)


def test_page_tells_verdict_graph_certainty_and_path_before_the_forces(discovery_folder: Path) -> None:
    page = re.sub(r"<script.*?</script>", "", (discovery_folder / "report.html").read_text(), flags=re.DOTALL)
    wanted = ["5 terms: can be trusted", "<h3>m1-ground", "Discovered links", "How certain it is", "Why these terms",
              "<summary>Residuals", "<summary>Record"]  # fmt: skip
    places = [page.index(text) for text in wanted]
    assert places == sorted(places) and page.count(' role="img" aria-label=') >= 4
    assert re.findall(r'<(?:script|link|img|iframe)[^>]*\b(?:src|href)="(?!data:)', page) == []


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_a_search_that_did_not_settle_is_not_to_be_trusted(discovered: lw.Discovery, tmp_path: Path) -> None:
    verdicts = (*discovered.verdicts, lw.Verdict.SEARCH_UNSETTLED)
    bad = replace(discovered, verdicts=verdicts, remarks=("m2 <b>hardly</b> moved.",))
    text = str(bad)
    assert discovered.trusted and not bad.trusted and text.splitlines()[0].endswith("NOT to be trusted")
    assert lw.Verdict.SEARCH_UNSETTLED.value in " ".join(text.split())
    assert "! m2 <b>hardly</b> moved." in text
    page = (lw.report.write_result(bad, tmp_path / "bad") / "report.html").read_text()
    assert 'class="verdict refused"' in page and 'class="verdict explained"' not in page
    assert "NOT to be trusted" in page and "Against the truth" not in page
    assert "<li>m2 &lt;b&gt;hardly&lt;/b&gt; moved.</li>" in page
