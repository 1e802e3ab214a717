"""`linkwise absorb`: what it prints and writes, and what it says to messy input."""

import json
import re
from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, said

import linkwise as lw
from linkwise.absorption import ensemble as survey_module

pytestmark = pytest.mark.usefixtures("unrendered")

TRIAL = "--duration 1 --rate 500 --release v:m1=1.0"
SWEEPS = "--sweep nes1.alpha=-150:-50:3 --sweep nes1.beta=2e5:2e6:2:log"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder, beside the chain that it is of."""
    home = tmp_path_factory.mktemp("absorb")
    lw.write_structure(lw.bnes_chain(2), home / "chain.toml")
    said(f"absorb {home}/chain.toml {TRIAL} --harvester nes1=0.01 -o {home}/out")
    return home / "out"


@pytest.fixture
def absorb(folder: Path) -> str:
    return f"absorb {folder.parent}/chain.toml {TRIAL}"


@pytest.mark.slow
def test_json_is_the_answer_of_the_library(absorb: str) -> None:
    options = "--without locked --settle 0.5 --harvester nes1=0.01 --sink nes1"
    printed = document(f"{absorb} {options} --impulse m2=0.01@0.2 --force m1=sin(9*t)")
    expected = lw.absorb(
        lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0}, impulses=(lw.model.Impulse("m2", 0.01, 0.2),),
        forces={"m1": "sin(9*t)"}, without="locked", settle=0.5, harvesters={"nes1": 0.01}, sinks=("nes1",),
    )  # fmt: skip
    assert printed["version"] == lw.__version__
    assert (printed["method"], printed["without"]) == ("absorb", "locked")
    assert printed["rms_reduction"] == pytest.approx(expected.rms_reduction, rel=1e-12)
    assert printed["sinks"]["nes1"]["crossing_times"] == expected.sinks[0].crossings.tolist()
    assert printed["harvesters"]["nes1"]["average_power"] == pytest.approx(
        expected.harvests[0].average_power, rel=1e-12
    )
    shares = printed["energy"]["with_sinks"]
    # identity, printed with 6 digits
    assert sum(shares["shares"].values()) + shares["remaining"] == pytest.approx(1.0, abs=1e-6)


def test_folder_is_complete(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    figures = {f"{name}.{suffix}" for name in ("decay", "energy", "crossings") for suffix in ("png", "csv")}
    assert names == {"absorption.json", "structure.toml", "report.html", *figures}
    result = json.loads((folder / "absorption.json").read_text())
    assert set(result["files"]) == names - {"absorption.json"}
    assert lw.read_structure(folder / "structure.toml").link("nes1-harvester").values == {"c": 0.01}

    header = (folder / "energy.csv").read_text().splitlines()[0].split(",")
    assert header[:3] == ["time", "put in", "stored"] and "spring1 without sinks" in header
    table = np.loadtxt(folder / "energy.csv", delimiter=",", skiprows=1)
    links = table[:, [header.index(name) for name in ("spring1", "nes1", "nes1-harvester")]].sum(axis=1)
    np.testing.assert_allclose(links + table[:, 2], table[:, 1], rtol=1e-9)  # ten digits
    decay = np.loadtxt(folder / "decay.csv", delimiter=",", skiprows=1)
    # files have ten digits
    assert decay.shape == (501, 5) and np.all(np.abs(decay[:, 1]) <= decay[:, 2] * (1 + 1e-9))
    lines = (folder / "crossings.csv").read_text().splitlines()
    assert lines[0] == "sink,time" and all(line.startswith("nes1,") for line in lines[1:]) and len(lines) > 20

    page = (folder / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'(?:src|href)="(?!data:|#)', page) == []
    assert page.count(' role="img" aria-label=') + page.count("<img ") == 3
    body = page.partition("<body>")[2]
    assert 0 < body.index("With its sinks") < body.index("<h2>Primary masses") < body.index("<h2>Harvesters")
    assert len(page) < 1.5e6


def test_an_earlier_result_is_replaced_and_files_of_others_are_left(absorb: str, folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")
    out, _ = said(f"{absorb} -o {folder}")
    assert out.startswith("With its sinks the RMS of the primary masses is")
    assert "nes1    m2    m1" in out and "! m1 did not settle below 5 %" in out
    assert (folder / "notes.txt").read_text() == "mine"
    assert "harvesters" not in (folder / "report.html").read_text().lower()
    (folder / "notes.txt").unlink()


def test_a_sweep_writes_a_map(absorb: str, tmp_path: Path) -> None:
    folder = tmp_path / "map"
    out, err = said(f"{absorb} {SWEEPS} --workers 1 -o {folder}")
    assert out.startswith(
        "6 runs of 1 s over nes1.alpha from -150 to -50 N/m and nes1.beta from 200000 to 2e+06 N/m^3"
    )
    assert err == f"written to {folder}; open {folder / 'report.html'}\n"
    files = {"absorption.json", "structure.toml", "map.csv", "map.png", "report.html"}
    assert {path.name for path in folder.iterdir()} == files
    header = (folder / "map.csv").read_text().splitlines()[0].split(",")
    table = np.loadtxt(folder / "map.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], [-150, -150, -100, -100, -50, -50], rtol=1e-12)
    # files have ten digits
    np.testing.assert_allclose(table[:, 1], [2e5, 2e6] * 3, rtol=1e-9)
    single = lw.absorb(lw.bnes_chain(2, beta=2e6), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    assert table[3, header.index("crossings")] == len(single.sinks[0].crossings)
    page = (folder / "report.html").read_text()
    assert "6 runs of 1 s" in page and page.count(' role="img" aria-label=') == 1

    printed = document(f"{absorb} {SWEEPS}")
    assert printed["runs"] == 6 and printed["diverged"] == 0
    assert [axis["name"] for axis in printed["axes"]] == ["nes1.alpha", "nes1.beta"]
    assert printed["axes"][1]["values"] == pytest.approx([2e5, 2e6])
    shares = printed["quantities"]["sinks_share"]
    assert set(shares["best_at"]) == {"nes1.alpha", "nes1.beta"} and np.shape(shares["values"]) == (3, 2)
    assert shares["largest"] == np.max(shares["values"])
    assert printed["quantities"]["settled"]["values"][0] == [None, None]  # a second is too short


def test_an_answer_not_to_be_trusted_ends_with_3(absorb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    good = lw.absorb(lw.bnes_chain(2), duration=0.5, release={"v:m1": 1.0})
    side = good.with_sinks
    bad = replace(good, with_sinks=replace(side, supplied=side.supplied - 2e-6 * side.total))
    monkeypatch.setattr(lw, "absorb", lambda *_, **__: bad)
    assert "! The energy balance with sinks has an error of 2e-06" in said(absorb, 3).out


def test_ctrl_c_ends_a_sweep(absorb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the terminal does: it interrupts the main thread while others run."""
    calls: list[object] = []

    def interrupted(futures: Any) -> Iterator[object]:
        for future in as_completed(futures):
            calls.append(future)
            yield future
            raise KeyboardInterrupt

    monkeypatch.setattr(survey_module, "as_completed", interrupted)
    err = said(f"{absorb} --sweep nes1.beta=2e5:2e6:400 -o {tmp_path}/map", 130).err
    assert "interrupted; nothing was left half written" in err
    assert calls and list(tmp_path.iterdir()) == []
