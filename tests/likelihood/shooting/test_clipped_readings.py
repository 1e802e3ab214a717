"""Clipped readings count as censored normal variables: cost, slope and curvature, and the columns of unknowns with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record, truth
from scipy.stats import norm

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.problem import ShootingProblem, shooting_problem
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.clipped_readings import ClippedReadings
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.loss import Gaussian, Student
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate

CHAIN = lw.bnes_chain(2)
GAINED = "x:m2"


def readings(sides: Floats) -> ClippedReadings:
    """Readings at 2 units, and a sample that is none behind them."""
    present = np.append(np.ones(len(sides), dtype=bool), False)[:, None, None]
    return ClippedReadings(present, 2.0 * present, np.append(sides, 0.0)[:, None, None])


def problem() -> ShootingProblem:
    """A record clipped at half of its peaks, with an unknown gain of one sensor."""
    record = chain_record(2).with_noise(20.0, seed=7).between(0.0, 1.0)
    peak = 0.5 * np.max(np.abs(record.values), axis=0)
    record = lw.inspection.mark_missing(
        replace(record, values=np.clip(record.values, -peak, peak), simulated=None)
    )
    asked = CHAIN.unknown("all")
    sensing = SensorModel.of([record], (), (GAINED,))
    return shooting_problem([record], asked, truth(CHAIN, asked), None, sensing)


def test_cost_is_that_of_the_probability_of_a_reading_at_the_bound_or_beyond() -> None:
    sides, motion = np.array([1.0, -1.0, 0.0]), np.array([2.6, 2.4, 1.5, 9.0])
    misfit = readings(sides).misfit(-motion[:, None, None] / 0.5, np.array(0.5))
    log_likelihood = norm.logsf(2.0, 2.6, 0.5) + norm.logcdf(2.0, 2.4, 0.5) - 0.5 * ((2.0 - 1.5) / 0.5) ** 2
    assert misfit.cost == pytest.approx(-2.0 * log_likelihood, rel=1e-12)
    assert misfit.residuals[3, 0, 0] == misfit.roots[3, 0, 0] == misfit.shown[3, 0, 0] == 0.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_residuals_and_weights_are_those_of_slope_and_curvature(side: float) -> None:
    """Against differences, whose error is that of their step of 1e-4."""
    step = 1e-4

    def cost(motion: float) -> float:
        return readings(np.array([side])).misfit(np.full((2, 1, 1), -motion), np.array(1.0)).cost

    places = np.linspace(-4.0, 8.0, 13)
    misfits = [readings(np.array([side])).misfit(np.full((2, 1, 1), -x), np.array(1.0)) for x in places]
    slopes = [(cost(x + step) - cost(x - step)) / (2.0 * step) for x in places]
    curvatures = [(cost(x + step) - 2.0 * cost(x) + cost(x - step)) / step**2 for x in places]
    roots = np.array([misfit.roots[0, 0, 0] for misfit in misfits])
    residuals = np.array([misfit.residuals[0, 0, 0] for misfit in misfits])
    np.testing.assert_allclose(-2.0 * roots**2 * residuals, slopes, atol=1e-5)
    np.testing.assert_allclose(2.0 * roots**2, curvatures, atol=1e-5)


def test_far_from_the_bound_it_counts_as_an_observation_or_for_nothing() -> None:
    inside, beyond = (
        readings(np.array([1.0])).misfit(np.full((2, 1, 1), -x), np.array(1.0)) for x in (-1e7, 1e3)
    )
    assert inside.roots[0, 0, 0] == pytest.approx(1.0, abs=1e-6) and inside.residuals[
        0, 0, 0
    ] == pytest.approx(1e5, rel=1e-4)
    assert beyond.roots[0, 0, 0] == beyond.cost == 0.0 and np.isfinite(beyond.residuals).all()


def test_equations_have_the_slope_of_the_cost_also_of_a_gain() -> None:
    """In single precision, against differences of the cost in the parameters and the gain."""
    given = problem()
    point = replace(given.start, gains=np.array([1.03]))
    misfit = evaluate(given.segments, point, given.scales, Gaussian())
    assert misfit.clipped is not None and given.segments.clipped is not None
    gradient = linearise(given.segments, misfit, given.scales, Gaussian()).data.corner_gradient
    p = len(point.theta)

    def cost_along(number: int, step: float) -> float:
        border = point.border.copy()
        border[number] += step * given.scales.theta[number]
        moved = evaluate(given.segments, point.moved(point.nodes, border), given.scales, Gaussian())
        return moved.data + (0.0 if moved.clipped is None else moved.clipped.cost)

    slopes = [(cost_along(number, 1e-4) - cost_along(number, -1e-4)) / 2e-4 for number in range(p + 1)]
    np.testing.assert_allclose(-2.0 * gradient, slopes, rtol=2e-3, atol=1e-4 * np.max(np.abs(slopes)))


def test_longer_segments_have_the_same_cost() -> None:
    given = problem()
    misfit = evaluate(given.segments, given.start, given.scales, Gaussian())
    longer = LongerSegments.of(given.segments)
    assert longer is not None and longer.segments.clipped is not None and given.segments.clipped is not None
    assert longer.segments.clipped.present.sum() == given.segments.clipped.present.sum()
    joined: Misfit = longer.misfit(misfit)
    assert joined.clipped is not None and misfit.clipped is not None
    assert joined.data == pytest.approx(misfit.data, rel=1e-12)
    assert joined.clipped.cost == pytest.approx(misfit.clipped.cost, rel=1e-12)
    np.testing.assert_array_equal(
        np.sort(joined.pulling[joined.pulling != 0.0]), np.sort(misfit.pulling[misfit.pulling != 0.0])
    )


def test_a_robust_loss_takes_them_as_missing() -> None:
    given = problem()
    assert evaluate(given.segments, given.start, given.scales, Student()).clipped is None
