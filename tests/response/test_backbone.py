"""Backbones, basins of rest positions, and measured points on curves of response."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal
from scipy.integrate import quad
from scipy.special import ellipk
from structures import HARDENING, oscillator, row_of_masses

import linkwise as lw
from linkwise.analysis.linear_modes import modes
from linkwise.model.coefficient import Name
from linkwise.response import basins

K, K3 = 400.0, 1e5


def test_frequencies_of_a_duffing_oscillator_are_those_of_its_exact_period() -> None:
    curve = lw.backbone(oscillator(HARDENING, k=K, k3=K3, c=0.4), 1, to_amplitude={"x:m1": 0.5})
    amplitude = curve.amplitude[:, 0]
    stiff = K + K3 * amplitude**2
    period = 4.0 / np.sqrt(stiff) * ellipk(0.5 * K3 * amplitude**2 / stiff)
    np.testing.assert_allclose(curve.hz, 1.0 / period, rtol=1e-8)
    np.testing.assert_allclose(curve.energy, 0.5 * K * amplitude**2 + 0.25 * K3 * amplitude**4, rtol=1e-8)
    assert amplitude[-1] == pytest.approx(0.5, rel=1e-8)
    for x, stiff, energy, damping in zip(
        amplitude, K + K3 * amplitude**2, curve.energy, curve.damping, strict=True
    ):
        # the integral of v over the way from 0 to the amplitude, v by the balance of energy; x = amplitude*sin(angle)
        speed = quad(
            lambda a, x=x, stiff=stiff: np.cos(a) ** 2 * np.sqrt(stiff - 0.5 * K3 * (x * np.cos(a)) ** 2),
            0,
            np.pi / 2,
        )
        assert damping == pytest.approx(0.4 * 4.0 * x**2 * speed[0] / (4.0 * np.pi * energy), rel=1e-8)


def test_a_mode_of_a_chain_is_periodic_in_a_simulation_without_damping() -> None:
    laws = {"k": K, "k3": K3, "c": 2.0}, {"k": 300.0, "k3": 4e5, "c": 1.0}
    chain = row_of_masses([1.0, 0.5], first=(HARDENING, laws[0]), second=(HARDENING, laws[1]))
    curve = lw.backbone(chain, 2, to_energy=0.3)
    assert curve.energy[-1] == pytest.approx(0.3, rel=1e-6)
    assert curve.hz[0] == pytest.approx(lw.analysis.modes(chain).frequencies[1], rel=1e-4)
    undamped, hz = chain.with_values({"first.c": 0.0, "second.c": 0.0}), curve.hz[-1]
    release = dict(zip(curve.channels, curve.starts[-1].tolist(), strict=True))
    record = lw.simulate(undamped, release=release, duration=1.0 / hz, rate=64.0 * hz)
    np.testing.assert_allclose(record.values[-1], curve.starts[-1], rtol=1e-9)
    np.testing.assert_allclose(0.5 * np.ptp(record.values, axis=0), curve.amplitude[-1], rtol=1e-3)


def test_phase_resonance_is_where_motion_follows_a_force_by_a_quarter() -> None:
    """Of two masses with cubic springs, by harmonic balance; `respond` follows the same force by shooting."""
    laws = {"k": K, "k3": K3, "c": 2.0}, {"k": 300.0, "k3": 4e5, "c": 1.0}
    chain = row_of_masses([1.0, 0.5], first=(HARDENING, laws[0]), second=(HARDENING, laws[1]))
    curve = lw.backbone(chain, 1, to_amplitude={"x:m1": 0.02}, force="m1")
    assert curve.force is not None and "under a force on m1" in str(curve)
    linear = lw.analysis.modes(chain)
    assert curve.damping[0] == pytest.approx(linear.damping[0], rel=0.01)  # of modes that damping couples
    hz, force = float(curve.hz[-1]), float(curve.force[-1])
    response = lw.respond(chain, force={"m1": force}, hz=(hz * (1.0 - 1e-6), hz * (1.0 + 1e-6)), starts=0)
    branches = response.levels[0].branches
    nearest = min(branches, key=lambda branch: abs(branch.amplitude[0, 0] - curve.amplitude[-1, 0]))
    np.testing.assert_allclose(nearest.amplitude[0], curve.amplitude[-1], rtol=1e-4)
    assert np.degrees(np.angle(nearest.first_harmonic[0, 0])) == pytest.approx(-90.0, abs=0.05)


def test_phase_resonance_of_friction_loses_what_the_joint_takes() -> None:
    """A joint that sticks with k + F/x0 and loses nearly 4 F times the amplitude in a cycle far beyond x0."""
    law = lw.Law.parse("k*d + F*z", states={"z": "(v - 0.5*abs(v)*z - 0.5*v*abs(z))/x0"})
    joint = lw.Link("joint", ("m1", "ground"), law, {"k": K, "F": 1.0, "x0": 2e-4})
    subject = lw.Structure("rubbing", (lw.Mass("m1", 1.0),), (joint,))
    curve = lw.backbone(subject, 1, to_amplitude={"x:m1": 0.02}, force="m1")
    assert curve.hz[0] == pytest.approx(np.sqrt(K + 1.0 / 2e-4) / (2.0 * np.pi), rel=0.1)
    assert 4.0 * np.pi * curve.damping[-1] * curve.energy[-1] == pytest.approx(4.0 * 0.02, rel=0.03)
    with pytest.raises(lw.StructureError, match=r"has memory .* follow its phase resonance under a force"):
        lw.backbone(subject, 1)
    message = "brings mode 1 into no motion a quarter of a period behind it"
    with pytest.raises(lw.SimulationError, match=message):
        lw.backbone(lw.bnes_chain(2), 1, to_energy=1e-3, force="m1")
    with pytest.raises(lw.SimulationError, match="unknown mass 'm9' in a force"):
        lw.backbone(subject, 1, force="m9")


def test_a_curve_that_ends_too_soon_says_so() -> None:
    """It came back to a small vibration: the headline tells of the largest."""
    curve = lw.backbone(lw.bnes_chain(2), 1, to_amplitude={"x:m1": 0.01})
    assert not curve.reached
    assert "before the end that was asked for" in str(curve)
    largest = curve.amplitude.max(axis=1).argmax()
    assert 0 < largest < len(curve.hz) - 1
    assert f"to {curve.hz[largest]:.5g} Hz at {curve.energy[largest]:.3g} J." in str(curve)


def test_what_has_no_backbone_is_refused() -> None:
    spring = oscillator(HARDENING, k=K, k3=K3, c=0.4)
    message = r"there is no vibration in mode 2; the frequencies of modes 1 to 1 are 3\.183 Hz"
    with pytest.raises(lw.SimulationError, match=message):
        lw.backbone(spring, 2)
    with pytest.raises(lw.SimulationError, match="an amplitude or at an energy; give one"):
        lw.backbone(spring, 1, to_amplitude={"x:m1": 0.1}, to_energy=1.0)
    message = r"the energy at which a backbone ends must be positive, in SI units, got -1\.0"
    with pytest.raises(lw.SimulationError, match=message):
        lw.backbone(spring, 1, to_energy=-1.0)
    with pytest.raises(lw.StructureError, match="is not smooth"):
        lw.backbone(oscillator("k*d + k2*d*abs(d)", k=K, k2=1.0), 1)


def test_a_linear_structure_needs_an_end() -> None:
    """Its curve went on to 1e36 J, as its frequency never changes by a third."""
    spring = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)
    with pytest.raises(lw.SimulationError, match="at any amplitude, so that nothing ends the curve"):
        lw.backbone(spring, 1)
    assert lw.backbone(spring, 1, to_energy=1.0).reached


def test_the_band_of_an_answer_is_that_of_its_frequency() -> None:
    """An answer of which k alone is uncertain: at small amplitudes f has half of its relative error, at large ones less."""
    duffing = oscillator(HARDENING, k=K, k3=K3, c=0.4)
    bounds = np.array([0.0]), np.array([np.inf])
    answer = lw.estimates.Posterior(duffing, (Name("link", "k"),), np.array([[16.0]]), *bounds)
    curve = lw.backbone(answer, 1, to_amplitude={"x:m1": 0.1})
    assert curve.lower is not None and curve.upper is not None
    width = (curve.upper - curve.lower) / curve.hz
    assert width[0] == pytest.approx(2.0 * 1.96 * 0.005, rel=0.01)  # 60 draws in pairs
    assert width[-1] < 0.6 * width[0]
    assert np.all((curve.lower < curve.hz) & (curve.hz < curve.upper))
    assert set(curve.to_dict()["points"][0]) == {
        "hz", "energy", "damping", "lower_hz", "upper_hz", "lower_damping", "upper_damping", "amplitude",
    }  # fmt: skip
    assert "95 % band" in str(curve)


def test_phase_resonance_ends_where_the_structure_feeds_itself() -> None:
    """At a van der Pol oscillation, of amplitude 2 sqrt(0.6/2e4), the force that holds the motion vanishes."""
    fed = oscillator("k*d + c*v + c2*d**2*v", k=900.0, c=-0.6, c2=2e4)
    curve = lw.backbone(fed, 1, to_amplitude={"x:m1": 0.02}, force="m1")
    assert not curve.reached and "by itself, without the force, as a limit cycle" in curve.findings[0]
    assert curve.amplitude[-1, 0] == pytest.approx(2.0 * np.sqrt(0.6 / 2e4), rel=1e-3)


@pytest.mark.parametrize("deviation", [0.04, 0.3])
def test_the_band_of_damping_holds_none_where_the_record_does_not_tell_it(deviation: float) -> None:
    duffing = oscillator(HARDENING, k=K, k3=K3, c=0.4)
    bounds = np.array([-np.inf]), np.array([np.inf])
    answer = lw.estimates.Posterior(duffing, (Name("link", "c"),), np.array([[deviation**2]]), *bounds)
    curve = lw.backbone(answer, 1, to_amplitude={"x:m1": 0.1})
    assert curve.lower_damping is not None and curve.upper_damping is not None
    ends = np.stack([curve.lower_damping, curve.upper_damping]) / curve.damping
    assert ends[:, 0] == pytest.approx(1.0 + 1.96 * np.array([-1.0, 1.0]) * deviation / 0.4, rel=1e-6)
    low, high = curve.plot().axes[-1].get_ylim()
    assert low <= 100.0 * min(0.0, curve.lower_damping.min()) and high >= 100.0 * curve.upper_damping.max()
    along = np.abs(ends - ends[:, :1]) / (1.96 * deviation / 0.4)
    assert along.max() < 0.05  # linear between twelve stations, the damping ratio falling to half


def test_the_band_of_a_curve_that_comes_back_has_two_frequencies_at_an_energy() -> None:
    """From a well to the barrier and back; each way its own motions count."""
    chain = lw.bnes_chain(2)
    bounds = np.array([-np.inf]), np.array([np.inf])
    answer = lw.estimates.Posterior(chain, (Name("nes1", "alpha"),), np.array([[0.01]]), *bounds)
    curve = lw.backbone(answer, 1, to_amplitude={"x:m1": 0.01})
    assert curve.lower is not None and curve.upper is not None
    width = (curve.upper - curve.lower) / curve.hz
    assert np.diff(curve.energy).min() < 0.0 and np.all((curve.lower <= curve.hz) & (curve.hz <= curve.upper))
    low, high = (modes(chain.with_values({"nes1.alpha": a})).frequencies[0] for a in (-99.9, -100.1))
    assert width[0] == pytest.approx(1.96 * (high - low) / curve.hz[0], rel=0.02)  # 60 draws in pairs
    assert width[-1] == pytest.approx(width[0], rel=0.02) and width.max() < 10.0 * width[0]


PLANE = {"x:m1": (-0.025, 0.02), "v:m1": (-0.6, 0.5)}
DOUBLE_WELL = oscillator("alpha*d + beta*d**3 + c*v", mass=0.1, alpha=-100.0, beta=1e6, c=0.3)


def test_motions_end_where_simulations_end() -> None:
    found = basins(DOUBLE_WELL, PLANE, points=5)
    for row, x in enumerate(found.values[0].tolist()):
        for column, v in enumerate(found.values[1].tolist()):
            run = lw.simulate(DOUBLE_WELL, release={"x:m1": x, "v:m1": v}, duration=10.0, rate=100.0)
            rest = float(found.rests[found.ends[row, column], 0])
            assert run.values[-1, 0] == pytest.approx(rest, abs=1e-3)
    assert sorted(found.rests[:, 0].tolist()) == pytest.approx([-0.01, 0.01])
    assert found.shares.sum() == 1.0


def test_what_is_no_plane_is_refused() -> None:
    message = "need two states and at least 2 values of each, got 1 and 31"
    with pytest.raises(lw.SimulationError, match=message):
        basins(DOUBLE_WELL, {"x:m1": (0.0, 1.0)})
    with pytest.raises(lw.StructureError, match="no stable equilibrium was found"):
        basins(oscillator("k*d", k=-1.0), PLANE)


SPRING = oscillator(HARDENING, name="spring", k=400.0, k3=1e5, c=0.8)
DRIVEN: dict[str, Any] = {"force": {"m1": 1.0}, "hz": (2.0, 4.5), "starts": 0}


@pytest.fixture(scope="module")
def sweep() -> lw.Record:
    """From 2.2 to 3.1 Hz, with the accelerometer's noise of 0.05 m/s2."""
    force = "1.0*cos(2*pi*(2.2 + 0.0075*t)*t)"
    record = lw.simulate(SPRING, forces={"m1": force}, duration=60.0, rate=60.0, sensors=["a:m1"])
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(record))
    values = record.values + noise[:, None] * [name == "a:m1" for name in record.channels]
    return lw.Record(record.start, record.rate, record.channels, values)


