"""Sinks and harvesters on hosts and with memory: the same as on masses, energies that close, power, loads, and refusals."""

import re
from typing import Any

import numpy as np
import pytest
from present import present, some
from structures import CANTILEVER, CANTILEVER_SHAPES, harvester, host, link, oscillator, structure, with_links

import linkwise as lw
from linkwise.analysis.linear_modes import natural_frequencies

K = np.array([[3000.0, -1000.0], [-1000.0, 2000.0]])
M = np.array([2.0, 0.5])  # kg
SINK = {"alpha": -60.0, "beta": 2e5, "c": 0.3}
RUN: dict[str, Any] = {
    "duration": 5.0,
    "rate": 500.0,
    "settle": 0.4,
    "impulses": [lw.model.Impulse("m1", 1.0)],
}
TAP: dict[str, Any] = RUN | {"impulses": [lw.model.Impulse("frame.m1", 1.0)]}
LINEAR = 4e-4  # s: damping is this times stiffness, so that it is diagonal in the modes


def on_masses(beta: float = SINK["beta"]) -> lw.Structure:
    """Two masses between springs, the second with a bistable sink."""
    springs = [("m1-ground", 2000.0), ("m2-m1", 1000.0), ("m2-ground", 1000.0)]
    links = [link(f"s{i}", ends, "k*d + c*v", k=k, c=LINEAR * k) for i, (ends, k) in enumerate(springs)]
    sink = link("sink", "ball-m2", "alpha*d + beta*d**3 + c*v", **(SINK | {"beta": beta}))
    return structure({"m1": M[0], "m2": M[1], "ball": 0.1}, *links, sink)


def on_host(beta: float = SINK["beta"]) -> lw.Structure:
    """The same two masses as a host by their modes."""
    root = np.sqrt(M)
    squares, modes = np.linalg.eigh(K / np.outer(root, root))
    shapes = modes / root[:, None]
    w = np.sqrt(squares)
    frame = host(
        "frame", (w / (2.0 * np.pi)).tolist(), 0.0, {"m1": shapes[0].tolist(), "m2": shapes[1].tolist()}
    )
    sink = link("sink", "ball-frame.m2", "alpha*d + beta*d**3 + c*v", **(SINK | {"beta": beta}))
    dampings = {f"frame.mode{r}.damping": 0.5 * LINEAR * w[r - 1] for r in (1, 2)}
    return structure({"ball": 0.1}, sink, hosts=[frame]).with_values(dampings)


@pytest.fixture(scope="module")
def both() -> tuple[lw.Absorption, lw.Absorption]:
    """The sink on masses and on the host of the same two."""
    return lw.absorb(on_masses(), **RUN), lw.absorb(on_host(), **TAP)


@pytest.mark.slow
def test_a_host_of_two_masses_is_the_two_masses(both: tuple[lw.Absorption, lw.Absorption]) -> None:
    masses, hosted = both
    assert [mass.name for mass in hosted.masses] == ["frame.m1", "frame.m2"]
    for ours, theirs in zip(some(hosted.masses), masses.masses, strict=True):
        for side, other in [(ours.with_sinks, theirs.with_sinks), (ours.without, theirs.without)]:
            assert (side.peak, side.rms) == pytest.approx((other.peak, other.rms), rel=1e-8)  # same numerics
            assert present(side.settled) == pytest.approx(other.settled, rel=1e-6)
    (sink,), (expected,) = hosted.sinks, masses.sinks
    assert sink.sink == lw.absorption.Sink("sink", "ball", "frame.m2") and len(expected.crossings) > 5
    np.testing.assert_allclose(sink.crossings, expected.crossings, rtol=1e-6)
    assert sink.share == pytest.approx(expected.share, rel=1e-8)
    # what three dampers between the masses dissipate is what both modes do
    springs = sum(masses.with_sinks.share(f"s{i}") for i in range(3))
    assert hosted.with_sinks.share("frame") == pytest.approx(springs, rel=1e-7)
    assert list(hosted.with_sinks.dissipated_by) == ["frame", "sink"] and hosted.trusted
    assert hosted.with_sinks.closure < 1e-9
    assert hosted.to_dict()["energy"]["with_sinks"]["shares"].keys() == {"frame", "sink"}


