"""Mapping files: columns, units and sensors stated once, errors that name the key, and a first mapping to be edited."""

import os
from pathlib import Path

import numpy as np
import pytest

import linkwise as lw
from linkwise.files import write_first_mapping
from linkwise.files.mapping import RecordMapping, read_mapping

N, RATE = 400, 100.0
T = np.arange(N) / RATE
X, A = np.sin(20.0 * T), np.cos(31.0 * T)

MAPPING = """
calibration = "2 %"
common_calibration = "1 %"

[time]
column = "Zeit"
unit = "ms"

[channel."x:m1"]
column = "Laser 1"
unit = "mm"
calibration = "0.5 %"
offset = "0.3 mm +- 0.1 mm"
noise = "5 um"

[channel."a:m2"]
column = 3
unit = "m/s^2"
gain = 1.02
delay = "+- 1 ms"

[mass]
m1 = "1 kg"
m2 = "unknown"
"""


def logger(folder: Path) -> Path:
    """A semicolon file with decimal commas, whose laser shows 0.3 mm too much and whose accelerometer 2 % too much."""
    rows = [
        f"{1e3 * t:.0f};{1e3 * x + 0.3:.7f};{1.02 * a:.9f}".replace(".", ",")
        for t, x, a in zip(T, X, A, strict=True)
    ]
    path = folder / "logger.csv"
    path.write_text("\n".join(["Zeit;Laser 1;Acc", *rows]))
    return path


def mapping_file(folder: Path, text: str = MAPPING) -> Path:
    path = folder / "sensors.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_mapping_says_what_columns_are_and_takes_known_errors_out(tmp_path: Path) -> None:
    record = lw.read_record(logger(tmp_path), mapping=mapping_file(tmp_path))
    assert record.rate == RATE and record.channels == ("x:m1", "a:m2")
    # the files have seven digits of a millimetre, and nine of the acceleration
    assert record.channel("x:m1") == pytest.approx(X, abs=1e-10)
    assert record.channel("a:m2") == pytest.approx(A, abs=1e-9)
    assert record.noise["x:m1"] == pytest.approx(5e-6, rel=1e-12)
    known = record.uncertainty
    assert (known["x:m1"].gain, known["common"].gain) == (0.005, 0.01)
    assert known["x:m1"].offset == pytest.approx(1e-4, rel=1e-12)
    # a gain that is stated has no standard deviation but its own
    assert known["a:m2"] == lw.records.SensorUncertainty(delay=1e-3)
    assert "x:m1: an offset of 0.0003 m was removed, as known." in record.notes
    assert any(note.startswith("a:m2: its delay is known to 0.001 s") for note in record.notes)


def test_arguments_go_before_the_mapping(tmp_path: Path) -> None:
    mapping = mapping_file(tmp_path)
    record = lw.read_record(
        logger(tmp_path), mapping=mapping, channels={"x:m1[m]": "Acc"}, rate=50.0, informative=False
    )
    assert record.rate == 50.0 and abs(record.channel("x:m1")).max() > 1.0
    own = RecordMapping(sensors={"x:m1": lw.records.SensorStatement.of({"offset": "unknown"}, "x:m1")})
    both = own.over(read_mapping(mapping))
    offset, gain = both.sensors["x:m1"].offset, both.sensors["x:m1"].gain
    assert offset == (0.0, np.inf) and gain == (1.0, 0.005)
    assert both.masses == {"m1": 1.0, "m2": "unknown"} and both.source == str(mapping)


