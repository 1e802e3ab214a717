"""Mapping files, decimation and headers on the command line, from a logger's file to the answer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
from problems import chain_record
from pyarrow import parquet

import linkwise as lw
from linkwise.cli import run

SENSORS = """
[time]
column = "Elapsed"
unit = "ms"

[channel."x:m1"]
column = "Laser 1"
unit = "mm"
calibration = "1 %"

[channel."x:m2"]
column = "Laser 2"
unit = "mm"
offset = "1 mm"

[mass]
m1 = 1.0
m2 = "10 g"
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logger's file with a preamble, whose second laser shows 1 mm too much, with its mapping and the structure."""
    folder = tmp_path_factory.mktemp("mapping")
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    rows = [
        f"{1e3 * t:.1f};{1e3 * first:.6f};{1e3 * second + 1.0:.6f}".replace(".", ",")
        for t, first, second in zip(record.time, record.channel("x:m1"), record.channel("x:m2"), strict=True)
    ]
    preamble = ["Operator;Jane", "Time;13:55:01", "Rate [Hz];1000", "", "Elapsed;Laser 1;Laser 2", "ms;mm;mm"]
    (folder / "logger.csv").write_text("\n".join([*preamble, *rows]), encoding="utf-8")
    (folder / "sensors.toml").write_text(SENSORS, encoding="utf-8")
    lw.write_structure(lw.bnes_chain(2), folder / "chain.toml")
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), folder / "unknown.toml")
    return folder


