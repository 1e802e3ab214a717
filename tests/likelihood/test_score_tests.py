"""Score tests of what a fit lacks: against the same forces really there, fits with them, and finer or fewer steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from present import present
from problems import bent_chain, chain_record, rubbing_trio
from random_force import random_force
from structures import HARDENING, link, oscillator, structure, with_links

import linkwise as lw
from linkwise.likelihood.fit import LikelihoodFit, Optimum, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import SensorModel
from linkwise.likelihood.shooting.flow import Inputs, Trajectories
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.starts.values import starting_values
from linkwise.likelihood.tests import diagnosis
from linkwise.likelihood.tests import score_test as module
from linkwise.likelihood.tests.diagnosis import TestedCauses
from linkwise.likelihood.tests.score_test import (
    CandidateForce,
    LocalQuadratic,
    SingleTests,
    finite_columns,
    local_quadratic,
    single_tests,
)
from linkwise.model.law import Law

#: Of sqrt(H_ii H_jj): tangents are in single precision, and forces that are not there pass through the middles of the steps
#: that interpolation finds, where those of the structure pass through the middles of the flow.
SAME = 1e-3


@dataclass(frozen=True)
class Missing:
    """A link that the fit does not have: its ends, by number (-1 the ground, -2 the base), and its law without coefficient."""

    ends: tuple[int, int]
    law: str

    @property
    def force(self) -> CandidateForce:
        return CandidateForce(*self.ends, Law.parse(self.law))


PAIRS = (
    Missing((0, -1), "d**3"),
    Missing((0, -1), "v"),
    Missing((1, -1), "d"),
    Missing((1, 0), "d**2"),
    Missing((1, 0), "tanh(v/0.3)"),
)


def widened(subject: lw.Structure, missing: Sequence[Missing]) -> lw.Structure:
    """`subject` with every missing force as a link of its own, of unknown size."""
    holds = {-1: "ground", -2: "base"}
    names = dict(enumerate(subject.mass_names)) | holds
    added = [
        link(f"added{number}", f"{names[term.ends[0]]}-{names[term.ends[1]]}", f"size*{term.law}")
        for number, term in enumerate(missing)
    ]
    return with_links(subject, *added)


def really_there(
    fit: LikelihoodFit,
    records: Sequence[lw.Record],
    structure: lw.Structure,
    missing: Sequence[Missing],
    options: LikelihoodOptions,
) -> LocalQuadratic:
    """The parabola at the same optimum of the structure that has the forces, all of size zero."""
    unknown = widened(structure, missing)
    optimum, sensing = fit.optimum, SensorModel.of(records, options.offsets, options.gains)
    p, f = len(structure.parameters), len(missing)
    segments = sensing.segments(records, unknown, System.of(unknown), optimum.segments.refine)
    segments = replace(segments, tangent_refine=optimum.segments.tangent_refine)
    theta = np.concatenate([optimum.point.theta, np.zeros(f)])
    scale = np.concatenate([optimum.scales.theta[:p], np.full(f, 3.0), optimum.scales.theta[p:]])
    return local_quadratic(
        replace(
            optimum,
            segments=segments,
            point=replace(optimum.point, theta=theta),
            scales=replace(optimum.scales, theta=scale),
        ),
        [],
    )


def fitted(
    true: lw.Structure, records: Sequence[lw.Record], options: LikelihoodOptions
) -> tuple[LikelihoodFit, lw.Structure]:
    """A fit that begins a little off."""
    unknown = true.unknown("all")
    start = np.array(
        [1.02 * present(true.coefficient(parameter.name).value) for parameter in unknown.parameters]
    )
    fit = likelihood_fit(records, unknown, start, spread=0.05 * np.abs(start), options=options)
    return fit, unknown


def apart(quadratic: LocalQuadratic, expected: LocalQuadratic) -> tuple[float, float]:
    """The largest differences of curvature and slope, in units of what either could be."""
    unit = np.sqrt(expected.curvature.diagonal())
    curved = (quadratic.curvature - expected.curvature) / np.outer(unit, unit)
    reach = np.sqrt(expected.slope @ np.linalg.solve(expected.curvature, expected.slope))
    return float(np.abs(curved).max()), float(np.abs((quadratic.slope - expected.slope) / unit).max() / reach)


def noisy_record(seed: int, **more: Any) -> lw.Record:
    return chain_record(2, duration=2.0, **more).with_noise(30.0, seed=seed)  # fmt: skip


@pytest.fixture(scope="module")
def free() -> tuple[lw.Structure, list[lw.Record], LikelihoodOptions]:
    return lw.bnes_chain(2), [noisy_record(1000)], LikelihoodOptions()


@pytest.fixture(scope="module")
def calibrated() -> tuple[lw.Structure, list[lw.Record], LikelihoodOptions]:
    """An offset and a gain in the border, and two records of different noise."""
    record = noisy_record(1001, sensors=("x", "v")).select(("x:m1", "x:m2", "v:m2"))
    values = record.values + np.array([0.0, 0.002, 0.0])
    values[:, 2] *= 1.1
    noisier = {name: 2.0 * sigma for name, sigma in record.noise.items()}
    records = [replace(record, values=values), replace(record, values=values, noise=noisier)]
    return lw.bnes_chain(2), records, LikelihoodOptions(offsets=("x:m2",), gains=("v:m2",))


@pytest.fixture(scope="module")
def based() -> tuple[lw.Structure, list[lw.Record], LikelihoodOptions]:
    """A base that moves, a force, friction, and sensors of all kinds."""
    true = rubbing_trio()
    record = lw.simulate(
        true, duration=2.0, rate=1000.0, sensors=("x", "v", "a"), release={"v:m1": 1.0},
        forces={"m2": "5*sin(400*t)"}, base="0.001*sin(300*t)",
    ).with_noise(30.0, seed=1002)  # fmt: skip
    names = ("x:m1", "v:m2", "x:m2", "a:m3", "x:m3", "force:m2", "x:base")
    return true, [record.select(names)], LikelihoodOptions()


@pytest.fixture(scope="module")
def stiff() -> tuple[lw.Structure, list[lw.Record], LikelihoodOptions]:
    """A gram on 2.5 kN/m at 1 kHz: steps of the flow shorter than the samples."""
    true = structure(
        {"m1": 1.0, "m2": 0.001},
        link("spring", "m1-ground", "k*d + c*v", k=30000.0, c=1.0),
        link("nes1", "m2-m1", HARDENING, k=2500.0, k3=1e7, c=0.02),
    )
    record = lw.simulate(true, release={"v:m1": 1.0, "v:m2": 3.0}, duration=1.0, rate=1000.0)
    return true, [record.with_noise(40.0, seed=1003)], LikelihoodOptions()


@pytest.mark.parametrize("case", ["free", "calibrated", "based", "stiff"])
def test_forces_of_size_zero_curve_the_cost_as_if_they_were_there(
    case: str, request: pytest.FixtureRequest
) -> None:
    true, records, options = request.getfixturevalue(case)
    more = (Missing((1, -2), "d"), Missing((2, -2), "v"), Missing((2, 1), "v")) if case == "based" else ()
    missing = (*PAIRS, *more)
    fit, unknown = fitted(true, records, options)
    assert fit.status.name == "CONVERGED"
    assert (fit.optimum.segments.refine > 1) == (case == "stiff")
    quadratic = local_quadratic(fit.optimum, [missing_term.force for missing_term in missing])
    expected = really_there(fit, records, unknown, missing, options)
    assert max(apart(quadratic, expected)) < SAME
    wrong = local_quadratic(
        fit.optimum,
        [replace(missing_term.force, law=Law.parse(f"1.01*{missing_term.law}")) for missing_term in missing],
    )
    assert max(apart(wrong, expected)) > SAME


def test_what_a_force_takes_off_the_cost_and_its_size_are_those_of_a_fit_with_it() -> None:
    """A weak k2 in the sink that the fit lacks, and the parabola foresees the fit that has it."""
    chain = lw.bnes_chain(2)
    records = [bent_chain(250.0).record(1004)]
    fit, unknown = fitted(chain, records, LikelihoodOptions(model_error=False))
    missing = Missing((1, 0), "d**2")
    quadratic = local_quadratic(fit.optimum, [missing.force])
    values = np.linalg.solve(quadratic.curvature, quadratic.slope)
    error = np.sqrt(np.linalg.inv(quadratic.curvature).diagonal())
    z = values[-1] / error[-1]
    whole = widened(unknown, [missing])
    again = likelihood_fit(
        records, whole, np.append(fit.values, 0.0), spread=np.append(error[:-1], 10 * error[-1])
    )
    took = fit.misfit.cost(fit.optimum.q) - again.misfit.cost(again.optimum.q)
    # two fits end within 0.02 of their least cost each; beyond, the parabola is the cost to the third order in the force
    assert took == pytest.approx(z**2, rel=0.01)
    # the same third order, of a value of ten deviations
    assert abs(values[-1] - again.values[-1]) < 0.05 * error[-1]
    # far from chance, and the truth within four deviations (6e-5)
    assert abs(z) > 8.0 and abs(values[-1] - 250.0) < 4.0 * error[-1]
    elsewhere = local_quadratic(fit.optimum, [replace(missing, ends=(1, -1)).force])
    # what must be refused: an order more than the 0.01 above
    assert np.linalg.solve(elsewhere.curvature, elsewhere.slope)[-1] != pytest.approx(values[-1], rel=0.1)


@pytest.mark.parametrize("row", [0, 1], ids=["x", "v"])
def test_the_middles_of_the_steps_are_of_the_sixth_order(row: int) -> None:
    """x and v there, of a motion that is known, at steps of one half: errors fall by 2^6 and more."""

    def error(steps: int) -> float:
        h = 1.0 / steps
        ends, middles = np.arange(steps + 1) * h, (np.arange(steps) + 0.5) * h
        x, v, a = np.sin(3.0 * ends), 3.0 * np.cos(3.0 * ends), -9.0 * np.sin(3.0 * ends)
        none = np.zeros((steps + 1, 2, 0, 1))
        orbit = Trajectories(
            np.stack([x, v * h], axis=1)[:, :, None, None],
            none,
            a[:, None, None],
            none[1:],
            np.zeros((steps, 1, 1)),
            none[:, 0],
            none[1:, 0],
        )
        computed = module.states_at_ends_and_middles(orbit, 1, np.array([h]), Inputs())[1][:, row, 0, 0]
        return float(np.abs(computed - (np.sin(3.0 * middles), 3.0 * np.cos(3.0 * middles))[row]).max())

    orders = [np.log2(error(steps) / error(2 * steps)) for steps in (5, 10, 20)]
    # the declared order; the next term falls by 2^2 a halving
    assert np.all(np.abs(np.array(orders) - 6.0) < 0.2), orders


def test_masses_at_rest_and_no_forces_do_no_harm(
    free: tuple[lw.Structure, list[lw.Record], LikelihoodOptions],
) -> None:
    """A force that never acts (the contact of a gap that never closes) has no curvature; no force leaves the fit's own."""
    true, records, options = free
    fit, _ = fitted(true, records, options)
    alone = local_quadratic(fit.optimum, [])
    p = len(fit.values)
    assert alone.curvature.shape == (p, p)
    np.testing.assert_allclose(np.linalg.inv(alone.curvature), fit.covariance, rtol=1e-3)
    np.testing.assert_allclose(np.linalg.solve(alone.curvature, alone.slope), fit.values, rtol=1e-3)
    never = local_quadratic(fit.optimum, [CandidateForce(1, 0, Law.parse("max(d - 1, 0)")), PAIRS[0].force])
    assert never.curvature[p, p] == 0.0 == never.slope[p]
    assert never.curvature[p + 1, p + 1] > 0.0