def test_the_energy_in_a_host_is_that_of_its_masses(both: tuple[lw.Absorption, lw.Absorption]) -> None:
    masses, hosted = both
    x, v = masses.with_sinks.x[:, :2], masses.with_sinks.v[:, :2]
    expected = 0.5 * (v**2 @ M) + 0.5 * np.einsum("ti,ij,tj->t", x, K, x)
    energy = hosted.with_sinks.host_energy("frame")
    np.testing.assert_allclose(energy, expected, atol=1e-8 * expected.max())
    np.testing.assert_allclose(
        hosted.with_sinks.displacement("frame.m2"), x[:, 1], atol=1e-8 * np.abs(x).max()
    )
    assert re.search(rf"mean energy in frame +{energy.mean():.4g} J", str(hosted))
    with pytest.raises(lw.StructureError, match='unknown host "beam"; the hosts are "frame"'):
        hosted.with_sinks.host_energy("beam")


@pytest.mark.slow
def test_intervals_hold_frequencies_known_to_within() -> None:
    beam = host("beam", [5.2], 0.01, {"tip": [1.0]}).known_to_within(frequency=0.01)
    subject = structure(
        {"ball": 0.05}, link("sink", "ball-beam.tip", "k*d + c*v", k=50.0, c=0.3), hosts=[beam]
    )
    true = subject.with_values({"beam.mode1.frequency": 5.23})
    record = lw.simulate(true, release={"v:beam.mode1": 0.5}, duration=4.0, rate=200.0)
    fit = lw.identify(record.with_noise(30.0, seed=12), subject.unknown("sink"))
    chosen: dict[str, Any] = {"duration": 4.0, "release": {"v:beam.mode1": 0.5}, "sinks": ["sink"]}
    intervals = lw.absorption.absorption_intervals(fit, draws=24, seed=1, **chosen)
    expected = lw.absorb(true, **chosen)
    share = intervals.quantity("sinks_share")
    lower, upper = present(share.lower), present(share.upper)
    # the range of 24 draws, widened by itself: five standard deviations on either side at least
    width = upper - lower
    assert lower - width < expected.sinks_share < upper + width and 0.0 < width < 0.1
    assert {parameter.name for parameter in fit.parameters} >= {"beam.mode1.frequency", "sink.k"}


@pytest.mark.slow
def test_a_piezo_between_points_of_a_beam_delivers_power() -> None:
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    law = lw.Law.parse("k*d - theta*V", {"V": lw.model.LinkState("(-theta*v - V/R)/C", unit="V")})
    patch = link("patch", "beam.mid-beam.root", law, k=10.0, theta=2e-3, R=1e5, C=43e-9)
    subject = structure({}, patch, hosts=[beam])
    shaken: dict[str, Any] = {"forces": {"beam.tip": "0.2*sin(20.7*t)"}, "duration": 4.0, "rate": 1000.0}
    asked: dict[str, Any] = {"sinks": ["patch"], "harvesters": {"patch": "V**2/R"}}
    found = lw.absorb(subject, **shaken, **asked)
    (harvest,) = found.harvests
    voltage = lw.simulate(subject, **shaken, sensors=["state:patch.V"]).channel("state:patch.V")
    assert harvest.energy == pytest.approx(np.trapezoid(voltage**2 / 1e5, dx=1e-3), rel=1e-9)
    left = 0.5 * 43e-9 * voltage[-1] ** 2  # in the capacitor
    taken = found.with_sinks.share("patch") * found.with_sinks.total
    assert taken == pytest.approx(harvest.energy + left, rel=(2 * 21 / 1000) ** 2)  # trapezoidal rule
    loads = lw.absorption.absorption_map(subject, {"patch.R": [1e4, 1e6, 1e8]}, **shaken, **asked)
    assert loads.best("power:patch") == {"patch.R": 1e6}  # 1/(w C) = 1.1e6


