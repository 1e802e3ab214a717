"""States that settle inside a piece, whose ends and other unknowns are held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.settled_states import settled_states, with_held_parameters

Q = 1e-4


@pytest.fixture(scope="module")
def optimum() -> Optimum:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 2.0}, duration=1.0, rate=1000.0).with_noise(
        20.0, seed=5441110
    )
    asked = chain.unknown("all")
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    return likelihood_fit([record], asked, start).optimum


@pytest.mark.parametrize("distance", [1e-3, 0.3])  # of the noise: 0.3 is 3000 times what links allow
def test_they_return_to_where_they_were_moved_from(optimum: Optimum, distance: float) -> None:
    segments, scales, point = optimum.segments, optimum.scales, optimum.point
    settled, lowest = settled_states(segments, point, scales, Q, optimum.loss, -np.inf)
    moved = point.nodes.copy()
    moved[:, 1:-1] += (
        distance * scales.state[:, None] * np.random.default_rng(2).normal(size=moved[:, 1:-1].shape)
    )
    start = replace(point, nodes=moved)
    before = evaluate(segments, start, scales, optimum.loss).cost(Q)
    nodes, cost = settled_states(segments, start, scales, Q, optimum.loss, -np.inf)
    assert before > lowest + 10.0
    assert cost == pytest.approx(lowest, abs=0.05)
    assert np.array_equal(nodes[:, [0, -1]], point.nodes[:, [0, -1]])
    assert np.abs((nodes - settled) / scales.state[:, None]).max() < 0.05
    again = evaluate(segments, replace(start, nodes=nodes), scales, optimum.loss)
    assert cost == pytest.approx(again.cost(Q), rel=1e-9)


def test_nothing_moves_where_the_cost_is_low_enough(optimum: Optimum) -> None:
    point, scales = optimum.point, optimum.scales
    cost = evaluate(optimum.segments, point, scales, optimum.loss).cost(Q)
    nodes, same = settled_states(optimum.segments, point, scales, Q, optimum.loss, 1.001 * cost)
    assert np.array_equal(nodes, point.nodes) and same == pytest.approx(cost, rel=1e-12)


def test_a_problem_without_parameters_has_the_same_misfit(optimum: Optimum) -> None:
    held = with_held_parameters(optimum.segments, optimum.point, optimum.scales)
    assert held[0].parameters == 0 and len(held[1].border) == 0
    expected = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
    assert evaluate(*held, optimum.loss).cost(Q) == pytest.approx(expected.cost(Q), rel=1e-12)
