"""`linkwise identify`: from files to the answer, to the folder, and to the exit code."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import linkwise as lw
from linkwise.cli import run

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, chain: lw.Structure, fitted: lw.Estimate) -> Path:
    """A folder with the true chain, the one to identify, and the record as a file."""
    folder = tmp_path_factory.mktemp("identify")
    lw.write_structure(chain, folder / "chain.toml")
    lw.write_structure(chain.unknown("nes"), folder / "unknown.toml")
    lw.write_record(fitted.record, folder / "run.csv")
    return folder


def arguments(files: Path, *options: str) -> list[str]:
    return ["identify", str(files / "run.csv"), str(files / "unknown.toml"), "--method", "weak", *options]


def test_prints_the_table_of_the_library(
    files: Path, fitted: lw.Estimate, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files)) == 0
    out, err = capsys.readouterr()
    assert "nes1" in out and "alpha" in out and "N/m" in out and err == ""


def test_json_is_all_that_is_printed(
    files: Path, fitted: lw.Estimate, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(files, "--json")) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    sink = next(link for link in result["links"] if link["name"] == "nes1")
    alpha = sink["coefficients"]["alpha"]["value"]
    assert alpha == pytest.approx(fitted.coefficient("nes1.alpha").value, rel=1e-8)  # same numerics
    assert err == "" and "nmse_percent" not in result


def test_compares_with_the_truth(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments(files, "--truth", str(files / "chain.toml"))) == 0
    assert "against the truth: NMSE of the force (paper Eq. 8)" in capsys.readouterr().out
    assert run(arguments(files, "--truth", str(files / "chain.toml"), "--json")) == 0
    assert set(json.loads(capsys.readouterr().out)["nmse_percent"]) == {"spring1", "nes1"}


def test_writes_the_folder_and_its_structure_is_the_next_input(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = tmp_path / "answer"
    assert run(arguments(files, "-o", str(answer))) == 0
    assert str(answer / "report.html") in capsys.readouterr().err
    again = ["simulate", str(answer / "structure.toml"), "--duration", "0.1", "--rate", "500"]
    assert run([*again, "--release", "v:m1=1", "-o", str(tmp_path / "run.csv")]) == 0


def test_part_of_the_record(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments(files, "--from", "0.5", "--to", "2.5", "--json")) == 0
    whole, part = 2 * 3001, 2 * 2001
    assert json.loads(capsys.readouterr().out)["fit"]["samples"] in range(part - 200, whole - 1000)


def test_columns_are_mapped(
    files: Path, fitted: lw.Estimate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = np.column_stack([fitted.record.time, 1e3 * fitted.record.values])
    path = tmp_path / "laser.csv"
    np.savetxt(path, table, delimiter=",", header="time,Laser 1,Laser 2", comments="")
    mapping = ["--channel", "x:m1[mm]=Laser 1", "--channel", "x:m2[mm]=Laser 2"]
    assert run(["identify", str(path), *arguments(files, *mapping, "--json")[2:]]) == 0
    sink = next(link for link in json.loads(capsys.readouterr().out)["links"] if link["name"] == "nes1")
    alpha = sink["coefficients"]["alpha"]["value"]
    assert alpha == pytest.approx(fitted.coefficient("nes1.alpha").value, rel=1e-6)  # the file has 18 digits


def test_an_answer_not_to_be_trusted_has_exit_code_3(
    files: Path, fitted: lw.Estimate, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = replace(fitted, fit_verdicts=(lw.Verdict.NOT_CONVERGED,))
    monkeypatch.setattr(lw, "identify", lambda record, structure, **_: bad)
    assert run(arguments(files)) == 3
    assert "not converged" in capsys.readouterr().out


def test_a_folder_that_is_no_result_is_refused_before_the_work(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    monkeypatch.setattr(lw, "identify", lambda *_, **__: pytest.fail("the work was begun"))
    assert run(arguments(files, "-o", str(tmp_path))) == 2
    assert "is not a result of linkwise" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("record", "options", "message"),
    [
        ("nowhere.csv", [], "nowhere.csv"),
        ("run.csv", ["--channel", "x:m1"], "--channel 'x:m1' is not NAME=VALUE"),
        ("run.csv", ["--channel", "x:m1=Laser"], "Laser"),
        ("run.csv", ["--method", "magic"], "'magic' is not one of"),
        ("run.csv", ["--from", "9"], "9"),
        ("run.csv", ["--truth", "nowhere.toml"], "nowhere.toml"),
        ("text.csv", [], "line 3"),
        ("unit.csv", [], "x:m1"),
    ],
)
def test_unreadable_input_is_one_paragraph_and_exit_code_2(
    record: str, options: list[str], message: str, files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "\n".join(f"{k / 1000},{k % 7},{k % 5}" for k in range(100))
    (files / "text.csv").write_text(f"time,x:m1,x:m2\n{rows}\n".replace("0.001,1,1", "0.001,one,1"))
    (files / "unit.csv").write_text(f"time,x:m1[N],x:m2\n{rows}\n")
    assert run(["identify", str(files / record), str(files / "unknown.toml"), *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err