def test_points_of_a_sweep_lie_on_the_curve(sweep: lw.Record) -> None:
    """By an acceleration, of which the displacement is shown; a slow sweep is behind by less than 2 %."""
    response = lw.respond(SPRING, **DRIVEN).beside(sweep)
    [branch], measured = response.levels[0].branches, response.measured
    assert measured is not None and len(measured.hz) > 10
    assert measured.size == pytest.approx(1.0, rel=1e-3)
    lower = slice(0, int(np.argmax(branch.amplitude[:, 0])))  # to the peak
    expected = np.interp(measured.hz, branch.hz[lower], branch.amplitude[lower, 0])
    early = measured.hz < 2.8
    assert early.sum() > 5 and measured.amplitude[early, 0] == pytest.approx(expected[early], rel=0.03)
    assert response.to_dict()["measured"][0]["amplitude"]["x:m1"] == measured.amplitude[0, 0]
    axes = lw.plot.response(response)
    assert "measured" in axes.get_legend_handles_labels()[1]


def test_a_decay_lies_on_the_backbone() -> None:
    record = lw.simulate(SPRING, release={"x:m1": 0.05}, duration=16.0, rate=60.0).with_noise(50.0, seed=1)
    curve = lw.backbone(SPRING, 1, to_amplitude={"x:m1": 0.06}).beside(record)
    measured = curve.measured
    assert measured is not None and np.ptp(measured.hz) > 0.02
    expected = np.interp(measured.amplitude[:, 0], curve.amplitude[:, 0], curve.hz)
    assert measured.hz == pytest.approx(expected, rel=0.01)
    assert set(curve.to_dict()["measured"][0]) == {"hz", "amplitude"}


