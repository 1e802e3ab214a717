"""`linkwise simulate`: what it drives, what it writes and what it tells."""

from pathlib import Path

import numpy as np
import pytest
from commands import document, said
from problems import chain_record
from structures import oscillator

import linkwise as lw

GRID = "--duration 0.5 --rate 500"
BASE = "0.004*sin(31*t) + 0.003*sin(47*t + 1) + 0.002*sin(71*t + 2) + 0.01*sin(9*t)"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lw.write_structure(lw.bnes_chain(2), "chain.toml")


def simulated(options: str) -> lw.Record:
    """The record that the command writes with these options."""
    said(f"simulate chain.toml {GRID} {options} -o run.csv")
    return lw.read_record("run.csv")


def test_what_drives_the_structure_is_that_of_the_library() -> None:
    record = simulated("--release v:m1=1.0 --noise 30 --seed 1")
    assert record.channels == ("x:m1", "x:m2")
    expected = chain_record(2, duration=0.5, rate=500.0).with_noise(30.0, seed=1)
    np.testing.assert_array_equal(record.values, expected.values)  # a file is exact
    forced = simulated("--impulse m1=0.3@0.1 --force m2=0.1*sin(2*pi*20*t)")
    expected = lw.simulate(
        lw.bnes_chain(2),
        impulses=(lw.model.Impulse("m1", 0.3, 0.1),),
        forces={"m2": lw.model.TimeFunction("0.1*sin(2*pi*20*t)")},
        duration=0.5,
        rate=500.0,
    )
    np.testing.assert_array_equal(forced.values, expected.values)
    assert "force:m2" in forced.channels
    sensors = simulated("--release v:m1=1.0 --sensors x,v,a").channels
    assert set(sensors) == {f"{kind}:{mass}" for kind in "xva" for mass in ("m1", "m2")}


def test_a_structure_that_nothing_sets_in_motion_is_told() -> None:
    err = said(f"simulate chain.toml {GRID} -o still.csv").err
    assert "note: nothing sets the structure in motion; give --release" in err
    in_well = "--release v:m1=1.0 --release x:m2=0.01"
    assert said(f"simulate chain.toml {GRID} {in_well} -o run.csv").err == ""
    assert lw.read_record("run.csv").values.any()


def test_a_sink_that_starts_on_its_hilltop_is_told_with_the_release_of_a_well() -> None:
    line = f"simulate four.toml {GRID} --release x:m3=0.003 -o run.csv"
    lw.write_structure(lw.bnes_chain(4), "four.toml")
    assert said(f"{line} --release x:m1=-0.002").err == ""
    err = said(f"{line} --release x:m2=0.01 --release x:m4=0.003").err
    assert "note: nes2 starts on the top of its barrier" in err
    assert err.strip().endswith("to start in a well, add the release x:m4=0.013.")


@pytest.mark.parametrize("column", ["push", "force:m1"])
def test_force_from_a_file(column: str) -> None:
    rows = "\n".join(f"{t:.3f},{np.sin(60 * t):.9f}" for t in np.arange(600) / 1000.0)
    Path("drive.csv").write_text(f"time,{column}\n{rows}\n")
    record = simulated(f"--force m1=drive.csv:{column}")
    exact = np.sin(60 * record.time)
    np.testing.assert_allclose(record.channel("force:m1"), exact, atol=1e-8)  # 9 printed digits


def test_a_file_that_cannot_drive_says_how_its_columns_are_named() -> None:
    rows = [f"{t:.3f};{np.sin(60 * t):.6f}".replace(".", ",") for t in np.arange(600) / 1000.0]
    Path("kraft.csv").write_text("\n".join(["Zeit [s];Kraft [N]", *rows]))
    line = f"simulate chain.toml {GRID} -o run.csv --force"
    for drive in ("m1=kraft.csv", "m1=kraft.csv:Kraft"):
        err = said(f"{line} {drive}", 2).err
        expected = (
            "the time is the column `time` (or `time[ms]`); its values are named as in kraft.csv:COLUMN"
        )
        assert expected in err
        assert "On the command line: --rate" not in err  # which is that of the simulation
    rows[200:220] = []
    Path("kraft.csv").write_text("\n".join(["time;Kraft", *rows]))
    assert "force:m1: 20 of 600 samples are missing" in said(f"{line} m1=kraft.csv:Kraft", 1).err


def test_tells_energy_horizon_and_file() -> None:
    out = said(f"simulate chain.toml {GRID} --release v:m1=1.0 --noise 30 -o run.csv").out
    assert "bistable chain of 2 masses: 2 masses, 2 links" in out
    assert "record      251 samples at 500 Hz of x:m1, x:m2" in out
    assert "energy      0.5 J put in" in out  # m v^2 / 2
    assert "horizon     " in out and "noise       30 dB per channel, seed 0" in out
    assert out.rstrip().endswith("run.csv")
    printed = document(f"simulate chain.toml {GRID} --release v:m1=1.0 -o run.csv")
    energy = printed["energy"]
    assert printed["samples"] == 251 and printed["channels"] == ["x:m1", "x:m2"]
    # the energies close to rounding, 4e-16 here
    assert energy["closure"] < 1e-9
    total = energy["stored"] + sum(energy["dissipated"].values())
    assert total == pytest.approx(energy["put_in"], rel=1e-9)


@pytest.fixture
def storey() -> None:
    """A structure on a moving base."""
    structure = oscillator("k*d + c*v", to="base", name="frame", k=900.0, c=1.5)
    lw.write_structure(structure, "storey.toml")
    lw.write_structure(structure.unknown("all"), "unknown.toml")


@pytest.mark.slow
def test_a_file_with_the_acceleration_of_the_base_drives_a_simulation(storey: None) -> None:
    """The base starts from rest: what is relative to it does not depend on that."""
    time = np.arange(801) / 200.0
    motion = lw.Record(0.0, 200.0, ("a:base",), lw.model.TimeFunction(BASE).derivative(time, 2)[:, None])
    lw.write_record(motion, "quake.csv")
    said("simulate storey.toml --duration 4 --rate 200 --base quake.csv --sensors rel:x,a:base -o run.csv")
    read_back = lw.read_record("run.csv")
    assert read_back.channels == ("rel:x:m1", "a:base")
    assert read_back.channel("a:base")[5:-5] == pytest.approx(motion.values[5:-5, 0], abs=0.02)  # of 20 m/s^2
    fit = lw.identify(read_back, lw.read_structure("unknown.toml"), method="weak")
    assert fit.coefficient("frame.k").value == pytest.approx(900.0, rel=1e-4)