def test_a_link_of_a_point_to_the_ground_is_a_sink_without_a_mass() -> None:
    beam = host("beam", [5.2], 0.01, {"tip": [1.0]})
    stop = link("stop", "beam.tip-ground", "c*v", c=1.0)
    subject = structure({}, stop, hosts=[beam])
    found = lw.absorb(subject, sinks=["stop"], duration=4.0, release={"v:beam.mode1": 1.0})
    assert found.sinks[0].sink == lw.absorption.Sink("stop", None, "ground")
    w, zeta = 2.0 * np.pi * 5.2, 0.01
    # both dampers act on one speed
    assert found.sinks_share / found.with_sinks.share("beam") == pytest.approx(
        1.0 / (2.0 * zeta * w), rel=1e-9
    )
    assert "RMS of the points is" in str(found) and present(found.rms_reduction) > 0.1


def test_what_cannot_be_told_on_a_host_is_refused() -> None:
    locked = r"linked to the point frame\.m2: locked, it would change the modes"
    with pytest.raises(lw.StructureError, match=locked):
        lw.absorb(on_host(), **TAP, without="locked")
    plain = with_links(on_host(), link("sink", "ball-frame.m2", "k*d", k=10.0))
    with pytest.raises(lw.StructureError, match=r"no sink to be found; name the sinks among the links sink$"):
        lw.absorb(plain, **TAP)
    with pytest.raises(lw.SimulationError, match=r"release x:frame\.m1 is that of a point"):
        lw.absorb(on_host(), duration=1.0, release={"x:frame.m1": 0.1})


def test_a_state_of_a_removed_sink_is_released_with_it_alone() -> None:
    """The run without sinks has no such state; it failed."""
    law = lw.Law.parse("k*d + F*z", {"z": "v/x0"})
    creep = link("sink", "m2-m1", law, k=40.0, F=1.0, x0=0.01)
    subject = structure({"m1": 1.0, "m2": 0.1}, link("s", "m1-ground", "k*d + c*v", k=900.0, c=1.0), creep)
    found = lw.absorb(subject, duration=1.0, sinks=["sink"], release={"v:m1": 1.0, "state:sink.z": 0.2})
    assert found.without.total == pytest.approx(0.5, rel=1e-12)


PIEZO = {"k": 40.0, "c": 0.4, "theta": 2e-3, "R": 1e5, "C": 43e-9}
RELEASE: dict[str, Any] = {"duration": 2.0, "release": {"v:m1": 1.0}, "sinks": ["piezo"]}


def tower(law: str = "k*d + c*v - theta*V", **changes: float) -> lw.Structure:
    """A mass on a spring that carries a small one on a piezo with a resistor."""
    host = link("tower", "m1-ground", "k*d + c*v", k=3000.0, c=1.0)
    state = lw.model.LinkState("(-theta*v - V/R)/C", unit="V")
    piezo = link("piezo", "m2-m1", law, {"V": state}, **(PIEZO | changes))
    return structure({"m1": 1.0, "m2": 0.05}, host, piezo)


def test_the_damper_the_resistor_and_the_capacitor_share_what_the_link_takes() -> None:
    """Work on the link less its spring's: c v^2 and V^2/R are dissipated, C V^2/2 stays in the capacitor."""
    structure = tower()
    by_power = {
        power: lw.absorb(structure, **RELEASE, rate=2000.0, harvesters={"piezo": power})
        for power in ("c*v**2", "V**2/R")
    }
    energies = [absorption.harvests[0].energy for absorption in by_power.values()]
    run = by_power["V**2/R"].with_sinks
    record = lw.simulate(structure, duration=2.0, rate=2000.0, release={"v:m1": 1.0}, sensors=["state"])
    stored = 0.5 * PIEZO["C"] * record.channel("state:piezo.V")[-1] ** 2
    # trapezoidal rule over a decaying oscillation: (2 w h)^2/12 of a term at its ends, w = 60 rad/s, h = 0.5 ms
    assert sum(energies) + stored == pytest.approx(
        run.share("piezo") * run.total, rel=(2 * 60 * 5e-4) ** 2 / 12
    )
    assert energies[1] > 0.1 * energies[0]  # it is a harvester


