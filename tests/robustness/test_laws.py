"""Laws that can hardly be meant, and records that say too little: an answer, or a refusal in words."""

import numpy as np
import pytest
from problems import chain_record
from structures import link, structure

import linkwise as lw


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