def test_the_calibration_of_all_is_of_responses_of_which_nothing_else_is_said(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = (f"{t},{x},{a},{a}" for t, x, a in zip(T, X, A, strict=True))
    path.write_text("\n".join(["time,x:m1,a:m2,force:m1", *rows]))
    text = 'calibration = "2 %"\n[channel."x:m1"]\ncalibration = 0.005\ndecimate = 1'
    with pytest.raises(lw.RecordError, match=r'channel\."x:m1": unknown key "decimate"'):
        lw.read_record(path, mapping=mapping_file(tmp_path, text))
    record = lw.read_record(path, mapping=mapping_file(tmp_path, text.rpartition("\n")[0]))
    assert {name: known.gain for name, known in record.uncertainty.items()} == {"x:m1": 0.005, "a:m2": 0.02}


def test_a_unit_that_is_not_that_of_the_header_is_told(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = (f"{t},{x},{x}" for t, x in zip(T, X, strict=True))
    path.write_text("\n".join(["time,x:m1[mm],a:m2[m/s^2]", *rows]))
    text = '[channel."x:m1"]\nunit = "um"\n[channel."a:m2"]\nunit = "m/s^2"'
    mapping = mapping_file(tmp_path, text.replace("unit", 'column = "x:m1"\nunit', 1))
    record = lw.read_record(path, mapping=mapping)
    assert record.channel("x:m1") == pytest.approx(1e-6 * X, abs=1e-12)
    assert record.notes == (
        "x:m1 is taken to be in um, as its mapping states; the header of its column, x:m1[mm], states mm.",
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[channel]\nx = 1", "'x' is not a channel"),
        ('[channel."x:m1[mm]"]\ncolumn = 1', 'channel."x:m1[mm]": write the unit as a key of its own'),
        ('[channel."x:m1"]\ncolum = 1', 'unknown key "colum"; did you mean "column"'),
        ('[channel."x:m1"]\noffset = "3 kg"', "channel x:m1: offset: '3 kg' is in kg: expected"),
        ('[channel."x:m1"]\noffset = "about 3 mm"', "write '0.3 m' for a known offset"),
        ('[channel."x:m1"]\ndelay = { start = 1, sgma = 2 }', "a table has the keys start and sigma"),
        ('[channel."x:m1"]\ngain = 0', "a gain of 0 shows no motion"),
        ('[channel."x:m1"]\ncalibration = 1', "calibration: 1 is 100 % of what the sensor shows; write '1 %'"),
        ('[channel."x:m1"]\nnoise = 0.0', "a noise of 0 takes every sample as exact"),
        ('[channel."x:m1"]\ncolumn = "Laser 9"', "x:m1 is mapped to column 'Laser 9', which does not exist"),
        ('rate = "fast"', "rate: 'fast' cannot be read"),
        ("decimate = 0", "decimate: must be a positive integer, got 0"),
        ('[mass]\nm1 = "-1 kg"', "mass.m1: must be positive"),
        ("rate = 1 kHz", "is not valid TOML"),
    ],
)  # fmt: skip
def test_errors_name_file_and_key(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["time,x:m1", *(f"{t},{x}" for t, x in zip(T, X, strict=True))]))
    with pytest.raises(lw.RecordError) as caught:
        lw.read_record(path, mapping=mapping_file(tmp_path, text))
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "run.csv" if "not in" in said else tmp_path))


def test_a_first_mapping_guesses_quantities_and_can_be_used(tmp_path: Path) -> None:
    path, written = tmp_path / "run.csv", tmp_path / "first.toml"
    rows = (f"{t},{x},{9.81 * a},{x},7" for t, x, a in zip(T, X, A, strict=True))
    path.write_text("\n".join(['Time (s),Laser "a" (mm),Pos 2,x:m4,counter', *rows]))
    guesses = write_first_mapping(path, written)
    assert guesses == (
        'Column Laser "a" was guessed from its unit to be a displacement, x:m1.',
        "Column Pos 2 was guessed from its name to be a displacement, x:m2.",
    )
    mapping = read_mapping(written)
    assert mapping.channels == {"time[s]": "Time", "x:m1[mm]": 'Laser "a"', "x:m2": "Pos 2", "x:m4": "x:m4"}
    assert '# not used: "counter"' in written.read_text()
    record = lw.read_record(path, mapping=written, informative=False)
    assert record.channel("x:m1") == pytest.approx(1e-3 * X, rel=1e-12)
    with pytest.raises(lw.RecordError, match="is there already"):
        write_first_mapping(path, written)
    with pytest.raises(lw.RecordError, match=r"none\.toml: there is no such file"):
        read_mapping(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("header", "channels"),
    [
        ("Time (s),x:m1,x:m2,Shaker (N),Load", ["x:m1", "x:m2", "force:m1", "force:m2"]),
        ("Time (s),Load cell,Laser 1,x:m12,x:a2,x:base", ["force:a2", "x:m1", "x:m12", "x:a2", "x:base"]),
        ("Time (s),x:m1,force:m1,Laser 2,Hammer,Kraft", ["x:m1", "force:m1", "x:m2", "force:m2", "force:m3"]),
    ],
)
def test_a_guessed_force_acts_on_a_mass_that_moves(tmp_path: Path, header: str, channels: list[str]) -> None:
    path = tmp_path / "run.csv"
    columns = header.count(",")
    path.write_text("\n".join([header, *(",".join([f"{t}", *(f"{t}",) * columns]) for t in T)]))
    write_first_mapping(path, tmp_path / "first.toml")
    named = read_mapping(tmp_path / "first.toml").channels
    assert [name.partition("[")[0] for name in named][1:] == channels


