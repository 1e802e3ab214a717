"""Applied forces with unknown gains and delays: what acts on the masses, in short segments and in longer ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from structures import row_of_masses

import linkwise as lw
from linkwise.likelihood.sensors import SensorModel
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tableau import POINTS

RATE, COUNT, REFINE = 100.0, 203, 2
PAIR = row_of_masses(
    [1.0, 2.0], lower=("k*d + c*v", {"k": 900.0, "c": 0.6}), upper=("k*d + c*v", {"k": 1000.0, "c": 0.6})
)
ASKED = PAIR.unknown("all")
WAVE = "3*sin(2*pi*29*t + 1) + 2*sin(2*pi*5*t)"  # up to 0.29 of the sampling rate
LATE = 6e-3  # s, beyond half a sample


def segments_of(delays: tuple[str, ...]) -> Segments:
    time = np.arange(COUNT) / RATE
    values = np.stack(
        [
            np.zeros(COUNT),
            np.zeros(COUNT),
            lw.model.TimeFunction("cos(9*t)").value(time),
            lw.model.TimeFunction(WAVE).value(time),
        ],
        axis=1,
    )
    record = lw.Record(0.0, RATE, ("x:m1", "x:m2", "force:m1", "force:m2"), values)
    record = replace(record, noise={"x:m1": 1.0, "x:m2": 1.0})
    sensing = SensorModel.of([record], (), ("force:m2",), delays=delays)
    return sensing.segments([record], ASKED, System.of(ASKED), REFINE)


@pytest.mark.parametrize("delays", [(), ("force:m2",)])
def test_a_force_acts_by_what_its_channel_shows_less_gain_and_delay(delays: tuple[str, ...]) -> None:
    segments = segments_of(delays)
    late = LATE if delays else 0.0
    acting = present(segments.inputs.at(np.array([1.25]), np.full(len(delays), LATE)).force)
    steps = np.arange(segments.count * segments.steps).reshape(segments.count, -1).T
    time = (steps[:, None] + POINTS[None, :, None]) / RATE / REFINE
    inside = (time > 0.35) & (time < 1.65)  # where the windowed sinc has all of its samples
    expected = lw.model.TimeFunction(WAVE).value(time + late) / 1.25
    # 1e-4 of the polynomial in the delay, and as much of the interpolation, of 5 N
    assert np.abs(acting[:, :, 1] - expected)[inside].max() < 2e-3
    np.testing.assert_array_equal(acting[:, :, 0], present(segments.inputs.force)[:, :, 0])


def test_inputs_without_unknown_errors_stay_the_same_arrays() -> None:
    inputs = replace(segments_of(()).inputs, uncertain=None)
    assert inputs.at(np.array([1.25]), np.zeros(0)) is inputs


def test_motion_under_uncertain_forces_is_the_same_in_longer_segments_and_in_parts() -> None:
    segments = segments_of(("force:m2",))
    nodes = np.random.default_rng(5).normal(size=(4, segments.count))
    theta = np.array([present(PAIR.coefficient(p.name).value) for p in ASKED.parameters])
    point = Iterate(nodes, theta, np.zeros(0), np.array([1.25]), np.array([LATE]))
    scales = Scales(np.ones(2), np.ones(4), np.ones(6))
    short = evaluate(segments, point, scales, Gaussian())
    longer = present(LongerSegments.of(segments))
    of_longer = longer.misfit(short)
    long = evaluate(longer.segments, longer.point(point), scales, Gaussian())
    first = segments.steps + 1  # the first of the short segments in each: later ones start elsewhere
    np.testing.assert_array_equal(
        long.trajectories.states[: first - 1], of_longer.trajectories.states[: first - 1]
    )
    which = np.arange(3, 9)
    some = evaluate(segments.chosen(which), replace(point, nodes=nodes[:, which]), scales, Gaussian())
    np.testing.assert_array_equal(some.trajectories.states, short.trajectories.states[..., which])
