"""Constant forces, and zero offsets of sensors for which they stand in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from structures import oscillator, row_of_masses

import linkwise as lw
from linkwise.discovery.rivals import RivalError

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


def decision(discovery: lw.Discovery, term: str) -> lw.discovery.Decision:
    [evidence] = [evidence for evidence in discovery.kept if evidence.term == term]
    return evidence.decision


@pytest.mark.parametrize(("force", "offset"), [(0.8, 0.0), (0.0, OFFSET)])
def test_a_linear_spring_does_not_tell_a_force_from_an_offset(force: float, offset: float) -> None:
    """A force of -0.8 N that was an offset of 1 mm was called certain."""
    discovery = lw.discover(record(LINEAR, force, offset), {"m1": 1.0}, terms="1, cubic")
    assert discovery.trusted
    assert decision(discovery, "1") is lw.discovery.Decision.DOUBTFUL
    assert decision(discovery, "d") is decision(discovery, "v") is lw.discovery.Decision.CERTAIN
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
    assert decision(discovery, "1") is lw.discovery.Decision.CERTAIN
    assert not [remark for remark in discovery.remarks if "zero offset" in remark]


def chain_record(
    sensors: Sequence[str], offset: float = OFFSET, force: float = 0.0, k3: float = 0.0
) -> lw.Record:
    """Of two masses, the first under a constant force in N and on a cubic spring, with `sensors` off their zeros in m."""
    chain = row_of_masses(
        [1.0, 0.5],
        **{
            "m1-ground": ("k*d + k3*d**3 + c*v + f0", {"k": 2000.0, "k3": k3, "c": 2.0, "f0": force}),
            "m2-m1": ("k*d + c*v", {"k": 900.0, "c": 1.0}),
        },
    )
    shaken = lw.simulate(chain, forces={"m1": FORCE}, duration=8.0, rate=200.0).with_noise(40.0, seed=5)
    values = shaken.values.copy()
    values[:, [shaken.channels.index(sensor) for sensor in sensors]] += offset
    return replace(shaken, values=values, simulated=None)


def test_one_offset_in_a_chain_is_told_in_place_of_forces_on_several_masses() -> None:
    discovery = lw.discover(chain_record(["x:m1"]), {"m1": 1.0, "m2": 0.5}, terms="1, cubic")
    assert not discovery.trusted
    assert any(remark.startswith("If x:m1 had a zero offset of 0.001 m") for remark in discovery.remarks)


@pytest.mark.parametrize(("offset", "force"), [(OFFSET, 0.0), (0.0, -2.0)])
def test_a_linear_chain_does_not_tell_a_force_from_an_offset_of_all_sensors(
    offset: float, force: float
) -> None:
    """A force of 2 N that was an offset of both sensors was called certain, 250 standard errors from zero."""
    shaken = chain_record(["x:m1", "x:m2"], offset, force)
    discovery = lw.discover(shaken, {"m1": 1.0, "m2": 0.5}, terms="1, cubic")
    assert discovery.trusted
    assert {term.name for term in discovery.kept if not term.certain} == {"m1-ground.f0"}
    [remark] = [remark for remark in discovery.remarks if "zero offset" in remark]
    said, _, size = remark.split(" m, ")[0].rpartition(" ")
    assert said == (
        "This record hardly distinguishes m1-ground.f0 from a zero offset that all sensors of displacement have in common: "
        "if all displacements were off by"
    )
    assert float(size) == pytest.approx(OFFSET, rel=0.02)


def test_a_cubic_spring_tells_a_force_from_an_offset_of_all_sensors() -> None:
    both, masses = ["x:m1", "x:m2"], {"m1": 1.0, "m2": 0.5}
    forced = lw.discover(chain_record(both, 0.0, -2.0, k3=2e6), masses, terms="1, cubic")
    assert decision(forced, "1") is lw.discovery.Decision.CERTAIN
    assert not [remark for remark in forced.remarks if "zero offset" in remark]
    shifted = lw.discover(chain_record(both, k3=2e6), masses, terms="1, cubic")
    assert not shifted.trusted
    [remark] = [
        remark for remark in shifted.remarks if remark.startswith("If all displacements were off by ")
    ]
    size, _, would = remark.removeprefix("If all displacements were off by ").partition(" m, ")
    assert float(size) == pytest.approx(OFFSET, rel=0.01)
    assert would.startswith("m1-ground.f0 and m1-ground.k2 would not be needed")
    told = lw.discover(chain_record(both, k3=2e6), masses, terms="cubic", offsets=both)
    assert told.trusted
    assert {term.name for term in told.kept} == {
        "m1-ground.k",
        "m1-ground.k3",
        "m1-ground.c",
        "m2-m1.k",
        "m2-m1.c",
    }
    assert [error.value for error in told.estimate.sensor_errors] == pytest.approx([OFFSET, OFFSET], rel=0.01)


def test_an_offset_of_all_sensors_that_explains_as_much_is_told_without_a_difference_of_zero() -> None:
    said = RivalError("common offset", "all displacements", 8e-4, (0,), -0.01, "m").remark(("a.f0",))
    assert said.endswith(
        "if all displacements were off by 0.0008 m, the criterion would be the same without it."
    )


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
    assert RivalError("offset", "x:m2", -0.002, (0, 1), excess, "m").remark(("a.f0", "b.k2")) == said
