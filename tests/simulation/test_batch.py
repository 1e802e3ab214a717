"""Runs side by side are the runs one by one: motion, energies, crossings; lanes that fail do not touch the others."""

import numpy as np
import pytest
from present import some
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.absorption.wells import crossings, distinct
from linkwise.model.excitation import Excitation
from linkwise.simulation.batch import LANES, BatchResult, SimulatedMotion, can_batch, run_batch
from linkwise.simulation.run import RunSchedule

TIMES = np.arange(501) / 1000.0
RELEASE = Excitation.of(release={"v:m1": 1.0})
TOPS = [np.zeros((LANES, 0)), np.zeros((LANES, 1))]


def schedules(betas: list[float], excitation: Excitation = RELEASE) -> list[RunSchedule]:
    return [RunSchedule(lw.bnes_chain(2, beta=beta), excitation, TIMES) for beta in betas]


def tops(runs: int) -> list[np.ndarray]:
    return [top[:runs] for top in TOPS]


def agree(batch: BatchResult, run: int, schedule: RunSchedule) -> None:
    """Double precision throughout against the first steps in 80 bits: same numerics, before chaos multiplies it."""
    motion = SimulatedMotion.of(schedule)
    energy, size = motion.energy, np.abs(motion.displacement).max()
    np.testing.assert_allclose(batch.x[..., run], motion.displacement, rtol=0.0, atol=1e-8 * size)
    fastest = np.abs(motion.velocity).max()
    np.testing.assert_allclose(batch.v[..., run], motion.velocity, rtol=0.0, atol=1e-8 * fastest)
    put_in = energy.supplied - energy.supplied[0]  # released with energy that no work was done for
    scale = np.abs(energy.supplied).max()
    np.testing.assert_allclose(batch.dissipated[..., run], energy.dissipated, rtol=0.0, atol=1e-8 * scale)
    np.testing.assert_allclose(batch.work[:, run], put_in, rtol=0.0, atol=1e-8 * scale)
    times = distinct(batch.crossings[run][1], 0.5)
    expected = crossings(schedule, motion.run, [np.empty(0), np.zeros(1)])[1]
    np.testing.assert_allclose(times, expected, atol=1e-8)
    assert len(times) > 3  # or the line above would compare nothing


@pytest.mark.parametrize("betas", [[1e6, 3e5, 5e5, 2e6], [8e5]])
def test_free_decays(betas: list[float]) -> None:
    fleet = schedules(betas)
    batch = run_batch(fleet, tops(len(betas)))
    assert batch.completed.all()
    for run, schedule in enumerate(fleet):
        agree(batch, run, schedule)


def test_blows_samples_and_functions_of_time_do_work() -> None:
    samples = lw.model.Sampled(0.0, 500.0, np.random.default_rng(1000).standard_normal(600))
    blows = ("m1", 0.5, 0.25), ("m2", 0.01, 0.2555), ("m1", 0.3, 0.0)
    impulses = tuple(lw.model.Impulse(*blow) for blow in blows)
    excitation = Excitation.of(forces={"m1": samples, "m2": "0.1*sin(30*t)"}, impulses=impulses)
    fleet = schedules([1e6, 7e5], excitation)
    batch = run_batch(fleet, tops(2))
    for run, schedule in some(enumerate(fleet)):
        motion = SimulatedMotion.of(schedule)
        put_in = motion.energy.supplied
        np.testing.assert_allclose(batch.work[:, run], put_in, rtol=0.0, atol=1e-8 * put_in.max())
        apart = np.abs(batch.x[..., run] - motion.displacement).max()
        assert apart < 1e-8 * np.abs(motion.displacement).max()


def test_a_moving_base_does_work() -> None:
    spring = link("a", "m1-base", "k*d + c*v", k=900.0, c=0.5)
    sink = link("s", "m2-m1", "p*d + q*d**3 + c*v", p=-10.0, q=1e5, c=0.01)
    anchored = structure({"m1": 1.0, "m2": 0.02}, spring, sink)
    schedule = RunSchedule(anchored, Excitation.of(base="0.02*sin(28*t)"), TIMES)
    batch = run_batch([schedule], tops(1))
    agree(batch, 0, schedule)


def test_a_lane_that_diverges_leaves_the_others_alone() -> None:
    fleet = schedules([1e6, -1e6, 7e5, -2e6])
    batch = run_batch(fleet, tops(4))
    assert batch.completed.tolist() == [True, False, True, False]
    assert np.isnan(batch.x[..., 1]).all() and not len(batch.crossings[1][1])
    for run in (0, 2):
        agree(batch, run, fleet[run])
    assert not run_batch(schedules([-1e6, -1e6]), tops(2)).completed.any()


def test_only_smooth_laws_can_fly() -> None:
    rubbing = oscillator("k*d + F*sign(v)", k=9.0, F=1.0)
    assert not can_batch(RunSchedule(rubbing, RELEASE, TIMES)) and can_batch(schedules([1e6])[0])
