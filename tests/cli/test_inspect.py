"""`linkwise inspect`: what it prints of good and of faulty files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import document, said
from present import present
from problems import chain_record
from record_faults import changed, without

import linkwise as lw


@pytest.fixture
def record() -> lw.Record:
    return chain_record(2, duration=2.0).with_noise(30.0, seed=1)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".h5", ".parquet"])
def test_a_clean_record_of_each_format_gives_no_alert(suffix: str, record: lw.Record, tmp_path: Path) -> None:
    lw.write_record(record, tmp_path / f"run{suffix}")
    printed = document(f"inspect {tmp_path}/run{suffix}")
    x = printed["channels"]["x:m1"]
    assert printed["alerts"] == []
    assert (x["unit"], x["samples"], x["missing"], x["rate"]) == ("m", 2001, 0, 1000.0)
    assert x["maximum"] == record.channel("x:m1").max()
    # the standard error of the estimate is about 2 % at 2001 samples
    assert x["noise"] == pytest.approx(present(record.simulated).noise["x:m1"], rel=0.1)


def test_alerts_come_first_and_name_the_options_that_mend(record: lw.Record, tmp_path: Path) -> None:
    lw.write_record(without(record, x_m2=slice(100, 103)), tmp_path / "gaps.csv")
    out = said(f"inspect {tmp_path}/gaps.csv").out
    assert out.startswith("1 alert, worst first.\n! dropped x:m2: 3 of 2001 samples are missing in one gap")
    assert "the longest of 3 samples at 0.1 s" in out and "(--from S, --to S)" in out


def test_errors_that_fits_find_are_named_as_they_are_typed(record: lw.Record, tmp_path: Path) -> None:
    values = record.values + np.outer(5e-3 * np.sin(2.0 * np.pi * 50.0 * record.time), [0.0, 1.0])
    lw.write_record(replace(record, values=values, simulated=None), tmp_path / "hum.csv")
    assert "(--sensor x:m2:hum=HZ (identify))" in said(f"inspect {tmp_path}/hum.csv").out


def test_channels_that_fits_refuse_are_inspected(record: lw.Record, tmp_path: Path) -> None:
    path = tmp_path / "faulty.csv"
    x = record.channel("x:m1")
    columns = np.column_stack([record.time, x, -2.0 * x, np.full(len(x), 1e-3)])
    np.savetxt(path, columns, delimiter=",", header="time,x:m1,x:m2,x:m3", comments="", fmt="%.17g")
    alerts = {(alert["kind"], alert["channel"]) for alert in document(f"inspect {path}")["alerts"]}
    assert alerts == {("equal", "x:m2"), ("dead", "x:m3")}
    with pytest.raises(lw.RecordError, match=r"every sample is 0\.001"):
        lw.read_record(path)


def test_several_files_are_told_together(record: lw.Record, tmp_path: Path) -> None:
    good, clipped = str(tmp_path / "good.csv"), str(tmp_path / "clipped.csv")
    lw.write_record(record, good)
    lw.write_record(changed(record, x_m1=lambda x: np.clip(x, -0.7 * x.max(), None)), clipped)
    printed = document(f"inspect {good} {clipped}")
    assert [summary["record"] for summary in printed["records"]] == [good, clipped]
    [alert] = printed["alerts"]
    assert (alert["kind"], alert["channel"], alert["record"]) == ("clipped", "x:m1", clipped)
    out = " ".join(said(f"inspect {good} {clipped}").out.split())  # lines are wrapped
    assert f"! {clipped}: clipped x:m1" in out and f"{good}: 2001 samples at 1000 Hz, 0 to 2 s" in out
