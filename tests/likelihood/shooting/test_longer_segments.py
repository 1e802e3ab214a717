"""Short segments joined to longer ones: the same samples, inputs and motion, whatever interrupts a chain of segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.random_states import RandomStates
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segmentation import cut_segments
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System

COUNTS = (9, 6)  # short segments of two records; neither is a multiple of those in a longer one


@pytest.fixture(scope="module")
def segments() -> Segments:
    """Two driven records of different rates, the first one interrupted behind its fifth segment."""
    three = rubbing_trio()
    unknown = three.unknown("all", "mass:m2")
    records = [
        lw.simulate(
            three, times=np.arange(5 * count - 2) / rate, sensors=("x", "a"), release={"v:m1": 1.0},
            forces={"m2": "5*sin(400*t)"}, base="0.001*sin(300*t)",
        ).with_noise(30.0, seed=count)
        for count, rate in zip(COUNTS, (1000.0, 1250.0), strict=True)
    ]  # fmt: skip
    noise = [np.full(len(records[0].responses), level) for level in (1.0, 2.0)]
    cut = cut_segments(records, unknown, System.of(unknown), samples=5, refine=2, relative_noise=noise)
    linked = cut.linked.copy()
    linked[4] = False
    return replace(cut, linked=linked)


@pytest.fixture(scope="module")
def start(segments: Segments) -> Iterate:
    nodes = np.random.default_rng(3).normal(size=(segments.system.dimension, segments.count))
    nodes[:3] *= 1e-3
    three = rubbing_trio()
    return Iterate(nodes, truth(three, three.unknown("all", "mass:m2")), np.zeros(0))


def test_motion_along_longer_segments_is_that_along_the_short_ones(
    segments: Segments, start: Iterate
) -> None:
    """The same operations on the same numbers."""
    longer = present(LongerSegments.of(segments))
    assert longer.parts.tolist() == [
        [0, 1, 2, 3],
        [4, 4, 4, 4],
        [5, 6, 7, 8],
        [9, 10, 11, 12],
        [13, 14, 14, 14],
    ]
    assert longer.segments.linked.tolist() == [True, False, False, True]
    scales = Scales(np.ones(6), np.ones(6), np.ones(0))
    along = evaluate(longer.segments, longer.point(start), scales, Gaussian())
    point = replace(start, nodes=longer.short_nodes(along.trajectories))
    short = evaluate(segments, point, scales, Gaussian())
    assert longer.segments.observed.sum() == segments.observed.sum()
    assert short.data == pytest.approx(along.data, rel=1e-12)
    assert short.continuity == pytest.approx(along.continuity, rel=1e-12)
    inside = [0, 1, 2, 4, 5, 6, 8, 9, 10, 11, 13]
    at_joints = np.delete(np.arange(segments.count - 1), inside)
    assert np.max(np.abs(short.defects[:, inside])) < 1e-12
    assert np.max(np.abs(short.defects[:, at_joints])) > 0.1  # random nodes are not continuous


def test_random_forces_keep_their_segments(segments: Segments) -> None:
    random = RandomStates(np.array([5]), np.ones((1, segments.count)), np.array([True]), None)
    assert LongerSegments.of(replace(segments, random=random)) is None
