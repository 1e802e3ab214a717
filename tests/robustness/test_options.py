"""Options, units and laws of numbers that cannot be, and what is too large: an answer, or a refusal in words."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import python, said
from problems import chain_record
from structures import link, structure

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


def held_by(law: str) -> lw.Structure:
    """One mass of 1 kg, held by a link of this law whose coefficients are 1, 1.5, 2, ..."""
    values = {name: 1.0 + 0.5 * k for k, name in enumerate(lw.Law.parse(law).coefficients)}
    return structure({"m": 1.0}, link("l", "m-ground", law, **values), name="one")


@pytest.mark.parametrize("law", ["0*c", "d*0", "0", "k*d + 0*c", "c*d - c*d + k*v"])
def test_a_coefficient_that_cancels_changes_nothing(law: str) -> None:
    """heyoka refuses a parameter that its equations do not use."""
    release = {"x:m": 0.1, "v:m": 1.0}
    record = lw.simulate(held_by(law), release=release, duration=0.1, rate=200.0)
    if "k" not in law:  # no force: the mass flies on
        np.testing.assert_allclose(record.channel("x:m"), 0.1 + record.time, rtol=1e-12)


@pytest.mark.parametrize(
    "law",
    [
        "exp((v + k)**17)",
        "-1e6*v - 3",
        "exp(exp(exp(exp(v + 9))))",
        "((1e-3 + k)**3)**0.5*(k*p*min(d, 1e300))**p",
        "1/d",
        "log(d - 1)",
    ],
)
def test_a_force_that_is_not_finite_is_told(law: str) -> None:
    try:
        record = lw.simulate(held_by(law), release={"x:m": 0.1, "v:m": 1.0}, duration=0.05, rate=200.0)
        assert np.isfinite(record.values).all()
    except lw.LinkwiseError as error:
        assert "fault" not in str(error) and len(str(error)) < 1000


@pytest.mark.parametrize("law", ["k*d + c*v + p*abs(d)**1.5", "k*d + c*v + p*d*sqrt(abs(d))"])
def test_a_root_that_cannot_be_followed_through_zero_is_told_with_a_law_that_can(law: str) -> None:
    release = {"x:m": 0.01}
    spring = {"k": 1000.0, "c": 1.0, "p": 1e4}
    with pytest.raises(lw.SimulationError, match=r"link a has a root .* write \(x\*\*2 \+ 1e-14\)\*\*0\.75"):
        lw.simulate(
            structure({"m": 1.0}, link("a", "m-ground", law, **spring)),
            release=release,
            duration=0.2,
            rate=400.0,
        )
    smooth = link("a", "m-ground", "k*d + c*v + p*(d**2 + 1e-14)**0.75", **spring)
    assert len(lw.simulate(structure({"m": 1.0}, smooth), release=release, duration=0.2, rate=400.0)) == 81


@pytest.mark.parametrize(("k", "c"), [(1e308, 1.0), (1.0, 1e308), (1.7e308, 1.7e308)])
def test_modes_of_coefficients_near_the_largest_number_are_refused(k: float, c: float) -> None:
    with pytest.raises(lw.StructureError, match="is too large for its masses: its modes are not finite"):
        lw.analysis.modes(lw.bnes_chain(4, k=k, sink_c=c), at=np.zeros(4))


def test_samples_that_nothing_can_have_are_refused() -> None:
    record = chain_record(2, duration=0.5, rate=500.0).with_noise(30.0, seed=1)
    values = {str(name): record.channel(name).copy() for name in record.channels}
    values["x:m2"][40] = 1e300
    with pytest.raises(lw.RecordError, match=r"the value is 1e\+300, more than 1e\+100; .* \(sample 40\)"):
        lw.Record.from_arrays(record.time, values)
    with pytest.raises(lw.RecordError, match=r"the value at 0.08 s is 1e\+300, more than 1e\+100"):
        lw.Record(0.0, 500.0, record.channels, np.column_stack(list(values.values())))


@pytest.mark.parametrize("law", ["k*max(d, 0)**3", "k*d**5*sign(v)"])
def test_an_overflow_at_a_kink_prints_nothing(law: str, capfd: pytest.CaptureFixture[str]) -> None:
    """Where results stand: heyoka warns there of a step that is not a number."""
    with pytest.raises(lw.SimulationError, match="diverges"):
        lw.simulate(held_by(law), release={"x:m": 1e100, "v:m": 1e100}, duration=1.0, rate=100.0)
    assert capfd.readouterr() == ("", "")
