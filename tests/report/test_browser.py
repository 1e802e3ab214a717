"""Pages in a real browser that has no network: they render, with their figures, and the console stays silent."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import CHROMIUM, Shown, show

import linkwise as lw

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


@pytest.fixture(scope="module")
def identified(fitted: lw.Estimate, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """The page of `linkwise identify`."""
    folder = lw.report.write_result(fitted, tmp_path_factory.mktemp("identified") / "answer", truth=chain)
    return show(folder / "report.html", tmp_path_factory.mktemp("browser"))


def test_identify_page_renders_without_a_word_on_the_console(identified: Shown) -> None:
    assert identified.console == ()
    assert identified.shades > 50  # text and lines are smoothed: an empty page has one
    assert "This answer can be trusted." in identified.body


def test_identify_page_has_its_figures(identified: Shown) -> None:
    """plotly draws three layers a figure, all named main-svg, into the division that waits for it."""
    for name in ("force_nes1", "force_spring1", "histories"):
        division = identified.body.partition(f'id="{name}"')[2]
        assert 'class="main-svg"' in division[:3000], name


@pytest.fixture(scope="module")
def studied(paper_report: Path, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """The page of `linkwise study paper`."""
    return show(paper_report / "report.html", tmp_path_factory.mktemp("browser"))


def test_study_page_renders_without_a_word_on_the_console(studied: Shown) -> None:
    assert studied.console == ()
    assert studied.shades > 50
    assert "The paper's results are reproduced, and surpassed." in studied.body


def test_study_page_has_its_figures_at_their_size(studied: Shown) -> None:
    assert [name.partition(":")[0] for name in studied.pictures] == [
        f"Figure {number}" for number in range(2, 10)
    ]
    assert min(studied.pictures.values()) > 400


def test_absorption_page_renders_with_its_figures(
    chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory
) -> None:
    absorption = lw.absorb(chain, duration=1.0, release={"v:m1": 1.0})
    folder = lw.report.write_absorption(absorption, tmp_path_factory.mktemp("absorbed") / "answer")
    shown = show(folder / "report.html", tmp_path_factory.mktemp("browser"))
    assert shown.console == () and shown.shades > 50
    assert len(shown.pictures) == 3 and min(shown.pictures.values()) > 400


def test_discovery_page_renders_with_its_figures(
    discovered: lw.Discovery, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = lw.report.write_discovery(
        discovered, tmp_path_factory.mktemp("discovered") / "answer", truth=chain
    )
    shown = show(folder / "report.html", tmp_path_factory.mktemp("browser"))
    assert shown.console == () and shown.shades > 50
    assert len(shown.pictures) == 4 and min(shown.pictures.values()) > 400
    for name in ("force_m1-ground", "force_m2-m1", "histories"):
        assert 'class="main-svg"' in shown.body.partition(f'id="{name}"')[2][:3000], name


FAULTS = {  # what is told of each
    "<script>console.error('it went wrong')</script>": "it went wrong",
    "<script>nobody.knows()</script>": "nobody is not defined",
    '<img src="https://example.org/picture.png">': "https://example.org/picture.png",
    '<link rel="stylesheet" href="missing.css">': "missing.css",
}


def test_a_broken_picture_and_faults_would_be_seen(tmp_path: Path) -> None:
    """Beside each check, one that must be refused."""
    page = tmp_path / "page.html"
    broken = '<img src="data:image/png;base64,AAAA" alt="broken">'
    page.write_text(
        f"<!doctype html><html><head></head><body><p>Words</p>{broken}{''.join(FAULTS)}</body></html>"
    )
    shown = show(page, tmp_path)
    assert shown.pictures == {"broken": 0}
    assert len(shown.console) == len(FAULTS)
    for message in FAULTS.values():
        assert sum(message in line for line in shown.console) == 1, message


def test_an_empty_page_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("<!doctype html><html><head></head><body></body></html>")
    shown = show(page, tmp_path)
    assert shown.console == () and shown.shades < 5
