"""The commands `respond`, `backbone`, `basins` and `limit`: what they print and write, and what they refuse."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from commands import document, refusal, said
from structures import oscillator

import linkwise as lw

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.mark.slow
def test_a_response_is_printed_written_and_handed_on(inside: None, tmp_path: Path) -> None:
    folder = tmp_path / "response"
    line = "respond chain.toml --force m1=0.5 --levels 0.3,0.1 --show x:m2 --from 21 --to 22 --starts 0"
    result = document(f"{line} -o {folder}")
    assert [level["force"] for level in result["levels"]] == [0.1, 0.3]
    level = result["levels"][1]
    point = level["branches"][0]["points"][0]
    assert set(point) == {
        "hz", "amplitude", "first_harmonic", "phase_deg", "mean", "stable", "largest_multiplier"
    }  # fmt: skip
    assert list(point["amplitude"]) == ["x:m2"]
    assert len(level["folds_hz"]) == 2 * len(level["branches"])
    assert json.loads((folder / "response.json").read_text())["levels"] == result["levels"]
    with (folder / "branches.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(len(b["points"]) for one in result["levels"] for b in one["branches"])
    assert float(rows[0]["x:m2 amplitude"]) == pytest.approx(
        result["levels"][0]["branches"][0]["points"][0]["amplitude"]["x:m2"]
    )
    assert "fold 2" in said("respond chain.toml --force m1=0.3 --from 21 --to 22 --starts 0").out


@pytest.mark.slow
def test_an_answer_has_bands_and_tells_where_its_laws_are_extrapolated(answer_folder: Path) -> None:
    line = f"respond {answer_folder} --force m1=200 --from 24.5 --to 25.5 --starts 0 --draws 8 --show x:m2"
    result = document(line)
    branch = min(result["levels"][0]["branches"], key=lambda branch: branch["turns"])
    stable = [point for point in branch["points"] if point["stable"]]
    points = [point for point in branch["points"] if point["lower"]["x:m2"] is not None]
    assert all(point["stable"] for point in points)
    assert len(points) > 0.7 * len(stable) > 0
    inside = [p["lower"]["x:m2"] <= p["amplitude"]["x:m2"] <= p["upper"]["x:m2"] for p in points]
    assert np.mean(inside) > 0.9
    assert any(point["outside_range"] for point in points)
    assert "its law is extrapolated there" in result["findings"][0]


def test_a_backbone_is_printed(inside: None, tmp_path: Path) -> None:
    result = document("backbone chain.toml --mode 1 --to-energy 1e-3")
    assert result["mode"] == 1
    assert set(result["points"][0]) == {"hz", "energy", "damping", "amplitude"}
    assert result["points"][-1]["energy"] == pytest.approx(1e-3)
    folder = tmp_path / "resonance"
    printed = said(f"backbone chain.toml --mode 1 --to-energy 1e-3 --force m2 -o {folder}").out
    assert "Phase resonance" in printed
    assert (folder / "backbone.csv").read_text("utf-8").startswith("hz,energy,x:m1,x:m2,damping,force\n")


def test_a_decay_at_uneven_times_is_read_as_the_mapping_file_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lw.write_structure(lw.rig({"m1": 1.0}, {"spring": "m1 - ground: k*d"}, {"spring.k": 400.0}), "rig.toml")
    time = np.arange(1600) / 100.0 + 0.003 * (np.arange(1600) % 3 == 1)
    noise = 1e-3 * np.random.default_rng(1).normal(size=len(time))
    decay = np.exp(-0.5 * time) * np.cos(20.0 * time) + noise
    np.savetxt("decay.csv", np.column_stack([time, decay]), delimiter=",")
    Path("decay.csv").write_text("time,x:m1\n" + Path("decay.csv").read_text())
    line = "backbone rig.toml --mode 1 --to-amplitude x:m1=1 --levels decay.csv"
    asked = refusal(line)
    assert 'On the command line: --mapping FILE with the line resample = "... Hz".' in asked
    Path("decay.toml").write_text('resample = "100 Hz"\n')
    measured = document(f"{line} --mapping decay.toml")["measured"]
    assert np.allclose([point["hz"] for point in measured], 20.0 / (2.0 * np.pi), rtol=0.01)


def test_basins_are_printed(inside: None) -> None:
    result = document("basins chain.toml --plane x:m2=-0.02:0.02,v:m2=-0.2:0.2 --points 4")
    assert [rest["share"] for rest in result["rests"]] == [0.5, 0.5]
    assert np.array(result["ends"]).shape == (4, 4)


PLAN = "--duration 0.5 --rate 500 --release v:m1=1.0"


@pytest.fixture
def limit(tmp_path: Path) -> str:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    return f"limit {tmp_path}/chain.toml {PLAN}"


def test_excitation_sensors_noise_and_segment_reach_it(limit: str) -> None:
    drive = "--impulse m2=0.01@0.2 --force m2=0.1*sin(2*pi*20*t) --sensors a:m2,v:m1"
    printed = document(f"{limit} {drive} --noise a:m2=3 --noise v:m1=10mm/s --segment 0.1")
    expected = lw.limit(
        lw.bnes_chain(2),
        duration=0.5,
        rate=500.0,
        release={"v:m1": 1.0},
        impulses=(lw.model.Impulse("m2", 0.01, 0.2),),
        forces={"m2": "0.1*sin(2*pi*20*t)"},
        sensors=("a:m2", "v:m1"),
        noise={"a:m2": 3.0, "v:m1": 0.01},
        segment=0.1,
    )
    assert printed["noise"] == {"a:m2": 3.0, "v:m1": 0.01} and printed["segment"] == 0.1
    errors = [coefficient["standard_error"] for coefficient in printed["coefficients"].values()]
    assert errors == pytest.approx(list(expected.standard_errors), rel=1e-12)


def test_says_what_sensors_cannot_tell(tmp_path: Path) -> None:
    """Without a force on it, a motion is the same when mass, stiffness and damping grow together."""
    lw.write_structure(oscillator("k*d + c*v", name="spring", k=400.0, c=0.5), tmp_path / "mass.toml")
    asked = f"limit {tmp_path}/mass.toml {PLAN} --noise 20 --unknown spring --unknown mass:m1"
    out = said(asked, 3).out
    assert "not identifiable" in out
    assert "! spring.k, spring.c and m1.mass are confounded: these sensors identify" in out
    assert "not identifiable" not in said(f"{asked} --force m1=5*sin(15*t)").out
