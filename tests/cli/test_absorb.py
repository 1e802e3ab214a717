"""`linkwise absorb`: what it prints and writes, and what it says to messy input."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import linkwise as lw
from linkwise.absorption import ensemble as survey_module
from linkwise.cli import run

pytestmark = pytest.mark.usefixtures("unrendered")

TRIAL = ["--duration", "1", "--rate", "500", "--release", "v:m1=1.0"]


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("absorb") / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), path)
    return path


@pytest.fixture(scope="module")
def folder(chain: Path) -> Path:
    """A result folder."""
    assert (
        run(["absorb", str(chain), *TRIAL, "--harvester", "nes1=0.01", "-o", str(chain.parent / "out")]) == 0
    )
    return chain.parent / "out"


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """What --json prints, and nothing else."""
    assert run(["absorb", *arguments, "--json"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    document: dict[str, Any] = json.loads(out)
    return document


def test_json_is_the_answer_of_the_library(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--without", "locked", "--settle", "0.5", "--harvester", "nes1=0.01", "--sink", "nes1"]
    document = answer(
        capsys, str(chain), *TRIAL, *options, "--impulse", "m2=0.01@0.2", "--force", "m1=sin(9*t)"
    )
    expected = lw.absorb(
        lw.bnes_chain(2), duration=1.0, rate=500.0, release={"v:m1": 1.0}, impulses=(lw.model.Impulse("m2", 0.01, 0.2),),
        forces={"m1": "sin(9*t)"}, without="locked", settle=0.5, harvesters={"nes1": 0.01}, sinks=("nes1",),
    )  # fmt: skip
    assert (
        document["version"] == lw.__version__
        and document["method"] == "absorb"
        and document["without"] == "locked"
    )
    assert document["rms_reduction"] == pytest.approx(expected.rms_reduction, rel=1e-12)
    assert document["sinks"]["nes1"]["crossing_times"] == expected.sinks[0].crossings.tolist()
    assert document["harvesters"]["nes1"]["average_power"] == pytest.approx(
        expected.harvests[0].power, rel=1e-12
    )
    shares = document["energy"]["with_sinks"]
    # identity, printed with 6 digits
    assert sum(shares["shares"].values()) + shares["remaining"] == pytest.approx(1.0, abs=1e-6)


def test_prints_the_answer(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["absorb", str(chain), *TRIAL]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("With its sinks the RMS of the primary masses is") and err == ""
    assert "nes1    m2    m1" in out and "! m1 did not settle below 5 %" in out


def test_folder_is_complete(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    figures = {f"{name}.{suffix}" for name in ("decay", "energy", "crossings") for suffix in ("png", "csv")}
    assert names == {"absorption.json", "structure.toml", "report.html", *figures}
    result = json.loads((folder / "absorption.json").read_text())
    assert set(result["files"]) == names - {"absorption.json"}
    assert lw.read_structure(folder / "structure.toml").link("nes1-harvester").values == {"c": 0.01}


def test_tables_hold_the_histories(folder: Path) -> None:
    header = (folder / "energy.csv").read_text().splitlines()[0].split(",")
    assert header[:3] == ["time", "put in", "stored"] and "spring1 without sinks" in header
    table = np.loadtxt(folder / "energy.csv", delimiter=",", skiprows=1)
    links = [header.index(name) for name in ("spring1", "nes1", "nes1-harvester")]
    np.testing.assert_allclose(
        table[:, links].sum(axis=1) + table[:, 2], table[:, 1], rtol=1e-9
    )  # ten digits
    decay = np.loadtxt(folder / "decay.csv", delimiter=",", skiprows=1)
    # files have ten digits
    assert decay.shape == (501, 5) and np.all(np.abs(decay[:, 1]) <= decay[:, 2] * (1 + 1e-9))
    lines = (folder / "crossings.csv").read_text().splitlines()
    assert lines[0] == "sink,time" and all(line.startswith("nes1,") for line in lines[1:]) and len(lines) > 20


def test_page_needs_nothing_else(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert re.findall(r'(?:src|href)="(?!data:)', page) == [] and page.count("data:image/png;base64,") == 3
    body = page.partition("<body>")[2]
    assert 0 < body.index("With its sinks") < body.index("<h2>Primary masses") < body.index("<h2>Harvesters")
    # characters: without plotly, which takes 4.8e6; 3.4e5 here
    assert len(page) < 2e6


def test_an_earlier_result_is_replaced_and_other_folders_are_left(
    folder: Path, chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "notes.txt").write_text("mine")
    assert run(["absorb", str(chain), *TRIAL, "-o", str(folder)]) == 0
    assert (folder / "notes.txt").read_text() == "mine"
    assert "harvesters" not in (folder / "report.html").read_text().lower()
    (folder / "notes.txt").unlink()
    elsewhere = tmp_path / "other"
    elsewhere.mkdir()
    (elsewhere / "thesis.tex").write_text("")
    capsys.readouterr()
    assert run(["absorb", str(chain), *TRIAL, "-o", str(elsewhere)]) == 2
    assert "is not a result of linkwise" in capsys.readouterr().err
    assert [path.name for path in elsewhere.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ([*TRIAL, "--sink", "nes2"], 2, 'unknown link "nes2"; did you mean "nes1"?'),
        (["--duration", "1"], 2, "nothing sets the structure in motion; give a release, an impulse"),
        (["--duration", "1", "--release", "v:m2=1"], 2, "--without removed|locked"),
        (["--duration", "1", "--release", "v:m9=1"], 2, "unknown mass 'm9'"),
        ([*TRIAL, "--harvester", "nes1"], 2, "--harvester 'nes1' is not NAME=VALUE, as in --harvester nes1=0.01"),
        ([*TRIAL, "--harvester", "nes1=0"], 2, "the damping of a harvester must be positive, got 0.0 N s/m"),
        ([*TRIAL, "--settle", "1"], 2, "settle is a part of the peak and must be between 0 and 1, got 1.0"),
        ([*TRIAL, "--without", "frozen"], 2, "'frozen' is not one of 'removed', 'locked'"),
        ([*TRIAL, "--rate", "0.5"], 2, "less than one sampling interval"),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_is_one_paragraph(
    chain: Path, options: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["absorb", str(chain), *options]) == code
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err


SWEEPS = ["--sweep", "nes1.alpha=-150:-50:3", "--sweep", "nes1.beta=2e5:2e6:2:log"]


def test_a_sweep_writes_a_map(chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "map"
    assert run(["absorb", str(chain), *TRIAL, *SWEEPS, "--workers", "1", "-o", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert out.startswith(
        "6 runs of 1 s over nes1.alpha from -150 to -50 N/m and nes1.beta from 200000 to 2e+06 N/m^3"
    )
    assert err == f"written to {folder}; open {folder / 'report.html'}\n"
    assert {path.name for path in folder.iterdir()} == {
        "absorption.json", "map.csv", "map.png", "report.html",
    }  # fmt: skip
    header = (folder / "map.csv").read_text().splitlines()[0].split(",")
    table = np.loadtxt(folder / "map.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 0], [-150, -150, -100, -100, -50, -50], rtol=1e-12)
    # files have ten digits
    np.testing.assert_allclose(table[:, 1], [2e5, 2e6] * 3, rtol=1e-9)
    single = lw.absorb(lw.bnes_chain(2, beta=2e6), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    crossings = table[3, header.index("crossings")]
    assert crossings == len(single.sinks[0].crossings)
    page = (folder / "report.html").read_text()
    assert "6 runs of 1 s" in page and page.count("data:image/png;base64,") == 1


def test_a_sweep_as_json(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = answer(capsys, str(chain), *TRIAL, *SWEEPS)
    assert document["runs"] == 6 and document["diverged"] == 0
    assert [axis["name"] for axis in document["axes"]] == ["nes1.alpha", "nes1.beta"]
    assert document["axes"][1]["values"] == pytest.approx([2e5, 2e6])
    shares = document["quantities"]["sinks_share"]
    assert set(shares["best_at"]) == {"nes1.alpha", "nes1.beta"} and np.shape(shares["values"]) == (3, 2)
    assert shares["largest"] == np.max(shares["values"])
    assert document["quantities"]["settled"]["values"][0] == [None, None]  # a second is too short


@pytest.mark.parametrize(
    ("sweeps", "code", "message"),
    [
        (
            ["nes1.alpha=-200:-20"],
            2,
            "'-200:-20' is not FROM:TO:COUNT or FROM:TO:COUNT:log, as in nes1.alpha=-200",
        ),
        (["nes1.alpha=-200:-20:ten"], 2, "'ten' is not a number"),
        (["nes1.alpha=-200:-20:2.5"], 2, "'2.5' is not a whole number from 2 to 100000"),
        (
            ["nes1.alpha=-200:20:5:log"],
            2,
            "cannot have steps of equal ratio; both ends must have the same sign and not be zero",
        ),
        (["nes1.alpha=-200:20:5", "nes1.alpha=1:2:3"], 2, "--sweep is given twice for 'nes1.alpha'"),
        (["nes1.gamma=1:2:3"], 2, 'unknown coefficient "nes1.gamma"; did you mean "nes1.alpha"'),
        (
            ["nes1.alpha=-9:-1:2", "nes1.beta=1:2:2", "nes1.c=1:2:2"],
            2,
            "a sweep takes one or two parameters, got 3",
        ),
    ],
)
def test_what_cannot_be_swept_is_one_paragraph(
    chain: Path, sweeps: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [part for sweep in sweeps for part in ("--sweep", sweep)]
    assert run(["absorb", str(chain), *TRIAL, *options]) == code
    out, err = capsys.readouterr()
    assert out == "" and message in err and err.startswith("linkwise: ") and "\n\n" not in err


def test_a_map_without_a_single_run_fails_with_a_reason(
    chain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = ["--sink", "nes1", "--sweep", "nes1.beta=-2e6:-1e6:2"]
    assert run(["absorb", str(chain), *TRIAL, *sweep]) == 1
    assert "none of the 2 runs came to its end: the motion diverges" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("structure", "code", "message"),
    [
        (
            lw.bnes_chain(2).unknown("nes"),
            2,
            'link "nes1": coefficient alpha is unknown and has no start value',
        ),
        (
            lw.bnes_chain(2, alpha=100.0),
            2,
            "has more than one stable well, so there is no sink to be found; name the sinks",
        ),
        (lw.bnes_chain(2, beta=-1e6, alpha=100.0), 2, "has more than one stable well"),
    ],
)
def test_structures_without_sinks_or_numbers(
    structure: lw.Structure, code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lw.write_structure(structure, tmp_path / "s.toml")
    assert run(["absorb", str(tmp_path / "s.toml"), *TRIAL]) == code
    assert message in capsys.readouterr().err


def test_an_answer_not_to_be_trusted_ends_with_3(
    chain: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    good = lw.absorb(lw.bnes_chain(2), duration=0.5, release={"v:m1": 1.0})
    side = good.with_sinks
    bad = replace(good, with_sinks=replace(side, stored=side.stored + 2e-6 * side.total))
    monkeypatch.setattr(lw, "absorb", lambda *_, **__: bad)
    assert run(["absorb", str(chain), *TRIAL]) == 3
    assert "! The energy balance with sinks has an error of 2e-06" in capsys.readouterr().out


def test_ctrl_c_ends_a_sweep_and_leaves_nothing(
    chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the terminal does: it interrupts the main thread while others run."""
    calls: list[object] = []

    def interrupted(futures: Any) -> Iterator[object]:
        for future in as_completed(futures):
            calls.append(future)
            yield future
            raise KeyboardInterrupt

    monkeypatch.setattr(survey_module, "as_completed", interrupted)
    sweep = ["--sweep", "nes1.beta=2e5:2e6:400", "-o", str(tmp_path / "map")]
    assert run(["absorb", str(chain), *TRIAL, *sweep]) == 130
    assert "interrupted; nothing was left half written" in capsys.readouterr().err
    assert calls and list(tmp_path.iterdir()) == []


def test_a_sink_that_tears_off_fails_with_a_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lw.write_structure(lw.bnes_chain(2, beta=-1e6), tmp_path / "s.toml")
    assert run(["absorb", str(tmp_path / "s.toml"), *TRIAL, "--sink", "nes1"]) == 1
    assert "the motion diverges" in capsys.readouterr().err
