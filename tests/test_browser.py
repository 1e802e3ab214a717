"""Pages in a real browser that has no network: they render, with their figures, and the console stays silent."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from matplotlib.image import imread
from paper_rows import paper_rows, paper_study, stored

import linkwise as lw

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
OPTIONS = [
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"),
    *(
        "--disable-component-update",
        "--disable-sync",
        "--hide-scrollbars",
        "--enable-logging=stderr",
        "--v=0",
    ),
    *("--host-resolver-rules=MAP * ~NOTFOUND", "--window-size=1000,2500", "--virtual-time-budget=20000"),
]
# What the page is allowed, put into a copy: all that it carries in itself. Asking for anything else is a word on the console,
# which a file or a host that cannot be had is not.
PROBE = """<script>addEventListener("load", () => {
  for (const image of document.images) image.dataset.width = image.naturalWidth;
})</script>"""
ALLOWED = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


@dataclass(frozen=True)
class Shown:
    """A page after its scripts ran: the document, what stood on the console, how many colours a part of the window shows."""

    document: str
    console: tuple[str, ...]
    shades: int

    @property
    def pictures(self) -> dict[str, int]:
        """Width in pixels of every image by what it is said to show; 0 where it is broken."""
        without = re.sub(r'src="[^"]*"', "", self.document)
        return {
            name: int(width) for name, width in re.findall(r'<img +alt="([^"]*)" data-width="(\d+)"', without)
        }

    @property
    def body(self) -> str:
        """What the reader sees of the document, as markup."""
        return re.sub(r"<script.*?</script>", "", self.document.partition("<body")[2], flags=re.DOTALL)


def show(page: Path, scratch: Path) -> Shown:
    """Open a copy of `page` in a fresh profile below `scratch`, without any network."""
    picture, copy = scratch / "window.png", scratch / "copy.html"
    policy = f'<head><meta http-equiv="Content-Security-Policy" content="{ALLOWED}">{PROBE}'
    markup = page.read_text(encoding="utf-8")
    assert "<head>" in markup
    copy.write_text(markup.replace("<head>", policy, 1), encoding="utf-8")
    run = subprocess.run(
        [
            *(str(CHROMIUM), *OPTIONS, f"--user-data-dir={scratch / 'profile'}"),
            *(f"--screenshot={picture}", "--dump-dom", copy.absolute().as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = re.findall(r":CONSOLE[:(]\d+\)?\] (.*)", run.stderr)
    return Shown(run.stdout, tuple(console), len({tuple(row) for row in imread(picture).reshape(-1, 4)[::7]}))


@pytest.fixture(scope="module")
def identified(fitted: lw.Estimate, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """The page of `linkwise identify`."""
    folder = lw.write_result(fitted, tmp_path_factory.mktemp("identified") / "answer", truth=chain)
    return show(folder / "report.html", tmp_path_factory.mktemp("browser"))


def test_identify_page_renders_without_a_word_on_the_console(identified: Shown) -> None:
    assert identified.console == ()
    assert identified.shades > 50  # text and lines are smoothed: an empty page has one
    assert "This answer can be trusted." in identified.body


def test_identify_page_has_its_figures(identified: Shown) -> None:
    """plotly draws three layers a figure, all named main-svg, into the division that waits for it."""
    for name in ("force-nes1", "force-spring1", "histories"):
        division = identified.body.partition(f'id="{name}"')[2]
        assert 'class="main-svg"' in division[:3000], name


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """The page of `linkwise study paper`."""
    study = paper_study()
    folder = stored(tmp_path_factory.mktemp("studied") / "paper", study, paper_rows(study))
    return show(lw.write_study_report(folder), tmp_path_factory.mktemp("browser"))


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
    found = lw.absorb(chain, duration=1.0, release={"v:m1": 1.0})
    folder = lw.write_absorption(found, tmp_path_factory.mktemp("absorbed") / "answer")
    shown = show(folder / "report.html", tmp_path_factory.mktemp("browser"))
    assert shown.console == () and shown.shades > 50
    assert len(shown.pictures) == 3 and min(shown.pictures.values()) > 400


def test_discovery_page_renders_with_its_figures(
    fitted: lw.Estimate, chain: lw.Structure, tmp_path_factory: pytest.TempPathFactory
) -> None:
    found = lw.discover(fitted.record, {mass.name: mass.mass.value or 0.0 for mass in chain.masses})
    folder = lw.write_discovery(found, tmp_path_factory.mktemp("discovered") / "answer", truth=chain)
    shown = show(folder / "report.html", tmp_path_factory.mktemp("browser"))
    assert shown.console == () and shown.shades > 50
    assert len(shown.pictures) == 3 and min(shown.pictures.values()) > 400
    for name in ("force-m1-ground", "force-m2-m1", "histories"):
        assert 'class="main-svg"' in shown.body.partition(f'id="{name}"')[2][:3000], name


def test_a_broken_picture_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    broken = '<img src="data:image/svg+xml;base64,AAAA" alt="broken">'
    page.write_text(f"<!doctype html><html><head></head><body>{broken}</body></html>")
    assert show(page, tmp_path).pictures == {"broken": 0}


@pytest.mark.parametrize(
    "fault",
    [
        "<script>console.error('it went wrong')</script>",
        "<script>nobody.knows()</script>",
        '<img src="https://example.org/picture.png">',
        '<link rel="stylesheet" href="missing.css">',
    ],
)
def test_a_fault_would_be_seen(fault: str, tmp_path: Path) -> None:
    """Beside each check, one that must be refused."""
    page = tmp_path / "page.html"
    page.write_text(f"<!doctype html><html><head></head><body><p>Words</p>{fault}</body></html>")
    assert len(show(page, tmp_path).console) == 1


def test_an_empty_page_would_be_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("<!doctype html><html><head></head><body></body></html>")
    shown = show(page, tmp_path)
    assert shown.console == () and shown.shades < 5
