"""Residuals, defects and the normal equations of segments: every gradient against differences of the cost."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from present import present, some
from problems import chain_record, rubbing_trio, truth

import linkwise as lw
from linkwise.likelihood.shooting import normal_equations as module
from linkwise.likelihood.shooting.bordered_system import BorderedSystem
from linkwise.likelihood.shooting.loss import Gaussian, Huber, Loss, Student
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segmentation import cut_segments
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.starts.states import segment_nodes, start_states

CHANNELS = ("x:m1", "v:m2", "a:m3", "x:m3", "a:m1", "force:m2", "x:base")
OFFSETS = ("v:m2", "a:m1")
FIRST, SECOND = 8, 6  # nodes of the two records


@pytest.fixture(scope="module")
def three() -> lw.Structure:
    return rubbing_trio()


@pytest.fixture(scope="module")
def unknown(three: lw.Structure) -> lw.Structure:
    return three.unknown("all", "mass:m2", "mass:m3")


@pytest.fixture(scope="module")
def records(three: lw.Structure) -> list[lw.Record]:
    """Two, of different rates; every kind of sensor, force and base motion, a gap in one channel."""

    def hit(rate: float, samples: int, release: dict[str, float]) -> lw.Record:
        record = lw.simulate(
            three, times=np.arange(samples) / rate, sensors=("x", "v", "a"), release=release,
            forces={"m2": "5*sin(400*t)"}, base="0.001*sin(300*t)",
        )  # fmt: skip
        return record.select(CHANNELS)

    first, second = hit(1000.0, 5 * FIRST - 2, {"v:m1": 1.0}), hit(1250.0, 5 * SECOND, {"x:m3": 0.01})
    values = first.values.copy()
    values[20:27, 0] = np.nan
    return [replace(first, values=values), second]


@pytest.fixture(scope="module")
def segments(records: list[lw.Record], unknown: lw.Structure) -> Segments:
    return cut_segments(records, unknown, System.of(unknown), samples=5, refine=4, offsets=OFFSETS)


@pytest.fixture(scope="module")
def scales(three: lw.Structure, unknown: lw.Structure, segments: Segments) -> Scales:
    sigma = np.array([1e-4, 0.05, 5.0, 1e-4, 5.0])
    return Scales(
        sigma, np.repeat([1e-4, 0.05], 3), np.concatenate([np.abs(truth(three, unknown)), sigma[[1, 4]]])
    )


@pytest.fixture(scope="module")
def point(
    three: lw.Structure, unknown: lw.Structure, segments: Segments, records: list[lw.Record]
) -> Iterate:
    """Away from the truth by some deviations in every unknown."""
    random = np.random.default_rng(3)
    true = [
        np.stack([present(record.simulated).displacement[::5].T, present(record.simulated).velocity[::5].T])
        for record in records
    ]
    at = np.concatenate(true, axis=2)
    at = at + random.normal(size=at.shape) * np.array([3e-4, 0.1])[:, None, None]
    at = at.reshape(-1, at.shape[-1])
    theta = truth(three, unknown)
    return Iterate(at, theta * (1.0 + 0.05 * random.normal(size=len(theta))), np.array([0.05, -4.0]))


def gradient(equations: BorderedSystem) -> np.ndarray:
    return np.concatenate([equations.right[..., -1].ravel(), equations.corner_gradient])


def moved(point: Iterate, scales: Scales, step: np.ndarray) -> Iterate:
    """`step` in the units of the unknowns, node by node, then theta and offsets."""
    n, K = len(point.nodes) // 2, point.nodes.shape[1]
    size, p = 2 * n * K, len(point.theta)
    shift = (step[:size].reshape(K, 2 * n) * scales.state).T
    border = step[size:] * scales.theta
    return Iterate(point.nodes + shift, point.theta + border[:p], point.offsets + border[p:])


EPS = 1e-4  # step of central differences, in the units of the unknowns


@pytest.fixture(scope="module", params=[Gaussian(), Huber(), Student()], ids=lambda loss: type(loss).__name__)
def loss(request: pytest.FixtureRequest) -> Loss:
    chosen: Loss = request.param
    return chosen


@pytest.fixture(scope="module")
def beside(segments: Segments, scales: Scales, point: Iterate, loss: Loss) -> dict[int, list[Misfit]]:
    """The misfits half a difference ahead of the point and behind it, in unknowns of some segments and all of the border."""
    size = point.nodes.size + len(point.theta) + len(point.offsets)
    checked = [*range(12), *range(6 * (FIRST - 1), 6 * (FIRST + 1)), *range(6 * (segments.count - 1), size)]
    steps = {i: EPS * (np.arange(size) == i) for i in checked}
    return {
        i: [evaluate(segments, moved(point, scales, sign * step), scales, loss) for sign in (1, -1)]
        for i, step in steps.items()
    }


@pytest.mark.parametrize("q", [1.0, 1e-3])
def test_the_gradient_is_the_costs_difference(
    segments: Segments,
    scales: Scales,
    point: Iterate,
    loss: Loss,
    beside: dict[int, list[Misfit]],
    q: float,
) -> None:
    misfit = evaluate(segments, point, scales, loss)
    equations = linearise(segments, misfit, scales, loss).equations(q)
    computed = gradient(equations)
    curvature = np.concatenate([np.einsum("kii->ki", equations.diagonal).ravel(), np.diag(equations.corner)])
    expected, checked = np.zeros_like(computed), some(beside)
    for i, (ahead, behind) in beside.items():
        expected[i] = -(ahead.cost(q) - behind.cost(q)) / (4.0 * EPS)
    assert np.abs(expected[checked]).min() > 0.0  # every unknown shows in the cost
    # in units of |column| |residuals|, the largest that J'r can be: single precision, and order 4 in (h omega)/4
    largest = np.sqrt(curvature * misfit.cost(q))
    # of quotients of differences; measured 6e-5
    assert np.abs((computed - expected) / largest)[checked].max() < 2e-4


def test_curvature_is_that_of_the_residuals(segments: Segments, scales: Scales, point: Iterate) -> None:
    """J'J against differences of the residuals and defects themselves."""
    loss, q = Gaussian(), 0.1
    misfit = evaluate(segments, point, scales, loss)
    equations = linearise(segments, misfit, scales, loss).equations(q)
    size, eps = equations.right[..., 0].size, 1e-4

    def rows(at: Iterate) -> np.ndarray:
        misfit = evaluate(segments, at, scales, loss)
        return np.concatenate([misfit.residuals.ravel(), misfit.defects.ravel() / q])

    columns = []
    for i in range(size + segments.parameters):
        step = np.zeros(size + segments.parameters)
        step[i] = eps
        ahead, behind = (rows(moved(point, scales, sign * step)) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * eps))
    jacobian = np.stack(columns, axis=1)
    hessian = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(hessian))
    m = equations.diagonal.shape[1]

    def close(ours: np.ndarray, rows: slice, columns: slice) -> None:
        difference = (ours - hessian[rows, columns]) / np.outer(scale[rows], scale[columns])
        assert np.abs(difference).max() < 1e-3  # tangents in single precision, of order 4 in a sample

    border = slice(size, None)
    for k in some(range(segments.count)):
        own, after = slice(m * k, m * (k + 1)), slice(m * (k + 1), m * (k + 2))
        close(equations.diagonal[k], own, own)
        close(equations.right[k, :, :-1], own, border)
        if k + 1 < segments.count:
            close(equations.coupling[k], after, own)
        far = hessian[own, m * (k + 2) : size]
        assert not far.any()  # block tridiagonal indeed
    close(equations.corner, border, border)


