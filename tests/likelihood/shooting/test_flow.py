"""The flow over segments and its tangents: against the engine, against their declared orders, against differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from present import present
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.likelihood.shooting.flow import Inputs, Trajectories, flow
from linkwise.likelihood.shooting.segmentation import cut_segments, flow_inputs
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tableau import CLOSING, POINTS, STAGE_POINT, STAGE_ROWS, TANGENT_CLOSING
from linkwise.likelihood.shooting.tangents import tangents
from linkwise.model.excitation import TimeFunction

RATE = 1000.0
# of the motion, five samples on: ten times what the test of the order allows in the mean of squares
LONG_STEP = 1e-5
FORCE, BASE = "5*sin(400*t)", "0.001*sin(300*t)"


@pytest.fixture(scope="module")
def three() -> lw.Structure:
    """Three masses, a moving base, two laws in turn, a coefficient shared, friction nonlinear in a coefficient."""
    return rubbing_trio()


@pytest.fixture(scope="module")
def unknown(three: lw.Structure) -> lw.Structure:
    return three.unknown("all", "mass:m2", "mass:m3")


def driven(
    structure: lw.Structure, sensors: tuple[str, ...] = ("x", "v", "a"), duration: float = 0.4
) -> lw.Record:
    return lw.simulate(
        structure, duration=duration, rate=RATE, sensors=sensors,
        release={"v:m1": 1.0, "x:m3": 0.005}, forces={"m2": FORCE}, base=BASE,
    )  # fmt: skip


def exact_inputs(starts: np.ndarray, step: float, steps: int) -> Inputs:
    """FORCE on m2 and BASE at the points of `steps` steps from the times `starts` (K,)."""
    time = (np.arange(steps)[:, None, None] + POINTS[:, None]) * step + starts
    force = np.zeros((steps, len(POINTS), 3, len(starts)))
    force[:, :, 1] = TimeFunction(FORCE).value(time)
    return Inputs(
        force, np.stack([1e-3 * np.sin(300 * time), 0.3 * np.cos(300 * time)], axis=2)
    )  # BASE and its rate


def states(record: lw.Record, every: int) -> np.ndarray:
    """(2, n, K) the true states at each `every`-th sample."""
    motion = present(record.simulated)
    return np.stack([motion.displacement[::every].T, motion.velocity[::every].T])


def test_the_tableau_sums_what_every_method_of_its_kind_must() -> None:
    # x'' = 1 from rest, for one step of length 1: displacement 1/2, velocity 1; a stage at t has moved by t^2/2
    assert CLOSING.sum(axis=1) == pytest.approx([0.5, 1.0], abs=1e-12)
    assert TANGENT_CLOSING.sum(axis=1) == pytest.approx([0.5, 1.0], abs=1e-6)  # single precision
    time = POINTS[list(STAGE_POINT)]
    assert STAGE_ROWS[:, 0, 1] == pytest.approx(time, abs=1e-12)
    bends = np.arange(len(time)) != 1  # stage 1 predicts the middle along the tangent
    assert STAGE_ROWS[bends, 0, 2:].sum(axis=1) == pytest.approx(time[bends] ** 2 / 2, abs=1e-12)


def test_the_flow_is_the_engines_with_force_and_base_between_the_samples(three: lw.Structure) -> None:
    record = driven(three)
    start = states(record, 5)
    time = record.time[::5][:-1]
    orbit = flow(
        System.of(three).at(np.zeros(0)),
        start[..., :-1], np.full(len(time), 1e-3), 5, exact_inputs(time, 1e-3, 5),
    )  # fmt: skip
    end = orbit.states[-1] / np.array([1.0, 1e-3])[:, None, None]
    error = np.abs(end - start[..., 1:]).max(axis=(1, 2)) / np.abs(start).max(axis=(1, 2))
    # where m2 flies far out a step of a sample is long, and the error ten times the mean; the next test measures the order
    assert error.max() < LONG_STEP
    for j in range(5):  # accelerations at every sample too, as close as the states that they follow from
        measured = record.values[j : j + 5 * len(time) : 5, 6:9].T
        assert np.abs(orbit.accelerations[j] - measured).max() < LONG_STEP * np.abs(measured).max()


def test_the_flow_has_order_eight(three: lw.Structure) -> None:
    system = System.of(three).at(np.zeros(0))
    record = driven(three, duration=0.2)
    true, time = states(record, 5), record.time[::5][:-1]
    size = np.abs(true).max(axis=(1, 2), keepdims=True)

    def error(count: int) -> float:
        step = 5e-3 / count
        drive = exact_inputs(time, step, count)
        orbit = flow(system, true[..., :-1], np.full(len(time), step), count, drive)
        end = orbit.states[-1] / np.array([1.0, step])[:, None, None]
        return float(np.sqrt(np.mean(((end - true[..., 1:]) / size) ** 2)))

    errors = [error(count) for count in (5, 10, 20)]
    orders = [np.log2(coarse / fine) for coarse, fine in pairwise(errors)]
    assert orders == pytest.approx([8.0, 8.0], abs=1.0)  # halved steps show the declared order to within one
    # 9e-8 at a step of a sample, and 4^8 less of that at a quarter: 1e-12, ten times each allowed
    assert errors[0] < 1e-6 and errors[-1] < 1e-11


def test_middles_are_what_twice_as_many_steps_find(three: lw.Structure) -> None:
    system = System.of(three).at(np.zeros(0))
    start = states(driven(three, duration=0.1), 20)[..., :-1]
    time = np.arange(start.shape[-1]) * 0.02
    coarse = flow(system, start, np.full(len(time), 1e-3), 4, exact_inputs(time, 1e-3, 4))
    fine = flow(system, start, np.full(len(time), 5e-4), 8, exact_inputs(time, 5e-4, 8))
    thin = fine.thinned(2)
    for name in ("states", "links", "accelerations", "middle_links", "middle_accelerations"):
        ours, theirs = getattr(coarse, name), getattr(thin, name)
        # the middle stage is of a lower order than the step
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max(), name
    assert fine.thinned(1) is fine


@pytest.mark.parametrize("degree", range(6))
def test_middles_of_masses_are_those_of_the_polynomial_of_both_ends(degree: int) -> None:
    """Displacement, velocity and acceleration at both ends determine degree 5, whose middles are exact."""
    step = np.array([0.5, 2.0])
    time = step * np.arange(4)[:, None] - 1.0  # (J + 1, K)
    motion = Polynomial.basis(degree)
    orbit = replace(
        Trajectories.empty(3, 1, 0, 0, 2),
        states=np.stack([motion(time), step * motion.deriv()(time)], axis=1)[:, :, None],
        accelerations=motion.deriv(2)(time)[:, None],
    )
    middle = time[:-1] + 0.5 * step
    expected = np.stack([motion(middle), step * motion.deriv()(middle)], axis=1)
    size = 5.0 * 5.0**degree  # of the farthest end, and of the slope there
    np.testing.assert_allclose(orbit.middles(step)[:, :, 0], expected, atol=1e-12 * size)


def test_inputs_between_samples_are_band_limited(three: lw.Structure) -> None:
    record = driven(three)
    inputs = flow_inputs([record], three, [81], samples=5, refine=2)
    exact = exact_inputs(np.arange(81) * 5e-3, 5e-4, 10)
    force, base = present(inputs.force), present(inputs.base)
    exact_force, exact_base = present(exact.force), present(exact.base)
    assert force.shape == exact_force.shape and base.shape == exact_base.shape
    middle = slice(10, 70)  # away from the ends, where samples stand on one side only
    # 100 dB of stop band is 1e-5 of the signal; its slope is taken by the spline through four points a sample. Amplitudes
    # are 5 N, 1 mm and 0.3 m/s; ten times is allowed, a hundred times for the slope
    assert np.abs(force - exact_force)[..., middle].max() < 1e-4 * 5.0
    assert np.abs(base - exact_base)[:, :, 0, middle].max() < 1e-4 * 1e-3
    assert np.abs(base - exact_base)[:, :, 1, middle].max() < 1e-3 * 0.3
    assert not force[:, :, [0, 2]].any()


def test_records_are_cut_into_segments_with_their_own_steps(three: lw.Structure) -> None:
    slow = lw.simulate(
        three, duration=0.2, rate=500.0, sensors=("x",), release={"v:m1": 1.0}, forces={"m2": FORCE},
        base=BASE,
    )  # fmt: skip
    fast = driven(three, sensors=("x",))
    segments = cut_segments([fast, slow], three, System.of(three), samples=5, refine=2, offsets=["x:m2"])
    assert segments.count == 81 + 21
    assert not segments.linked[80] and segments.linked.sum() == 100
    assert set(segments.step[:81]) == {5e-4} and set(segments.step[81:]) == {1e-3}
    assert segments.observed[:, 0].sum() == 401 + 101
    assert segments.samples[1, 2, 81] == slow.channel("x:m3")[1]
    assert list(segments.sensors.offset) == [-1, 0, -1]


@pytest.mark.parametrize("refine", [1, 4])
def test_tangents_are_the_flows_differences(three: lw.Structure, unknown: lw.Structure, refine: int) -> None:
    """By every state, coefficient (one shared, one nonlinear) and unknown mass, with inputs."""
    system, theta = System.of(unknown), truth(three, unknown)
    record = driven(three, duration=0.1)
    start = states(record, 5)[..., :-1]
    time, step = record.time[::5][:-1], 1e-3 / refine
    steps, drive = 5 * refine, exact_inputs(time, step, 5 * refine)
    scale = np.repeat([1e-4, 1e-1], 3)
    h = np.full(len(time), step)

    def end(at: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        orbit = flow(system.at(values), at, h, steps, drive)
        return orbit.states[-1], orbit.accelerations[-1 - refine] * step**2

    stored = [
        (tangent.state.copy(), None if tangent.acceleration is None else tangent.acceleration.copy())
        for tangent in tangents(
            system.at(theta), flow(system.at(theta), start, h, steps, drive), h, scale, theta, inputs=drive
        )
    ]
    state, acceleration = stored[-1][0], stored[-1 - refine][1]
    eps = 1e-4
    for column in range(6 + len(theta)):
        shift, change = np.zeros((2, 3, 1)), np.zeros_like(theta)
        if column < 6:
            shift.reshape(6)[column] = eps * scale[column]
        else:
            change[column - 6] = eps * theta[column - 6]
        ahead, behind = end(start + shift, theta + change), end(start - shift, theta - change)
        for ours, plus, minus in zip((state, acceleration), ahead, behind, strict=True):
            difference = (plus - minus) / (2 * eps)
            size = np.abs(difference).max()
            # single precision leaves 1e-6 of each step; steps of a whole sample err by (h omega)^4, 0.4^4
            limit = 2e-2 if refine == 1 else 2e-4
            assert np.abs(present(ours)[..., column, :] - difference).max() < limit * size, column


def test_tangents_have_their_declared_order(three: lw.Structure, unknown: lw.Structure) -> None:
    system, theta = System.of(unknown), truth(three, unknown)
    record = driven(three, duration=0.1)
    start = states(record, 5)[..., :-1]
    time = record.time[::5][:-1]
    scale = np.repeat([1e-4, 1e-1], 3)

    def end(refine: int) -> np.ndarray:
        step = 1e-3 / refine
        h = np.full(len(time), step)
        orbit = flow(system.at(theta), start, h, 5 * refine, exact_inputs(time, step, 5 * refine))
        *_, last = tangents(
            system.at(theta), orbit, h, scale, theta, inputs=exact_inputs(time, step, 5 * refine)
        )
        scaled: np.ndarray = last.state / np.array([1.0, step])[:, None, None, None]
        return scaled

    exact = end(16)
    size = np.abs(exact).max(axis=(1, 3), keepdims=True)  # each sensitivity by its own size
    errors = [np.sqrt(np.mean(((end(refine) - exact) / size) ** 2)) for refine in (1, 2, 4)]
    assert np.log2(errors[0] / errors[1]) > 3.0  # order 4 in the displacements, 3 in the rates
    assert np.log2(errors[1] / errors[2]) > 2.5  # single precision begins to show


def test_a_base_without_record_is_refused(three: lw.Structure) -> None:
    record = driven(three, sensors=("x",)).select(["x:m1", "x:m2", "x:m3", "force:m2"])
    with pytest.raises(lw.IdentificationError, match="give a channel x:base"):
        cut_segments([record], three, System.of(three), samples=5, refine=1, offsets=())


def test_a_gap_in_an_input_is_refused(three: lw.Structure) -> None:
    record = driven(three, sensors=("x",))
    values = record.values.copy()
    values[50, list(record.channels).index("force:m2")] = np.nan
    gappy = lw.Record(0.0, RATE, record.channels, values)
    with pytest.raises(
        lw.IdentificationError, match=r"force:m2: 1 of .* samples are missing.*inputs must be complete"
    ):
        cut_segments([gappy], three, System.of(three), samples=5, refine=1, offsets=())


def test_records_of_other_channels_are_refused(three: lw.Structure) -> None:
    record = driven(three, sensors=("x",))
    reordered = record.select(["x:m1", "x:m2", "force:m2", "x:base"])
    with pytest.raises(lw.IdentificationError, match=r"same channels in the same order.*record\.select"):
        cut_segments([record, reordered], three, System.of(three), samples=5, refine=1, offsets=())
    with pytest.raises(lw.IdentificationError, match="no offset or gain of x:m9"):
        cut_segments([record], three, System.of(three), samples=5, refine=1, offsets=["x:m9"])
    with pytest.raises(lw.IdentificationError, match="has no response"):
        only = record.select(["force:m2", "x:base"])
        cut_segments([only], three, System.of(three), samples=5, refine=1, offsets=())
    with pytest.raises(lw.IdentificationError, match=r"x:m3 belongs to no mass.*m1, m2"):
        cut_segments([record], lw.bnes_chain(2), System.of(lw.bnes_chain(2)), samples=5, refine=1, offsets=())
