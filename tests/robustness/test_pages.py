"""Names that somebody else chose: in pages they run no code, in figures they set no mathematics, in tables no formula."""

import csv
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from present import some

import linkwise as lw
from linkwise.display import csv_cell, from_csv_cell

NAMES = {  # a name holds none of [ ] : = / and the backslash
    "script": 'x")+document.write("mine")+("',
    "element": "<script>document.write(1)<script>a\" onmouseover \"b' onclick '",
    "mathematics": "$x^2$ $y$ {{ 7*7 }}{% x %}",
    "formula": "+cmd|' 'C'!A0,b\"c",
    "at": "＠SUM(1)",  # full width, which some spreadsheets take for a formula too
    "no glyph": "\u8cea\u91cf",  # in no font that comes with matplotlib
}


class Scripts(HTMLParser):
    """What a browser would run: tags in their order and the names of attributes, beside drawings and in them, and links."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.drawn: set[str] = set()
        self.links: set[str] = set()
        self._inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = {name for name, _ in attrs}
        self.links |= {value or "" for name, value in attrs if name.endswith(("href", "src"))}
        self._inside = self._inside or tag == "svg"
        if self._inside:
            self.drawn |= {tag, *names}
        else:
            self.tags.append(tag)
            self.attributes |= names

    def handle_endtag(self, tag: str) -> None:
        self._inside = self._inside and tag != "svg"


def chain_with(name: str) -> lw.Structure:
    """The chain with `name` for its sink, and for itself with the end of a script."""
    chain = lw.bnes_chain(2)
    spring, sink = chain.links
    links = spring, replace(sink, name=name)
    return replace(chain, name=f"{name}</script><script>document.write(1)</script>", links=links)


def written(name: str, folder: Path) -> lw.Estimate:
    """The result folder of an estimate of the sink, with a truth beside it; the record has remarks of somebody else."""
    subject = chain_with(name)
    record = lw.simulate(subject, release={"v:m1": 1.0}, duration=1.0, rate=500.0).with_noise(30.0, seed=1)
    said = f"{name}</script><img src=x>"
    fit = lw.identify(replace(record, source=said, notes=(said,)), subject.unknown(name), method="weak")
    lw.report.write_result(replace(fit, message=said, remarks=(said,)), folder, truth=subject)
    return fit


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Scripts:
    """The page of the same link under its usual name."""
    folder = tmp_path_factory.mktemp("usual") / "answer"
    written("nes1", folder)
    return Scripts((folder / "report.html").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES.keys())
def test_no_text_of_an_answer_adds_anything_that_runs(
    name: str, usual: Scripts, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if name.isascii() and "$" not in name:  # neither mathematics nor a missing glyph
        request.getfixturevalue("unrendered")
    fit = written(name, tmp_path / "answer")
    text = (tmp_path / "answer" / "report.html").read_text(encoding="utf-8")
    page = Scripts(text)
    assert text.count("&lt;img src=x&gt;") >= 2
    assert page.tags == usual.tags and "img" not in page.tags and page.attributes == usual.attributes
    assert lw.read_structure(tmp_path / "answer" / "structure.toml") == fit.structure
    assert "script" not in {*page.tags, *page.drawn} and not any(name.startswith("on") for name in page.drawn)
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert set(lw.estimates.read_posterior(tmp_path / "answer").names) == {
        parameter.name for parameter in fit.parameters
    }


@pytest.mark.usefixtures("unrendered")
def test_no_cell_of_an_absorption_is_a_formula(tmp_path: Path) -> None:
    subject = chain_with(NAMES["formula"])
    absorption = lw.absorb(subject, duration=1.0, release={"v:m1": 1.0})
    lw.report.write_result(absorption, tmp_path / "absorbed")
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