def document(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    assert run([*arguments, "--json"]) == code
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def usual(files: Path) -> tuple[str, ...]:
    return str(files / "logger.csv"), "--mapping", str(files / "sensors.toml")


def read(files: Path, **keywords: Any) -> lw.Record:
    return lw.read_record(files / "logger.csv", mapping=files / "sensors.toml", **keywords)


def test_identify_discover_and_validate_read_by_a_mapping(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = document(capsys, "identify", *usual(files), str(files / "unknown.toml"))
    expected = lw.identify(read(files), lw.bnes_chain(2).unknown("nes"))
    alpha = result["links"][1]["coefficients"]["alpha"]
    assert alpha["value"] == expected.coefficient("nes1.alpha").value
    assert any(finding.startswith("x:m1 shows ") for finding in result["findings"])
    answer = document(capsys, "discover", *usual(files))
    assert [link["name"] for link in answer["links"]] == ["m1-ground", "m2-m1"]
    assert document(capsys, "validate", *usual(files), str(files / "chain.toml"))["trusted"]
    assert set(document(capsys, "inspect", *usual(files))["channels"]) == {"x:m1", "x:m2"}


def test_notes_say_what_was_stated(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["inspect", *usual(files)]) == 0
    printed = capsys.readouterr().err
    assert "note: x:m1: its gain is known to 1 %." in printed
    assert "note: x:m2: an offset of 0.001 m was removed, as known." in printed


def test_options_go_before_the_mapping(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = document(
        capsys, "identify", *usual(files), str(files / "unknown.toml"), "--offset", "x:m2", "--gain", "x:m1=1"
    )
    [offset] = [finding for finding in result["findings"] if finding.startswith("x:m2 is off by")]
    # 1 mm; at 40 dB the mean of 2000 samples of some centimetres is known to some micrometres
    assert float(offset.split()[4]) == pytest.approx(1e-3, abs=2e-5)
    assert not any(finding.startswith("x:m1 shows ") for finding in result["findings"])
    within = document(
        capsys, "identify", *usual(files), str(files / "unknown.toml"), "--offset", "x:m2=1mm+-0.01mm"
    )
    assert any(finding.startswith("x:m2 is off by") for finding in within["findings"])


def test_decimation_is_that_of_the_library(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = document(capsys, "inspect", *usual(files), "--decimate", "4")
    expected = read(files).decimate(4)
    channel = result["channels"]["x:m1"]
    assert (channel["rate"], channel["samples"]) == (250.0, len(expected))
    assert channel["maximum"] == expected.channel("x:m1").max()
    assert run(["inspect", *usual(files), "--decimate", "500"]) == 2
    assert "samples are too few to decimate by 500" in capsys.readouterr().err


def test_a_header_line_can_be_named(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = files / "odd.csv"
    lines = (files / "logger.csv").read_text(encoding="utf-8").split("\n")
    path.write_text("\n".join(["time;x:m1", "of;all", *lines]), encoding="utf-8")
    mapping = ("--mapping", str(files / "sensors.toml"))
    assert run(["inspect", str(path), *mapping]) == 2
    assert "--header LINE" in capsys.readouterr().err
    for line in ("Laser 1;", "7"):
        assert set(document(capsys, "inspect", str(path), *mapping, "--header", line)["channels"]) == {
            "x:m1",
            "x:m2",
        }
    for line, said in (("Laser 9", "no line contains 'Laser 9'"), ("9999", "line 9999 cannot be the header")):
        assert run(["inspect", str(path), *mapping, "--header", line]) == 2
        assert said in capsys.readouterr().err


def test_a_first_mapping_is_written_and_used(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "first.toml"
    assert run(["inspect", str(files / "logger.csv"), "--rate", "1000", "--write-mapping", str(written)]) == 0
    printed = capsys.readouterr()
    assert "note: Column Laser 1 was guessed from its unit to be a displacement, x:m1." in printed.err
    assert f"--mapping {written}" in printed.err and "x:m2" in printed.out
    assert set(
        document(capsys, "inspect", str(files / "logger.csv"), "--rate", "1000", "--mapping", str(written))[
            "channels"
        ]
    ) == {"x:m1", "x:m2"}
    assert run(["inspect", str(files / "logger.csv"), "--write-mapping", str(written)]) == 2
    assert "is there already" in capsys.readouterr().err


def test_attributes_of_a_file_are_counted_and_options_go_before_them(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, path = read(files), tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["time"] = record.time
        for name, unit in (("x:m1", "m"), ("x:m2", "m")):
            file[name] = record.channel(name)
            file[name].attrs["unit"] = unit
        file["x:m1"].attrs["calibration"] = "2 %"
        file["x:m2"].attrs["offset"] = "unknown"
        file["x:m2"].attrs["gain"] = 7.0  # of an amplifier, perhaps
    result = document(capsys, "identify", str(path), str(files / "unknown.toml"))
    assert {"x:m1 shows", "x:m2 is of"} <= {finding[:10] for finding in result["findings"]}
    assert run(["inspect", str(path)]) == 0
    printed = capsys.readouterr().err
    assert "note: x:m1: its gain is known to 2 %." in printed
    assert "The attribute gain of x:m2, '7.0', was not used" in printed
    known = document(
        capsys, "identify", str(path), str(files / "unknown.toml"), "--offset", "x:m2=0", "--gain", "x:m1=1"
    )
    assert not any("estimated with the other unknowns" in finding for finding in known["findings"])


@pytest.mark.parametrize("option", [("--offset", "x:m2"), ("--gain", "x:m2"), ("--delay", "x:m2")])
def test_an_unknown_error_is_for_commands_that_find_it(
    files: Path, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["validate", *usual(files), str(files / "chain.toml"), *option]) == 2
    assert f"{option[0]} x:m2 has no" in capsys.readouterr().err


def test_what_is_known_of_sensors_survives_every_format(tmp_path: Path) -> None:
    known = {
        "x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4, delay=np.inf),
        "common": lw.records.SensorUncertainty(gain=0.02),
    }
    record = chain_record(2, duration=0.2).with_noise(40.0, seed=1)
    stated = lw.Record(0.0, record.rate, record.channels, record.values, uncertainty=known)
    for suffix in (".h5", ".mat", ".parquet"):
        path = tmp_path / f"run{suffix}"
        lw.write_record(stated, path)
        assert lw.read_record(path).uncertainty == known
    text = json.dumps({"x:m1": {"calibration": "1 %", "offset": "+- 0.1 mm"}})
    columns = {"x_m1": record.channel("x:m1"), "x_m2": record.channel("x:m2"), "fs": np.array(1000.0)}
    np.savez(tmp_path / "run.npz", **columns, sensors=np.array(text))  # type: ignore[arg-type]  # stub takes a flag
    read_back = lw.read_record(tmp_path / "run.npz").uncertainty
    assert read_back == {"x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4)}
    (tmp_path / "run.json").write_text(
        json.dumps(
            {name: column.tolist() for name, column in columns.items()} | {"sensors": json.loads(text)}
        )
    )
    assert lw.read_record(tmp_path / "run.json").uncertainty == read_back


def test_parts_of_a_record_and_files_of_one_clock_are_joined(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    for name, part in (("one", record[:900]), ("two", record[920:]), ("late", record[300:])):
        lw.write_record(
            part.select(["x:m1"]) if name != "late" else part.select(["x:m2"]), tmp_path / f"{name}.csv"
        )
    first, second, late = (str(tmp_path / f"{name}.csv") for name in ("one", "two", "late"))
    answer = document(
        capsys, "inspect", first, "--then", second, "--channel", f"x:m2={late}:x:m2", "--by-time"
    )
    channels = answer["channels"]
    # from 0.3 s, where the second instrument begins, to 2 s
    assert (channels["x:m1"]["samples"], channels["x:m1"]["missing"]) == (1681, 20)
    assert (channels["x:m2"]["samples"], channels["x:m2"]["missing"]) == (1701, 0)
    assert run(["inspect", first, "--then", first]) == 2
    assert "overlaps in time" in capsys.readouterr().err
    assert run(["inspect", first, "--by-time"]) == 2
    assert "--by-time joins the files of --channel" in capsys.readouterr().err


def test_a_periodic_test_is_averaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.arange(2000) / 200.0
    x = np.sin(np.pi * 3.0 * time) + 0.01 * np.random.default_rng(1).standard_normal(2000)
    path = tmp_path / "periodic.csv"
    lw.write_record(lw.Record(0.0, 200.0, ("x:m1",), x[:, None]), path)
    answer = document(capsys, "inspect", str(path), "--period", "2")["channels"]["x:m1"]
    expected = lw.records.average_periods(lw.read_record(path), 2.0)
    assert (answer["samples"], answer["noise"]) == (400, expected.noise["x:m1"])
    assert run(["inspect", str(path), "--period", "2.001"]) == 2
    assert "not a whole number: check it, or resample" in capsys.readouterr().err


def test_other_masses_of_a_mapping_are_told(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mapping = tmp_path / "other.toml"
    mapping.write_text(SENSORS.replace("m1 = 1.0", "m1 = 1.5\nm9 = 2.0"), encoding="utf-8")
    arguments = (str(files / "logger.csv"), "--mapping", str(mapping), str(files / "chain.toml"))
    run(["validate", *arguments])
    note = "note: m1 weighs 1.5 kg in the mapping file and 1.0 kg in the structure, which counts."
    err = capsys.readouterr().err
    assert note in err
    assert "states a mass m9, which the structure does not have" in err


def test_metadata_of_parquet_columns_are_read(files: Path, tmp_path: Path) -> None:
    record, path = read(files), tmp_path / "run.parquet"
    fields = [
        pyarrow.field("time", pyarrow.float64()),
        pyarrow.field("x:m1", pyarrow.float64(), metadata={"calibration": "2 %", "offset": "about zero"}),
    ]
    columns = [pyarrow.array(record.time), pyarrow.array(record.channel("x:m1"))]
    parquet.write_table(pyarrow.Table.from_arrays(columns, schema=pyarrow.schema(fields)), path)
    read_back = lw.read_record(path)
    assert read_back.uncertainty == {"x:m1": lw.records.SensorUncertainty(gain=0.02)}
    assert any("The attribute offset of x:m1, 'about zero', was not used" in note for note in read_back.notes)
