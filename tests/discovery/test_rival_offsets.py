"""Constant forces, and zero offsets of sensors for which they stand in."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from structures import oscillator, row_of_masses

import linkwise as lw
from linkwise.discovery.rival_errors import RivalError

FORCE = "3*sin(13*t) + 2*sin(24*t + 1) + 2*sin(37*t + 2) + sin(48*t + 3)"
OFFSET = 1e-3  # m
LINEAR = oscillator("k*d + c*v + f0", k=800.0, c=4.0, f0=0.0)
CUBIC = oscillator("k*d + k3*d**3 + c*v + f0", k=800.0, k3=3e5, c=4.0, f0=0.0)


@cache
def record(structure: lw.Structure, force: float = 0.0, offset: float = 0.0) -> lw.Record:
    """Under a constant force of the link in N, with its sensor off its zero by an offset in m."""
    loaded = structure.with_values({"link.f0": force})
    shaken = lw.simulate(loaded, forces={"m1": FORCE}, duration=8.0, rate=200.0).with_noise(40.0, seed=5)
    values = shaken.values.copy()
    values[:, shaken.channels.index("x:m1")] += offset
    return replace(shaken, values=values, simulated=None)


def decision(discovery: lw.Discovery, term: str) -> lw.Decision:
    [evidence] = [evidence for evidence in discovery.kept if evidence.term == term]
    return evidence.decision


@pytest.mark.parametrize(("force", "offset"), [(0.8, 0.0), (0.0, OFFSET)])
def test_a_linear_spring_does_not_tell_a_force_from_an_offset(force: float, offset: float) -> None:
    """A force of -0.8 N that was an offset of 1 mm was called certain."""
    discovery = lw.discover(record(LINEAR, force, offset), {"m1": 1.0}, terms="1, cubic")
    assert discovery.trusted
    assert decision(discovery, "1") is lw.Decision.DOUBTFUL
    assert decision(discovery, "d") is decision(discovery, "v") is lw.Decision.CERTAIN
    [remark] = [remark for remark in discovery.remarks if "zero offset" in remark]
    stated, size = remark.split(" m, ")[0].rsplit(" ", 1)
    assert (
        stated
        == "This record hardly distinguishes m1-ground.f0 from a zero offset of a sensor: if x:m1 had one of"
    )
    assert float(size) == pytest.approx(offset - force / 800.0, rel=0.01)


def test_an_offset_beside_a_cubic_spring_is_told_as_one() -> None:
    """A constant and a quadratic force were called certain, beside a stiffness three standard errors off."""
    discovery = lw.discover(record(CUBIC, 0.0, OFFSET), {"m1": 1.0}, terms="1, cubic")
    assert not discovery.trusted
    assert discovery.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    assert not any(term.certain for term in discovery.terms)
    assert any(
        remark.startswith(
            "If x:m1 had a zero offset of 0.001 m, m1-ground.f0 and m1-ground.k2 would not be needed"
        )
        for remark in discovery.remarks
    )
    told = lw.discover(record(CUBIC, 0.0, OFFSET), {"m1": 1.0}, terms="1, cubic", offsets=["x:m1"])
    assert told.trusted
    assert {term.term for term in told.kept} == {"d", "d**3", "v"}


def test_a_constant_force_on_a_cubic_spring_is_certain() -> None:
    discovery = lw.discover(record(CUBIC, 0.8), {"m1": 1.0}, terms="1, cubic")
    assert discovery.trusted
    assert decision(discovery, "1") is lw.Decision.CERTAIN
    assert not [remark for remark in discovery.remarks if "zero offset" in remark]


def test_one_offset_in_a_chain_is_told_in_place_of_forces_on_several_masses() -> None:
    chain = row_of_masses(
        [1.0, 0.5],
        **{
            "m1-ground": ("k*d + c*v", {"k": 2000.0, "c": 2.0}),
            "m2-m1": ("k*d + c*v", {"k": 900.0, "c": 1.0}),
        },
    )
    shaken = lw.simulate(chain, forces={"m1": FORCE}, duration=8.0, rate=200.0).with_noise(40.0, seed=5)
    values = shaken.values.copy()
    values[:, shaken.channels.index("x:m1")] += OFFSET
    shaken = replace(shaken, values=values, simulated=None)
    discovery = lw.discover(shaken, {"m1": 1.0, "m2": 0.5}, terms="1, cubic")
    assert not discovery.trusted
    assert any(remark.startswith("If x:m1 had a zero offset of 0.001 m") for remark in discovery.remarks)


@pytest.mark.parametrize(
    ("excess", "said"),
    [
        (
            -25.0,
            "If x:m2 had a zero offset of -0.002 m, a.f0 and b.k2 would not be needed and the criterion would be 25 lower: "
            "check the zero of the channel, or estimate its offset.",
        ),
        (
            0.5,
            "This record hardly distinguishes a.f0 and b.k2 from a zero offset of a sensor: if x:m2 had one of -0.002 m, the "
            "criterion would be only 0.5 higher without them.",
        ),
    ],
)
def test_a_rival_offset_is_told_with_what_to_do(excess: float, said: str) -> None:
    assert RivalError("offset", "x:m2", -0.002, (0, 1), excess).remark(("a.f0", "b.k2")) == said