@pytest.mark.parametrize("rounding", [-6.7e-6, 0.0, 6.7e-6])
def test_a_column_of_which_rounding_is_left_is_not_tested(rounding: float) -> None:
    """An offset that drifts stand for: numbers of a record whose diagnosis told a gain of 8e299."""
    curvature, slope = np.diag([7.2e6, 7.2e6, 491.8]), np.array([0.0, 4e3, 3e-3])
    scatter = np.diag([5e6, 5e6, rounding])
    tests = single_tests(curvature, slope, scatter, 1)
    assert tests.gains[0] == pytest.approx(4e3**2 / 5e6)  # of a column beside it, which is tested
    assert tests.gains[1] == 0.0
    assert np.isfinite(tests.sizes).all() and np.isfinite(tests.deviations).all()
    least = 0.05 / 1.95  # of white noise at the Nyquist frequency, with a pole of 0.95
    coloured = single_tests(curvature, slope, np.diag([5e6, 5e6, least * 491.8]), 1)
    assert coloured.gains[1] == pytest.approx(3e-3**2 / (least * 491.8))


PARAMETERS, TESTED = 2, 3


def equations(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (N, p + f) of parameters and what is tested, and residuals (N,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((60, PARAMETERS + TESTED)), rng.standard_normal(60)


def test_a_gain_is_what_a_fit_of_the_column_takes_off() -> None:
    columns, residuals = equations(1)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    tests = single_tests(curvature, slope, curvature, PARAMETERS)

    def cost(names: list[int]) -> tuple[float, np.ndarray]:
        solution, *_ = np.linalg.lstsq(columns[:, names], residuals)
        return float(np.sum((residuals - columns[:, names] @ solution) ** 2)), solution

    own = list(range(PARAMETERS))
    without, _ = cost(own)
    fitted = [cost([*own, PARAMETERS + number]) for number in range(TESTED)]
    np.testing.assert_allclose(tests.gains, [without - gone for gone, _ in fitted], rtol=1e-8)
    np.testing.assert_allclose(tests.sizes, [solution[-1] for _, solution in fitted], rtol=1e-8)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("white", [True, False])
def test_a_column_that_is_not_finite_leaves_the_others_as_they_are(value: float, white: bool) -> None:
    """One such column ended the tests of all, so that no error of a sensor and no missing term was named."""
    columns, residuals = equations(2)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    scatter = curvature if white else 1.5 * curvature
    apart = single_tests(curvature, slope, scatter, PARAMETERS)
    broken, steep = curvature.copy(), slope.copy()
    infinite = PARAMETERS + 1
    broken[infinite], broken[:, infinite], steep[infinite] = value, value, value
    spread = broken if white else 1.5 * broken
    tests = single_tests(broken, steep, spread, PARAMETERS)
    assert finite_columns(broken, steep, spread, PARAMETERS).tolist() == [True, False, True]
    assert tests.gains[1] == 0.0 and tests.sizes[1] == 0.0
    others = [0, 2]
    np.testing.assert_allclose(tests.gains[others], apart.gains[others], rtol=1e-12)
    np.testing.assert_allclose(tests.sizes[others], apart.sizes[others], rtol=1e-12)
    np.testing.assert_allclose(tests.deviations[others], apart.deviations[others], rtol=1e-12)
    np.testing.assert_allclose(tests.changes[:, others], apart.changes[:, others], rtol=1e-12)


def in_short_segments(fit: LikelihoodFit, *, longest: bool = False) -> tuple[Optimum, Misfit]:
    return fit.optimum, fit.misfit


class Tests:
    """Score tests of all coefficients of a chain in a record of so many seconds."""

    __test__ = False  # no test of pytest

    def __init__(self, masses: int, duration: float) -> None:
        self.record = chain_record(masses, duration=duration).with_noise(25.0, seed=71)
        self.asked = lw.bnes_chain(masses).unknown("all")
        theta, spread = starting_values([self.record], self.asked, None)
        self.fit = likelihood_fit([self.record], self.asked, theta, spread=spread)
        assert self.fit.model_error == 0.0
        values = {p.name: float(v) for p, v in zip(self.asked.parameters, self.fit.values, strict=True)}
        self.identified = self.asked.with_values(values)

    def __call__(self) -> tuple[TestedCauses, SingleTests]:
        """What is tested, and the tests of each."""
        tested = diagnosis.tested_causes(self.fit, self.identified, self.record.channels, terms=False)
        size = len(self.fit.values)
        return tested, single_tests(tested.curvature, tested.slope, tested.scatter, size)


@pytest.mark.parametrize(
    ("masses", "duration", "joined"), [(2, 2.0, 4), (4, 2.0, 4), (2, 3.0, 6), (4, 1.5, 8)]
)
def test_score_tests_are_those_of_short_segments(
    monkeypatch: pytest.MonkeyPatch, masses: int, duration: float, joined: int
) -> None:
    """Gains to within a hundredth of what chance gives them, sizes and deviations to a tenth, as single precision leaves."""
    tests = Tests(masses, duration)
    tested, longer = tests()
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    of_short, short = tests()
    many = of_short.errors.values.shape[-1]
    assert tested.errors.values.shape[-1] == -(-many // joined)
    assert np.max(np.abs(longer.gains - short.gains)) < 0.02
    assert np.max(np.abs(longer.sizes - short.sizes) / short.deviations) < 0.1
    assert np.max(np.abs(longer.deviations / short.deviations - 1.0)) < 0.1


def test_score_tests_of_many_masses_are_those_of_short_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    """In standard deviations to a twentieth: columns reach parts of the structure only, and farther in longer segments."""
    tests = Tests(26, 2.0)
    tested, longer = tests()
    monkeypatch.setattr(diagnosis, "in_longer_segments", in_short_segments)
    of_short, short = tests()
    assert tested.errors.values.shape[-1] == -(-of_short.errors.values.shape[-1] // 4)
    scores = [np.sign(own.sizes) * np.sqrt(own.gains) for own in (longer, short)]
    assert np.max(np.abs(scores[0] - scores[1])) < 0.05 * tests.fit.optimum.noise
    assert np.max(np.abs(longer.deviations / short.deviations - 1.0)) < 0.1


RATE, DURATION = 200.0, 10.0
CUBIC = oscillator("k*d + c*v + k3*d**3", k=987.0, c=6.0, k3=4e4)
LINEAR = oscillator("k*d + c*v", k=987.0, c=6.0).unknown("all")


@pytest.fixture(scope="module")
def in_load_cell() -> lw.Record:
    forces = {"m1": random_force(np.random.default_rng(3), DURATION, RATE)}
    return lw.simulate(CUBIC, forces=forces, duration=DURATION, rate=RATE, sensors=["x", "f"])


def with_noise_of(in_load_cell: lw.Record, displacement: float, load: float) -> lw.Record:
    """The record with noise of these standard deviations in m and N."""
    rng = np.random.default_rng(4)
    deviations = {"x:m1": displacement, "f:link": load, "force:m1": 0.0}
    channels = {
        name: in_load_cell.channel(name) + sigma * rng.standard_normal(len(in_load_cell))
        for name, sigma in deviations.items()
    }
    return lw.Record.from_arrays(in_load_cell.time, channels)


@pytest.mark.parametrize(("displacement", "load"), [(3e-4, 0.05), (1e-3, 0.02)])
def test_a_missing_term_is_found_in_the_load_cell_as_large_as_a_fit_finds_it(
    in_load_cell: lw.Record, displacement: float, load: float
) -> None:
    """It was tested in the motion alone, and d**5 named in its place with up to half more than its force."""
    record = with_noise_of(in_load_cell, displacement, load)
    lacking, fitted = lw.identify(record, LINEAR), lw.identify(record, CUBIC.unknown("all"))
    cause = lacking.diagnosis[0]
    assert (cause.kind, cause.where, cause.term) == ("term", "link", "d**3")
    k3, unit = fitted.coefficient("link.k3"), np.sqrt(np.mean(in_load_cell.channel("x:m1") ** 6))
    # the first order, in the motion that the wrong law follows: a term of 2 % of the force changes that by as much
    assert cause.size == pytest.approx(k3.value * unit, rel=0.03)
    assert cause.standard_error > present(k3.standard_error) * unit  # with the model error of the wrong law


def test_a_law_that_lacks_nothing_has_no_cause_in_its_load_cell(in_load_cell: lw.Record) -> None:
    fit = lw.identify(with_noise_of(in_load_cell, 3e-4, 0.05), CUBIC.unknown("all"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.diagnosis == ()
