"""The flow over segments and its tangents: against the engine, against their declared orders, against differences."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from present import present
from problems import rubbing_trio, truth

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.shooting.flow import (
    POINTS,
    Inputs,
    Trajectories,
    flow,
)
from linkwise.likelihood.shooting.segmentation import cut_segments, flow_inputs
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangents import CandidateForces, Single, tangents
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
    # BASE and its rate
    return Inputs(force, np.stack([1e-3 * np.sin(300 * time), 0.3 * np.cos(300 * time)], axis=2))


def states(record: lw.Record, every: int) -> np.ndarray:
    """(2, n, K) the true states at each `every`-th sample."""
    motion = present(record.simulated)
    return np.stack([motion.displacement[::every].T, motion.velocity[::every].T])


@pytest.mark.slow
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


STEP, STEPS, SCALE = 3e-3, 6, np.repeat([1e-4, 1e-1], 3)
ENDS = np.array([-1, 0]), np.array([1, 2])  # of two candidates, one of them on a single mass
NOTHING = Inputs()


@pytest.fixture(scope="module")
def without_inputs() -> tuple[System, Floats, Floats]:
    """With two unknown masses and a coefficient that links on both sides of a mass share; states of some nodes."""
    three = rubbing_trio()
    unknown = three.unknown("all", "mass:m2", "mass:m3")
    record = lw.simulate(
        three,
        duration=0.3,
        rate=1.0 / STEP,
        sensors=("x", "v"),
        release={"v:m1": 1.0, "x:m3": 0.005},
        base="0",
    )
    nodes = np.concatenate([[record.channel(f"{kind}:m{i}")[::STEPS] for i in (1, 2, 3)] for kind in "xv"])
    return System.of(unknown), truth(three, unknown), nodes[:, :-1]


def orbit_in(without_inputs: tuple[System, Floats, Floats], steps: int) -> tuple[Trajectories, Floats]:
    """The motion in so many steps a sample, and their durations."""
    system, theta, nodes = without_inputs
    step = np.full(nodes.shape[1], STEP / steps)
    return flow(system.at(theta), nodes, step, STEPS * steps, NOTHING), step


def candidates_along(orbit: Trajectories) -> CandidateForces:
    """Forces that follow elongations of links, in N."""
    return CandidateForces(*ENDS, 100.0 * orbit.links[:, 0, :2], 100.0 * orbit.middle_links[:, 0, :2])


def ends_by_march(without_inputs: tuple[System, Floats, Floats], steps: int) -> Floats:
    """(2 n, P, K) of x and v at the ends, in so many steps a sample."""
    (system, theta, _), (orbit, step) = without_inputs, orbit_in(without_inputs, steps)
    candidates = candidates_along(orbit)
    *_, last = tangents(system.at(theta), orbit, step, SCALE, theta, candidates, inputs=NOTHING)
    return in_their_units(last.state, step)


def in_their_units(state: Single, step: Floats) -> Floats:
    return np.asarray(np.concatenate([state[0], state[1] / step]) / SCALE[:, None, None], dtype=float)


def test_all_columns_have_their_declared_order(without_inputs: tuple[System, Floats, Floats]) -> None:
    """Those of parameters and of candidates as well, of order 4 by Simpson's rule; one that is wrong keeps its error."""
    exact = ends_by_march(without_inputs, 16)
    size = np.sqrt(np.mean(exact**2, axis=(0, 2)))
    errors = [
        np.sqrt(np.mean((ends_by_march(without_inputs, steps) - exact) ** 2, axis=(0, 2))) / size
        for steps in (1, 2)
    ]
    assert exact.shape[1] == len(SCALE) + len(without_inputs[1]) + 2
    assert np.max(errors[1]) < 0.01
    orders = np.log2(errors[0] / errors[1])  # 4 in the displacements, 3 in the rates
    assert np.median(orders) > 3.0 and np.min(orders) > 2.5


Records = list[lw.Record]


def with_gap(record: lw.Record) -> lw.Record:
    values = record.values.copy()
    values[50, record.channels.index("force:m2")] = np.nan
    return replace(record, values=values)


@pytest.mark.parametrize(
    ("change", "offsets", "message"),
    [
        (lambda record: [record.select(["x:m1", "x:m2", "x:m3", "force:m2"])], [], "add a channel x:base"),
        (lambda record: [with_gap(record)], [], "force:m2: 1 of .* missing.*inputs must be complete"),
        (lambda record: [record], ["x:m9"], "no offset or gain of x:m9"),
        (lambda record: [record.select(["force:m2", "x:base"])], [], "channel"),
    ],
)
def test_records_that_the_flow_does_not_take_are_refused(
    three: lw.Structure, change: Callable[[lw.Record], Records], offsets: list[str], message: str
) -> None:
    with pytest.raises((lw.IdentificationError, lw.RecordError), match=message):
        lw.identify(change(driven(three, sensors=("x",))), three.unknown("spring"), offsets=offsets)


def test_records_of_other_channels_are_refused(three: lw.Structure) -> None:
    record = driven(three, sensors=("x",))
    fewer = record.select(["x:m1", "x:m2", "force:m2", "x:base"])[50:]
    with pytest.raises(lw.IdentificationError, match=r"same channels in the same order.*record\.select"):
        cut_segments([record, fewer], three, System.of(three), samples=5, refine=1, offsets=())
