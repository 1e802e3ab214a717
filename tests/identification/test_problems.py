"""The table of problems by two methods, and records whose inputs are held or interpolated between samples."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
from problems import PROBLEMS, Problem, truth
from random_signals import random_force
from structures import link, oscillator, with_links

import linkwise as lw

FARTHEST = 4.5  # standard errors: the largest of 30 normal errors is beyond once in 5000 seeds


@pytest.mark.slow
@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_both_methods_find_the_coefficients_and_likelihood_is_the_sharper(problem: Problem) -> None:
    """Their difference scatters by less than the error of the weak form, since the likelihood uses all that it uses."""
    record, unknown = problem.record(seed=13), problem.unknown_structure
    likelihood, weak = lw.identify(record, unknown), lw.identify(record, unknown, method="weak")
    for fit in (likelihood, weak):
        assert fit.trusted, fit.explanation
        assert len(fit.values) >= 3 and np.max(np.abs(problem.errors(fit))) < FARTHEST
    deviation = np.sqrt(weak.covariance.diagonal())
    assert np.all(np.abs(likelihood.values - weak.values) < FARTHEST * deviation)
    # 10 %: errors of their estimate
    assert np.all(np.sqrt(likelihood.covariance.diagonal()) < 1.1 * deviation)


@pytest.mark.slow
def test_a_linear_law_in_place_of_the_last_one_is_not_trusted() -> None:
    """Beside what must be accepted, one that must not."""
    problem = PROBLEMS["masses unknown, a force applied"]
    unknown_structure = problem.unknown_structure
    last = unknown_structure.links[-1]
    unknown = lw.Coefficient.unknown(start=1.0)
    linear = link(last.name, "-".join(last.between), "k*d + c*v", k=unknown, c=unknown)
    fit = lw.identify(problem.record(seed=13), with_links(unknown_structure, linear))
    assert not fit.trusted and fit.verdicts[0].forbids


RATE, DURATION = 100.0, 20.0
QUANTILE = 0.9999  # of chi-square with one degree of freedom a coefficient
ORDERS = {"held": 0, "linear": 1}


def duffing() -> lw.Structure:
    return oscillator("k*d + k3*d**3 + c*v", k=900.0, k3=2e5, c=2.0)


@cache
def driven(kind: str, seed: int = 3) -> lw.Record:
    """A random force up to 12 Hz, held or linear between its samples in the simulation; 40 dB."""
    force = random_force(np.random.default_rng(seed), DURATION, RATE, rms=5.0)
    forces = {"m1": replace(force, order=ORDERS[kind])}
    clean = lw.simulate(duffing(), forces=forces, duration=DURATION, rate=RATE)
    return replace(clean.with_noise(40.0, seed=seed), simulated=None)


def distance(fit: lw.Estimate) -> float:
    error = fit.values - truth(duffing(), fit.given_structure)
    return float(error @ np.linalg.solve(fit.covariance, error))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ORDERS)
def test_what_is_stated_is_used(kind: str) -> None:
    record = replace(driven(kind), interpolation={"force:m1": kind})
    fit = lw.identify(record, duffing().unknown("all"))
    assert fit.trusted
    assert distance(fit) < scipy.stats.chi2.ppf(QUANTILE, len(fit.values))
    assert lw.validate(record, duffing()).trusted


@pytest.mark.slow
def test_a_held_force_taken_for_a_band_limited_one_looks_half_a_sample_late() -> None:
    fit = lw.identify(driven("held"), duffing().unknown("all"))
    assert not fit.trusted
    first = fit.diagnosis[:2]  # the response is then as late as the force
    assert {(cause.kind, cause.where) for cause in first} == {("force delay", "force:m1"), ("delay", "x:m1")}
    [cause] = [cause for cause in first if cause.kind == "force delay"]
    # a hold is late by half a sample, and its gain sin(a)/a less by a^2/6 at most, a = pi 12 Hz / RATE
    assert cause.size == pytest.approx(0.5 / RATE, rel=(np.pi * 12.0 / RATE) ** 2 / 6.0)
    assert "held between its samples" in cause.description
    assert not lw.validate(driven("held"), duffing()).trusted


def test_straight_lines_taken_for_a_band_limited_force_look_like_a_filter() -> None:
    """Their gain is (sin(a)/a)^2, 1 - a^2/3 to first order, as a second derivative times a twelfth of a sample squared."""
    fit = lw.identify(driven("linear"), duffing().unknown("all"))
    assert not fit.trusted
    cause = fit.diagnosis[0]
    assert cause.kind == "filter"
    assert cause.size == pytest.approx(1.0 / (12.0 * RATE**2), rel=0.2)
    assert "(as of an input that runs in straight lines between its samples)" in cause.description


def test_interpolations_travel_with_the_record() -> None:
    record = replace(driven("held"), interpolation={"force:m1": "held"})
    assert dict(record[:50].interpolation) == {"force:m1": "held"}
    assert dict(record.select(["x:m1"]).interpolation) == {}
    with pytest.raises(lw.RecordError, match=r"x:m1.*not an input of the record; inputs: force:m1"):
        replace(record, interpolation={"x:m1": "held"})
    with pytest.raises(lw.RecordError, match="'cubic'; choose from held, linear, band-limited"):
        replace(record, interpolation={"force:m1": "cubic"})
    moved = lw.Record(0.0, 10.0, ("x:m1", "x:base"), np.zeros((40, 2)))
    with pytest.raises(lw.RecordError, match="a base does not jump"):
        replace(moved, interpolation={"x:base": "held"})
