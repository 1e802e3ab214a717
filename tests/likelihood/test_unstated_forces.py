"""Random forces that nobody stated beside those that were, and stated ones that are too small."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
from present import some
from structures import oscillator, row_of_masses

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.variance_score import SquareSum, VarianceScore
from linkwise.verdict import Verdict

RATE, SUBSTEPS, COUNT, STEADY = 100.0, 4, 1500, 2000
STIFFNESS, DAMPING = 1000.0, 1.0  # N/m, N s/m; masses of 1 kg
DENSITY = np.sqrt(2.0 / RATE)  # N/sqrt(Hz) of 1 N a sample
DRAWN = 500  # draws of a sum of squares: 124750 pairs


def chain(n: int) -> lw.Structure:
    link = "k*d + c*v", {"k": STIFFNESS, "c": DAMPING}
    return row_of_masses([1.0] * n, **{f"l{i}": link for i in range(1, n + 1)})


def displacements(forces: Floats) -> Floats:
    """(N, n) of the chain in forces (N * SUBSTEPS, n) that are constant in each substep."""
    n = forces.shape[1]
    incidence, still = np.eye(n) - np.eye(n, k=1), np.zeros((n, n))
    pulls = incidence @ incidence.T
    matrix = np.block(
        [[still, np.eye(n), still], [-STIFFNESS * pulls, -DAMPING * pulls, np.eye(n)], [np.zeros((n, 3 * n))]]
    )
    step = scipy.linalg.expm(matrix / (RATE * SUBSTEPS))[: 2 * n]
    state, out = np.zeros(2 * n), np.empty((len(forces) // SUBSTEPS, n))
    for number, force in enumerate(forces):
        if number % SUBSTEPS == 0:
            out[number // SUBSTEPS] = state[:n]
        state = step @ np.append(state, force)
    return out


@cache
def shaken(deviations: tuple[float, ...], seed: int) -> lw.Record:
    """Displacements in independent white forces of so many N a sample, which no channel shows."""
    rng, n = np.random.default_rng(seed), len(deviations)
    forces = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + COUNT) * SUBSTEPS, n)) * deviations
    x = displacements(forces)[STEADY:]
    channels = tuple(f"x:m{i}" for i in range(1, n + 1))
    return lw.Record(0.0, RATE, channels, x + 1e-4 * rng.standard_normal(x.shape))


@cache
def with_load_cell(seed: int) -> lw.Record:
    """Two masses, a force on the first of about 1 N that is held between its samples, whose channel has noise of 0.1 N."""
    rng = np.random.default_rng(seed)
    applied = np.convolve(rng.standard_normal(COUNT), np.ones(4) / 2.0, mode="same")
    forces = np.column_stack([np.repeat(applied, SUBSTEPS), np.zeros(COUNT * SUBSTEPS)])
    x = displacements(forces)
    shown = [x + 1e-5 * rng.standard_normal(x.shape), applied + 0.1 * rng.standard_normal(COUNT)]
    channels = ("x:m1", "x:m2", "force:m1")
    return lw.Record(0.0, RATE, channels, np.column_stack(shown), interpolation={"force:m1": "held"})


@pytest.mark.parametrize(("named", "unnamed"), [("m1", "m2"), ("m2", "m1")])
@pytest.mark.parametrize("seed", [51, 52])
def test_an_ambient_force_on_a_mass_that_is_not_named_takes_trust_and_is_told(
    named: str, unnamed: str, seed: int
) -> None:
    fit = lw.identify(shaken((1.0, 1.0), seed), chain(2).unknown("all"), ambient=[named])
    assert fit.fit_verdicts == (Verdict.MEASUREMENT_ERROR,)
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.unit, cause.is_instrument) == (
        "ambient",
        unnamed,
        "N/sqrt(Hz)",
        True,
    )
    assert cause.description in fit.message
    assert f"allow for an ambient force on {unnamed}" in fit.message
    # one step of the score from a deviation of zero: to the first order
    assert cause.size == pytest.approx(DENSITY, rel=0.2)


@pytest.mark.parametrize(
    ("deviations", "named"), [((1.0, 0.0), "m1"), ((0.0, 1.0), "m2"), ((1.0, 0.0, 0.0), "m1")]
)
def test_masses_on_which_no_force_acts_are_not_told(deviations: tuple[float, ...], named: str) -> None:
    fit = lw.identify(shaken(deviations, 53), chain(len(deviations)).unknown("all"), ambient=[named])
    assert fit.trusted, fit.message


@pytest.mark.parametrize(("deviations", "seed"), [((1.0, 0.0), 61), ((1.0, 0.0, 0.0), 65)])
def test_a_force_that_is_looked_for_and_does_not_act_is_zero_below_a_limit(
    deviations: tuple[float, ...], seed: int
) -> None:
    """The search for its deviation, which would shrink for ever, ends."""
    fit = lw.identify(shaken(deviations, seed), chain(len(deviations)).unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    last = some([force for force in fit.random_forces[1:] if force.deviation == 0.0])[-1]
    assert (last.spectral_density, last.found) == (0.0, True)
    # forces of a tenth of that on m1 are told in such records
    assert last.upper_limit is not None and 0.0 < last.upper_limit < 0.1 * DENSITY
    assert f"No ambient force on {last.where} was found: it is below" in last.description
    assert last.description in fit.findings
    upper_limits = {force["where"]: force["upper_limit"] for force in fit.to_dict()["random_forces"]}
    assert upper_limits[last.where] == last.upper_limit
    assert fit.random_forces[0].upper_limit is None


def test_forces_that_are_looked_for_in_a_free_decay_are_absent() -> None:
    record = lw.simulate(chain(2), release={"v:m1": 1.0}, duration=15.0, rate=RATE).with_noise(40.0, seed=63)
    fit = lw.identify(record, chain(2).unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    assert fit.random_forces[0].deviation == 0.0
    assert fit.random_forces[1].deviation < 1e-3  # of forces of some N in the springs


def test_a_stated_ambient_force_may_be_too_small_and_not_right() -> None:
    record, unknown = shaken((1.0, 1.0), 54), chain(2).unknown("all")
    small = lw.identify(record, unknown, ambient={"m1": DENSITY, "m2": 0.3 * DENSITY})
    assert not small.trusted
    [cause] = [cause for cause in small.diagnosis if cause.kind == "ambient"]
    assert cause.where == "m2"
    assert cause.size == pytest.approx(DENSITY, rel=0.2)
    assert cause.description.endswith("(0.0424 was stated)")
    assert lw.identify(record, unknown, ambient={"m1": DENSITY, "m2": DENSITY}).trusted


@pytest.mark.parametrize("seed", [55, 56])
def test_noise_of_an_input_that_is_stated_too_small_is_told(seed: int) -> None:
    record, unknown = with_load_cell(seed), chain(2).unknown("all")
    fit = lw.identify(record, unknown, input_noise={"force:m1": 0.07})
    assert not fit.trusted
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("input noise", "force:m1")
    assert fit.diagnosis[0].size == pytest.approx(0.1, rel=0.2)
    assert "(0.07 was stated)" in fit.message
    assert lw.identify(record, unknown, input_noise={"force:m1": 0.1}).trusted


def test_noise_of_a_force_is_told_beside_an_ambient_one() -> None:
    fit = lw.identify(with_load_cell(57), chain(2).unknown("all"), ambient={"m2": 1e-4})
    assert not fit.trusted
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("input noise", "force:m1")


def test_the_efficient_score_is_that_of_a_regression_on_the_scores_of_what_was_found() -> None:
    """Of slopes that share a part, whose covariance is known."""
    rng = np.random.default_rng(58)
    root = np.array([[1.0, 0.0], [0.8, 0.6]])  # of pairs of slopes: a correlation of 0.8
    K = 200
    pairs = rng.standard_normal((K, DRAWN, 2)) @ root.T
    tested, estimated = (
        SquareSum.of(np.sqrt(1.5) * slopes[:, 0], slopes[:, 1:]) for slopes in np.moveaxis(pairs, -1, 0)
    )
    score = VarianceScore.of(tested, [estimated])
    assert score is not None
    # traces: K of each, 0.64 K of both; excess and square of what is left after the regression
    assert 2.0 / score.error**2 == pytest.approx(K * (1.0 - 0.64**2), rel=0.05)
    assert score.excess == pytest.approx(
        (tested.total - K) - 0.64 * (estimated.total - K), abs=0.2 * np.sqrt(2.0 * K)
    )
    alone = VarianceScore.of(tested)
    assert alone is not None
    assert alone.deviation**2 == pytest.approx((tested.total - K) / K, rel=0.1)
    assert VarianceScore.of(tested, [tested]) is None


def test_a_force_that_may_be_chance_is_told_with_a_limit() -> None:
    """A force of 0.008 N/sqrt(Hz), about what the record shows of one beside its own noise; 4 s of a Duffing oscillator."""
    rate, density = 400.0, 0.008
    rng = np.random.default_rng(2403)
    time = np.arange(1601) / rate
    known = 20.0 * np.sin(40.0 * time) + 10.0 * np.sin(63.0 * time)
    ambient = density * np.sqrt(rate / 2.0) * rng.standard_normal(len(time))
    frame = oscillator("k*d + k3*d**3 + c*v", mass=1.0, name="s", k=2000.0, k3=2e5, c=1.0)
    applied = lw.model.Sampled(0.0, rate, known + ambient, band_limited=True)
    record = lw.simulate(frame, forces={"m1": applied}, duration=4.0, rate=rate).with_noise(30.0, seed=2403)
    values = record.values.copy()
    values[:, record.channels.index("force:m1")] = known
    fit = lw.identify(replace(record, values=values), frame.unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    [force] = fit.random_forces
    assert force.upper_limit is not None
    assert 0.0 < force.spectral_density < force.upper_limit
    assert density < force.upper_limit < 2.0 * density
    assert "it may be chance, and is below" in force.description
    assert force.description in fit.findings
