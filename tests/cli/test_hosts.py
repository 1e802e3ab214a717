"""Hosts on the command line: from a table of modes or matrices to an identified link and its validation."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal, said

import linkwise as lw

STORE = """
[[mass]]
name = "store"
mass = "50 g"
"""
LINK = """
[[link]]
name = "payload"
between = ["store", "wing.tip"]
law = "k*d + k3*d**3 + c*v"
coefficients = { k = 200.0, k3 = 2e6, c = 0.05 }
"""
ASKED = STORE + LINK.replace("k = 200.0, k3 = 2e6, c = 0.05", 'k = "unknown", k3 = "unknown", c = "unknown"')
DRIVE = "--force wing.tip=5*sin(33*t) --release v:wing.mode1=0.3"
TAP = "--force 'wing.tip=2*exp(-((t - {})/0.01)**2)' --sensors a:wing.tip,a:wing.joint --rate 200 --noise 40 --seed 1"
ROD = "structure host rod.npz --point mid=15 --keep 4"
MTX = "structure host m.mtx k.mtx --point mid=15z --keep 3"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The modes of a wing, bare and with a payload, and the matrices of a rod of 30 masses."""
    monkeypatch.chdir(tmp_path)
    Path("modes.csv").write_text("frequency[Hz],damping,tip,joint\n5.2,0.01,1.0,0.62\n21,0.01,-1,0.3\n")
    rod(1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1)))
    return tmp_path


def rod(stiffness: np.ndarray) -> None:
    np.savez("rod.npz", M=0.1 * np.eye(30), K=stiffness)


def wing() -> str:
    """The text of the wing, which is in wing.toml, and with a payload in true.toml and asked.toml."""
    said("structure host modes.csv --name wing -o wing.toml")
    text = Path("wing.toml").read_text()
    Path("true.toml").write_text(text + STORE + LINK)
    Path("asked.toml").write_text(text + ASKED)
    return text


def taps(at: float, duration: float) -> None:
    """The record of a tap on the bare wing, in taps.csv."""
    wing()
    said(f"simulate wing.toml {TAP.format(at)} --duration {duration} -o taps.csv")


def assert_payload(result: dict[str, Any]) -> None:
    coefficients = result["links"][0]["coefficients"]
    for name, value in (("k", 200.0), ("k3", 2e6), ("c", 0.05)):
        # four standard errors: 6e-5 of chance each
        assert abs(coefficients[name]["value"] - value) < 4.0 * coefficients[name]["standard_error"]


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_from_modes_to_a_validated_link() -> None:
    wing()
    drive = DRIVE.replace("tip", "joint")
    out, _ = said(f"simulate true.toml {drive} --duration 1 --rate 400 --noise 30 --seed 2 -o wing.csv")
    assert "1 host, 2 modes, 1 mass, 1 link" in out
    header = "time,x:wing.tip,x:wing.joint,x:store,force:wing.joint"
    assert Path("wing.csv").read_text().startswith(header)
    said("identify wing.csv asked.toml -o answer")
    result = json.loads(Path("answer/result.json").read_text())
    assert result["trusted"]
    assert [mode["name"] for mode in result["modes"]] == ["wing.mode1", "wing.mode2"]
    assert_payload(result)
    assert not list(Path("answer").glob("force_wing*"))
    assert "x:wing.tip" in said("validate wing.csv answer").out


def test_matrices_become_a_host() -> None:
    out, err = said(f"{ROD} --modal-damping 0.02")
    assert len(lw.parse_structure(out).hosts[0].modes) == 5
    assert "4 modes and 1 residual ones" in err and "does not oscillate" not in err
    told = said(f"{ROD} --modal-damping 2").err
    assert "note: mode 1 does not oscillate: its damping ratio is 2" in told
    free = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    free[0, 0] = free[-1, -1] = 1e4
    rod(free)
    assert "1 mode is at 0 Hz: the model is free to move" in said(ROD).err


def test_links_that_were_added_to_a_file_are_not_lost() -> None:
    for ratio in ("0.01", "0.02"):  # a host alone is written again
        said(f"{ROD} --modal-damping {ratio} -o rod.toml")
    added = Path("rod.toml").read_text() + STORE + LINK.replace("wing.tip", "rod.mid")
    Path("rod.toml").write_text(added)
    assert "-o rod.toml is there already and holds more than hosts" in refusal(f"{ROD} -o rod.toml")
    assert Path("rod.toml").read_text() == added


