"""Names that somebody else chose: in pages they run no code, in figures they set no mathematics, in tables no formula."""

from __future__ import annotations

import csv
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from present import some

import linkwise as lw
from linkwise.display import csv_cell, from_csv_cell

NAMES = {  # a name holds none of [ ] : = / and the backslash
    "script": 'x")+document.write("mine")+("',
    "element": "<script>document.write(1)<script>",
    "attribute": "a\" onmouseover \"b' onclick '",
    "half mathematics": "$frac{",
    "mathematics": "$x^2$ $y$",
    "template": "{{ 7*7 }}{% x %}",
    "formula": "+cmd|' 'C'!A0",
    "at": "@SUM(1)",
    "comma": 'a,b"c',
    "no glyph": "\u8cea\u91cf",  # in no font that comes with matplotlib
}


class Scripts(HTMLParser):
    """What a browser would run: the text of scripts, and the names of attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.scripts: list[str] = []
        self.attributes: set[str] = set()
        self._inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes |= {name for name, _ in attrs}
        self._inside = tag == "script"
        if self._inside:
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = False

    def handle_data(self, data: str) -> None:
        if self._inside:
            self.scripts[-1] += data


def link_names(name: str) -> lw.Structure:
    """The chain with `name` for its sink alone, which may have any name."""
    quoted = name.replace("\\", "\\\\").replace('"', '\\"')
    return lw.parse_structure(lw.format_structure(lw.bnes_chain(2)).replace('"nes1"', f'"{quoted}"'))


def written(subject: lw.Structure, unknown: str, folder: Path) -> lw.Estimate:
    """The result folder of an estimate of the link `unknown`, with a truth beside it."""
    record = lw.simulate(subject, release={"v:m1": 1.0}, duration=1.0, rate=500.0).with_noise(30.0, seed=1)
    fit = lw.identify(record, subject.unknown(unknown), method="weak")
    lw.write_result(fit, folder, truth=subject)
    return fit


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Scripts:
    """The page of the same link under its usual name."""
    folder = tmp_path_factory.mktemp("usual") / "answer"
    written(lw.bnes_chain(2), "nes1", folder)
    return Scripts((folder / "report.html").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES.keys())
def test_the_name_of_a_link_adds_nothing_that_runs(
    name: str, usual: Scripts, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if name.isascii() and "$" not in name:  # neither mathematics nor a missing glyph
        request.getfixturevalue("unrendered")
    fit = written(link_names(name), name, tmp_path / "answer")
    page = Scripts((tmp_path / "answer" / "report.html").read_text(encoding="utf-8"))
    assert len(page.scripts) == len(usual.scripts) and page.attributes == usual.attributes
    for script in some(page.scripts):
        assert 'document.write("mine")' not in script
    assert set(lw.read_posterior(tmp_path / "answer").names) == {
        parameter.name for parameter in fit.parameters
    }


@pytest.mark.usefixtures("unrendered")
def test_no_cell_of_an_absorption_is_a_formula(tmp_path: Path) -> None:
    subject = link_names(NAMES["formula"])
    absorption = lw.absorb(subject, duration=1.0, release={"v:m1": 1.0})
    lw.write_absorption(absorption, tmp_path / "absorbed")
    for name in ("decay.csv", "energy.csv", "crossings.csv"):
        with (tmp_path / "absorbed" / name).open(newline="") as file:
            header, *rows = csv.reader(file)
        assert not any(cell.startswith(("=", "+", "-", "@")) for cell in some(header))
        assert {len(row) for row in rows} == {len(header)}
        assert not any(row[0].startswith(("=", "+", "@")) for row in some(rows))
    names = np.genfromtxt(tmp_path / "absorbed" / "decay.csv", delimiter=",", names=True)
    assert len(names) == len(absorption.time)


@pytest.mark.parametrize("text", ["nes1", "=1+1", "'=1+1", "''", "+a", "-a", "@a", "\ta", "", "a'b"])
def test_a_cell_comes_back_as_it_was(text: str) -> None:
    cell = csv_cell(text)
    assert isinstance(cell, str) and from_csv_cell(cell) == text
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r"))
