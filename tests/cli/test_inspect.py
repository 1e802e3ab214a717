"""`linkwise inspect`: what it prints of good and of faulty files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.cli import run


@pytest.fixture
def record() -> lw.Record:
    return chain_record(2, duration=2.0).with_noise(30.0, seed=1)


def test_a_clean_record_of_each_format_gives_no_alert(
    record: lw.Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for suffix in (".csv", ".mat", ".h5", ".parquet"):
        path = tmp_path / f"run{suffix}"
        lw.write_record(record, path)
        assert run(["inspect", str(path), "--json"]) == 0
        out, err = capsys.readouterr()
        document = json.loads(out)
        assert document["alerts"] == [] and err == ""
        x = document["channels"]["x:m1"]
        assert (x["unit"], x["samples"], x["missing"], x["rate"]) == ("m", 2001, 0, 1000.0)
        assert x["maximum"] == record.channel("x:m1").max()
        truth = record.simulated
        assert truth is not None
        # the standard error of the estimate is about 2 % at 2001 samples
        assert x["noise"] == pytest.approx(truth.noise["x:m1"], rel=0.1)


def test_alerts_come_first_and_name_the_options_that_mend(
    record: lw.Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = record.values.copy()
    values[100:103, 1] = np.nan
    path = tmp_path / "gaps.csv"
    lw.write_record(replace(record, values=values), path)
    assert run(["inspect", str(path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("1 alert, worst first.\n! dropped x:m2: 3 of 2001 samples are missing in one gap")
    assert "the longest of 3 samples at 0.1 s" in out and "(--from S, --to S)" in out


def test_channels_that_fits_refuse_are_inspected(
    record: lw.Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "faulty.csv"
    x = record.channel("x:m1")
    columns = np.column_stack([record.time, x, -2.0 * x, np.full(len(x), 1e-3)])
    np.savetxt(path, columns, delimiter=",", header="time,x:m1,x:m2,x:m3", comments="", fmt="%.17g")
    assert run(["inspect", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    alerts = {(alert["kind"], alert["channel"]) for alert in document["alerts"]}
    assert alerts == {("equal", "x:m2"), ("dead", "x:m3")}
    with pytest.raises(lw.RecordError, match=r"every sample is 0\.001"):
        lw.read_record(path)


def test_several_files_are_told_together(
    record: lw.Record, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = record.values.copy()
    values[:, 0] = np.clip(values[:, 0], -0.7 * values[:, 0].max(), None)
    paths = [tmp_path / "good.csv", tmp_path / "clipped.csv"]
    lw.write_record(record, paths[0])
    lw.write_record(replace(record, values=values), paths[1])
    assert run(["inspect", *map(str, paths), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [summary["record"] for summary in document["records"]] == list(map(str, paths))
    [alert] = document["alerts"]
    assert (alert["kind"], alert["channel"], alert["record"]) == ("clipped", "x:m1", str(paths[1]))
    assert run(["inspect", *map(str, paths)]) == 0
    out = " ".join(capsys.readouterr().out.split())  # lines are wrapped
    assert f"! {paths[1]}: clipped x:m1" in out and f"{paths[0]}: 2001 samples at 1000 Hz, 0 to 2 s" in out


def test_a_file_that_cannot_be_read_is_wrong_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "no.csv"
    path.write_text("time,x:m1\n0,one\n")
    assert run(["inspect", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and "no.csv" in err and "Traceback" not in err
    assert run(["inspect"]) == 2
