"""`linkwise simulate`: what it drives, what it writes and what it tells."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.cli import run

GRID = ["--duration", "0.5", "--rate", "500"]


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    path = tmp_path / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), path)
    return path


def simulated(chain: Path, *options: str) -> lw.Record:
    """The record that the command writes with these options."""
    output = chain.parent / "run.csv"
    assert run(["simulate", str(chain), *GRID, *options, "-o", str(output)]) == 0
    return lw.read_record(output)


def test_release_and_noise_are_those_of_the_library(chain: Path) -> None:
    record = simulated(chain, "--release", "v:m1=1.0", "--noise", "30", "--seed", "1")
    expected = chain_record(2, duration=0.5, rate=500.0).with_noise(30.0, seed=1)
    assert record.channels == ("x:m1", "x:m2")
    np.testing.assert_array_equal(record.values, expected.values)  # a file is exact


def test_impulse_force_and_base_reach_the_structure(chain: Path) -> None:
    forced = simulated(chain, "--impulse", "m1=0.3@0.1", "--force", "m2=0.1*sin(2*pi*20*t)")
    expected = lw.simulate(
        lw.bnes_chain(2),
        impulses=(lw.model.Impulse("m1", 0.3, 0.1),),
        forces={"m2": lw.model.TimeFunction("0.1*sin(2*pi*20*t)")},
        duration=0.5,
        rate=500.0,
    )
    np.testing.assert_array_equal(forced.values, expected.values)
    assert "force:m2" in forced.channels


def test_a_structure_that_nothing_sets_in_motion_is_told(
    chain: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["simulate", str(chain), *GRID, "-o", str(chain.parent / "still.csv")]) == 0
    assert "note: nothing sets the structure in motion; give --release" in capsys.readouterr().err
    assert simulated(chain, "--release", "v:m1=1.0").values.any()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("column", [":push", ":force:m1"])
def test_force_from_a_file(chain: Path, column: str, tmp_path: Path) -> None:
    drive = tmp_path / "drive.csv"
    time = np.arange(600) / 1000.0
    heading = column[1:]
    rows = "\n".join(f"{t:.3f},{np.sin(60 * t):.9f}" for t in time)
    drive.write_text(f"time,{heading}\n{rows}\n")
    record = simulated(chain, "--force", f"m1={drive}{column}")
    np.testing.assert_allclose(
        record.channel("force:m1"), np.sin(60 * record.time), atol=1e-8
    )  # 9 printed digits


def test_sensors_are_chosen(chain: Path) -> None:
    record = simulated(chain, "--release", "v:m1=1.0", "--sensors", "x,v,a")
    assert set(record.channels) == {f"{kind}:{mass}" for kind in "xva" for mass in ("m1", "m2")}


def test_tells_energy_horizon_and_file(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated(chain, "--release", "v:m1=1.0", "--noise", "30")
    out = capsys.readouterr().out
    assert "bistable chain of 2 masses: 2 masses, 2 links" in out
    assert "record      251 samples at 500 Hz of x:m1, x:m2" in out
    assert "energy      0.5 J put in" in out  # m v^2 / 2
    assert "horizon     " in out and "noise       30 dB per channel, seed 0" in out
    assert out.rstrip().endswith("run.csv")


def test_json_is_all_that_is_printed(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated(chain, "--release", "v:m1=1.0", "--json")
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert err == "" and document["samples"] == 251 and document["channels"] == ["x:m1", "x:m2"]
    energy = document["energy"]
    # the energies close to rounding, 4e-16 here
    assert energy["closure"] < 1e-9
    total = energy["stored"] + sum(energy["dissipated"].values())
    assert total == pytest.approx(energy["put_in"], rel=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--release", "v:m1"], "--release 'v:m1' is not NAME=VALUE, as in --release v:m1=1.0."),
        (["--release", "v:m1=fast"], "--release: 'fast' is not a number"),
        (["--release", "v:m1=1", "--release", "v:m1=2"], "--release is given twice for 'v:m1': 1 and 2."),
        (["--release", "v:m9=1"], "m9"),
        (["--impulse", "m1=0.3@soon"], "--impulse: 'soon' is not a number"),
        (["--force", "m1=sinus(t)"], "sinus"),
        (["--force", "m9=sin(t)"], "m9"),
        (["--force", "m1=missing.csv:F"], "linkwise: missing.csv: there is no such file"),
        (["--force", "m1=missing.csv"], "linkwise: missing.csv: there is no such file"),
        (["--base", "missing.mat"], "linkwise: missing.mat: there is no such file"),
        (["--sensors", "x,w"], "w"),
        (["--seed", "-1"], "-1 is not in the range"),
        (["--rate", "0"], "0.0 is not in the range x>0"),
    ],
)
def test_wrong_usage_is_one_paragraph(
    chain: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output = chain.parent / "run.csv"
    assert run(["simulate", str(chain), *GRID, *options, "-o", str(output)]) == 2
    err = capsys.readouterr().err
    assert message in err and err.startswith("linkwise: ") and "Traceback" not in err
    assert not output.exists()


@pytest.mark.parametrize(("option", "missing"), [("--force", "force:m1"), ("--base", "x:base")])
def test_a_file_without_the_channel_of_the_drive_is_named(
    chain: Path, option: str, missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = chain.parent / "drive.csv"
    file.write_text("time,x:m1,x:m2\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(50)))
    value = f"m1={file}" if option == "--force" else str(file)
    assert run(["simulate", str(chain), *GRID, option, value, "-o", str(chain.parent / "run.csv")]) == 2
    err = capsys.readouterr().err
    assert err.startswith(
        f"linkwise: {file}: has no channel {missing}, but x:m1, x:m2; name the column of it"
    )


def test_an_unknown_suffix_is_refused(chain: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run(["simulate", str(chain), *GRID, "--release", "v:m1=1", "-o", str(chain.parent / "run.xls")]) == 2
    )
    assert "xls" in capsys.readouterr().err


def test_a_structure_with_unknowns_is_not_simulated(
    chain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), chain)
    assert run(["simulate", str(chain), *GRID, "--release", "v:m1=1", "-o", str(tmp_path / "run.csv")]) == 2
    assert "unknown" in capsys.readouterr().err