def test_missing_samples_carry_no_residual(
    segments: Segments, scales: Scales, point: Iterate, records: list[lw.Record], unknown: lw.Structure
) -> None:
    misfit = evaluate(segments, point, scales, Gaussian())
    assert segments.observed.sum() == 5 * (5 * (FIRST + SECOND) - 2) - 7
    assert not misfit.residuals[~segments.observed].any()
    assert misfit.residuals[segments.observed].all()
    lost = np.where(segments.observed, segments.samples, 1e6)
    changed_misfit = evaluate(replace(segments, samples=lost), point, scales, Gaussian())
    assert np.array_equal(changed_misfit.residuals, misfit.residuals)
    a = linearise(segments, misfit, scales, Student()).equations(0.1)
    b = linearise(segments, changed_misfit, scales, Student()).equations(0.1)
    assert np.array_equal(a.diagonal, b.diagonal) and np.array_equal(a.corner, b.corner)


def test_records_are_not_linked_to_each_other(segments: Segments, scales: Scales, point: Iterate) -> None:
    misfit = evaluate(segments, point, scales, Gaussian())
    assert not misfit.defects[..., FIRST - 1].any()
    others = np.delete(np.arange(segments.count - 1), FIRST - 1)
    assert np.abs(misfit.defects[..., others]).min() > 0.0
    equations = linearise(segments, misfit, scales, Gaussian()).equations(1e-3)
    assert not equations.coupling[FIRST - 1].any()
    assert all(equations.coupling[k].any() for k in some(others))
    shifted = point.nodes.copy()
    shifted[..., FIRST:] += 0.01
    away = evaluate(segments, replace(point, nodes=shifted), scales, Gaussian())
    assert np.array_equal(away.residuals[..., :FIRST], misfit.residuals[..., :FIRST])
    assert np.array_equal(away.defects[..., : FIRST - 1], misfit.defects[..., : FIRST - 1])


