"""Options and units that are numbers and yet cannot be, and what is too large: refused in words."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import python, said
from problems import chain_record

import linkwise as lw


def test_a_record_runs_to_infinity_and_from_there() -> None:
    record = chain_record(2, duration=1.0, rate=500.0)
    np.testing.assert_array_equal(record.between(-np.inf, np.inf).values, record.values)
    assert record.between(0.5, np.inf).start == 0.5


@pytest.mark.slow
def test_a_segment_longer_than_the_test_is_the_whole_test() -> None:
    """Identity: there is one segment, however much longer it might be."""
    test: dict[str, Any] = {"duration": 0.5, "rate": 500.0, "noise": 20.0, "release": {"v:m1": 1.0}}
    near, far = (lw.limit(lw.bnes_chain(2), segment=segment, **test) for segment in (0.6, 1e9))
    assert near.to_dict()["coefficients"] == far.to_dict()["coefficients"]


def test_a_force_may_be_long(tmp_path: Path) -> None:
    """Longer than the name of a file can be, with a colon in no place where a file could be meant. All terms are alike, which
    is compiled in no time."""
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    force = " + ".join(["20*sin(20*t)"] * 99)
    said(f"simulate {tmp_path}/chain.toml --duration 0.5 --rate 100 -o {tmp_path}/o.csv --force 'm1={force}'")
    assert lw.read_record(tmp_path / "o.csv").inputs == ("force:m1",)


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
    done = python("-c", code, given="\n".join(ENDLESS), timeout=SECONDS)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == len(ENDLESS)
    assert max(int(line.split()[0]) for line in lines) < 400
