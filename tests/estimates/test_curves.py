"""Curves of forces over the motion: along it, over elongations, around loops, by harmonics, and what a fit leaves."""

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from rigs import BOUC_WEN, measured, rig
from structures import hysteretic_oscillator, link, named, structure, with_links

import linkwise as lw
from linkwise.estimates import equivalent
from linkwise.estimates.curves import MeanResiduals, force_curve, force_loop, has_loop
from linkwise.estimates.link_estimate import LinkEstimate
from linkwise.plot.links import loop_figure


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


def test_curve_of_a_measured_record_has_what_was_measured(unseen: lw.Estimate, chain: lw.Structure) -> None:
    curve = force_curve(unseen, "nes1")
    assert curve.true is None and not curve.samples_are_true
    assert len(curve.sample_force) == len(curve.sample_d) > 0
    assert force_curve(unseen, "nes1", chain).true is not None
    blind = replace(unseen, compute_motion=lambda: replace(unseen.motion, compute_residual=lambda: None))
    assert len(force_curve(blind, "nes1").sample_d) == 0


def test_a_link_that_the_simulated_structure_lacks_has_no_true_curve(fitted: lw.Estimate) -> None:
    """Of a record of a structure whose links have other names, and another order."""
    truth = present(fitted.record.simulated)
    renamed = [replace(link, name="other") if link.name == "nes1" else link for link in truth.structure.links]
    other = replace(truth, structure=replace(truth.structure, links=tuple(reversed(renamed))))
    shown = replace(fitted, record=replace(fitted.record, simulated=other))
    curve = force_curve(shown, "nes1")
    assert curve.true is None and not curve.samples_are_true and len(curve.sample_d)
    known, same = force_curve(fitted, "spring1"), force_curve(shown, "spring1")
    assert np.array_equal(known.sample_d, same.sample_d)
    assert np.array_equal(known.sample_force, same.sample_force)


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


@pytest.fixture(scope="module")
def damped() -> lw.Estimate:
    structure = rig("k*d + c*v", {"k": 2000.0, "c": 50.0})
    record = lw.simulate(structure, duration=10.0, rate=200.0, base="0.01*sin(5*t)")
    return lw.identify(measured(record, 1), structure.unknown("damper"))


def test_a_viscous_damper_dissipates_pi_c_omega_squared_amplitude_a_cycle(damped: lw.Estimate) -> None:
    loop = force_loop(damped, "damper")
    assert loop.cycles == 6  # of 10 s at 5 rad/s, from the first rise through 0 that was seen from below
    c = damped.coefficient("damper.c").value
    assert loop.energy == pytest.approx(np.pi * c * 5.0 * 0.01**2, rel=0.01)  # cycles end at samples, of 251
    assert "energy dissipated a cycle" in loop.energy_text


@pytest.mark.slow
def test_a_link_with_memory_between_masses_has_a_loop_with_its_states() -> None:
    structure = hysteretic_oscillator(**BOUC_WEN)
    forces = {"m1": "150*sin(40*t) + 60*sin(97*t)"}
    exact = lw.simulate(structure, duration=1.0, rate=500.0, sensors=["x", "f"], forces=forces)
    record = exact.select(["x:m1", "force:m1"]).with_noise(50.0, seed=1)
    fit = lw.identify(record, structure.unknown("joint.F"))
    loop = force_loop(fit, "joint")
    assert loop.measured is None and has_loop(fit, "joint")
    force = exact.channel("f:joint")
    # noise of 0.3 % moves the orbit
    assert np.sqrt(np.mean((loop.identified - force) ** 2)) < 0.05 * np.std(force)
    record = chain_record(2, duration=1.0, rate=500.0).with_noise(40.0, seed=1)
    fit = lw.identify(record, lw.bnes_chain(2).unknown("nes"), method="weak")
    assert not has_loop(fit, "nes1")


def test_the_figure_draws_what_was_measured_and_identified(damped: lw.Estimate) -> None:
    panels = loop_figure(damped, "damper").axes
    assert [panel.get_xlabel() for panel in panels] == ["elongation d, mm", "rate v, mm/s"]
    for panel in panels:
        assert [line.get_label() for line in panel.get_lines()] == ["measured", "identified"]
    with pytest.raises(lw.StructureError, match='a loop is drawn over "d" or "v", got "a"'):
        lw.plot.loop(damped, "damper", over="a")


AMPLITUDES = np.array([0.001, 0.01, 0.05])
FREQUENCY = 7.0
OMEGA = 2.0 * np.pi * FREQUENCY


