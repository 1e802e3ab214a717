"""`linkwise start`: from a file of columns to an answer, by options or by questions; what is not known is never taken."""

import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import said

import linkwise as lw
from linkwise.inspection.channel_faults import driven_mass

pytestmark = pytest.mark.usefixtures("unrendered")

MASSES = {"frame": 2.3, "sink": 0.21}
LINKS = {"leaf": "frame - ground: k*d + c*v", "nes": "sink - frame: alpha*d + beta*d**3 + c*v"}
TRUE = {"leaf.k": 3400.0, "leaf.c": 2.1, "nes.alpha": 130.0, "nes.beta": 4e6, "nes.c": 0.12}
HIT = "*exp(-((t - 0.1)/0.003)**2)"
ANSWERED = " ".join(f"--mass {name}={mass}" for name, mass in MASSES.items())
LINKED = " ".join(f"--link {shlex.quote(f'{name}: {text}')}" for name, text in LINKS.items())


def hammer(force: str = "frame", duration: float = 0.5) -> lw.Record:
    rig = lw.rig(MASSES, LINKS, TRUE)
    forces = {force: f"{100.0 * MASSES[force]}{HIT}"}
    return lw.simulate(rig, forces=forces, duration=duration, rate=1000.0).with_noise(34.0, seed=3)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return hammer()


@pytest.fixture
def file(record: lw.Record, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A hammer test in mm, as a data logger writes it."""
    monkeypatch.chdir(tmp_path)
    columns = zip(
        record.time, *(1e3 * record[f"x:{name}"] for name in MASSES), record["force:frame"], strict=True
    )
    rows = (",".join(f"{value:.6f}" for value in row) for row in columns)
    (tmp_path / "rig.csv").write_text(
        "\n".join(["Logger 7", "Time [s],Laser frame [mm],Laser sink [mm],Hammer [N]", *rows])
    )
    return tmp_path / "rig.csv"


@pytest.mark.slow
def test_one_command_gives_the_right_answer_and_others_to_repeat(file: Path) -> None:
    out, err = said(f"start rig.csv {ANSWERED} {LINKED} --known leaf.c=2.1 --yes -o found")
    assert "Nothing wrong was seen." in out and "can be trusted" in out
    identified = lw.read_structure("found/answer/structure.toml")
    posterior = lw.estimates.read_posterior("found/answer")
    for name, error in zip(posterior.names, posterior.covariance.diagonal() ** 0.5, strict=True):
        assert abs((identified.coefficient(name).value or 0.0) - TRUE[name]) < 4.0 * error
    assert "Laser sink        x:sink   displacement    mm  by its unit" in err
    assert "note: Hammer acts on frame" in err
    notes = [line for line in err.splitlines() if line.startswith("note: ")]
    assert len(notes) > 1 and len(set(notes)) == len(notes)
    written = lw.read_structure("found/structure.toml")
    assert written == lw.rig(MASSES, LINKS, {"leaf.c": 2.1}, name="found")
    repeat = [line.strip() for line in err.partition("and repeat:")[2].splitlines() if line.strip()]
    expected = "linkwise identify rig.csv found/structure.toml --mapping found/sensors.toml -o found/answer"
    assert repeat[1] == expected
    assert said(repeat[0].removeprefix("linkwise ")).out.strip() in out
    second = "linkwise validate SECOND_RECORD found/answer --mapping found/sensors.toml"
    assert repeat[3] == second
    given = second.removeprefix("linkwise ").replace("SECOND_RECORD found/answer", "rig.csv found")
    assert f"note: the answer in found is taken, {Path('found', 'answer')}" in said(given).err
    inside = given.replace(" found ", " found/structure.toml ")
    assert f"; an answer is in {Path('found', 'answer')}" in said(inside, 2).err
    assert "respond" in said("respond found --force frame=1 --from 5 --to 6 --starts 0 --json").out
    printed = said(second.removeprefix("linkwise ").replace("SECOND_RECORD", "rig.csv")).out
    assert "agrees with the record" in printed
    told = said(f"start rig.csv {ANSWERED} {LINKED} --yes -o found", 2).err
    assert "what was edited in it would be lost" in told


@pytest.mark.slow
@pytest.mark.usefixtures("memory_not_sought")
def test_without_links_they_are_discovered(file: Path) -> None:
    out, err = said(f"start rig.csv {ANSWERED} --yes")
    assert "frame-ground, linear: k*d + c*v" in out and "sink-frame, hardening: k*d + k3*d**3 + c*v" in out
    assert "$ linkwise discover rig.csv --mapping rig/sensors.toml -o rig/answer" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--yes", "give --mass frame=KG --mass sink=KG"),
        (ANSWERED, "give --yes to take it, or state columns by --channel"),
        ("--mass a=1 --mass b=2 --yes", "--channel 'x:a[mm]=Laser frame' --channel 'x:b[mm]=Laser sink'"),
        (f"{ANSWERED} --link 'leaf: frame:k*d' --yes", 'expected "FIRST - SECOND: LAW"'),
        (f"{ANSWERED} --link leaf --yes", "--link 'leaf' is not NAME: A - B: LAW"),
        (f"{ANSWERED} --known leaf.c=1 --yes", "no --link is given"),
        (f"{ANSWERED} --channel x:base=7 --yes", "does not exist"),
        ("--mass frame=1 --channel x:frame[mm]=2 --channel x:rod[mm]=3 --yes", "give --mass rod=KG"),
        (f"{ANSWERED} --leave-out Time --yes", "give --rate HZ"),
    ],
)
def test_what_is_missing_names_its_option_and_writes_nothing(options: str, message: str, file: Path) -> None:
    _, err = said(f"start rig.csv {options}", 2)
    assert message in err and "Traceback" not in err
    assert options != "--yes" or "Laser sink" in err.partition("linkwise:")[0]  # the columns are shown first
    assert [path.name for path in file.parent.iterdir()] == ["rig.csv"]


def test_uneven_times_are_resampled_as_the_refusal_of_them_advises(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of a micro-controller, which reads its sensor when it comes round."""
    monkeypatch.chdir(tmp_path)
    spring = lw.rig({"m1": 1.0}, {"spring": "m1 - ground: k*d + c*v"}, {"spring.k": 400.0, "spring.c": 0.5})
    swing = lw.simulate(spring, release={"x:m1": 0.01}, duration=3.0, rate=1000.0)
    uneven = np.cumsum(np.random.default_rng(3).integers(9, 12, 270))
    rows = zip(swing.time[uneven], 1e3 * swing["x:m1"][uneven], strict=True)
    Path("log.csv").write_text("\n".join(["Time [s],Laser [mm]", *(f"{t:.3f},{x:.5f}" for t, x in rows)]))
    asked = "start log.csv --mass m1=1 --link 'spring: m1 - ground: k*d + c*v' --yes"
    assert "On the command line: --resample HZ" in said(f"{asked} -o even", 2).err
    said(f"{asked} -o resampled --resample 100")
    assert lw.files.read_mapping("resampled/sensors.toml").resample == 100.0
    stiffness = lw.read_structure("resampled/answer/structure.toml").coefficient("spring.k").value
    assert stiffness == pytest.approx(400.0, rel=0.01)


def test_a_file_without_a_motion_is_refused(file: Path) -> None:
    Path("scope.csv").write_text("Time [s],Laser [mm]\n" + "\n".join(f"{k / 500},OL" for k in range(9)))
    assert "[mm] holds 'OL' in line 2" in said("start scope.csv --mass m1=1 --yes", 2).err


def test_a_column_with_a_text_is_not_left_out_without_a_word(file: Path) -> None:
    lines = file.read_text().splitlines()
    lines[300] = lines[300].replace(",", ",OVERLOAD,", 1).rpartition(",")[0]
    file.write_text("\n".join(lines))
    stated = said(f"start rig.csv {ANSWERED} --channel 'x:frame[mm]=Laser frame' --yes", 2).err
    assert "rig.csv, line 301, channel x:frame: 'OVERLOAD' is not a number" in stated
    guessed = said(f"start rig.csv {ANSWERED} --yes", 2).err
    assert (
        "Not used, since they are not numbers alone: Laser frame [mm] holds 'OVERLOAD' in line 301" in guessed
    )
    assert "To use such a column, leave the cells of missing samples empty." in guessed


def test_what_identify_advises_is_told_with_its_options(file: Path) -> None:
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:150], *lines[190:]]))
    _, err = said(f"start rig.csv {ANSWERED} {LINKED} --channel force:frame=Hammer --yes -o found", 1)
    assert "inputs must be complete; cut the record to a piece without gaps (the longest is from 0.18" in err
    assert "On the command line: --from S, --to S." in err and "and repeat:" in err


