"""`linkwise validate`: JSON, exit codes, folders, and gains that are stated or found."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import document, refusal, said
from structures import THREE_TONES, duffing

import linkwise as lw

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unrendered", "inside")]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with structures, records, an answer, and one to a load cell whose gain was found."""
    folder = tmp_path_factory.mktemp("validate")
    lw.write_structure(duffing(), folder / "true.toml")
    lw.write_structure(duffing(990.0), folder / "wrong.toml")
    clean = lw.simulate(duffing(), forces=THREE_TONES, duration=3.0, rate=200.0)
    for seed in (1, 2):
        record = clean.with_noise(40.0, seed=seed)
        lw.write_record(record, folder / f"run{seed}.csv")
        force = np.array([1.05 if name == "force:m1" else 1.0 for name in record.channels])
        lw.write_record(replace(record, values=record.values * force), folder / f"scaled{seed}.csv")
    for name, gains, answer in (("run1", (), "answer"), ("scaled1", ("force:m1",), "scaled")):
        record = lw.read_record(folder / f"{name}.csv")
        estimate = lw.identify(record, duffing().unknown("all"), gains=gains)
        lw.report.write_result(estimate, folder / answer)
    return folder


@pytest.fixture
def inside(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place)


def test_json_of_an_answer() -> None:
    printed = document("validate run2.csv answer --burn 0.25 --from 0.5 --to 2.5")
    assert printed["burn"] == 0.25 and printed["free_run"] is True and printed["trusted"] is True
    score = printed["channels"]["x:m1"]
    assert score["unit"] == "m" and score["samples"] == 351 and score["rmse"] <= score["limit"]
    assert score["fit_percent"] == pytest.approx(100 - 10 * np.sqrt(score["nmse_percent"]), rel=1e-12)
    assert not printed["coefficients"] and printed["refittable"] == ["spring.k", "spring.k3", "spring.c"]
    again = document("validate run2.csv answer --refit")
    assert set(again["coefficients"]) == set(printed["refittable"]) and not again["refittable"]
    expected = lw.validate(lw.read_record("run2.csv").between(0.5, 2.5), "answer", burn=0.25)
    assert score["rmse"] == pytest.approx(expected.channels["x:m1"].rmse, rel=1e-12)


def test_a_wrong_structure_ends_in_3_and_leaves_a_page(tmp_path: Path) -> None:
    folder = tmp_path / "validation"
    out, err = said(f"validate run2.csv wrong.toml -o {folder}", 3)
    assert out.startswith("The prediction differs from the record") and "written to" in err
    assert json.loads((folder / "validation.json").read_text())["verdicts"] == ["PREDICTION_DISAGREES"]
    assert (folder / "report.html").exists() and (folder / "motion.png").exists()
    said(f"validate run2.csv true.toml -o {folder}")
    assert "another command" in refusal("validate run2.csv true.toml -o answer")


@pytest.mark.parametrize(
    ("record", "stated", "code", "removed"),
    [
        ("scaled2.csv", "", 0, True),
        ("scaled2.csv", "--sensor force:m1:gain=1.05", 0, False),
        ("scaled2.csv", "--sensor force:m1:gain=1.05+-1%", 0, False),
        ("scaled2.csv", "--sensor force:m1:gain=+-1%", 0, True),  # nothing was taken out
        ("run2.csv", "", 3, True),
        ("run2.csv", "--sensor force:m1:gain=1", 0, False),
    ],
)
def test_a_stated_gain_replaces_that_of_the_answer(
    record: str, stated: str, code: int, removed: bool
) -> None:
    """Both were taken out, and a record of a load cell that was repaired could not be told."""
    out = " ".join(said(f"validate {record} scaled {stated}", code).out.split())
    assert ("! The gain of force:m1 that the answer found, 1.0" in out) is not removed
    assert ("Removed from the record, as found by the answer: gain of force:m1" in out) is removed