def link_estimate(
    law: str, covariance: np.ndarray | None = None, free: tuple[str, ...] = (), **values: float
) -> LinkEstimate:
    subject = link("link", "m1-ground", law, **values)
    return LinkEstimate(subject, (), (-0.05, 0.05), (-1.0, 1.0), free, covariance, 1.0)


def test_linear_links_powers_and_quadratic_damping_have_their_closed_forms() -> None:
    answer = equivalent(link_estimate("k*d + c*v", k=300.0, c=2.0), AMPLITUDES, FREQUENCY)
    np.testing.assert_allclose(answer.stiffness, 300.0, rtol=1e-12)
    np.testing.assert_allclose(answer.damping, 2.0, rtol=1e-12)
    powers = link_estimate("k*d + k3*d**3 + c3*v*d**2", k=300.0, k3=1e5, c3=50.0)
    answer = equivalent(powers, AMPLITUDES, FREQUENCY)
    np.testing.assert_allclose(answer.stiffness, 300.0 + 0.75e5 * AMPLITUDES**2, rtol=1e-12)
    rounding = 1e-12 * 300.0 / OMEGA  # of the spring, which the integral takes out
    np.testing.assert_allclose(answer.damping, 50.0 * AMPLITUDES**2 / 4.0, rtol=1e-12, atol=rounding)
    assert equivalent(link_estimate("c2*v", c2=3.0), [], FREQUENCY).stiffness_band.shape == (0, 2)
    answer = equivalent(link_estimate("c2*v*abs(v)", c2=3.0), AMPLITUDES, FREQUENCY)
    quadratic = 8.0 / (3.0 * np.pi) * 3.0 * OMEGA * AMPLITUDES
    np.testing.assert_allclose(answer.damping, quadratic, rtol=1e-4)  # kink of abs
    # identity: rounding of a force of c2 omega^2
    np.testing.assert_allclose(answer.stiffness, 0.0, atol=1e-12 * OMEGA**2)


def test_the_band_is_that_of_the_coefficients_and_none_without_a_covariance() -> None:
    spring = link_estimate("k*d + c*v", np.diag([4.0, 0.01]), ("k", "c"), k=300.0, c=2.0)
    answer = equivalent(spring, AMPLITUDES, FREQUENCY)
    # the quantile is written with seven digits
    np.testing.assert_allclose(answer.stiffness_band[:, 1] - 300.0, 1.959964 * 2.0, rtol=1e-6)
    np.testing.assert_allclose(answer.damping_band[:, 1] - 2.0, 1.959964 * 0.1, rtol=1e-6)
    answer = equivalent(link_estimate("k*d", None, ("k",), k=300.0), 0.01, FREQUENCY)
    assert np.isnan(answer.damping_band).all()
    assert answer.stiffness == pytest.approx(300.0)


@pytest.fixture(scope="module")
def quiet() -> lw.Record:
    return chain_record(2, duration=2.0)


def test_measured_force_is_the_true_one_even_where_the_law_is_wrong(quiet: lw.Record) -> None:
    chain = lw.bnes_chain(2)
    sink = chain.link("nes1")
    wrong = with_links(chain, link("nes1", "m2-m1", "k*d + c*v"))
    motion = lw.identify(quiet, wrong, method="weak").motion
    assert motion.force is not None
    true = sink.force(motion.d[:, 1], motion.v[:, 1])
    force = motion.structure.link("nes1").force(motion.d[:, 1], motion.v[:, 1])
    missed = np.sqrt(np.mean((force - true) ** 2) / np.var(true))
    left = np.sqrt(np.mean((motion.force[:, 1] - true) ** 2) / np.var(true))
    assert missed > 0.3  # a straight line through a cubic
    assert left < 0.5 * missed  # the curvature of both laws within one window is all that is lost


def test_a_trend_is_shown_where_it_is_missing_samples_are_left_out_and_few_are_one_part() -> None:
    motion = np.linspace(-2.0, 2.0, 4001)
    means = MeanResiduals.along(motion, 3.0 * motion)
    np.testing.assert_allclose(means.mean, 3.0 * means.place, rtol=0, atol=1e-12)
    assert len(means.place) == 24 and means.by_chance[0] == 2.0 / np.sqrt(167)
    motion = np.arange(30.0)
    residuals = np.where(motion < 10.0, np.nan, 1.0)
    means = MeanResiduals.along(motion, residuals)
    assert (means.place.tolist(), means.mean.tolist()) == ([19.5], [1.0])
    assert np.isnan(MeanResiduals.along(motion, np.full(30, np.nan)).mean).all()
