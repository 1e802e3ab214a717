"""Sliders at the start of a record: what is known of them beforehand, and its slope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import some
from structures import named, structure

import linkwise as lw
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segmentation import cut_segments
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.slider_starts import add_starts, cost_of_starts
from linkwise.likelihood.shooting.system import System

SCALE = np.array([1e-4, 0.01, 1e-3, 2e-3])  # of x, v and two sliders


def problem(law: str) -> tuple[Segments, Iterate, Scales]:
    """A record of two samples a segment of a mass on a joint, and nodes away from zero."""
    sliding = structure({"m1": 1.0}, named("joint", "m1-ground", law))
    record = lw.Record(0.0, 100.0, ("x:m1",), 1e-3 * np.sin(0.1 * np.arange(20.0))[:, None])
    segments = cut_segments([record], sliding, System.of(sliding, lag=1e-3), samples=2, refine=1)
    nodes = SCALE[:, None] * np.random.default_rng(1).normal(size=(len(SCALE), segments.count))
    theta = np.array([{"FS": 5.0, "KT": 500.0, "chi": -0.4, "beta": 0.7}.get(p.name.split(".")[1], 0.5)
                      for p in sliding.parameters])  # fmt: skip
    return segments, Iterate(nodes, theta, np.zeros(0)), Scales(np.array([1e-5]), SCALE, np.abs(theta))


def test_a_slider_at_the_start_is_normal_with_its_size_along_the_motion() -> None:
    segments, point, scales = problem("iwan(1)")
    nodes = np.zeros_like(point.nodes)
    assert cost_of_starts(segments, nodes, scales) == 0.0
    nodes[2:, 0] = 10.0 * SCALE[2:]
    nodes[:, 1:] = 1.0  # not of the start
    nodes[:2] = 1.0  # not of a slider
    assert cost_of_starts(segments, nodes, scales) == pytest.approx(2.0, rel=1e-12)
    every = replace(segments, linked=np.zeros_like(segments.linked))  # each segment begins anew
    assert cost_of_starts(every, nodes, scales) > 2.0


def test_the_equations_have_its_slope() -> None:
    segments, point, scales = problem("iwan(1)")
    misfit = evaluate(segments, point, scales, Gaussian())
    assert misfit.prior == pytest.approx(cost_of_starts(segments, point.nodes, scales), rel=1e-12)
    (m, K), p = point.nodes.shape, len(point.theta)
    state, right = np.zeros((K, m, m)), np.zeros((K, m, p + 1))
    add_starts(state, right, segments, point.nodes, scales)
    assert np.count_nonzero(state) == np.count_nonzero(right) == 2
    for row in some((2, 3)):
        nodes = [point.nodes.copy() for _ in range(2)]
        for own, sign in zip(nodes, (1.0, -1.0), strict=True):
            own[row, 0] += sign * scales.state[row]
        ahead, behind = (cost_of_starts(segments, own, scales) for own in nodes)
        middle = cost_of_starts(segments, point.nodes, scales)
        assert right[0, row, -1] == pytest.approx(
            -0.25 * (ahead - behind), rel=1e-9
        )  # half the slope of a parabola
        assert state[0, row, row] == pytest.approx(0.5 * (ahead + behind) - middle, rel=1e-9)
    blocks = linearise(segments, misfit, scales, Gaussian()).data
    without = linearise(segments, replace(misfit, point=at_zero(segments, point)), scales, Gaussian()).data
    np.testing.assert_allclose(
        blocks.right[0, 2:, -1] - without.right[0, 2:, -1], right[0, 2:, -1], atol=1e-6
    )


def at_zero(segments: Segments, point: Iterate) -> Iterate:
    """The point with sliders at zero."""
    nodes = point.nodes.copy()
    nodes[2:] = 0.0
    return replace(point, nodes=nodes)


def test_other_states_are_free_at_the_start() -> None:
    for law in some(("bouc-wen", "dahl", "maxwell")):
        system = System.of(structure({"m1": 1.0}, named("joint", "m1-ground", law)))
        assert len(system.slider_states) == 0
