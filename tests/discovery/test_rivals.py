"""What terms that are not there stand in for: values stated a little wrong, zeros of sensors, forms that were not offered."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from random_signals import random_force
from record_faults import changed
from structures import oscillator, row_of_masses
from within import masses

import linkwise as lw

FRAME = row_of_masses(
    [1.0, 0.5, 0.3],
    **{
        "m1-ground": ("k*d + k3*d**3 + c*v", {"k": 2e4, "k3": 1e7, "c": 1.0}),
        "m2-m1": ("k*d + c*v", {"k": 1.2e4, "c": 0.8}),
        "m3-m2": ("k*d + c*v", {"k": 9e3, "c": 0.5}),
    },
)
FORCE = "3*sin(13*t) + 2*sin(24*t + 1) + 2*sin(37*t + 2) + sin(48*t + 3)"
OFFSET = 1e-3  # m
HARDLY = "This record hardly distinguishes m1-ground.f0 from a zero offset"


@cache
def released() -> lw.Record:
    return lw.simulate(FRAME, release={"v:m1": 1.0}, duration=2.0, rate=1000.0)


@pytest.mark.slow
def test_right_values_have_no_rival() -> None:
    discovery = lw.discover(released().with_noise(30.0, seed=11), masses(FRAME))
    assert discovery.trusted
    assert lw.discovery.term_score(discovery.structure, FRAME).exact
    assert all(term.certain for term in some(discovery.kept))
    assert not [remark for remark in discovery.remarks if "than stated" in remark]


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "factor", "message"), [("m2", 0.99, "more"), ("m3", 1.01, "less")])
def test_a_mass_that_is_stated_a_percent_wrong_is_named(mass: str, factor: float, message: str) -> None:
    """Springs that are not there were called certain, beside coefficients many standard errors off."""
    stated = {**masses(FRAME), mass: factor * float(masses(FRAME)[mass])}
    discovery = lw.discover(released().with_noise(30.0, seed=11), stated)
    false = lw.discovery.term_score(discovery.structure, FRAME).extra
    assert false and not [term for term in discovery.terms if term.certain and term.name in false]
    assert not discovery.trusted and lw.Verdict.MEASUREMENT_ERROR in discovery.verdicts
    coefficients = some(discovery.estimate.links[0].coefficients)
    assert all(coefficient.standard_error is None for coefficient in coefficients)
    said = f"If the mass of {mass} were 1 % {message} than stated"
    [named] = [remark for remark in discovery.remarks if said in remark]
    assert all(name in named for name in false)


def test_a_stiffness_that_is_stated_wrong_is_named() -> None:
    stated = FRAME.link("m2-m1")
    wrong = replace(stated, coefficients={**stated.coefficients, "k": lw.Coefficient.number(1.02 * 1.2e4)})
    noisy = released().with_noise(18.0, seed=11)  # with less noise the diagnosis of the fit tells it
    discovery = lw.discover(noisy, lw.model.PartialStructure(FRAME.masses, (wrong,)))
    assert not discovery.trusted
    assert any("If m2-m1.k were 1.9 % less than stated" in remark for remark in discovery.remarks)


@cache
def shaken(k3: float, force: float = 0.0, sensors: Sequence[str] = (), number: int = 1) -> lw.Record:
    """One or two masses, the first on a spring and under a constant force in N, `sensors` off their zeros."""
    values = {"k": 800.0 if number == 1 else 2000.0, "k3": k3, "c": 4.0 / number, "f0": force}
    links = {"m1-ground": ("k*d + k3*d**3 + c*v + f0", values)}
    if number == 2:
        links["m2-m1"] = ("k*d + c*v", {"k": 900.0, "c": 1.0})
    structure = row_of_masses([1.0, 0.5][:number], **links)
    record = lw.simulate(structure, forces={"m1": FORCE}, duration=8.0, rate=200.0).with_noise(40.0, seed=5)
    return changed(record, **{sensor: lambda x: x + OFFSET for sensor in sensors})


def discovered(record: lw.Record, **options: list[str]) -> lw.Discovery:
    kilograms = {"m1": 1.0, "m2": 0.5} if "x:m2" in record.channels else {"m1": 1.0}
    return lw.discover(record, kilograms, terms="1, cubic", **options)  # type: ignore[arg-type]


def about_zeros(discovery: lw.Discovery) -> list[str]:
    return [remark for remark in discovery.remarks if "zero offset" in remark or "were off by" in remark]


BOTH = ("x:m1", "x:m2")


@pytest.mark.parametrize(
    ("record", "offset"),
    [(shaken(0.0, 0.8), -0.8 / 800.0), (shaken(0.0, 0.0, BOTH, 2), OFFSET)],
    ids=["force", "offset of both sensors"],
)
def test_linear_springs_do_not_tell_a_force_from_an_offset(record: lw.Record, offset: float) -> None:
    """A force of -0.8 N that was an offset of 1 mm was called certain, and one of 2 N that was one of both sensors."""
    discovery = discovered(record)
    assert discovery.trusted
    assert {term.name for term in discovery.kept if not term.certain} == {"m1-ground.f0"}
    [remark] = about_zeros(discovery)
    assert remark.startswith(HARDLY)
    assert ("all sensors" in remark) is ("x:m2" in record.channels)
    assert float(remark.split(" m, ")[0].rpartition(" ")[2]) == pytest.approx(offset, rel=0.02)


def test_a_constant_force_beside_a_cubic_spring_is_certain() -> None:
    discovery = discovered(shaken(2e6, -2.0, (), 2))
    [force] = [term for term in discovery.kept if term.term == "1"]
    assert force.decision is lw.discovery.Decision.CERTAIN
    assert not about_zeros(discovery)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("k3", "sensors", "number", "said", "sizes"),
    [
        (3e5, ("x:m1",), 1, "If x:m1 had a zero offset of ", ["m1-ground.f0 and m1-ground.k2"]),
        (2e6, BOTH, 2, "If all displacements were off by ", ["m1-ground.f0 and m1-ground.k2"]),
    ],
    ids=["one mass", "both sensors"],
)
def test_an_offset_is_told_in_place_of_forces_and_estimated_where_it_is_asked_for(
    k3: float, sensors: tuple[str, ...], number: int, said: str, sizes: list[str]
) -> None:
    """A constant and a quadratic force were called certain, beside a stiffness three standard errors off."""
    record = shaken(k3, 0.0, sensors, number)
    discovery = discovered(record)
    assert not discovery.trusted and not any(term.certain for term in discovery.terms)
    assert lw.Verdict.MEASUREMENT_ERROR in discovery.verdicts
    [remark] = [remark for remark in about_zeros(discovery) if remark.startswith(said)]
    size, _, would = remark.removeprefix(said).partition(" m, ")
    assert float(size) == pytest.approx(OFFSET, rel=0.02)
    assert all(would.startswith(f"{stand_ins} would not be needed") for stand_ins in sizes)
    told = discovered(record, offsets=list(sensors))
    assert told.trusted
    links = {("m1-ground", term) for term in ("d", "v", *(["d**3"] if k3 else []))}
    links |= {("m2-m1", "d"), ("m2-m1", "v")} if number == 2 else set()
    assert {(term.link, term.term) for term in told.kept} == links
    assert [error.value for error in told.estimate.sensor_errors] == pytest.approx(
        [OFFSET] * len(sensors), rel=0.02
    )


RATE, DURATION = 200.0, 10.0
OFFERED = "d, d**3, v, v**3"


def record(law: str, seed: int, *, c: float, k3: float, q: float) -> lw.Record:
    """A mass of 1 kg under a random force of 6 N root mean square from 1 to 12 Hz, at 20 dB."""
    true = oscillator(law, k=987.0, k3=k3, c=c, q=q)
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(true, forces=forces, duration=DURATION, rate=RATE).with_noise(20.0, seed=seed)


def test_terms_that_stand_in_for_a_form_that_was_not_offered_are_in_doubt() -> None:
    """They were certain, and trusted: other terms on offer explain the record far worse."""
    given = record("k*d + k3*d**3 + c*v + q*d*abs(d)", 32, c=2.0, k3=0.0, q=400.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.estimate.trusted  # by its residuals alone
    assert not discovery.trusted and lw.Verdict.TERMS_MAY_BE_MISSING in discovery.verdicts
    assert not [term for term in discovery.kept if term.certain]
    (remark,) = (remark for remark in discovery.remarks if "offer it" in remark)
    assert "a force like d*abs(d) in m1-ground, which was not offered, m1-ground.k3 would not be" in remark


@pytest.mark.slow
def test_beside_a_model_error_terms_that_stand_in_for_another_form_are_in_doubt() -> None:
    """Damping that falls with the rate gives no energy: springs are told with intervals, damping as what it may be."""
    given = record("k*d + k3*d**3 + c*v + q*tanh(v/0.3)", 33, c=0.0, k3=4e5, q=1.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert lw.Verdict.MODEL_ERROR_NEEDED in discovery.verdicts
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3"}
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v", "v**3"}
    assert [
        remark for remark in discovery.remarks if "a force like tanh(v" in remark and "offer it" in remark
    ]
    for name, true in (("k", 987.0), ("k3", 4e5)):
        low, high = discovery.estimate.coefficient(f"m1-ground.{name}").interval or (np.nan, np.nan)
        assert low < true < high


def test_terms_that_are_there_stay_certain_beside_other_forms() -> None:
    given = record("k*d + k3*d**3 + c*v + q*v**3", 6, c=2.0, k3=4e5, q=4.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.trusted and not [remark for remark in discovery.remarks if "offer it" in remark]
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v", "v**3"}


def test_a_term_whose_interval_holds_zero_for_a_hint_of_another_one_is_not_certain() -> None:
    """Residuals hint at v*abs(v), which was not offered, with which v**3 would hardly be there; its margin alone is large."""
    given = record("k*d + k3*d**3 + c*v + q*v*abs(v)", 4202, c=6.0, k3=4e5, q=-2.0)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert "The residuals hint at" in discovery.estimate.message
    low, high = present(discovery.estimate.coefficient("m1-ground.c3").interval)
    assert low < 0.0 < high
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v"}


def test_damping_that_falls_with_the_motion_and_stays_damping_is_no_stand_in() -> None:
    """It was refused for the sign of its term alone, though the law takes energy throughout the motion."""
    term, q = "v*d**2", -4e3
    given = record(f"k*d + k3*d**3 + c*v + q*{term}", 43, c=6.0, k3=4e5, q=q)
    discovery = lw.discover(given, {"m1": 1.0}, terms=f"d, d**3, v, {term}")
    assert discovery.trusted
    assert {term.term for term in discovery.kept if term.certain} == {"d", "d**3", "v", term}
    fallen = next(kept for kept in discovery.kept if kept.term == term)
    assert (
        fallen.value < 0.0 and abs(fallen.value - q) < 4.0 * fallen.standard_error
    )  # 1e-4 of normal errors are larger


@pytest.mark.parametrize(("k3", "q", "certain"), [(0.0, 150.0, {"d", "v"}), (4e4, 0.0, {"d", "v", "d**3"})])
def test_a_term_of_which_another_form_is_as_good_is_in_doubt(k3: float, q: float, certain: set[str]) -> None:
    """A stiffness that grows with the elongation was told as cubic, beyond doubt; one that is cubic stays so."""
    given = record("k*d + k3*d**3 + c*v + q*d*abs(d)", 42, c=2.0, k3=k3, q=q)
    discovery = lw.discover(given, {"m1": 1.0}, terms=OFFERED)
    assert discovery.trusted and {term.term for term in discovery.kept} == {"d", "v", "d**3"}
    assert {term.term for term in discovery.kept if term.certain} == certain
    told = [remark for remark in discovery.remarks if "explains the record as well as m1-ground.k3" in remark]
    assert len(told) == ("d**3" not in certain)