def test_a_first_mapping_of_columns_that_say_nothing_can_be_read(tmp_path: Path) -> None:
    name = "run.npy" if os.name == "nt" else "run\n[x]\n.npy"  # of which the comment is one line
    path, written = tmp_path / name, tmp_path / "first.toml"
    np.save(path, np.column_stack([X, T, A]))
    assert write_first_mapping(path, written) == (
        "Column 1 stands as x:m1, a displacement: nothing says what it is.",
        "Column 2 was guessed from its values to be the time.",
        "Column 3 stands as x:m2, a displacement: nothing says what it is.",
    )
    record = lw.read_record(path, mapping=written)
    assert np.array_equal(record.channel("x:m2"), A)
    assert record.rate == pytest.approx(1.0 / (T[1] - T[0]), rel=1e-9)


def test_a_first_mapping_of_volts_can_be_read(tmp_path: Path) -> None:
    path, written = tmp_path / "scope.csv", tmp_path / "first.toml"
    rows = (f"{t},{x}" for t, x in zip(T, X, strict=True))
    path.write_text("\n".join(["Time,Channel A", "(s),(V)", *rows]))
    write_first_mapping(path, written)
    assert '"x:m1"]  # nothing says what it is, in V: which quantity, of which mass?' in written.read_text()
    assert np.array_equal(lw.read_record(path, mapping=written).channel("x:m1"), X)


def test_times_may_be_in_a_file_of_their_own(tmp_path: Path) -> None:
    path, clock = tmp_path / "run.csv", tmp_path / "clock.csv"
    path.write_text("\n".join(["Laser,x:m2", *(f"{x},{a}" for x, a in zip(X, A, strict=True))]))
    clock.write_text(
        "\n".join(["Sample,Time (ms)", *(f"{n},{1000.0 * float(t)!r}" for n, t in enumerate(T))])
    )
    channels: dict[str, str | int] = {"time": f"{clock}:Time", "x:m1": "Laser"}
    record = lw.read_record(path, channels=channels)
    assert np.array_equal(record.channel("x:m1"), X) and np.array_equal(record.channel("x:m2"), A)
    assert record.time == pytest.approx(T, abs=1e-12)
    clock.write_text("\n".join(clock.read_text().split("\n")[:-1]))
    with pytest.raises(lw.RecordError, match=rf"clock\.csv has {len(T) - 1} times for {len(T)} rows"):
        lw.read_record(path, channels=channels)
    with pytest.raises(lw.RecordError, match="time is mapped to column 'clock'"):
        lw.read_record(path, channels={**channels, "time": f"{clock}:clock"})


def test_a_column_is_mapped_by_the_name_that_the_file_spells(tmp_path: Path) -> None:
    """A unit below a stroke, which is read, was no part of the name any more."""
    path = tmp_path / "pendulum.csv"
    rows = "".join(f"{0.1 * i:.1f},{i},{2 * i}\n" for i in range(40))
    path.write_text(f"Time/s,Angle/mm,AngVel/rad/s\n{rows}")
    for time, angle in (("Time/s", "Angle/mm"), ("Time", "Angle[mm]")):
        record = lw.read_record(path, channels={"time": time, "x:bob": angle})
        assert record.channel("x:bob") == pytest.approx(1e-3 * np.arange(40))
