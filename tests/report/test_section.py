"""A new figure is one function and one line in the page's list of sections."""

import json
import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import linkwise as lw
import linkwise.paper
from linkwise.plot.links import force_figure
from linkwise.registry import Registry
from linkwise.report import absorption, discovery, estimate
from linkwise.report.page import Build, Reported, figure_section

pytestmark = pytest.mark.usefixtures("unrendered")

FUNCTION = '''
from linkwise.plot.style import sheet


def spectrum_figure(result):
    """What a contributor writes."""
    with sheet() as (figure, [axes]):
        axes.plot([1.0, 2.0], [3.0, 4.0], label=type(result).__name__)
    return figure
'''
LINE = '"spectrum": figure_section("Spectrum of all", spectrum_figure),'


@pytest.fixture
def section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Build[Any]]:
    """The section of that line, its function in a temporary module."""
    (tmp_path / "temporary_spectrum.py").write_text(FUNCTION, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    module = import_module("temporary_spectrum")
    entry = eval(f"{{{LINE}}}", {"figure_section": figure_section, "spectrum_figure": module.spectrum_figure})
    yield entry["spectrum"]
    del sys.modules["temporary_spectrum"]


@pytest.mark.parametrize("kind", ["Estimate", "Discovery", "Absorption"])
def test_a_figure_of_an_answer_is_a_function_and_a_line(
    kind: str,
    section: Build[Any],
    fitted: lw.Estimate,
    discovered: lw.Discovery,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The figure is on the page and beside it as a file; that folders hold no other is tested beside."""

    def write_absorbed(folder: Path) -> Path:
        absorbed = lw.absorb(lw.bnes_chain(2), duration=0.1, rate=500.0, release={"v:m1": 1.0})
        return lw.report.write_absorption(absorbed, folder)

    kinds: dict[str, tuple[Registry[Build[Any]], Callable[[Path], Path]]] = {
        "Estimate": (estimate.SECTIONS, partial(lw.report.write_result, fitted)),
        "Discovery": (discovery.SECTIONS, partial(lw.report.write_discovery, discovered)),
        "Absorption": (absorption.SECTIONS, write_absorbed),
    }
    sections, write = kinds[kind]
    monkeypatch.setitem(sections, "spectrum", section)
    folder = write(tmp_path / "answer")
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Spectrum of all</h2>" in page and 'aria-label="Spectrum of all"' in page
    assert (folder / "spectrum.png").exists()
    [listed] = folder.glob("*.json")
    assert "spectrum.png" in json.loads(listed.read_text())["files"]
    assert kind != "Absorption" or re.search(r"the balance closes to \d+e-\d+\.", page)


def test_a_figure_of_every_link(fitted: lw.Estimate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(reported: Reported[lw.Estimate], link: str) -> Callable[[], Figure]:
        return lambda: force_figure(reported.result, link)

    monkeypatch.setitem(estimate.LINK_FIGURES, "again", again)
    folder = lw.report.write_result(fitted, tmp_path / "answer")
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert (folder / "again_nes1.png").exists() and page.count('aria-label="nes1"') == 2
    assert not (folder / "again_spring1.png").exists()  # all of it is known
