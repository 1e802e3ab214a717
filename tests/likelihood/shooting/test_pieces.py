"""Steps of pieces whose inner nodes are eliminated are those of the equations of all nodes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from present import present

import linkwise as lw
from linkwise.likelihood.fit import Optimum, likelihood_fit
from linkwise.likelihood.shooting.linear_model import covariance
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.pieces import InCaller, JoinedPieces, joined_pieces, piece_ends
from linkwise.likelihood.shooting.prior import Prior
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate

Q = 1e-4
SAME = 1e-7  # the same equations in another order, the condition of which takes half of the digits


@pytest.fixture(scope="module", params=[1, 2], ids="{} records".format)
def optimum(request: pytest.FixtureRequest) -> Optimum:
    """The optimum of one or two records, of which a coefficient is known beforehand."""
    chain = lw.bnes_chain(2)
    clean = lw.simulate(chain, release={"v:m1": 2.0}, duration=1.0, rate=1000.0)
    records = [clean.with_noise(20.0, seed=5441100 + number) for number in range(request.param)]
    asked = chain.unknown("all")
    start = np.array([chain.coefficient(p.name).value for p in asked.parameters])
    found = likelihood_fit(records, asked, start).optimum
    deviation = np.full(len(start), np.inf)
    deviation[0] = 1e-4 * start[0]
    return replace(found, segments=replace(found.segments, prior=Prior(start, deviation)))


def beside(optimum: Optimum) -> Iterate:
    """A point near the optimum."""
    random = np.random.default_rng(1)
    nodes = optimum.point.nodes
    moved = nodes + 1e-3 * optimum.scales.state[:, None] * random.normal(size=nodes.shape)
    return replace(optimum.point, nodes=moved, theta=optimum.point.theta * (1.0 + 1e-5))


def in_pieces(optimum: Optimum, ends: list[int]) -> JoinedPieces:
    point, scales = beside(optimum), optimum.scales
    return present(
        joined_pieces(optimum.segments, point, scales, Q, optimum.loss, np.array(ends), InCaller())
    )


@pytest.mark.parametrize("inner_ends", [[], [90], [20, 57, 130]])
def test_they_are_those_of_all_nodes(optimum: Optimum, inner_ends: list[int]) -> None:
    segments, scales, point = optimum.segments, optimum.scales, beside(optimum)
    joined = in_pieces(optimum, [0, *inner_ends, segments.count - 1])
    misfit = evaluate(segments, point, scales, optimum.loss)
    equations = linearise(segments, misfit, scales, optimum.loss).equations(Q)
    factor = present(equations.factor())
    free = np.ones(len(scales.theta), dtype=bool)
    nodes, border = present(factor.solve(free))
    steps = present(joined.steps(scales))
    deviations = np.sqrt(covariance(factor, scales, free).diagonal())
    assert np.max(np.abs(steps.border - border * scales.theta) / deviations) < SAME
    atol = SAME * np.abs(nodes).max()
    np.testing.assert_allclose(steps.nodes.T / scales.state, nodes, rtol=0.0, atol=atol)
    assert steps.predicted == pytest.approx(equations.drop(nodes, border), rel=SAME)
    assert joined.cost == pytest.approx(misfit.cost(Q), rel=SAME)
    assert joined.log_determinant == pytest.approx(factor.log_determinant(free), rel=SAME)
    size = np.outer(deviations, deviations)  # a correlation next to zero has no digits of its own
    np.testing.assert_allclose(
        covariance(joined.factor, scales, free) / size,
        covariance(factor, scales, free) / size,
        rtol=0.0,
        atol=SAME,
    )


def test_nodes_follow_unknowns_that_are_held(optimum: Optimum) -> None:
    segments, scales = optimum.segments, optimum.scales
    change = 1e-4 * scales.theta * np.arange(1.0, len(scales.theta) + 1.0)
    joined = in_pieces(optimum, [0, 64, segments.count - 1])
    steps = present(joined.steps(scales, border_change=change))
    misfit = evaluate(segments, beside(optimum), scales, optimum.loss)
    factor = present(linearise(segments, misfit, scales, optimum.loss).equations(Q).factor())
    nodes, _ = present(factor.solve(np.zeros(len(change), dtype=bool), change / scales.theta))
    np.testing.assert_allclose(steps.border, change, rtol=SAME)
    np.testing.assert_allclose(steps.nodes.T / scales.state, nodes, rtol=0.0, atol=SAME * np.abs(nodes).max())


def test_threads_change_nothing(optimum: Optimum) -> None:
    segments, scales, point = optimum.segments, optimum.scales, beside(optimum)
    ends = np.array([0, 30, 60, 90, 120, segments.count - 1])
    with ThreadPoolExecutor(2) as threads:
        steps = [
            present(
                present(joined_pieces(segments, point, scales, Q, optimum.loss, ends, executor)).steps(scales)
            )
            for executor in (threads, InCaller())
        ]
    assert np.array_equal(steps[0].nodes, steps[1].nodes)
    assert np.array_equal(steps[0].border, steps[1].border)


@pytest.mark.parametrize("count", [8, 6000, 6001, 40_001])
def test_ends_cover_the_record_and_shifted_ones_lie_between(count: int) -> None:
    linked = np.ones(count - 1, dtype=bool)
    ends, shifted = piece_ends(linked), piece_ends(linked, shifted=True)
    for nodes in (ends, shifted):
        assert nodes[0] == 0 and nodes[-1] == count - 1 and (np.diff(nodes) > 2).all()
        assert np.diff(nodes).max() <= max(count, 6000)
    assert not set(ends[1:-1].tolist()) & set(shifted[1:-1].tolist())


def test_no_piece_ends_at_the_first_node_of_another_record() -> None:
    """There it would have neither samples nor a link, and count as known."""
    linked = np.ones(40_000, dtype=bool)
    middle = int(piece_ends(linked)[5])
    linked[middle - 1] = False
    assert middle - 1 in piece_ends(linked) and middle not in piece_ends(linked)
