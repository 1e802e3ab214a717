"""Mapping files, decimation and headers on the command line, from a logger's file to the answer."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pytest
from commands import document, refusal, said
from problems import chain_record
from pyarrow import parquet

import linkwise as lw

pytestmark = pytest.mark.usefixtures("inside")

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
MAPPED = "logger.csv --mapping sensors.toml"
BOTH = {"x:m1", "x:m2"}


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


@pytest.fixture
def inside(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)


def read(**keywords: Any) -> lw.Record:
    return lw.read_record("logger.csv", mapping="sensors.toml", **keywords)


@pytest.mark.slow
def test_every_command_that_reads_takes_a_mapping() -> None:
    result = document(f"identify {MAPPED} unknown.toml")
    expected = lw.identify(read(), lw.bnes_chain(2).unknown("nes"))
    alpha = result["links"][1]["coefficients"]["alpha"]
    assert alpha["value"] == expected.coefficient("nes1.alpha").value
    assert any(finding.startswith("x:m1 shows ") for finding in result["findings"])
    links = document(f"discover {MAPPED}")["links"]
    assert [link["name"] for link in links] == ["m1-ground", "m2-m1"]
    assert document(f"validate {MAPPED} chain.toml")["trusted"]
    assert set(document(f"inspect {MAPPED}")["channels"]) == BOTH
    notes = said(f"inspect {MAPPED}").err
    assert "note: x:m1: its gain is known to 1 %." in notes
    assert "note: x:m2: an offset of 0.001 m was removed, as known." in notes


def test_options_go_before_the_mapping() -> None:
    findings = document(f"identify {MAPPED} unknown.toml --sensor x:m2:offset --sensor x:m1:gain=1")[
        "findings"
    ]
    [offset] = [finding for finding in findings if finding.startswith("x:m2 is off by")]
    # 1 mm; at 40 dB the mean of 2000 samples of some centimetres is known to some micrometres
    assert float(offset.split()[4]) == pytest.approx(1e-3, abs=2e-5)
    assert not any(finding.startswith("x:m1 shows ") for finding in findings)
    within = document(f"identify {MAPPED} unknown.toml --sensor x:m2:offset=1mm+-0.01mm")
    assert any(finding.startswith("x:m2 is off by") for finding in within["findings"])


def test_decimation_is_that_of_the_library() -> None:
    channel = document(f"inspect {MAPPED} --decimate 4")["channels"]["x:m1"]
    expected = read().decimate(4)
    assert (channel["rate"], channel["samples"]) == (250.0, len(expected))
    assert channel["maximum"] == expected.channel("x:m1").max()
    assert "samples are too few to decimate by 500" in refusal(f"inspect {MAPPED} --decimate 500")


def test_a_header_line_can_be_named() -> None:
    odd = "inspect odd.csv --mapping sensors.toml"
    Path("odd.csv").write_text("time;x:m1\nof;all\n" + Path("logger.csv").read_text(encoding="utf-8"))
    assert "--header LINE" in refusal(odd)
    for line in ("'Laser 1;'", "7"):
        assert set(document(f"{odd} --header {line}")["channels"]) == BOTH
    assert "no line contains 'Laser 9'" in refusal(f"{odd} --header 'Laser 9'")
    assert "line 9999 cannot be the header" in refusal(f"{odd} --header 9999")


def test_a_first_mapping_is_written_and_used(tmp_path: Path) -> None:
    first = f"{tmp_path}/first.toml"
    out, err = said(f"inspect logger.csv --rate 1000 --write-mapping {first}")
    assert "note: Column Laser 1 was guessed from its unit to be a displacement, x:m1." in err
    assert f"--mapping {first}" in err and "x:m2" in out
    assert set(document(f"inspect logger.csv --rate 1000 --mapping {first}")["channels"]) == BOTH
    assert "is there already" in said(f"inspect logger.csv --write-mapping {first}", 2).err


def test_attributes_of_a_file_are_counted_and_options_go_before_them(tmp_path: Path) -> None:
    record, path = read(), tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["time"] = record.time
        for name in BOTH:
            file[name] = record.channel(name)
            file[name].attrs["unit"] = "m"
        file["x:m1"].attrs["calibration"] = "2 %"
        file["x:m2"].attrs["offset"] = "unknown"
        file["x:m2"].attrs["gain"] = 7.0  # of an amplifier, perhaps
    result = document(f"identify {path} unknown.toml")
    assert {"x:m1 shows", "x:m2 is of"} <= {finding[:10] for finding in result["findings"]}
    notes = said(f"inspect {path}").err
    assert "note: x:m1: its gain is known to 2 %." in notes
    assert "The attribute gain of x:m2, '7.0', was not used" in notes
    known = document(f"identify {path} unknown.toml --sensor x:m2:offset=0 --sensor x:m1:gain=1")
    assert not any("estimated with the other unknowns" in finding for finding in known["findings"])


def test_files_of_other_programs_state_what_is_known_of_sensors(tmp_path: Path) -> None:
    record = chain_record(2, duration=0.2).with_noise(40.0, seed=1)
    sensors = {"x:m1": {"calibration": "1 %", "offset": "+- 0.1 mm"}}
    columns = {"x_m1": record.channel("x:m1"), "x_m2": record.channel("x:m2"), "fs": np.array(1000.0)}
    text = np.array(json.dumps(sensors))
    np.savez(tmp_path / "run.npz", **columns, sensors=text)  # type: ignore[arg-type]  # stub takes a flag
    lists = {name: column.tolist() for name, column in columns.items()}
    (tmp_path / "run.json").write_text(json.dumps(lists | {"sensors": sensors}))
    for suffix in (".npz", ".json"):
        read_back = lw.read_record(tmp_path / f"run{suffix}").uncertainty
        assert read_back == {"x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4)}
    fields = [
        pyarrow.field("time", pyarrow.float64()),
        pyarrow.field("x:m1", pyarrow.float64(), metadata={"calibration": "2 %", "offset": "about zero"}),
    ]
    arrays = [pyarrow.array(record.time), pyarrow.array(record.channel("x:m1"))]
    table = pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))
    parquet.write_table(table, tmp_path / "run.parquet")
    noted = lw.read_record(tmp_path / "run.parquet")
    assert noted.uncertainty == {"x:m1": lw.records.SensorUncertainty(gain=0.02)}
    assert any("The attribute offset of x:m1, 'about zero', was not used" in note for note in noted.notes)


def test_parts_and_files_of_one_clock_are_joined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    lw.write_record(record[:900].select(["x:m1"]), "one.csv")
    lw.write_record(record[920:].select(["x:m1"]), "two.csv")
    lw.write_record(record[300:].select(["x:m2"]), "late.csv")
    joined = "inspect one.csv --then two.csv --channel x:m2=late.csv:x:m2 --by-time"
    channels = document(joined)["channels"]
    # from 0.3 s, where the second instrument begins, to 2 s
    assert (channels["x:m1"]["samples"], channels["x:m1"]["missing"]) == (1681, 20)
    assert (channels["x:m2"]["samples"], channels["x:m2"]["missing"]) == (1701, 0)
    assert "overlaps in time" in refusal("inspect one.csv --then one.csv")
    assert "--by-time joins the files of --channel" in refusal("inspect one.csv --by-time")


def test_a_periodic_test_is_averaged(tmp_path: Path) -> None:
    time = np.arange(2000) / 200.0
    x = np.sin(np.pi * 3.0 * time) + 0.01 * np.random.default_rng(1).standard_normal(2000)
    path = tmp_path / "periodic.csv"
    lw.write_record(lw.Record(0.0, 200.0, ("x:m1",), x[:, None]), path)
    answer = document(f"inspect {path} --period 2")["channels"]["x:m1"]
    expected = lw.records.average_periods(lw.read_record(path), 2.0)
    assert (answer["samples"], answer["noise"]) == (400, expected.noise["x:m1"])
    assert "not a whole number: check it, or resample" in refusal(f"inspect {path} --period 2.001")


def test_other_masses_of_a_mapping_are_told(tmp_path: Path) -> None:
    mapping = tmp_path / "other.toml"
    mapping.write_text(SENSORS.replace("m1 = 1.0", "m1 = 1.5\nm9 = 2.0"), encoding="utf-8")
    err = said(f"validate logger.csv --mapping {mapping} chain.toml").err
    note = "note: m1 weighs 1.5 kg in the mapping file and 1.0 kg in the structure, which counts."
    assert note in err and "states a mass m9, which the structure does not have" in err
