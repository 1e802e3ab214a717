"""Hosts on the command line: from a table of modes or matrices to an identified link and its validation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import linkwise as lw
from linkwise.cli import run

pytestmark = pytest.mark.usefixtures("unrendered")

LINK = """
[[mass]]
name = "store"
mass = "50 g"

[[link]]
name = "payload"
between = ["store", "wing.tip"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = 200.0, k3 = 2e6, c = 0.05 }
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "modes.csv").write_text(
        "frequency[Hz],damping,tip,joint\n5.2,0.01,1.0,0.62\n21,0.01,-1,0.3\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_modes_to_a_validated_link(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "wing.toml"]) == 0
    true = (folder / "wing.toml").read_text() + LINK
    (folder / "true.toml").write_text(true)
    unknown = true.replace("k = 200.0, k3 = 2e6, c = 0.05", 'k = "unknown", k3 = "unknown", c = "unknown"')
    (folder / "asked.toml").write_text(unknown)
    drive = ["--force", "wing.joint=5*sin(33*t)", "--release", "v:wing.mode1=0.3"]
    recorded = ["--duration", "2", "--rate", "400", "--noise", "30", "--seed", "2", "-o", "wing.csv"]
    assert run(["simulate", "true.toml", *drive, *recorded]) == 0
    assert "1 host, 2 modes, 1 mass, 1 link" in capsys.readouterr().out
    assert (
        (folder / "wing.csv").read_text().startswith("time,x:wing.tip,x:wing.joint,x:store,force:wing.joint")
    )
    assert run(["identify", "wing.csv", "asked.toml", "-o", "answer"]) == 0
    result = json.loads((folder / "answer" / "result.json").read_text())
    assert result["trusted"]
    assert [mode["name"] for mode in result["modes"]] == ["wing.mode1", "wing.mode2"]
    coefficients = result["links"][0]["coefficients"]
    for name, value in (("k", 200.0), ("k3", 2e6), ("c", 0.05)):
        # four standard errors: 6e-5 of chance each
        assert abs(coefficients[name]["value"] - value) < 4.0 * coefficients[name]["standard_error"]
    assert not list((folder / "answer").glob("force_wing*"))
    assert run(["validate", "wing.csv", "answer"]) == 0
    assert "x:wing.tip" in capsys.readouterr().out


def test_matrices_become_a_host(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiffness = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    np.savez(folder / "rod.npz", M=0.1 * np.eye(30), K=stiffness)
    assert (
        run(["structure", "host", "rod.npz", "--point", "mid=15", "--keep", "4", "--modal-damping", "0.02"])
        == 0
    )
    out, err = capsys.readouterr()
    assert len(lw.parse_structure(out).hosts[0].modes) == 5
    assert "4 modes and 1 residual ones" in err
    for wrong, message in (
        (["rod.npz"], "at least one point"),
        (["rod.npz", "--point", "mid15"], "--point needs NAME=ROW"),
        (
            ["rod.npz", "--point", "mid=fifteen"],
            'the point "mid" is fifteen, but the matrices have rows 1 to 30',
        ),
        (["rod.npz", "--mass", "Q", "--point", "mid=15"], "holds no matrix 'Q'"),
        (["modes.csv", "--point", "mid=15"], "A file of modes has its own points"),
        (["modes.csv", "--keep", "1"], "--keep is for matrices"),
        (["modes.csv", "--no-residual"], "--no-residual is for matrices"),
        (["modes.csv", "--shape-sigma", "2"], "--shape-sigma needs a percentage, such as 2%, got '2'"),
        (["rod.npz", "--mass", "K", "--stiffness", "M", "--point", "mid=15"], "may be swapped"),
    ):
        assert run(["structure", "host", *wrong]) == 2
        assert message in " ".join(capsys.readouterr().err.split())


def test_abaqus_matrices_become_a_host(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points by node and direction, Rayleigh damping, and a damping matrix in a third file."""
    (folder / "m.mtx").write_text("".join(f"{node},3, {node},3, 0.1\n" for node in range(1, 31)))
    (folder / "k.mtx").write_text(
        "".join(
            f"{node},3, {node},3, 2e4\n" + (f"{node},3, {node - 1},3, -1e4\n" if node > 1 else "")
            for node in range(1, 31)
        )
    )
    (folder / "c.mtx").write_text("15,3,15,3,20.0\n")
    given = ["structure", "host", "m.mtx", "k.mtx", "--point", "mid=15z", "--keep", "3"]
    assert run([*given, "--name", "rod", "--rayleigh", "0.5,1e-5"]) == 0
    out, err = capsys.readouterr()
    assert "the model weighs 3 kg" in err
    assert "couples" not in err and "0 Hz" not in err
    host = lw.parse_structure(out).hosts[0]
    frequency = 2.0 * np.pi * np.asarray(host.modes[0].frequency.value)
    assert host.modes[0].damping.value == pytest.approx(0.5 * (0.5 / frequency + 1e-5 * frequency))
    assert run([*given[:4], "c.mtx", *given[4:]]) == 0
    out, err = capsys.readouterr()
    damped = lw.parse_structure(out).hosts[0].modes[0]
    assert damped.damping.value == pytest.approx(20.0 * damped.shape["mid"] ** 2 / (2.0 * frequency))
    assert "the damping matrix couples" in err
    assert (1, 2) in lw.parse_structure(out).hosts[0].damping
    for wrong, message in (
        (["--rayleigh", "0.5"], "--rayleigh needs two numbers A,B"),
        (["--point", "tip=31z"], "names points by node and direction"),
        (["--damping", "C"], "--damping needs a third file"),
    ):
        assert run([*given, *wrong]) == 2
        assert message in " ".join(capsys.readouterr().err.split())
    assert run(["structure", "host", "m.mtx", "--point", "mid=15z"]) == 2
    assert "m is taken for the mass and for the stiffness" in " ".join(capsys.readouterr().err.split())
    (folder / "rod.toml").write_text(
        '[[host]]\nname = "rod"\npoints = { mid = "15z" }\nkeep = 3\n'
        'matrices = { mass = "m.mtx", stiffness = "k.mtx", damping = "c.mtx" }\n'
    )
    assert (1, 2) in lw.read_structure(folder / "rod.toml").hosts[0].damping
    (folder / "c.mtx").write_text("".join(f"{node},3, {node},3, 0.2\n" for node in range(1, 31)))
    proportional = lw.read_structure(folder / "rod.toml").hosts[0].modes[0]
    assert proportional.damping.value == pytest.approx(0.2 / 0.1 / (2.0 * frequency))


def test_a_structure_file_with_matrices_tells_the_error_of_its_reduction(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stiffness = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    np.savez(folder / "rod.npz", M=0.1 * np.eye(30), K=stiffness)
    (folder / "rod.toml").write_text(
        '[[host]]\nname = "rod"\npoints = { mid = 15, between = "0.5*20 + 0.5*21" }\nkeep = 4\n'
        'matrices = { mass = "rod.npz:M", stiffness = "rod.npz:K" }\n'
    )
    drive = ["--release", "v:rod.mode1=0.1", "--duration", "0.1", "--rate", "400", "-o", "rod.csv"]
    assert run(["simulate", "rod.toml", *drive]) == 0
    assert "note: rod: 4 modes and 2 residual ones; at " in capsys.readouterr().err
    assert run(["structure", "show", "rod.toml"]) == 0
    assert "note: 4 modes and 2 residual ones; at " in capsys.readouterr().out
    assert run(["discover", "rod.csv", "--structure", "rod.toml", "--terms", "d"]) == 1
    refused = capsys.readouterr().err
    assert "note: rod: 4 modes" in refused and "it needs at least 50" in refused


def test_a_model_without_its_boundary_conditions_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stiffness = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    stiffness[0, 0] = stiffness[-1, -1] = 1e4
    np.savez(folder / "rod.npz", M=0.1 * np.eye(30), K=stiffness)
    assert run(["structure", "host", "rod.npz", "--point", "mid=15", "--keep", "4"]) == 0
    assert "1 mode is at 0 Hz: the model is free to move" in capsys.readouterr().err


def test_show_prints_the_modes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "-o", "host.toml"]) == 0
    assert run(["structure", "show", "host.toml"]) == 0
    out = capsys.readouterr().out
    assert "2 modes; shapes in 1/sqrt(kg) at modes.tip, modes.joint" in out
    assert "modes.mode2  21 Hz" in out


def test_show_draws_the_shapes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "wing.toml"]) == 0
    assert run(["structure", "show", "wing.toml", "--shapes", "wing.png"]) == 0
    assert "note: wing.svg is written" in capsys.readouterr().err
    assert (folder / "wing.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (folder / "wing.svg").read_text()
    assert run(["structure", "bnes", "--dof", "2", "-o", "chain.toml"]) == 0
    assert run(["structure", "show", "chain.toml", "--shapes", "chain"]) == 2
    assert "has no host, whose shapes could be drawn" in capsys.readouterr().err
    assert not (folder / "chain.png").exists()


def test_values_of_a_host_known_to_within(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sigmas = ["--frequency-sigma", "1%", "--damping-sigma", "20 %", "--shape-sigma", "2%"]
    assert run(["structure", "host", "modes.csv", *sigmas, "-o", "host.toml"]) == 0
    (first, second) = lw.read_structure(folder / "host.toml").hosts[0].modes
    assert first.frequency.sigma == pytest.approx(0.052)
    assert second.damping.sigma == pytest.approx(0.002)
    assert dict(second.shape_sigma) == {"tip": pytest.approx(0.02), "joint": pytest.approx(0.02)}
    assert run(["structure", "show", "host.toml"]) == 0
    assert "0.62 +- 0.02" in capsys.readouterr().out


def test_a_record_may_show_the_coordinate_of_a_mode(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "wing.toml"]) == 0
    (folder / "true.toml").write_text((folder / "wing.toml").read_text() + LINK)
    (folder / "asked.toml").write_text(
        (folder / "true.toml").read_text().replace("k = 200.0", 'k = "unknown"')
    )
    drive = ["--release", "v:wing.mode1=0.3", "--sensors", "x:wing.mode1,x:wing.mode2,x:store"]
    recorded = ["--duration", "1", "--rate", "400", "--noise", "40", "--seed", "2", "-o", "modal.csv"]
    assert run(["simulate", "true.toml", *drive, *recorded]) == 0
    assert run(["identify", "modal.csv", "asked.toml"]) == 0
    assert "x:wing.mode1" in capsys.readouterr().out


def test_where_a_payload_hangs_is_discovered(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "wing.toml"]) == 0
    (folder / "true.toml").write_text(
        (folder / "wing.toml").read_text() + LINK.replace("wing.tip", "wing.joint")
    )
    (folder / "known.toml").write_text((folder / "wing.toml").read_text() + LINK.partition("[[link]]")[0])
    drive = [
        "--force",
        "wing.tip=5*sin(33*t)",
        "--release",
        "v:wing.mode1=0.3",
        "--sensors",
        "a:wing.tip,a:store",
    ]
    recorded = ["--duration", "1", "--rate", "400", "--noise", "30", "--seed", "2", "-o", "wing.csv"]
    assert run(["simulate", "true.toml", *drive, *recorded]) == 0
    given = ["--structure", "known.toml", "--terms", "v, d, d**3", "--truth", "true.toml", "-o", "found"]
    assert run(["discover", "wing.csv", *given]) == 0
    out = capsys.readouterr().out
    assert "store-wing.joint, hardening: k*d + k3*d**3 + c*v" in out
    assert "against the truth: 3 terms right" in out
    result = json.loads((folder / "found" / "result.json").read_text())
    assert result["trusted"]
    assert list(result["nmse_percent"]) == ["store-wing.joint"]
    assert (folder / "found" / "graph.png").exists()
    assert lw.read_structure(folder / "found" / "structure.toml").hosts[0].points == (
        "wing.tip",
        "wing.joint",
    )


def test_from_taps_to_a_payload(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "bare.toml"]) == 0
    tap = ["--force", "wing.tip=2*exp(-((t - 0.1)/0.01)**2)", "--sensors", "a:wing.tip,a:wing.joint"]
    recorded = ["--duration", "2", "--rate", "200", "--noise", "40", "--seed", "1", "-o", "taps.csv"]
    assert run(["simulate", "bare.toml", *tap, *recorded]) == 0
    assert run(["structure", "host", "taps.csv", "--modes", "auto", "--json"]) == 0
    document = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (
        document["host"][0]["name"] == document["identified"]["host"]
        and document["identified"]["trusted"] is True
    )
    assert run(["structure", "host", "taps.csv", "--modes", "auto", "-o", "wing.toml"]) == 0
    assert "wing: 2 modes at 2 points, can be trusted" in capsys.readouterr().out
    (folder / "true.toml").write_text((folder / "bare.toml").read_text() + LINK)
    unknown = LINK.replace("k = 200.0, k3 = 2e6, c = 0.05", 'k = "unknown", k3 = "unknown", c = "unknown"')
    (folder / "asked.toml").write_text((folder / "wing.toml").read_text() + unknown)
    drive = ["--force", "wing.tip=5*sin(33*t)", "--release", "v:wing.mode1=0.3"]
    recorded = ["--duration", "2", "--rate", "400", "--noise", "30", "--seed", "2", "-o", "wing.csv"]
    assert run(["simulate", "true.toml", *drive, *recorded]) == 0
    assert run(["identify", "wing.csv", "asked.toml", "--json"]) == 0
    result = json.loads(capsys.readouterr().out.partition("{")[2].join(["{", ""]))
    coefficients = result["links"][0]["coefficients"]
    for name, value in (("k", 200.0), ("k3", 2e6), ("c", 0.05)):
        # four standard errors: 6e-5 of chance each
        assert abs(coefficients[name]["value"] - value) < 4.0 * coefficients[name]["standard_error"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--modes", "some"], "a number of modes, or auto"),
        (["--modes", "2", "--point", "tip=3"], "--point is for modes or matrices"),
        (["--modes", "2", "--keep", "3"], "--keep is for modes or matrices"),
        (["--from", "2"], "--from is for records of a test: give --modes"),
        (["--modes", "2", "--gain", "a:wing.tip"], "--gain a:wing.tip has no size"),
    ],
)
def test_options_of_a_test_are_checked(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert run(["structure", "host", "modes.csv", *options]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_a_test_is_read_with_the_names_of_a_logger(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "bare.toml"]) == 0
    tap = ["--force", "wing.tip=2*exp(-((t - 0.5)/0.01)**2)", "--sensors", "a:wing.tip,a:wing.joint"]
    recorded = ["--duration", "2", "--rate", "200", "--noise", "40", "--seed", "1", "-o", "taps.csv"]
    assert run(["simulate", "bare.toml", *tap, *recorded]) == 0
    header, _, rows = (folder / "taps.csv").read_text().partition("\n")
    assert header == "time,a:wing.tip,a:wing.joint,force:wing.tip"
    (folder / "logger.csv").write_text(f"Time,Acc 1,Acc 2,Hammer\n{rows}")
    columns = {"a:wing.tip": "Acc 1", "a:wing.joint": "Acc 2", "force:wing.tip": "Hammer", "time": "Time"}
    named = [text for name, column in columns.items() for text in ("--channel", f"{name}={column}")]
    window = ["--modes", "2", "--from", "0.4", "--to", "1.9"]
    assert run(["structure", "host", "logger.csv", *named, *window, "-o", "mapped.toml"]) == 0
    assert "(602 samples" in capsys.readouterr().out  # of 1.5 s at 200 Hz, two responses
    assert run(["structure", "host", "taps.csv", *window, "-o", "named.toml"]) == 0
    mapped, direct = (lw.read_structure(folder / f"{which}.toml").hosts for which in ("mapped", "named"))
    assert mapped == direct


def test_errors_of_a_test_are_no_less_than_stated(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "host", "modes.csv", "--name", "wing", "-o", "bare.toml"]) == 0
    tap = ["--force", "wing.tip=2*exp(-((t - 0.1)/0.01)**2)", "--sensors", "a:wing.tip,a:wing.joint"]
    recorded = ["--duration", "1", "--rate", "200", "--noise", "40", "--seed", "1", "-o", "taps.csv"]
    assert run(["simulate", "bare.toml", *tap, *recorded]) == 0
    least = ["--frequency-sigma", "1%", "--shape-sigma", "30%"]
    assert run(["structure", "host", "taps.csv", "--modes", "2", *least, "-o", "wing.toml"]) == 0
    first = lw.read_structure(folder / "wing.toml").hosts[0].modes[0]
    assert first.frequency.value is not None
    assert first.frequency.sigma == pytest.approx(0.01 * first.frequency.value)  # the record tells far more
    assert first.shape_sigma["joint"] == pytest.approx(0.3 * max(map(abs, first.shape.values())))


def test_rows_of_matrices_that_turn_are_stated(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stiffness = np.array([[400.0, -20.0], [-20.0, 5.0]])
    np.savez(folder / "post.npz", M=np.diag([1.0, 0.002]), K=stiffness)
    given = ["structure", "host", "post.npz", "--point", "tip=1", "--point", "tip_r=2", "--keep", "2"]
    assert run([*given, "--unit", "tip_r=rad", "-o", "post.toml"]) == 0
    assert lw.read_structure(folder / "post.toml").rotations == ("post.tip_r",)
    capsys.readouterr()
    assert run(["structure", "show", "post.toml"]) == 0
    assert (
        "shapes in 1/sqrt(kg), or rad/(m sqrt(kg)), at post.tip, post.tip_r (in rad)"
        in capsys.readouterr().out
    )
    for wrong, message in (
        ("tip_r=deg", 'the point "tip_r" is displaced in "rad" or "m", got \'deg\''),
        ("top=rad", 'unknown point "top"'),
        ("tip_r", "is not NAME=VALUE, as in --unit tip_r=rad"),
    ):
        assert run([*given, "--unit", wrong]) in (1, 2)
        assert message in capsys.readouterr().err
    assert run(["structure", "host", "run.csv", "--modes", "2", "--unit", "tip=rad"]) == 2
    assert "--unit is for modes or matrices" in capsys.readouterr().err


def test_modes_of_a_file_that_turn_are_stated(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run(["structure", "host", "modes.csv", "--name", "wing", "--unit", "joint=rad", "-o", "wing.toml"])
        == 0
    )
    assert lw.read_structure(folder / "wing.toml").rotations == ("wing.joint",)
    (folder / "turned.csv").write_text("frequency[Hz],damping,tip,12rz[rad]\n5.2,0.01,1.0,0.62\n")
    assert run(["structure", "host", "turned.csv", "--name", "wing", "-o", "turned.toml"]) == 0
    assert lw.read_structure(folder / "turned.toml").rotations == ("wing.12rz",)
    capsys.readouterr()
    assert run(["structure", "host", "turned.csv", "--unit", "12rz=m"]) != 0
    assert "is the direction 12rz, which is in rad, not in m" in capsys.readouterr().err
