"""States to start from where smoothing tells them badly, and searches that end before they converge."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.held_laws import states_by_held_laws, within_reach
from linkwise.likelihood.problem import ShootingProblem, shooting_problem
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.anneal import Annealer
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.progress import silent

PER_PERIOD = 5.5


@pytest.fixture(scope="module")
def softening() -> lw.Structure:
    """One mass whose spring lets go beyond 1/sqrt(300) = 58 mm."""
    return oscillator("k*d + k3*d**3 + c*v", name="spring", k=1e4, k3=-3e6, c=0.5)


@pytest.fixture(scope="module")
def problem(softening: lw.Structure) -> ShootingProblem:
    """At the true coefficients, from the states that smoothing gives."""
    rate = PER_PERIOD * float(np.max(lw.analysis.modes(softening).frequencies))
    record = lw.simulate(softening, release={"v:m1": 1.5}, duration=1000 / rate, rate=rate)
    record = record.with_noise(40.0, seed=1)
    unknown = softening.unknown("all")
    theta = np.array([softening.coefficient(p.name).value for p in unknown.parameters], dtype=float)
    return shooting_problem([record], unknown, theta, 0.01 * np.abs(theta), SensorModel.of([record], (), ()))


def cost_per_sample(problem: ShootingProblem, q: float) -> float:
    misfit = evaluate(problem.segments, problem.start, problem.scales, Gaussian())
    return misfit.cost(q) / int(problem.segments.observed.sum())


def with_fitted_states(problem: ShootingProblem) -> ShootingProblem:
    with ThreadPoolExecutor(1) as executor:
        annealer = Annealer(executor, Gaussian(), silent)
        start = within_reach(problem.segments, problem.start, problem.scales, Gaussian())
        start = states_by_held_laws(problem.segments, start, problem.scales, annealer)
    return replace(problem, start=start)


def disturbed(problem: ShootingProblem, size: float) -> ShootingProblem:
    """The same start with velocities multiplied by `size` in every tenth segment."""
    nodes = problem.start.nodes.copy()
    nodes[len(nodes) // 2 :, ::10] *= size  # velocities
    return replace(problem, start=replace(problem.start, nodes=nodes))


@pytest.mark.parametrize("size", [1.3, 30.0], ids=["far from the record", "runs to infinity"])
def test_states_become_a_motion_of_the_laws(problem: ShootingProblem, size: float) -> None:
    rough = disturbed(problem, size)
    # noise alone costs 1; twice that much more is no motion of the laws
    assert not cost_per_sample(rough, 1.0) < 3.0
    assert np.isfinite(cost_per_sample(rough, 1.0)) == (size < 2.0)
    better = with_fitted_states(rough)
    # noise of the samples is 1, and defects of true laws at q = 0.1 are far below it
    assert cost_per_sample(better, 0.1) == pytest.approx(1.0, abs=0.2)
    assert np.array_equal(better.start.theta, rough.start.theta)


def test_a_flow_that_runs_away_behind_the_last_sample_is_seen(problem: ShootingProblem) -> None:
    """With a spring that lets go much earlier some segments stay near their samples, and end far away from the next one."""
    theta = problem.start.theta.copy()
    theta[1] *= 19.4
    wild = replace(problem, start=replace(problem.start, theta=theta))
    before, after = wild.start, within_reach(wild.segments, wild.start, wild.scales, Gaussian())
    ends = [
        np.sum(evaluate(wild.segments, point, wild.scales, Gaussian()).defects ** 2, axis=0)
        for point in (before, after)
    ]
    largest = np.sum(np.max((after.nodes / wild.scales.state[:, None]) ** 2, axis=1))
    assert np.nanmax(ends[0]) > 1e20 and np.max(ends[1]) <= 4.0 * largest  # of twice the largest state


def test_states_that_are_a_motion_stay(problem: ShootingProblem) -> None:
    good = with_fitted_states(disturbed(problem, 1.3))
    assert np.array_equal(with_fitted_states(good).start.nodes, good.start.nodes)


def test_states_stay_where_the_flow_runs_away_from_many(problem: ShootingProblem) -> None:
    nodes = 30.0 * problem.start.nodes
    wild = replace(problem.start, nodes=nodes)
    assert within_reach(problem.segments, wild, problem.scales, Gaussian()) is wild


@pytest.mark.parametrize("release", [2.5, 3.0])
def test_a_state_that_runs_to_infinity_is_no_reason_to_refuse(
    softening: lw.Structure, release: float
) -> None:
    """A record of few samples a period, whose smoothed states pass the barrier: the laws themselves are right."""
    rate = PER_PERIOD * float(np.max(lw.analysis.modes(softening).frequencies))
    clean = lw.simulate(softening, release={"v:m1": release}, duration=1000 / rate, rate=rate)
    fit = lw.identify(clean.with_noise(15.0, seed=3), softening.unknown("all"))
    assert lw.Verdict.NOT_CONVERGED not in fit.verdicts
    true = np.array([softening.coefficient(p.name).value for p in fit.parameters], dtype=float)
    assert np.abs((fit.values - true) / np.sqrt(fit.covariance.diagonal())).max() < 4.0
