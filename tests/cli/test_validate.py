"""`linkwise validate`: JSON, exit codes, folders, and what it says of wrong input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.cli import run

pytestmark = pytest.mark.usefixtures("unrendered")

FORCE = "3*sin(25*t) + 2*sin(61*t) + 2*cos(90*t)"


def duffing(k: float) -> lw.Structure:
    return oscillator("k*d + k3*d**3 + c*v", name="spring", k=k, k3=2e6, c=2.0)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with structures, records and an answer."""
    folder = tmp_path_factory.mktemp("validate")
    lw.write_structure(duffing(900.0), folder / "true.toml")
    lw.write_structure(duffing(990.0), folder / "wrong.toml")
    for seed in (1, 2):
        record = lw.simulate(duffing(900.0), forces={"m1": FORCE}, duration=3.0, rate=400.0)
        lw.write_record(record.with_noise(40.0, seed=seed), folder / f"run{seed}.csv")
    estimate = lw.identify(lw.read_record(folder / "run1.csv"), duffing(900.0).unknown("all"))
    lw.report.write_result(estimate, folder / "answer")
    return folder


def written(place: Path, name: str, gain: float, folder: Path) -> Path:
    """A record of `place` whose force was measured with a gain, written into a folder."""
    record = lw.read_record(place / f"{name}.csv")
    values = record.values.copy()
    values[:, record.channels.index("force:m1")] *= gain
    lw.write_record(replace(record, values=values), folder / f"{name}.csv")
    return folder / f"{name}.csv"


@pytest.fixture(scope="module")
def scaled(place: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The answer to a record whose load cell has a gain, with that gain found."""
    folder = tmp_path_factory.mktemp("scaled")
    record = lw.read_record(written(place, "run1", 1.05, folder))
    lw.report.write_result(
        lw.identify(record, duffing(900.0).unknown("all"), gains=["force:m1"]), folder / "answer"
    )
    return folder / "answer"


def test_json_of_an_answer(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--burn", "0.25", "--from", "0.5", "--to", "2.5", "--json"]
    assert run(["validate", str(place / "run2.csv"), str(place / "answer"), *arguments]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    document = json.loads(out)
    assert document["burn"] == 0.25 and document["free_run"] is True and document["trusted"] is True
    score = document["channels"]["x:m1"]
    assert score["unit"] == "m" and score["samples"] == 701 and score["rmse"] <= score["limit"]
    assert score["fit_percent"] == pytest.approx(100 - 10 * np.sqrt(score["nmse_percent"]), rel=1e-12)
    assert set(document["coefficients"]) == {"spring.k", "spring.k3", "spring.c"}
    expected = lw.validate(lw.read_record(place / "run2.csv").between(0.5, 2.5), place / "answer", burn=0.25)
    assert score["rmse"] == pytest.approx(expected.channels["x:m1"].rmse, rel=1e-12)


def test_a_wrong_structure_ends_in_3_and_leaves_a_page(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "validation"
    assert run(["validate", str(place / "run2.csv"), str(place / "wrong.toml"), "-o", str(folder)]) == 3
    out, err = capsys.readouterr()
    assert out.startswith("The prediction differs from the record") and "written to" in err
    assert json.loads((folder / "validation.json").read_text())["verdicts"] == ["PREDICTION_DISAGREES"]
    assert (folder / "report.html").exists() and (folder / "motion.png").exists()
    assert run(["validate", str(place / "run2.csv"), str(place / "true.toml"), "-o", str(folder)]) == 0
    assert (
        run(["validate", str(place / "run2.csv"), str(place / "true.toml"), "-o", str(place / "answer")]) == 2
    )
    assert "another command" in capsys.readouterr().err


def test_a_messy_file_is_mapped_like_that_of_identify(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Columns with other names, one of them in mm, with lines left out and empty cells."""
    record = lw.read_record(place / "run2.csv")
    lines = ["t [s];Laser;Hammer;Temperature"]
    for time, force, x in zip(record.time, record.channel("force:m1"), record.channel("x:m1"), strict=True):
        cell = "" if round(time * 400) % 50 == 7 else f"{1e3 * x:.9g}"
        lines.append(f"{time:.6f};{cell};{force:.9g};21.5")
    path = tmp_path / "messy.csv"
    path.write_text("\n".join(lines) + "\n")
    mapping = ["--channel", "x:m1[mm]=Laser", "--channel", "force:m1=Hammer"]
    assert run(["validate", str(path), str(place / "true.toml"), *mapping, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert run(["validate", str(place / "run2.csv"), str(place / "true.toml"), "--json"]) == 0
    clean = json.loads(capsys.readouterr().out)
    assert document["channels"]["x:m1"]["samples"] == pytest.approx(
        clean["channels"]["x:m1"]["samples"] * 0.98, abs=2
    )
    # the same record but for 2 % of its samples
    assert document["channels"]["x:m1"]["rmse"] == pytest.approx(clean["channels"]["x:m1"]["rmse"], rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["none.csv", "true.toml"], 2, "none.csv: there is no such file"),
        (["run2.csv", "none.toml"], 2, "none.toml"),
        (["run2.csv", "."], 2, "there is no structure.toml in this folder"),
        (["run2.csv", "true.toml", "--burn", "2.99"], 2, "On the command line: --burn S."),
        (["run2.csv", "true.toml", "--burn", "0"], 2, "--burn"),
        (["run2.csv", "run1.csv"], 2, "run1.csv"),
    ],
)
def test_wrong_input_is_one_paragraph(
    arguments: list[str],
    code: int,
    message: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(place)
    assert run(["validate", *arguments]) == code
    out, err = capsys.readouterr()
    assert out == "" and message in err and len(err.strip().splitlines()) == 1


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["validate", "--help"]) == 0
    assert "linkwise validate second.csv answer -o validation" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("gain", "stated", "code", "removed"),
    [
        (1.05, (), 0, True),
        (1.05, ("--gain", "force:m1=1.05"), 0, False),
        (1.05, ("--gain", "force:m1=1.05+-1%"), 0, False),
        (1.05, ("--gain", "force:m1=+-1%"), 0, True),  # nothing was taken out
        (1.0, (), 3, True),
        (1.0, ("--gain", "force:m1=1"), 0, False),
    ],
)
def test_a_gain_that_is_stated_counts_in_place_of_what_the_answer_found(
    gain: float, stated: tuple[str, ...], code: int, removed: bool, tmp_path: Path, place: Path,
    scaled: Path, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Both were taken out, and a record of a load cell that was repaired could not be told."""
    assert run(["validate", str(written(place, "run2", gain, tmp_path)), str(scaled), *stated]) == code
    said = " ".join(capsys.readouterr().out.split())
    assert ("! The gain of force:m1 that the answer found, 1.0" in said) is not removed
    assert ("Removed from the record, as found by the answer: gain of force:m1" in said) is removed
