"""`linkwise compare`: methods side by side, with what is missing, and a reason where a method does not apply."""

import json
from pathlib import Path
from typing import Any

import pytest
from commands import document, said
from structures import THREE_TONES, duffing, oscillator

import linkwise as lw
from linkwise.identification.compare import compare

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unrendered")]
LINEAR = oscillator("k*d + c*v", name="spring", k=900.0, c=2.0)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return lw.simulate(duffing(), forces=THREE_TONES, duration=2.0, rate=200.0).with_noise(40.0, seed=1)


def test_methods_stand_side_by_side_with_what_is_missing(record: lw.Record, tmp_path: Path) -> None:
    lw.write_record(record, tmp_path / "run.csv")
    lw.write_structure(LINEAR.unknown("all"), tmp_path / "linear.toml")
    line = f"compare {tmp_path}/run.csv {tmp_path}/linear.toml"
    out, err = said(f"{line} -o {tmp_path}/compared", 3)
    rows = {row.split("  ")[1]: row for row in out.splitlines() if row.startswith("  ")}
    assert " ".join(out.splitlines()[3].split()) == "ml weak sindy ml with d**3 in spring unit"
    assert rows["grade"].split()[1:] == ["refused", "refused", "not", "tested", "explained"]
    result = json.loads((tmp_path / "compared" / "comparison.json").read_text())
    answers = {answer["name"]: answer for answer in result["answers"]}
    assert result["grade"] == "refused" and result["missing"]["cause"] == "term d**3" and "report.html" in err
    errors = [answers[name]["prediction_error_percent"]["x:m1"] for name in ("ml with d**3 in spring", "ml")]
    assert errors[0] < 2.0 < 10.0 < errors[1]  # noise of 40 dB is 1 %
    added = answers["ml with d**3 in spring"]["links"][0]["coefficients"]["added"]
    assert abs(added["value"] - 2e6) < 4.0 * added["standard_error"]
    assert {"forces.png", "report.html", "structure.toml"} < {
        path.name for path in (tmp_path / "compared").iterdir()
    }


def test_right_laws_are_told_and_printed_as_json(record: lw.Record, tmp_path: Path) -> None:
    lw.write_record(record, tmp_path / "run.csv")
    lw.write_structure(duffing().unknown("all"), tmp_path / "cubic.toml")
    result = document(f"compare {tmp_path}/run.csv {tmp_path}/cubic.toml")
    assert result["trusted"] and result["missing"] is None
    assert [answer["name"] for answer in result["answers"]] == ["ml", "weak", "sindy"]


def test_a_method_that_does_not_apply_says_why() -> None:
    rig = lw.rig(
        {"m1": 1.0, "m2": 0.5},
        {"a": "m1 - ground: k*d + c*v", "b": "m2 - m1: k*d + c*v"},
        {"a.k": {"start": 900.0}, "a.c": 2.0, "b.k": 700.0, "b.c": 0.5},
    )
    forced: dict[str, Any] = {"forces": {"m1": "3*sin(25*t)"}, "duration": 2.0, "rate": 200.0}
    hidden = lw.simulate(rig.with_values({"a.k": 1000.0}), sensors=["x:m1"], **forced)
    comparison = compare(hidden.with_noise(40.0, seed=1), rig)
    assert [answer.estimate is None for answer in comparison.answers][::2] == [False, True]
    assert comparison.grade is lw.Grade.EXPLAINED
    assert any(finding.startswith("sindy: ") and "m2" in finding for finding in comparison.findings)
    assert "not applicable" in str(comparison)
