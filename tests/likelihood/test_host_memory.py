"""Maximum likelihood with links with memory on hosts: starts from the forces of links that a smoother tells."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from present import some
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts.host_memory import host_memory_starts
from linkwise.likelihood.starts.memory import MemorySearch

SHAPES = {"tip": (1.0, -1.0, 0.8), "joint": (0.62, 0.3, -0.7)}
HYSTERETIC = {"k": 100.0, "c": 0.05, "F": 0.5, "s": 0.6, "x0": 2e-3}
RATE = {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"}


def wing(mass: float | lw.Coefficient = 0.05) -> lw.Structure:
    """A wing by three modes, with a store that hangs at its tip and slips."""
    payload = link("payload", "store-wing.tip", "k*d + c*v + F*z", RATE, **HYSTERETIC)
    return structure(
        {"store": mass}, payload, hosts=[host("wing", (5.2, 21.0, 47.0), 0.01, SHAPES)], name="wing"
    )


@cache
def shaken(kind: str, seed: int) -> lw.Record:
    """Four seconds of a force of twelve frequencies, with three sensors of one kind."""
    rng = np.random.default_rng(seed)
    tones = zip(rng.uniform(2.0, 40.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12), strict=True)
    force = " + ".join(f"0.6*sin({2.0 * np.pi * frequency}*t + {phase})" for frequency, phase in tones)
    return lw.simulate(
        wing(),
        forces={"wing.joint": force},
        duration=4.0,
        rate=400.0,
        sensors=[f"{kind}:wing.tip", f"{kind}:wing.joint", f"{kind}:store"],
    ).with_noise(35.0, seed=seed)


@cache
def identified() -> lw.Estimate:
    return lw.identify(shaken("a", 65), wing().unknown("payload"))


def test_hysteresis_on_a_host_is_identified_from_accelerations() -> None:
    fit = identified()
    assert fit.trusted
    for name, true in HYSTERETIC.items():
        estimate = fit.coefficient(f"payload.{name}")
        assert estimate.standard_error is not None
        assert abs(estimate.value - true) < 4.0 * estimate.standard_error  # 1 of 3000 of five is further off
        assert estimate.standard_error < 0.05 * true  # four of them are a fifth: still of use


@pytest.mark.parametrize("kind", ["x", "v"])
def test_starts_are_near_where_the_motion_is_measured_well(kind: str) -> None:
    unknown = wing().unknown("payload")
    best, *_ = host_memory_starts([shaken(kind, 67)], unknown, {})
    found = {p.name: value for p, value in zip(unknown.parameters, best.values, strict=True)}
    for name in ("F", "s", "x0"):  # a search from there converges
        assert found[f"payload.{name}"] == pytest.approx(HYSTERETIC[name], rel=0.5)


def test_starts_after_the_lowest_are_far_from_each_other_and_hardly_worse() -> None:
    """The store hardly slips: its force is that of a spring for many lengths of slip."""
    unknown = wing().unknown("payload")
    faint = lw.simulate(
        wing(),
        forces={"wing.joint": "0.02*sin(30*t) + 0.02*sin(150*t)"},
        duration=3.0,
        rate=400.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(20.0, seed=66)
    lowest, best, *others = host_memory_starts([faint], unknown, {})
    assert lowest.misfit <= best.misfit
    assert all(start.misfit <= 1.3 * best.misfit for start in some(others))
    names = [parameter.name for parameter in unknown.parameters]
    curved = [names.index("payload.s"), names.index("payload.x0")]
    pairs = combinations([start.values[curved] for start in (best, *others)], 2)
    assert all(np.max(np.abs(a - b) / np.maximum(np.abs(a), np.abs(b))) > 0.6 for a, b in some(list(pairs)))


def test_sizes_of_coefficients_are_those_of_the_motion_of_links_not_of_modes() -> None:
    """Modal coordinates are of another size: slip was looked for at lengths that a joint never moved."""
    unknown, rng = wing().unknown("payload"), np.random.default_rng(5)
    d = rng.normal(size=(500, len(unknown.links)))
    is_mode = np.array([entry.name in unknown.modes for entry in unknown.links])
    d[:, is_mode] *= 100.0
    force = rng.normal(size=500)
    search = MemorySearch(unknown, 0.01, d, 10.0 * d, (), {"f:payload": force}, {})
    assert search.sizes["payload.x0"] == pytest.approx(np.std(d[:, ~is_mode]), rel=1e-12)


def test_starts_come_from_the_record_that_moves_most() -> None:
    loud, unknown = shaken("x", 67), wing().unknown("payload")
    quiet = lw.Record(0.0, 400.0, loud.channels, 0.01 * loud.values)
    alone, both = (host_memory_starts(records, unknown, {})[0] for records in ([loud], [quiet, loud]))
    np.testing.assert_array_equal(both.values, alone.values)


def test_a_second_record_of_a_host_with_memory_is_predicted() -> None:
    second = lw.simulate(
        wing(),
        forces={"wing.joint": "0.5*sin(30*t) + 0.4*sin(150*t)"},
        duration=2.0,
        rate=400.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(35.0, seed=63)
    validation = lw.validate(second, identified())
    assert validation.trusted


def test_an_unknown_mass_beside_a_host_with_memory_needs_a_start() -> None:
    unknown = wing(lw.Coefficient.unknown()).unknown("payload")
    with pytest.raises(lw.StructureError, match=r"store.*no start value"):
        lw.identify(shaken("a", 65), unknown)


def test_equivalent_springs_start_a_joint_between_two_points_of_a_host() -> None:
    """A joint between two points with like shapes: its force drifts more than it says, as frequencies are a little off."""
    rng = np.random.default_rng(64)
    frequencies = np.sort(rng.uniform(3.0, 40.0, 6))
    left = rng.normal(0.0, 0.25, 6)
    ends = {"shaker": rng.normal(0.0, 0.25, 6), "left": left, "right": left + rng.normal(0.0, 0.15, 6)}
    shapes = {point: shape.tolist() for point, shape in ends.items()}
    law = {"k": 9000.0, "k3": 3e10, "c": 6.0}
    joint = link("joint", "air.left-air.right", "k*d + k3*d**3 + c*v", **law)
    true = structure({}, joint, hosts=[host("air", frequencies.tolist(), 0.01, shapes)], name="aircraft")
    lines = zip(np.linspace(2.0, 42.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40), strict=True)
    force = " + ".join(f"2*sin({2.0 * np.pi * frequency}*t + {phase})" for frequency, phase in lines)
    sensors = ["a:air.shaker", "a:air.left", "a:air.right"]
    record = lw.simulate(true, forces={"air.shaker": force}, duration=5.0, rate=400.0, sensors=sensors)
    off = [lw.Coefficient.unknown(f * (1.0 + 0.005 * rng.normal()), sigma=0.005 * f) for f in frequencies]
    stated = structure({}, joint, hosts=[host("air", off, 0.01, shapes)], name="aircraft").unknown("joint")
    fit = lw.identify(record.with_noise(40.0, seed=64), stated)
    assert fit.trusted
    for name, value in law.items():
        estimate = fit.coefficient(f"joint.{name}")
        assert estimate.standard_error is not None
        assert (
            abs(estimate.value - value) < 4.0 * estimate.standard_error
        )  # 1 of 5000 of three is further off
