"""Units that are meant to be computed for ever, wherever a unit is read."""

import subprocess
import sys

import pytest

import linkwise as lw

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


@pytest.mark.parametrize(
    ("given", "value"),
    [
        ("10**3 g", 1.0),
        ("10^-3 t", 1.0),
        ("2*10**3 g", 2.0),
        ("1e3 g", 1.0),
        ("1/4 kg", 0.25),
        ("kg**1", 1.0),
    ],
)
def test_powers_that_people_write_are_read(given: str, value: float) -> None:
    assert lw.files.to_si(given, "kg") == pytest.approx(value, rel=1e-15)
