"""The curve of a link's force: it covers what the record visited and knows no more than the record does."""

from dataclasses import replace

import numpy as np
import pytest
from structures import named, structure

import linkwise as lw
from linkwise.estimates.curves import force_curve


@pytest.fixture
def measured(fitted: lw.Estimate) -> lw.Estimate:
    """The same estimate as if its record had been measured: nobody knows the truth."""
    return replace(fitted, record=replace(fitted.record, simulated=None))


def test_curve_covers_the_visited_range_and_its_band_holds_the_curve(fitted: lw.Estimate) -> None:
    curve = force_curve(fitted, "nes1")
    assert curve.d[0] < curve.visited[0] < curve.visited[1] < curve.d[-1]
    assert np.all(curve.lower <= curve.force) and np.all(curve.force <= curve.upper)
    np.testing.assert_array_equal(curve.force, fitted.structure.link("nes1").force(curve.d))
    assert curve.frame[0] < curve.force.min() and curve.force.max() < curve.frame[1]


def test_curve_of_a_simulated_record_has_the_truth(fitted: lw.Estimate, chain: lw.Structure) -> None:
    curve = force_curve(fitted, "nes1")
    assert curve.true is not None and curve.samples_are_true
    np.testing.assert_array_equal(curve.true, chain.link("nes1").force(curve.d))
    # without noise, force less damping lies on the elastic curve but for the error of the identified damping
    damping = fitted.coefficient("nes1.c").value - 0.02
    speed = max(abs(end) for end in fitted.link("nes1").v_range)
    off = np.abs(curve.sample_force - chain.link("nes1").force(curve.sample_d))
    # at most so, a tenth for the speed between two samples
    assert off.max() <= 1.1 * abs(damping) * speed


def test_curve_of_a_measured_record_has_what_was_measured(measured: lw.Estimate, chain: lw.Structure) -> None:
    curve = force_curve(measured, "nes1")
    assert curve.true is None and not curve.samples_are_true
    assert len(curve.sample_force) == len(curve.sample_d) > 0
    assert force_curve(measured, "nes1", chain).true is not None
    blind = replace(measured, compute_motion=lambda: replace(measured.motion, compute_residual=lambda: None))
    assert len(force_curve(blind, "nes1").sample_d) == 0


@pytest.mark.slow
@pytest.mark.parametrize("known_truth", [True, False])
def test_samples_of_a_link_with_memory_are_less_what_its_states_add(known_truth: bool) -> None:
    """A hysteretic damper alone on a rig: its force over the elongation is a loop, its elastic part a line."""
    joint = named("joint", "base-ground", "bouc-wen", k=800.0, c=0.3, F=3.0, s=0.5, x0=0.005)
    rig = structure({}, joint)
    drive = lw.model.TimeFunction("0.01*sin(6*t)*exp(-t/4)")
    clean = lw.simulate(rig, base=drive, duration=6.0, rate=200.0, sensors=("f:joint",))
    record = clean.with_noise(50.0, seed=3)
    estimate = lw.identify(record, rig.unknown("joint.k", "joint.F"))
    shown = estimate if known_truth else replace(estimate, record=replace(record, simulated=None))
    curve = force_curve(shown, "joint")
    off = curve.sample_force - 800.0 * curve.sample_d
    noise = estimate.noise["f:joint"].sigma
    assert len(off) > 1000 and np.sqrt(np.mean(off**2)) < 2.0 * noise  # the loop is 40 times as wide
    loop = clean.channel("f:joint") - 800.0 * clean.channel("x:base")
    assert np.sqrt(np.mean(loop**2)) > 40.0 * noise
