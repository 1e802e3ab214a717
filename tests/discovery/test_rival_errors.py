"""Stated values and zeros of sensors that are a little wrong, for which terms that are not there stand in."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from present import some
from record_faults import changed
from structures import row_of_masses
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
