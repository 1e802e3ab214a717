"""Commands on a moving base: channels of two files, delays, and motions of the base that are not displacements."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.cli import run

BASE = "0.004*sin(31*t) + 0.003*sin(47*t + 1) + 0.002*sin(71*t + 2) + 0.01*sin(9*t)"
LATE = 0.003


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A structure, and two instruments: one on the floor, the other, late, on the ground."""
    structure = oscillator("k*d + c*v", to="base", name="frame", k=900.0, c=1.5)
    lw.write_structure(structure, tmp_path / "storey.toml")
    lw.write_structure(structure.unknown("all"), tmp_path / "unknown.toml")
    record = lw.simulate(structure, base=BASE, duration=4.0, rate=200.0, sensors=["a", "a:base"])
    record = record.with_noise(40.0, seed=1)
    late = lw.model.TimeFunction(BASE).derivative(record.time - LATE, 2)
    for name, values in (("top", record.channel("a:m1")), ("ground", late)):
        np.savetxt(tmp_path / f"{name}.csv", values, header="AccX", comments="")
    return tmp_path


def test_two_files_and_a_delay(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["identify", str(folder / "top.csv"), str(folder / "unknown.toml"), "--rate", "200", "--json"]
    command += ["--channel", "a:m1=AccX", "--channel", f"a:base={folder / 'ground.csv'}:AccX"]
    assert run(command) == 3
    cause = json.loads(capsys.readouterr().out)["diagnosis"][0]
    assert (cause["cause"], cause["where"]) == ("delay", "a:base")
    assert cause["size"] == pytest.approx(LATE, rel=0.1)  # to first order: a tenth of a radian at 31 rad/s
    assert run([*command, "--delay", f"a:base={LATE}"]) == 0
    [link] = json.loads(capsys.readouterr().out)["links"]
    low, high = link["coefficients"]["k"]["interval"]
    assert low < 900.0 < high


def test_the_column_of_times_is_that_of_both_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("top", "ground"):
        values = np.loadtxt(folder / f"{name}.csv", skiprows=1)
        stamped = np.column_stack([5000 * np.arange(len(values)), values])
        np.savetxt(folder / f"{name}.csv", stamped, header="Stamp,AccX", delimiter=",", comments="")
    command = ["inspect", str(folder / "top.csv"), "--channel", "time[us]=Stamp", "--channel", "a:m1=AccX"]
    assert run([*command, "--channel", f"a:base={folder / 'ground.csv'}:AccX"]) == 0
    assert "801 samples at 200 Hz" in capsys.readouterr().out


def test_a_file_with_the_acceleration_of_the_base_drives_a_simulation(folder: Path) -> None:
    """The base starts from rest: what is relative to it does not depend on that."""
    time = np.arange(801) / 200.0
    motion = lw.Record(0.0, 200.0, ("a:base",), lw.model.TimeFunction(BASE).derivative(time, 2)[:, None])
    lw.write_record(motion, folder / "quake.csv")
    options = ["--duration", "4", "--rate", "200", "--base", str(folder / "quake.csv")]
    output = folder / "run.csv"
    assert (
        run(
            [
                "simulate",
                str(folder / "storey.toml"),
                *options,
                "--sensors",
                "rel:x,a:base",
                "-o",
                str(output),
            ]
        )
        == 0
    )
    read_back = lw.read_record(output)
    assert read_back.channels == ("rel:x:m1", "a:base")
    assert read_back.channel("a:base")[5:-5] == pytest.approx(motion.values[5:-5, 0], abs=0.02)  # of 20 m/s^2
    fit = lw.identify(read_back, lw.read_structure(folder / "unknown.toml"))
    assert fit.coefficient("frame.k").value == pytest.approx(900.0, rel=1e-4)
