"""The flow over segments: against the engine, against its declared order; and inputs between samples."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from present import present
from problems import rubbing_trio
from record_faults import without

import linkwise as lw
from linkwise.likelihood.shooting.flow import POINTS, Inputs, flow
from linkwise.likelihood.shooting.segmentation import Cut, cut_segments, flow_inputs
from linkwise.likelihood.shooting.system import System

RATE = 1000.0
FORCE, BASE = "5*sin(400*t)", "0.001*sin(300*t)"


@pytest.fixture(scope="module")
def three() -> lw.Structure:
    """Three masses, a moving base, two laws in turn, a coefficient shared, friction nonlinear in a coefficient."""
    return rubbing_trio()


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
    force[:, :, 1] = lw.model.TimeFunction(FORCE).value(time)
    # BASE and its rate
    return Inputs(force, np.stack([1e-3 * np.sin(300 * time), 0.3 * np.cos(300 * time)], axis=2))


def states(record: lw.Record, every: int) -> np.ndarray:
    """(2, n, K) the true states at each `every`-th sample."""
    motion = present(record.simulated)
    return np.stack([motion.displacement[::every].T, motion.velocity[::every].T])


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
    inputs = flow_inputs(Cut([record], 5, 2), three)
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda record: record.select(["x:m1", "x:m2", "x:m3", "force:m2"]), "add a channel x:base"),
        (lambda record: without(record, force_m2=50), "force:m2: 1 of .* missing.*inputs must be complete"),
        (lambda record: record.select(["force:m2", "x:base"]), "channel"),
    ],
)
def test_records_that_the_flow_does_not_take_are_refused(
    three: lw.Structure, change: Callable[[lw.Record], lw.Record], message: str
) -> None:
    with pytest.raises((lw.IdentificationError, lw.RecordError), match=message):
        lw.identify(change(driven(three, sensors=("x",))), three.unknown("spring"))


def test_records_of_other_channels_are_refused(three: lw.Structure) -> None:
    record = driven(three, sensors=("x",))
    fewer = record.select(["x:m1", "x:m2", "force:m2", "x:base"])[50:]
    with pytest.raises(lw.IdentificationError, match=r"same channels in the same order.*record\.select"):
        cut_segments(Cut([record, fewer], 5, 1), three, System.of(three))
