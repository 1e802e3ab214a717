"""The gradient by the adjoint against that of the normal equations, which have it from sensitivities, and against the cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import some

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting.adjoint import gradient, has_adjoint
from linkwise.likelihood.shooting.clipped_readings import ClippedReadings
from linkwise.likelihood.shooting.linear_model import linear_model
from linkwise.likelihood.shooting.local_equations import LocalLinearization
from linkwise.likelihood.shooting.normal_equations import Linearization
from linkwise.likelihood.shooting.residuals import evaluate

Q = 0.1


def optimum(masses: int, sensors: tuple[str, ...] = (), unknown: tuple[str, ...] = ("all",)) -> Optimum:
    chain = lw.bnes_chain(masses)
    channels = [f"x:{name}" for name in chain.mass_names] + list(sensors)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=channels)
    asked = chain.unknown(*unknown)
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    return likelihood_fit([record.with_noise(30.0, seed=5206900)], asked, start).optimum


def aside(start: Optimum, seed: int) -> Optimum:
    """The same with all unknowns moved by a little, so that there is a gradient."""
    rng, scales, point = np.random.default_rng(seed), start.scales, start.point
    nodes = point.nodes + 0.1 * rng.normal(size=point.nodes.shape) * scales.state[:, None]
    return replace(
        start,
        point=point.moved(nodes, point.border + 1e-3 * rng.normal(size=len(scales.theta)) * scales.theta),
    )


def right_side(start: Optimum) -> tuple[np.ndarray, np.ndarray]:
    """(K, m) and (P,) of the normal equations."""
    misfit = evaluate(start.segments, start.point, start.scales, start.loss)
    linear = linear_model(start.segments, misfit, start.scales, start.loss)
    if isinstance(linear, Linearization):
        equations = linear.equations(Q)
        return equations.right[..., -1], equations.corner_gradient
    local = linear.equations(Q)
    assert isinstance(linear, LocalLinearization)
    return local.gradient[:, local.order.places], local.corner_gradient


def by_adjoint(start: Optimum) -> tuple[np.ndarray, np.ndarray]:
    misfit = evaluate(start.segments, start.point, start.scales, start.loss)
    return gradient(start.segments, misfit, start.scales, start.loss, misfit.defects.T / Q**2)


@pytest.mark.parametrize(
    ("masses", "sensors", "unknown", "tolerance"),
    [
        (2, (), ("all",), 1e-5),
        (2, ("v:m1", "v:m2"), ("all", "mass:m2"), 1e-5),
        (4, (), ("nes",), 1e-5),
        (14, (), ("all",), 2e-3),  # whose sensitivities are short of a thousandth
    ],
)
def test_it_is_that_of_the_normal_equations(
    masses: int, sensors: tuple[str, ...], unknown: tuple[str, ...], tolerance: float
) -> None:
    start = aside(optimum(masses, sensors, unknown), masses)
    assert has_adjoint(start.segments)
    for mine, theirs in some(zip(by_adjoint(start), right_side(start), strict=True)):
        assert np.abs(mine - theirs).max() < tolerance * np.abs(theirs).max()


def test_missing_samples_pull_at_nothing() -> None:
    start = aside(optimum(2), 7)
    observed = start.segments.observed.copy()
    observed[1, 0, ::3] = False
    some_samples = replace(start, segments=replace(start.segments, observed=observed))
    for mine, theirs in some(zip(by_adjoint(some_samples), right_side(some_samples), strict=True)):
        assert np.abs(mine - theirs).max() < 1e-5 * np.abs(theirs).max()


def test_it_is_the_slope_of_the_cost() -> None:
    """Along a random direction, by central differences of the flow, whose order is higher than that of the sensitivities."""
    start = aside(optimum(4), 11)
    rng, scales, point = np.random.default_rng(3), start.scales, start.point
    nodes, border = rng.normal(size=point.nodes.shape), 1e-2 * rng.normal(size=len(scales.theta))
    costs = []
    for side in (-1e-4, 1e-4):
        moved = point.moved(
            point.nodes + side * nodes * scales.state[:, None], point.border + side * border * scales.theta
        )
        costs.append(evaluate(start.segments, moved, scales, start.loss).cost(Q))
    of_nodes, of_border = by_adjoint(start)
    slope = -2.0 * (np.vdot(of_nodes, nodes.T) + of_border @ border)
    assert (costs[1] - costs[0]) / 2e-4 == pytest.approx(slope, rel=1e-4)


def test_accelerations_and_clipped_readings_have_none() -> None:
    assert not has_adjoint(optimum(2, ("a:m1",)).segments)
    segments = optimum(2).segments
    present = np.zeros(segments.samples.shape, bool)
    clipped = ClippedReadings(present, 0.0 * segments.samples, 0.0 * segments.samples)
    assert has_adjoint(segments) and not has_adjoint(replace(segments, clipped=clipped))