def test_records_that_show_no_points_are_refused(sweep: lw.Record, tmp_path: Path) -> None:
    lw.write_structure(SPRING, tmp_path / "spring.toml")
    lw.write_record(sweep, tmp_path / "sweep.csv")
    lw.write_record(sweep.select(["a:m1"]), tmp_path / "alone.csv")
    lw.write_record(sweep.select(["force:m1"]), tmp_path / "force.csv")
    lw.write_record(sweep[:200], tmp_path / "short.csv")
    line = f"respond {tmp_path}/spring.toml --force m1=1 --from 2.2 --to 2.4 --starts 0 --record {tmp_path}"
    assert len(document(f"{line}/sweep.csv")["measured"]) > 10
    assert "need the excitation, force:m1" in refusal(f"{line}/alone.csv")
    assert "none of x:m1 was measured" in refusal(f"{line}/force.csv")
    assert "no 8 steady cycles in a row" in refusal(f"{line}/short.csv")
    mode = f"backbone {tmp_path}/spring.toml --mode 1 --to-energy 0.01 --levels {tmp_path}"
    assert "no mode rings down" in refusal(f"{mode}/sweep.csv")
    values = sweep.values.copy()
    values[400:420] = np.nan
    lw.write_record(replace(sweep, values=values), tmp_path / "gap.csv")  # of the force too
    assert "no mode rings down" in refusal(f"{mode}/gap.csv")
