"""Pages in a real browser that has no network: they render, with their figures, and the console stays silent."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, Shown, show
from problems import chain_record

import linkwise as lw
from linkwise.identification.compare import compare

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")]


def shown(folder: Path, scratch: Path, *, figures: int, width: int = 800) -> Shown:
    """The page of a folder: it renders without a word on the console, with its figures at their size."""
    scratch.mkdir()
    page = show(folder / "report.html", scratch, width)
    assert page.console == () and page.overlaps == "" and page.cut == ""
    assert (folder / "report.html").stat().st_size < 1.5e6
    assert page.shades > 50  # text and lines are smoothed: an empty page has one
    assert len(page.pictures) == figures and min(width for _, width in page.pictures) > 400
    return page


@pytest.mark.parametrize("width", [800, 1280])
def test_identify_page(width: int, tmp_path: Path) -> None:
    """Everything is unfolded, no two texts overlap, none is cut, and the page is small."""
    chain = lw.bnes_chain(2)
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=1)
    folder = lw.report.write_result(lw.identify(record, chain.unknown("all")), tmp_path / "answer")
    shown(folder, tmp_path / "browser", figures=4, width=width)


PLANE = {"x:m2": (-0.02, 0.02), "v:m2": (-0.2, 0.2)}
PAGES: dict[str, tuple[Callable[[lw.Structure, lw.Record, lw.Estimate], Any], int]] = {  # and figures
    "inspect": (lambda chain, record, fit: lw.inspect(record), 4),
    "validate": (lambda chain, record, fit: lw.validate(record, fit), 4),
    "compare": (lambda chain, record, fit: compare(record, chain.unknown("nes")), 1),
    "respond": (
        lambda chain, record, fit: lw.respond(chain, force={"m1": 0.3}, hz=(21.0, 24.0), starts=0, levels=(0.1, 0.3)),
        1,
    ),
    "backbone": (lambda chain, record, fit: lw.backbone(fit, 1, to_energy=1e-3), 1),
    "basins": (lambda chain, record, fit: lw.response.basins(chain, PLANE, points=4), 1),
    "design": (
        lambda chain, record, fit: lw.design(
            chain,
            {"nes1.alpha": (-300.0, -20.0), "m2.mass": (0.005, 0.02)},
            "rms",
            lw.absorption.DesignOptions(evaluations=20),
            release={"v:m1": 1.0},
            duration=0.5,
        ),
        3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("question", PAGES)
def test_pages_say_what_follows(
    question: str, chain: lw.Structure, fitted: lw.Estimate, tmp_path: Path
) -> None:
    answer, figures = PAGES[question]
    record = chain_record(2, duration=1.0).with_noise(30.0, seed=2)
    folder = lw.report.write_result(answer(chain, record, fitted), tmp_path / "answer")
    for width in (800, 1280):
        page = shown(folder, tmp_path / f"{width}", figures=figures, width=width)
        assert "<b>Next:</b>" in page.body


@pytest.mark.parametrize("width", [800, 1280])
def test_study_page(width: int, paper_report: Path, tmp_path: Path) -> None:
    page = shown(paper_report, tmp_path / "browser", figures=8, width=width)
    assert "The paper's results are reproduced, and surpassed." in page.body
    names = [name.partition(":")[0] for name, _ in page.pictures]
    assert names == [f"Figure {number}" for number in range(2, 10)]


def test_absorption_pages(chain: lw.Structure, tmp_path: Path) -> None:
    options: dict[str, Any] = {"duration": 0.5, "rate": 500.0, "release": {"v:m1": 1.0}}
    over = {"nes1.alpha": [-150.0, -100.0], "nes1.beta": [5e5, 1e6]}
    absorption, swept = lw.absorb(chain, **options), lw.absorption.absorption_map(chain, over, **options)
    shown(lw.report.write_result(absorption, tmp_path / "absorbed"), tmp_path / "first", figures=3)
    shown(lw.report.write_result(swept, tmp_path / "map"), tmp_path / "second", figures=1)


def test_discovery_page(discovered: lw.Discovery, chain: lw.Structure, tmp_path: Path) -> None:
    folder = lw.report.write_result(discovered, tmp_path / "answer", truth=chain)
    shown(folder, tmp_path / "browser", figures=7)


FAULTS = {  # what is told of each
    "<script>console.error('it went wrong')</script>": "it went wrong",
    "<script>nobody.knows()</script>": "nobody is not defined",
    '<img src="https://example.org/picture.png">': "https://example.org/picture.png",
    '<link rel="stylesheet" href="missing.css">': "missing.css",
}


def test_faults_and_an_empty_page_would_be_seen(tmp_path: Path) -> None:
    """Beside each check, one that must be refused."""
    page, html = tmp_path / "page.html", "<!doctype html><html><head></head><body>{}</body></html>"
    broken = '<img src="data:image/png;base64,AAAA" alt="broken">'
    page.write_text(html.format(f"<p>Words</p>{broken}{''.join(FAULTS)}"))
    faulty = show(page, tmp_path)
    assert faulty.pictures == [("broken", 0)]
    assert len(faulty.console) == len(FAULTS)
    for message in FAULTS.values():
        assert sum(message in line for line in faulty.console) == 1, message
    assert faulty.overlaps == ""
    page.write_text(html.format('<p>Words</p><p style="margin-top: -2em">over others</p>'))
    (tmp_path / "over").mkdir()
    assert show(page, tmp_path / "over").overlaps == "Words | over others"
    page.write_text(html.format('<p style="margin-left: 99vw; white-space: nowrap">beyond the window</p>'))
    (tmp_path / "cut").mkdir()
    assert show(page, tmp_path / "cut").cut == "beyond the window"
    (tmp_path / "again").mkdir()
    page.write_text(html.format(""))
    empty = show(page, tmp_path / "again")
    assert empty.console == () and empty.shades < 5