@pytest.mark.parametrize(
    ("harvesters", "message"),
    [
        ({"piezo": "V**2*R"}, r"'V\*\*2\*R' is not a power in W, with V in V, R in ohm"),
        ({"piezo": "V**2/Q"}, r"contains 'Q'; choose from d, v, V, k, c, theta, R, C"),
        ({"piezo": "V**/R"}, "is not a power"),
        ({"pie": "V**2/R"}, 'unknown link "pie"; did you mean "piezo"'),
        ({"piezo": -0.1}, "the damping of a harvester must be positive"),
        # a nan beside "can be trusted" before; V is 0/0 at the start in the second
        ({"piezo": "V**2/(R - R)"}, r"harvester on piezo: its power .* is not a finite number at 0 s"),
        ({"piezo": "V**2/R*abs(V)/abs(V)"}, r"harvester on piezo: its power .* is not a finite number at 0 s"),
    ],
)  # fmt: skip
def test_what_is_no_harvester_is_refused(harvesters: dict[str, float | str], message: str) -> None:
    numbers = "finite" in message
    with pytest.raises(lw.SimulationError if numbers else lw.StructureError, match=message):
        lw.absorb(tower(), **RELEASE, harvesters=harvesters)


@pytest.mark.parametrize("power", ["2", "-V**2/R", "20*V**2/R"])
def test_a_link_that_delivers_more_than_it_takes_is_not_trusted(power: str) -> None:
    found = lw.absorb(tower(), **RELEASE, harvesters={"piezo": power})
    assert not found.trusted
    assert any(f"{power} would deliver" in finding for finding in found.findings)
    assert lw.absorb(tower(), **RELEASE, harvesters={"piezo": "V**2/R"}).trusted


# --- rest and modes at states of 0


def test_equilibria_and_modes_are_those_in_a_short_circuit() -> None:
    still = oscillator("k*d + c*v", k=40.0, c=0.4)
    piezo = harvester(1.0, "ground", "piezo", **PIEZO)
    assert [point.x.tolist() for point in lw.analysis.equilibria(piezo).stable] == [[0.0]]
    np.testing.assert_allclose(
        lw.analysis.modes(piezo).frequencies, lw.analysis.modes(still).frequencies, rtol=1e-12
    )
    open_circuit = np.sqrt((40.0 + PIEZO["theta"] ** 2 / PIEZO["C"]) / still.mass_values[0]) / (2.0 * np.pi)
    assert natural_frequencies(piezo)[0] == pytest.approx(open_circuit, rel=1e-12)


def test_a_state_that_does_not_rest_is_refused() -> None:
    creep = lw.Law.parse("k*(d - z)", {"z": "r*(d - z)"})
    creeping, sink = (
        link(name, ends, creep, k=40.0, r=2.0) for name, ends in (("creep", "m1-ground"), ("sink", "m2-m1"))
    )
    resting = "the state z does not rest at 0 while the ends of the link are at rest"
    with pytest.raises(lw.StructureError, match=resting):
        lw.analysis.equilibria(structure({"m1": 1.0}, creeping))
    two = structure({"m1": 1.0, "m2": 0.1}, creeping, sink)
    with pytest.raises(lw.StructureError, match="does not rest at 0"):
        lw.absorb(two, duration=1.0, release={"v:m1": 1.0}, sinks=["sink"])