def test_abaqus_matrices_become_a_host() -> None:
    """Points by node and direction, Rayleigh damping, and a damping matrix in a third file."""
    Path("m.mtx").write_text("".join(f"{node},3, {node},3, 0.1\n" for node in range(1, 31)))
    coupled = (
        f"{node},3, {node},3, 2e4\n" + (f"{node},3, {node - 1},3, -1e4\n" if node > 1 else "")
        for node in range(1, 31)
    )
    Path("k.mtx").write_text("".join(coupled))
    Path("c.mtx").write_text("15,3,15,3,20.0\n")
    out, err = said(f"{MTX} --name rod --rayleigh 0.5,1e-5")
    assert "the model weighs 3 kg" in err
    assert "couples" not in err and "0 Hz" not in err
    host = lw.parse_structure(out).hosts[0]
    frequency = 2.0 * np.pi * np.asarray(host.modes[0].frequency.value)
    assert host.modes[0].damping.value == pytest.approx(0.5 * (0.5 / frequency + 1e-5 * frequency))
    out, err = said(MTX.replace("k.mtx", "k.mtx c.mtx"))
    damped = lw.parse_structure(out).hosts[0].modes[0]
    assert damped.damping.value == pytest.approx(20.0 * damped.shape["mid"] ** 2 / (2.0 * frequency))
    assert "the damping matrix couples" in err
    assert (1, 2) in lw.parse_structure(out).hosts[0].damping
    for wrong, message in (
        (f"{MTX} --rayleigh 0.5", "--rayleigh needs two numbers A,B"),
        (f"{MTX} --point tip=31z", "names points by node and direction"),
        (f"{MTX} --damping C", "--damping needs a third file"),
        ("structure host m.mtx --point mid=15z", "m is taken for the mass and for the stiffness"),
    ):
        assert message in refusal(wrong)
    Path("rod.toml").write_text(
        '[[host]]\nname = "rod"\npoints = { mid = "15z" }\nkeep = 3\n'
        'matrices = { mass = "m.mtx", stiffness = "k.mtx", damping = "c.mtx" }\n'
    )
    assert (1, 2) in lw.read_structure("rod.toml").hosts[0].damping
    Path("c.mtx").write_text("".join(f"{node},3, {node},3, 0.2\n" for node in range(1, 31)))
    proportional = lw.read_structure("rod.toml").hosts[0].modes[0]
    assert proportional.damping.value == pytest.approx(0.2 / 0.1 / (2.0 * frequency))


def test_a_structure_file_with_matrices_tells_the_error_of_its_reduction() -> None:
    Path("rod.toml").write_text(
        '[[host]]\nname = "rod"\npoints = { mid = 15, between = "0.5*20 + 0.5*21" }\nkeep = 4\n'
        'matrices = { mass = "rod.npz:M", stiffness = "rod.npz:K" }\n'
    )
    err = said("simulate rod.toml --release v:rod.mode1=0.1 --duration 0.1 --rate 400 -o rod.csv").err
    assert "note: rod: 4 modes and 2 residual ones; at " in err
    assert "note: 4 modes and 2 residual ones; at " in said("structure show rod.toml").out
    refused = refusal("discover rod.csv --structure rod.toml --terms d", 1)
    assert "note: rod: 4 modes" in refused and "it needs at least 50" in refused


