"""Options and units that are numbers and yet cannot be, and what is too large: refused in words."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.cli import run

SHOWN = 4000  # characters that a screen shows


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with chain.toml, unknown.toml and one second of its motion, run.csv."""
    folder = tmp_path_factory.mktemp("files")
    chain = lw.bnes_chain(2)
    lw.write_structure(chain, folder / "chain.toml")
    lw.write_structure(chain.unknown("nes"), folder / "unknown.toml")
    record = chain_record(2, duration=1.0, rate=500.0).with_noise(30.0, seed=1)
    lw.write_record(record, folder / "run.csv")
    return folder


@pytest.fixture(scope="module")
def record(files: Path) -> lw.Record:
    return lw.read_record(files / "run.csv")


IDENTIFY = ["identify", "run.csv", "unknown.toml", "--method", "weak"]
SIMULATE = ["simulate", "chain.toml", "--duration", "1", "--rate", "500", "-o", "o.csv"]
LIMIT = ["limit", "chain.toml", "--release", "v:m1=1", "--noise", "20"]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([*IDENTIFY, "--from", "nan"], 2, "nan"),
        ([*IDENTIFY, "--from", "inf"], 2, "no sample between inf and"),
        ([*IDENTIFY, "--resample", "1e9"], 2, "resampl"),
        ([*IDENTIFY, "--resample", "inf"], 2, "rate"),
        ([*IDENTIFY, "--rate", "1e999"], 2, "rate"),
        ([*IDENTIFY, "--sensor", "x:m1:noise=nan"], 2, "x:m1"),
        ([*IDENTIFY, "--sensor", "x:m1:noise=1e99"], 2, "x:m1: its noise is stated as 1e+99 m"),
        (["identify", "run.csv", "unknown.toml", "--sensor", "x:m2:noise=10"], 2, "which hold that noise"),
        ([*SIMULATE, "--release", "v:m1=1", "--sensors", "x:m1,x:m1"], 2, "x:m1 is listed twice"),
        ([*LIMIT, "--duration", "1", "--rate", "500", "--sensors", "v,v"], 2, "sensor v is listed twice"),
        ([*LIMIT, "--duration", "0.001", "--rate", "1000"], 1, "too short"),
        ([*LIMIT, "--duration", "1", "--rate", "500", "--segment", "1e-9"], 1, "too short"),
        ([*LIMIT, "--duration", "nan", "--rate", "1000"], 2, "duration"),
        ([*SIMULATE, "--noise", "-1e308"], 2, "decibel must be within 1000 of zero"),
        ([*LIMIT[:-1], "1e308", "--duration", "1", "--rate", "500"], 1, "must be within 1000 dB of zero"),
        (["study", "paper", "--workers", "1000000", "-o", "out"], 2, "at most 1000 workers"),
        (["structure", "bnes", "--dof", "1" + "0" * 400], 2, "masses must be at most 100000"),
    ],
)
def test_option_that_cannot_be(
    arguments: list[str],
    code: int,
    said: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(files)
    assert run(arguments) == code
    error = capsys.readouterr().err
    assert said in error and "internal error" not in error and len(error) < SHOWN


def test_a_record_runs_to_infinity_and_from_there(record: lw.Record) -> None:
    np.testing.assert_array_equal(record.between(-np.inf, np.inf).values, record.values)
    assert record.between(0.5, np.inf).start == 0.5


@pytest.mark.slow
def test_a_segment_longer_than_the_test_is_the_whole_test() -> None:
    """Identity: there is one segment, however much longer it might be."""
    test: dict[str, Any] = {"duration": 0.5, "rate": 500.0, "noise": 20.0, "release": {"v:m1": 1.0}}
    near, far = (lw.limit(lw.bnes_chain(2), segment=segment, **test) for segment in (0.6, 1e9))
    assert near.to_dict()["coefficients"] == far.to_dict()["coefficients"]


def test_a_force_may_be_long(files: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Longer than the name of a file can be, with a colon in no place where a file could be meant. All terms are alike, which
    is compiled in no time."""
    monkeypatch.chdir(files)
    force = " + ".join(["20*sin(20*t)"] * 99)
    out = str(tmp_path / "o.csv")
    arguments = ["simulate", "chain.toml", "--duration", "0.5", "--rate", "100", "-o", out]
    assert run([*arguments, "--force", f"m1={force}"]) == 0
    assert lw.read_record(out).inputs == ("force:m1",)


@pytest.mark.parametrize("force", ["\0", "x" * 300 + ":f", ":" * 300])
def test_a_force_that_is_neither_file_nor_expression_is_refused(
    force: str, files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    arguments = ["simulate", "chain.toml", "--duration", "0.1", "--rate", "100", "-o", "o.csv"]
    assert run([*arguments, "--force", f"m1={force}"]) == 2
    assert "internal error" not in capsys.readouterr().err


@pytest.mark.parametrize("digits", ["9" * 400, f'"{"9" * 400} kg"', f"{{ start = {'9' * 400} }}", "1e400"])
def test_a_number_of_400_digits_is_no_finite_one(digits: str) -> None:
    for key in ("mass", "k"):
        text = lw.model.format_structure(lw.bnes_chain(2))
        old = "mass = 1.0" if key == "mass" else "k = 30000.0"
        assert old in text
        with pytest.raises(lw.StructureError) as error:
            lw.parse_structure(text.replace(old, f"{key} = {digits}", 1))
        assert len(str(error.value)) < 600
    with pytest.raises(lw.StructureError, match="finite"):
        lw.Coefficient.number(10**400)
    with pytest.raises(lw.LinkwiseError, match="finite"):
        lw.files.to_si(10**400, "kg")


SECONDS = 20.0  # in which a command that takes one second must end on a busy machine
ENDLESS = [
    "9**9**9",
    "9**9**9 kg",
    "(9**9)**9**9",
    "((((((((9**9)**9)**9)**9)**9)**9)**9)**9)**9 kg",
    "9^9^9 kg",
    "kg**9**9**9",
    "2**(3**(4**5)) kg",
    "9²²²²²²² kg",
    "(" * 5000 + "kg" + ")" * 5000,
    "kg*" * 50_000 + "kg",
    "1e999999999 kg",
    "kg" * 100_000,
    "d**(1e9)",
    "kg*d**1e9/d**1e9*km**9999",
]


def test_a_unit_is_read_or_refused_at_once() -> None:
    """In a process of its own, since what hangs in the arithmetic of whole numbers hears no signal."""
    code = (
        "import sys, linkwise as lw\n"
        "for text in sys.stdin.read().split('\\n'):\n"
        "    try:\n"
        "        lw.files.to_si(text, 'kg')\n"
        "    except lw.LinkwiseError as error:\n"
        "        print(len(str(error)), str(error)[:60])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        input="\n".join(ENDLESS),
        capture_output=True,
        text=True,
        timeout=SECONDS,
    )
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == len(ENDLESS)
    assert max(int(line.split()[0]) for line in lines) < 400
