"""What is known beforehand: priors of coefficients and masses, and the calibration of sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy
from present import present
from problems import chain_record

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.prior import Prior
from linkwise.likelihood.shooting.residuals import evaluate

CHAIN = lw.bnes_chain(2)
TRUTH = {p.name: present(CHAIN.coefficient(p.name).value) for p in CHAIN.unknown("all").parameters}


def known_within(structure: lw.Structure, start: float, sigma: float) -> lw.Structure:
    """The structure with a prior of its second mass."""
    first, second = structure.masses
    mass = replace(second, mass=lw.Coefficient.unknown(start, sigma=sigma))
    return replace(structure, masses=(first, mass))


def miscalibrated(record: lw.Record, deviation: float, seed: int) -> lw.Record:
    """The record with gains drawn about 1, one for each channel."""
    gains = 1.0 + deviation * np.random.default_rng(seed).standard_normal(record.values.shape[1])
    return replace(record, values=record.values * gains)


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return chain_record(2, duration=3.0).with_noise(40.0, seed=1)


def test_a_prior_counts_once_in_gradient_curvature_and_cost(record: lw.Record) -> None:
    unknown = known_within(CHAIN.unknown("nes"), 0.0101, 1e-4)
    fit = likelihood_fit([record[:300]], unknown, np.array([-100.0, 1e6, 0.02, 0.0101]))
    optimum, prior = fit.optimum, present(fit.segments.prior)
    free = replace(optimum.segments, prior=None)
    point = replace(optimum.point, theta=optimum.point.theta * 1.003)
    both = [
        linearise(segments, evaluate(segments, point, optimum.scales, Gaussian()), optimum.scales, Gaussian())
        for segments in (optimum.segments, free)
    ]
    unit, mass = optimum.scales.theta[3], point.theta[3]
    curvature = both[0].data.corner - both[1].data.corner
    slope = both[0].data.corner_gradient - both[1].data.corner_gradient
    assert curvature[3, 3] == pytest.approx((unit / 1e-4) ** 2, rel=1e-5)  # the rest is in single precision
    assert np.count_nonzero(curvature) == 1
    # likewise
    assert slope[3] == pytest.approx((0.0101 - mass) * unit / 1e-4**2, rel=1e-5)
    costs = [
        evaluate(segments, point, optimum.scales, Gaussian()).cost(1.0)
        for segments in (optimum.segments, free)
    ]
    assert costs[0] - costs[1] == pytest.approx(((mass - 0.0101) / 1e-4) ** 2, rel=1e-8)
    assert prior.count == 1


def test_a_mass_that_is_known_to_within_is_found_between_prior_and_record(record: lw.Record) -> None:
    """The product of two normal densities, of the prior and of the fit without it (an applied force sets no scale here, but
    the other mass does)."""
    prior = lw.identify(record, known_within(CHAIN.unknown("all"), 0.010002, 1e-6)).coefficient("m2.mass")
    free = lw.identify(record, known_within(CHAIN.unknown("all"), 0.010002, 1.0)).coefficient("m2.mass")
    weights = np.array([1e-6, present(free.standard_error)]) ** -2.0
    joined = weights @ [0.010002, free.value] / weights.sum()
    # the likelihood is quadratic over its own errors to some per cent
    assert prior.value == pytest.approx(joined, abs=0.05 * weights.sum() ** -0.5)
    assert present(prior.standard_error) == pytest.approx(weights.sum() ** -0.5, rel=0.05)


@pytest.mark.parametrize("method", ["ml", "weak"])
def test_a_value_that_the_record_contradicts_is_not_trusted(method: str, record: lw.Record) -> None:
    right = lw.identify(record, known_within(CHAIN.unknown("all"), 0.0101, 1e-4), method=method)  # type: ignore[arg-type]
    wrong = lw.identify(record, known_within(CHAIN.unknown("all"), 0.0120, 1e-4), method=method)  # type: ignore[arg-type]
    assert right.trusted and not wrong.trusted
    assert wrong.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR and "m2.mass" in wrong.message


def test_sparse_regression_and_discovery_refuse_what_they_would_not_count(record: lw.Record) -> None:
    unknown = known_within(CHAIN.unknown("nes"), 0.0101, 1e-4)
    with pytest.raises(lw.IdentificationError, match=r"m2\.mass is stated with a sigma"):
        lw.identify(record, unknown, method="sindy")
    with pytest.raises(lw.StructureError, match=r"m2\.mass is stated with a sigma"):
        lw.discover(record, lw.model.PartialStructure(unknown.masses, ()))


def test_calibration_widens_only_what_a_gain_may_change(record: lw.Record) -> None:
    """All gains 1 % larger leave a linear law as it is and make a cubic coefficient 2 % smaller."""
    unknown = CHAIN.unknown("all")
    sharp = lw.identify(record, unknown)
    wide = lw.identify(record, unknown, calibration={"common": 0.01})
    ratio = {
        name: present(wide.coefficient(name).standard_error) / present(sharp.coefficient(name).standard_error)
        for name in TRUTH
    }
    assert ratio["nes1.beta"] > 10.0  # 2 % of it, 0.03 % without
    assert ratio["spring1.k"] == pytest.approx(1.0, abs=0.05)  # the same numerics, another optimum
    assert present(wide.coefficient("nes1.beta").standard_error) == pytest.approx(0.02 * 1e6, rel=0.1)


def test_intervals_of_sensors_of_stated_calibration_cover_the_truth() -> None:
    """Ten drawn sets of gains; the sum of squares of standardised errors, dependent in a record, stays below what ten
    independent ones reach once in 10 000."""
    squares = []
    for seed in range(4100, 4110):
        record = miscalibrated(chain_record(2, duration=1.0).with_noise(40.0, seed=seed), 0.01, seed)
        fit = lw.identify(record, CHAIN.unknown("all"), calibration={"all": 0.01})
        assert fit.trusted
        errors = [
            (fit.coefficient(name).value - true) / present(fit.coefficient(name).standard_error)
            for name, true in TRUTH.items()
        ]
        squares.append(np.square(errors))
    chance = scipy.stats.chi2.ppf(1.0 - 1e-4, 10) / 10.0
    assert (np.mean(squares, axis=0) < chance).all()


def test_calibration_names_the_channel_that_is_not_there(record: lw.Record) -> None:
    with pytest.raises(lw.IdentificationError, match=r"no calibration of x:m9 can be stated"):
        lw.identify(record, CHAIN.unknown("nes"), calibration={"x:m9": 0.01})
    with pytest.raises(lw.IdentificationError, match=r"calibration of x:m1 must be .* got 1$"):
        lw.identify(record, CHAIN.unknown("nes"), calibration={"x:m1": 1.0})


@pytest.mark.parametrize(("kind", "said"), [("gain", "x:m2 shows 1.1"), ("offset", "x:m2 is off by")])
def test_an_error_that_is_admitted_is_taken_into_the_model(kind: str, said: str, record: lw.Record) -> None:
    column = record.channels.index("x:m2")
    values = record.values.copy()
    # of 2 % a gain of the other sensor explains as much, and none is taken
    values[:, column] = 1.1 * values[:, column] if kind == "gain" else values[:, column] + 2e-4
    faulty = replace(record, values=values)
    unknown = CHAIN.unknown("nes")
    assert not lw.identify(faulty, unknown).trusted
    wrong_kind = "offset" if kind == "gain" else "gain"
    assert not lw.identify(faulty, unknown, admit=[wrong_kind]).trusted
    fit = lw.identify(faulty, unknown, admit=["offset", "gain"])
    assert fit.trusted and any(line.startswith(said) for line in fit.findings)
    beta = fit.coefficient("nes1.beta")
    # five deviations, 6e-7 of chance
    assert abs(beta.value - 1e6) < 5.0 * present(beta.standard_error)
    with pytest.raises(lw.IdentificationError, match='unknown error of a sensor "gian"; did you mean "gain"'):
        lw.identify(faulty, unknown, admit=["gian"])


def test_a_test_is_planned_with_what_is_known_beforehand() -> None:
    plan = {"duration": 0.5, "rate": 1000.0, "noise": 40.0, "release": {"v:m1": 1.0}}
    wide, narrow = (
        lw.limit(known_within(CHAIN, 0.01, sigma), **plan).coefficient("m2.mass")  # type: ignore[arg-type]
        for sigma in (1.0, 1e-6)
    )
    information = np.array([present(wide.standard_error), 1e-6]) ** -2.0
    # same numerics, of a matrix whose scales are 1e6 apart
    assert present(narrow.standard_error) == pytest.approx(information.sum() ** -0.5, rel=1e-6)


def test_a_prior_says_nothing_against_itself() -> None:
    prior = Prior(np.array([1.0, 0.0]), np.array([0.1, np.inf]))
    border = np.array([1.5, 7.0])
    assert prior.conflicts(border, np.array([0.01, 1.0])) == pytest.approx([0.0, 0.0])
    assert prior.conflicts(border, np.array([0.0, 1.0])) == pytest.approx([25.0, 0.0])


def test_options_of_a_fit_carry_the_calibration(record: lw.Record) -> None:
    theta = np.array([TRUTH[p.name] for p in CHAIN.unknown("nes").parameters])
    options = LikelihoodOptions(calibration={"x:m1": 0.01}, model_error=False)
    fit = likelihood_fit([record[:500]], CHAIN.unknown("nes"), theta, options=options)
    assert list(fit.gains) == ["x:m1"] and present(fit.segments.prior).count == 1
