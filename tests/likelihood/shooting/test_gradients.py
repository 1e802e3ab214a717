"""Residuals, defects and the equations of segments: every gradient against differences of the cost."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from problems import chain_record, rubbing_trio, truth
from record_faults import without
from scipy.stats import norm
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    CANTILEVER_SINK,
    NES,
    host,
    link,
    row_of_masses,
    structure,
)

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.bordered_system import BorderedSystem
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import Gaussian, Huber, Loss, Misfit, Student, evaluate
from linkwise.likelihood.shooting.segmentation import Cut, cut_segments
from linkwise.likelihood.shooting.segments import ClippedReadings, Iterate, Scales, Segments, SensorErrors
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.terms import Delay, Drift, Gain, Hum, Offset, Term

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
    gap = replace(without(first, x_m1=slice(20, 27)), simulated=first.simulated)
    return [gap, second]


@pytest.fixture(scope="module")
def segments(records: list[lw.Record], unknown: lw.Structure) -> Segments:
    cut = cut_segments(Cut(records, 5, 4), unknown, System.of(unknown))
    shown = [name for name in CHANNELS if not name.startswith(("force:", "x:base"))]
    errors = SensorErrors(np.array([shown.index(name) for name in OFFSETS]), [np.ones((5, cut.count))] * 2)
    return replace(cut, errors=errors, sensors=replace(cut.sensors, offsets=len(OFFSETS)))


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
    return np.concatenate([equations.nodes[2][..., -1].ravel(), equations.corner_gradient])


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
    segments: Segments, scales: Scales, point: Iterate, loss: Loss, beside: dict[int, list[Misfit]], q: float
) -> None:
    misfit = evaluate(segments, point, scales, loss)
    equations = linearise(misfit).equations(q)
    computed = gradient(equations)
    curvature = np.concatenate([np.einsum("kii->ki", equations.nodes[0]).ravel(), np.diag(equations.corner)])
    expected, checked = np.zeros_like(computed), some(beside)
    for i, (ahead, behind) in beside.items():
        expected[i] = -(ahead.cost(q) - behind.cost(q)) / (4.0 * EPS)
    assert np.abs(expected[checked]).min() > 0.0  # every unknown shows in the cost
    # in units of |column| |residuals|, the largest that J'r can be: single precision, and order 4 in (h omega)/4
    largest = np.sqrt(curvature * misfit.cost(q))
    # of quotients of differences; measured 6e-5
    assert np.abs((computed - expected) / largest)[checked].max() < 2e-4


WAVE = "40*sin(31*t + 1) + 20*sin(53*t) + 30*sin(11*t)"
PAIR = row_of_masses(
    [1.0, 1.0],
    lower=("k*d + k3*d**3 + c*v", {"k": 900.0, "k3": 2e5, "c": 0.6}),
    upper=("k*d + c*v", {"k": 1000.0, "c": 0.6}),
)
SENSORS = ("x:m1", "x:m2", "v:m1", "a:m2")


def chain_released(sensors: tuple[str, ...] = ("x",), *, clipped: bool = False) -> lw.Record:
    record = chain_record(2, duration=0.6, sensors=sensors).with_noise(30.0, seed=35)
    if not clipped:
        return record
    peak = 0.5 * np.max(np.abs(record.values), axis=0)
    return lw.inspection.mark_missing(
        replace(record, values=np.clip(record.values, -peak, peak), simulated=None)
    )


def pair_driven() -> lw.Record:
    forces = {"m1": WAVE, "m2": f"0.6*cos(7*t) - 0.5*({WAVE})"}
    return lw.simulate(PAIR, forces=forces, duration=1.0, rate=200.0).with_noise(35.0, seed=1)


#: A sink that also remembers, on a cantilever whose shapes are known to within.
BEAM = structure(
    {"sink": 0.03},
    link("nes", "sink-beam.tip", NES, **CANTILEVER_SINK),
    link("creep", "sink-beam.tip", "k*z", {"z": "v + pull*d - z/tau"}, k=50.0, pull=30.0, tau=0.01),
    hosts=[host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES).known_to_within(shape=0.02)],
)


def hit_beam() -> lw.Record:
    hit = {"beam.mid": "80*exp(-((t - 0.05)/0.002)**2)"}
    sensors = ["a:beam.tip", "a:beam.root", "a:sink"]
    return lw.simulate(BEAM, forces=hit, duration=0.1, rate=1000.0, sensors=sensors).with_noise(25.0, seed=42)


# records, structure, what is unknown of sensors, and by how much slopes may differ
ERRORS_OF_SENSORS: dict[str, tuple[list[lw.Record], lw.Structure, list[Term], float]] = {
    "offset and gain": (
        [chain_released()], lw.bnes_chain(2), [Offset("x:m2"), Gain("x:m2")], 1e-4,
    ),
    "drift and hum": (
        [chain_released()], lw.bnes_chain(2), [Drift("x:m2"), Hum("x:m1", 50.0), Gain("x:m2")], 1e-4,
    ),
    "clipped": ([chain_released(clipped=True)], lw.bnes_chain(2), [Gain("x:m2")], 2e-3),
    "delays": (
        [chain_released(SENSORS)], lw.bnes_chain(2), [Delay("v:m1"), Delay("x:m2"), Gain("v:m1")], 1e-3,
    ),
    "forces": (
        [pair_driven(), pair_driven()[:107]],
        PAIR,
        [*map(Gain, ("force:m2", "x:m1", "force:m1")), *map(Delay, ("force:m1", "x:m2", "force:m2"))],
        1e-2,
    ),
    "calibration": ([chain_released()], lw.bnes_chain(2), [Gain("x:m2", 0.01)], 1e-4),
    "shapes of a host": ([hit_beam()], BEAM, [Gain("a:sink")], 1e-2),
}  # fmt: skip


@cache
def beside_optimum(kind: str) -> tuple[Scales, Segments, Iterate]:
    """After some steps of a search, with all but the states moved."""
    records, true, unknown, _ = ERRORS_OF_SENSORS[kind]
    asked = true.unknown("all")
    options = LikelihoodOptions(unknown, model_error=False, steps=3)
    start = likelihood_fit(records, asked, truth(true, asked), options=options).optimum
    shift = 0.03 * np.random.default_rng(3).normal(size=len(start.scales.theta)) * start.scales.theta
    shift[: len(asked.parameters)] *= 1e-3
    return start.scales, start.segments, start.point.moved(start.point.nodes, start.point.border + shift)


@pytest.mark.parametrize("kind", ERRORS_OF_SENSORS)
@pytest.mark.parametrize("q", [1e3, 1e-3])
def test_slopes_by_errors_of_sensors_are_the_costs_differences(kind: str, q: float) -> None:
    """Of data alone, and beside defects, to which errors of forces add; columns are in single precision."""
    _, true, _, tolerance = ERRORS_OF_SENSORS[kind]
    scales, segments, point = beside_optimum(kind)

    def cost(border: np.ndarray) -> float:
        return evaluate(segments, point.moved(point.nodes, border), scales, Gaussian()).cost(q)

    linear = linearise(evaluate(segments, point, scales, Gaussian()))
    computed = -2.0 * linear.equations(q).corner_gradient
    names = [parameter.name for parameter in true.unknown("all").parameters]
    shapes = [number for number, name in enumerate(names) if ".shape." in name]
    assert len(shapes) == (9 if true is BEAM else 0)
    for number in some([*shapes, *range(len(names), len(computed))]):
        step = EPS * scales.theta * (np.arange(len(computed)) == number)
        quotient = (cost(point.border + step) - cost(point.border - step)) / (2.0 * EPS)
        assert computed[number] == pytest.approx(quotient, rel=tolerance), number


def readings(sides: Floats) -> ClippedReadings:
    """Readings at 2 units, and a sample that is none behind them."""
    present = np.append(np.ones(len(sides), dtype=bool), False)[:, None, None]
    return ClippedReadings(present, 2.0 * present, np.append(sides, 0.0)[:, None, None])


def test_cost_is_that_of_the_probability_of_a_reading_at_the_bound_or_beyond() -> None:
    sides, motion = np.array([1.0, -1.0, 0.0]), np.array([2.6, 2.4, 1.5, 9.0])
    misfit = readings(sides).misfit(-motion[:, None, None] / 0.5, np.array(0.5))
    log_likelihood = norm.logsf(2.0, 2.6, 0.5) + norm.logcdf(2.0, 2.4, 0.5) - 0.5 * ((2.0 - 1.5) / 0.5) ** 2
    assert misfit.cost == pytest.approx(-2.0 * log_likelihood, rel=1e-12)
    assert misfit.residuals[3, 0, 0] == misfit.roots[3, 0, 0] == misfit.shown[3, 0, 0] == 0.0