def test_links_are_asked_of_a_person_alone(file: Path) -> None:
    text = file.read_text().replace("Laser frame", "x:frame").replace("Laser sink", "x:sink")
    file.write_text(text.replace("Hammer", "force:frame"))
    assert "or --yes to discover them" in said(f"start rig.csv {ANSWERED}", 2).err


@pytest.mark.slow
def test_a_person_is_asked(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = file.read_text().replace("Laser frame [mm]", "CH1 [mm]").replace("Laser sink [mm]", "CH2 [mm]")
    file.write_text(text.replace("Hammer [N]", "Hammer"))
    answers: Iterator[str] = iter([
        "frame, sink", "2.3", "", "heavy", "210 g",  # names, masses; what says none is asked again
        "", "power:frame", "force:frame[N]",  # columns: the first is as guessed, and so follows the second
        "y", "leaf", "leaf: frame - ground: k*(d",
        "leaf: frame - ground: k*d + c*v", "nes: sink - frame: alpha*d + beta*d**3 + c*v", "",
    ])  # fmt: skip
    monkeypatch.setattr("builtins.input", lambda *_: next(answers))
    monkeypatch.setattr("linkwise.cli.start._is_attended", lambda: True)
    out, err = said("start rig.csv -o asked")
    assert "can be trusted" in out and next(answers, None) is None
    for told in ("--mass sink: ", "--link 'leaf' is not NAME: A - B: LAW", 'link "leaf": invalid law'):
        assert told in err
    assert "frame_link: frame - ground: k*d + c*v" in err and 'Column "CH1 [mm]" holds' in err
    assert lw.read_structure("asked/structure.toml") == lw.rig(MASSES, LINKS, name="asked")


@pytest.mark.parametrize("force", MASSES)
def test_a_record_tells_on_which_mass_a_hammer_acts(force: str) -> None:
    record = hammer(force, 0.4)
    assert driven_mass(record, f"force:{force}", MASSES) == force
    assert driven_mass(record, f"force:{force}", {"frame": 0.5, "sink": 3.0}) is None


def test_a_record_of_a_slow_force_does_not_tell() -> None:
    rig = lw.rig(MASSES, LINKS, TRUE)
    slow = lw.simulate(rig, forces={"frame": "5*sin(30*t)"}, duration=0.8, rate=1000.0).with_noise(
        40.0, seed=1
    )
    assert driven_mass(slow, "force:frame", MASSES) is None