def test_an_offset_moves_its_channel_and_no_other(segments: Segments, scales: Scales, point: Iterate) -> None:
    misfit = evaluate(segments, point, scales, Gaussian())
    moved = evaluate(
        segments, replace(point, offsets=point.offsets + np.array([0.5, 0.0])), scales, Gaussian()
    )
    change = moved.residuals - misfit.residuals
    assert change[:, 1][segments.observed[:, 1]] == pytest.approx(-0.5 / scales.sigma[1], rel=1e-12)
    assert not np.delete(change, 1, axis=1).any()


def test_the_truth_leaves_nothing(
    three: lw.Structure, unknown: lw.Structure, segments: Segments, scales: Scales, records: list[lw.Record]
) -> None:
    true = [
        np.concatenate(
            [present(record.simulated).displacement[::5].T, present(record.simulated).velocity[::5].T]
        )
        for record in records
    ]
    misfit = evaluate(
        segments,
        Iterate(np.concatenate(true, axis=1), truth(three, unknown), np.zeros(2)),
        scales,
        Gaussian(),
    )
    # inputs between samples come from a spline, which stands on one side only at the ends of a record
    ends = [0, FIRST - 1, FIRST, FIRST + SECOND - 1]
    inner = np.delete(misfit.residuals, ends, axis=2)
    # in deviations of the noise: 1e-3 is what the steps may leave, and at the ends at most as much as the noise
    assert np.abs(inner).max() < 1e-3
    assert np.abs(misfit.residuals).max() < 1.0


def test_sums_do_not_depend_on_chunks_and_threads(
    segments: Segments, scales: Scales, point: Iterate, monkeypatch: pytest.MonkeyPatch
) -> None:
    misfit = evaluate(segments, point, scales, Gaussian())
    whole = linearise(segments, misfit, scales, Gaussian()).equations(0.1)
    monkeypatch.setattr(module, "CHUNK", 1)
    parts = linearise(segments, misfit, scales, Gaussian()).equations(0.1)
    with ThreadPoolExecutor(2) as executor:
        side = linearise(segments, misfit, scales, Gaussian(), executor).equations(0.1)
    for name in ("diagonal", "coupling", "right", "corner", "corner_gradient"):
        size = np.abs(getattr(whole, name)).max()
        # chunks are added up in another order, in single precision; threads change nothing
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), abs=1e-5 * size)
        assert np.array_equal(getattr(side, name), getattr(parts, name))


def test_nodes_start_where_the_sensors_say(three: lw.Structure) -> None:
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    sigma = dict(present(record.simulated).noise)
    states = start_states(record, lw.bnes_chain(2), sigma, 5)
    at = segment_nodes([states], 5)
    assert at.shape == (4, 401)
    true = present(record.simulated)
    for i, name in enumerate(("x:m1", "x:m2")):
        error = np.sqrt(np.mean((states.x[i] - true.displacement[:, i])[20:-20] ** 2))
        assert error < sigma[name]  # smoothing takes noise away
    speed = np.sqrt(np.mean((states.v - true.velocity.T)[:, 20:-20] ** 2, axis=1))
    assert (speed < 0.05 * np.sqrt(np.mean(true.velocity**2, axis=0))).all()  # 1 % noise, at most five fold
    assert states.scale[:2] == pytest.approx([sigma["x:m1"], sigma["x:m2"]])


def test_losses_cost_what_their_densities_say() -> None:
    r = np.linspace(-6.0, 6.0, 25)
    for loss in (Gaussian(), Huber(1.5), Student(4.0)):
        eps = 1e-6
        for value in some(r[np.abs(r) != 1.5]):  # Huber's corner bends within the difference
            slope = (loss.total(np.array([value + eps])) - loss.total(np.array([value - eps]))) / (2 * eps)
            # costs up to 36 are rounded to 8e-15, which makes 4e-9 of the quotient
            assert 2.0 * value * loss.weight(np.array([value]))[0] == pytest.approx(slope, abs=1e-7)
    assert Huber(1.5).total(np.array([1.0, 1.5])) == pytest.approx(1.0 + 2.25, rel=1e-12)
    assert Huber(1.5).total(np.array([10.0])) == pytest.approx(2 * 1.5 * 10 - 1.5**2, rel=1e-12)
    many = Student(1e6)  # many degrees of freedom are a Gaussian
    assert many.total(np.array([3.0])) == pytest.approx(9.0, rel=1e-5)  # (r^2/2 - 1)/1e6 = 3.5e-6 less