def test_show_prints_the_modes_and_draws_the_shapes() -> None:
    sigmas = "--frequency-sigma 1% --damping-sigma '20 %' --shape-sigma 2%"
    said(f"structure host modes.csv --name wing {sigmas} -o wing.toml")
    (first, second) = lw.read_structure("wing.toml").hosts[0].modes
    assert first.frequency.sigma == pytest.approx(0.052)
    assert second.damping.sigma == pytest.approx(0.002)
    assert dict(second.shape_sigma) == {"tip": pytest.approx(0.02), "joint": pytest.approx(0.02)}
    out, err = said("structure show wing.toml --shapes wing.png")
    assert "2 modes; shapes in 1/sqrt(kg) at wing.tip, wing.joint" in out
    assert re.search(r"wing\.mode2 +21 ", out) and "0.62 +- 0.02" in out
    assert "note: wing.svg is written" in err
    assert Path("wing.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in Path("wing.svg").read_text()


@pytest.mark.slow
def test_a_record_may_show_the_coordinate_of_a_mode() -> None:
    Path("asked.toml").write_text(wing() + STORE + LINK.replace("k = 200.0", 'k = "unknown"'))
    modal = "--release v:wing.mode1=0.3 --sensors x:wing.mode1,x:wing.mode2,x:store"
    said(f"simulate true.toml {modal} --duration 1 --rate 400 --noise 40 --seed 2 -o modal.csv")
    assert "x:wing.mode1" in said("identify modal.csv asked.toml").out


@pytest.mark.slow
def test_from_taps_to_a_payload() -> None:
    taps(0.1, 2)
    identified = json.loads(said("structure host taps.csv --modes 2 --json").out.splitlines()[-1])
    assert identified["host"][0]["name"] == identified["identified"]["host"]
    assert identified["identified"]["trusted"] is True
    out = said("structure host taps.csv --modes auto -o identified.toml").out
    assert "wing: 2 modes at 2 points, can be trusted" in out
    Path("asked.toml").write_text(Path("identified.toml").read_text() + ASKED)
    said(f"simulate true.toml {DRIVE} --duration 1 --rate 400 --noise 30 --seed 2 -o wing.csv")
    assert_payload(document("identify wing.csv asked.toml"))


@pytest.mark.slow
def test_a_test_is_read_with_the_names_of_a_logger_and_the_errors_that_are_stated() -> None:
    taps(0.5, 2)
    header, _, rows = Path("taps.csv").read_text().partition("\n")
    assert header == "time,a:wing.tip,a:wing.joint,force:wing.tip"
    Path("logger.csv").write_text(f"Time,Acc 1,Acc 2,Hammer\n{rows}")
    columns = {"a:wing.tip": "Acc 1", "a:wing.joint": "Acc 2", "force:wing.tip": "Hammer", "time": "Time"}
    named = " ".join(f"--channel '{name}={column}'" for name, column in columns.items())
    window = "--modes 2 --from 0.4 --to 1.9 --frequency-sigma 1% --shape-sigma 30%"
    out = said(f"structure host logger.csv {named} {window} -o mapped.toml").out
    assert "(602 samples" in out  # of 1.5 s at 200 Hz, two responses
    said(f"structure host taps.csv {window} -o named.toml")
    mapped, direct = (lw.read_structure(f"{which}.toml").hosts for which in ("mapped", "named"))
    assert mapped == direct
    first = direct[0].modes[0]
    assert first.frequency.value is not None
    assert first.frequency.sigma == pytest.approx(0.01 * first.frequency.value)  # the record tells far more
    assert first.shape_sigma["joint"] == pytest.approx(0.3 * max(map(abs, first.shape.values())))


def test_rows_and_modes_that_turn_are_stated() -> None:
    np.savez("post.npz", M=np.diag([1.0, 0.002]), K=np.array([[400.0, -20.0], [-20.0, 5.0]]))
    post = "structure host post.npz --point tip=1 --point tip_r=2 --keep 2"
    said(f"{post} --unit tip_r=rad -o post.toml")
    assert lw.read_structure("post.toml").rotations == ("post.tip_r",)
    shown = said("structure show post.toml").out
    assert "shapes in 1/sqrt(kg), or rad/(m sqrt(kg)), at post.tip, post.tip_r (in rad)" in shown
    said("structure host modes.csv --name wing --unit joint=rad -o wing.toml")
    assert lw.read_structure("wing.toml").rotations == ("wing.joint",)
    Path("turned.csv").write_text("frequency[Hz],damping,tip,12rz[rad]\n5.2,0.01,1.0,0.62\n")
    said("structure host turned.csv --name wing -o turned.toml")
    assert lw.read_structure("turned.toml").rotations == ("wing.12rz",)
    refused = refusal("structure host turned.csv --unit 12rz=m")
    assert "is the direction 12rz, which is in rad, not in m" in refused


@pytest.mark.slow
def test_a_free_decay_takes_the_masses_at_its_points() -> None:
    wing()
    pulled = "--release v:wing.mode1=0.3 --sensors a:wing.tip --duration 2 --rate 200 --noise 40 --seed 1"
    said(f"simulate wing.toml {pulled} -o decay.csv")
    out = said("structure host decay.csv --modes 1 --point-mass tip=500g -o decayed.toml").out
    assert "wing: 1 modes at 1 points, can be trusted" in out
    [mode] = lw.read_structure("decayed.toml").hosts[0].modes
    assert abs(mode.shape["tip"]) == pytest.approx(2.0**0.5, rel=1e-12)  # 1/sqrt(0.5 kg)
