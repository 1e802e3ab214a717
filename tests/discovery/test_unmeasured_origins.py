"""Discovery from accelerations of a link whose law depends on an origin that they do not tell."""

from __future__ import annotations

import pytest
from present import some
from structures import oscillator

import linkwise as lw

ALPHA, BETA = -100.0, 1e6
WELL = (-ALPHA / BETA) ** 0.5
IN_ONE_WELL = {"x:m1": 1.35 * WELL}


def with_stiffness(alpha: float) -> lw.Structure:
    return oscillator("alpha*d + beta*d**3 + c*v", mass=0.01, alpha=alpha, beta=BETA, c=0.02)


def discovered(structure: lw.Structure, sensors: tuple[str, ...]) -> lw.Discovery:
    record = lw.simulate(structure, release=IN_ONE_WELL, duration=2.0, rate=500.0, sensors=sensors)
    return lw.discover(record.with_noise(40.0, seed=22), {"m1": 0.01})


def test_a_motion_in_one_well_does_not_tell_that_there_are_two() -> None:
    """About the well the force is -2 alpha d + 3 beta w d**2 + beta d**3, as far as accelerations tell."""
    discovery = discovered(with_stiffness(ALPHA), ("a",))
    (link,) = discovery.structure.links
    assert link.coefficients["k"].value == pytest.approx(-2.0 * ALPHA, rel=0.01)
    assert abs(float(link.coefficients["k2"].value or 0.0)) == pytest.approx(3.0 * BETA * WELL, rel=0.01)
    assert not any(term.certain for term in some(discovery.kept)) and not discovery.trusted
    assert discovery.in_doubt == ("m1-ground",)
    assert any(remark.startswith("The law of m1-ground is not odd") for remark in discovery.remarks)


def test_with_the_displacement_the_wells_are_certain() -> None:
    discovery = discovered(with_stiffness(ALPHA), ("x", "a"))
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}
    assert discovery.trusted and all(term.certain for term in some(discovery.kept))


def test_a_law_that_is_odd_about_its_origin_is_certain() -> None:
    discovery = discovered(with_stiffness(-ALPHA), ("a",))
    assert {term.term for term in discovery.kept} == {"d", "d**3", "v"}
    assert discovery.trusted and all(term.certain for term in some(discovery.kept))
    assert not any("not odd" in remark for remark in discovery.remarks)


def test_a_constant_force_beside_all_powers_starts_from_these() -> None:
    """It only shifts an elongation that accelerations do not tell: the equations of the start were singular."""
    true = oscillator("k*d + k3*d**3 + c*v", mass=1.0, k=4000.0, k3=4e7, c=1.5)
    drive = {"m1": "8*sin(2*pi*(2 + 1.5*t)*t)"}
    record = lw.simulate(true, forces=drive, duration=10.0, rate=200.0, sensors=("a",)).with_noise(
        40.0, seed=2
    )
    discovery = lw.discover(record, {"m1": 1.0}, terms="1, v, d, d**2, d**3, v*abs(v)")
    assert {term.term for term in discovery.kept} == {"v", "d", "d**3"} and discovery.trusted
    constant = next(term for term in discovery.terms if term.term == "1")
    assert not constant.kept and constant.margin > 10.0
