"""Intervals of laws that lack a term: they hold what the term would make of the coefficients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import truth
from random_force import random_force
from structures import oscillator

import linkwise as lw

RATE, DURATION = 200.0, 20.0
LAW = "k*d + c*v + k3*d**3"
TRUE = oscillator(LAW, k=987.0, c=2.0, k3=4e5)
CHANCE = 3.3  # standard errors that a normal estimate is off once in 1000


def record(structure: lw.Structure, seed: int) -> lw.Record:
    """The structure under a random force of 6 N root mean square from 1 to 12 Hz, at 40 dB."""
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(structure, forces=forces, duration=DURATION, rate=RATE).with_noise(40.0, seed=seed)


@pytest.mark.parametrize(
    ("missing", "size", "moved"), [("d**5", 2e7, "k3"), ("v*abs(v)", 0.5, "c"), ("tanh(v/0.01)", 0.08, "c")]
)
def test_intervals_hold_what_a_missing_term_makes_of_the_coefficients(
    missing: str, size: float, moved: str
) -> None:
    """The coefficient that makes up for it was 8 to 14 standard errors off, and trusted: by blocks these do not differ."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(oscillator(f"{LAW} + q*{missing}", k=987.0, c=2.0, k3=4e5, q=size), 3), unknown)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,) and fit.for_dropped_terms is not None
    off = np.abs(fit.values - truth(TRUE, unknown))
    covariance = np.asarray(fit.covariance)
    number = [parameter.name for parameter in fit.parameters].index(f"link.{moved}")
    assert off[number] > CHANCE * np.sqrt((covariance - fit.for_dropped_terms)[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))
    assert fit.diagnosis[0].shifted == f"link.{moved}" and "the intervals allow for that" in fit.message
    with pytest.raises(lw.IdentificationError, match="does not allow for terms that are missing"):
        lw.likelihood.profile_interval(fit, f"link.{moved}")


@pytest.mark.parametrize("seed", [17, 19])
def test_intervals_hold_a_second_term_that_is_not_significant(seed: int) -> None:
    """Beside missing drag a quintic of 0.5 % of the force left k3 5 to 7 standard errors off, and was trusted."""
    unknown = TRUE.unknown("all")
    true = oscillator(f"{LAW} + q*v*abs(v) + r*d**5", k=987.0, c=2.0, k3=4e5, q=0.5, r=6e6)
    fit = lw.identify(record(true, seed), unknown)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert "d**5" not in [cause.term for cause in fit.diagnosis]
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    number = [parameter.name for parameter in fit.parameters].index("link.k3")
    alone = covariance - present(fit.for_dropped_terms)
    assert off[number] > CHANCE * np.sqrt(alone[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


def test_intervals_beside_errors_of_sensors_hold_the_same() -> None:
    """An offset is found with the coefficients, and is not one of them."""
    given = record(oscillator(f"{LAW} + q*v*abs(v)", k=987.0, c=2.0, k3=4e5, q=0.5), 3)
    unknown = TRUE.unknown("all")
    fit = lw.identify(given, unknown, offsets=["x:m1"])
    added = present(fit.for_dropped_terms)
    assert added.shape == (3, 3)
    alone = present(lw.identify(given, unknown).for_dropped_terms)
    number = [parameter.name for parameter in fit.parameters].index("link.c")
    # an offset moves the damping by far less than the missing damping does
    assert added[number, number] == pytest.approx(alone[number, number], rel=0.2)


def test_intervals_hold_what_a_term_below_detection_makes_of_the_coefficients() -> None:
    """A quintic of 0.05 % of the force left k3 15 standard errors off, and was trusted as exact: no score is significant."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(oscillator(f"{LAW} + q*d**5", k=987.0, c=2.0, k3=4e5, q=6e5), 7), unknown)
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and not fit.diagnosis
    assert "The residuals hint at a force like d**5 in link" in fit.message
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    number = [parameter.name for parameter in fit.parameters].index("link.k3")
    without = covariance - present(fit.for_dropped_terms)  # which blocks widen
    assert off[number] > 3.0 * CHANCE * np.sqrt(without[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


@pytest.mark.parametrize("seed", [5_001_004, 5_001_017])
def test_intervals_hold_a_power_with_a_score_little_above_two(seed: int) -> None:
    """A quintic of 0.03 % of the force left k3 6 and 9 standard errors off, and was trusted as exact."""
    unknown = TRUE.unknown("all")
    fit = lw.identify(record(oscillator(f"{LAW} + q*d**5", k=987.0, c=2.0, k3=4e5, q=3e5), seed), unknown)
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and not fit.diagnosis
    assert "The residuals hint at a force like d**5 in link" in fit.message
    off, covariance = np.abs(fit.values - truth(TRUE, unknown)), np.asarray(fit.covariance)
    number = [parameter.name for parameter in fit.parameters].index("link.k3")
    without = covariance - present(fit.for_dropped_terms)
    assert off[number] > CHANCE * np.sqrt(without[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))


def test_chance_hints_at_a_term_in_few_records_of_exact_laws() -> None:
    """Of a power in one record of 22, of two other usual terms in one of 80 each: more than two of twelve once in 21."""
    fits = [lw.identify(record(TRUE, seed), TRUE.unknown("all")) for seed in range(40, 52)]
    assert {fit.verdicts for fit in fits} == {(lw.Verdict.CONVERGED,)}
    assert sum(fit.for_dropped_terms is not None for fit in fits) <= 2


def test_laws_that_lack_nothing_keep_their_intervals() -> None:
    fit = lw.identify(record(TRUE, 4), TRUE.unknown("all"))
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.for_dropped_terms is None


def test_intervals_hold_a_term_that_hardly_raises_chi_square() -> None:
    """Coefficients of a chain of six masses were 11 standard errors off, and trusted: chi-square was within chance of 1."""
    chain = lw.bnes_chain(6)
    links = {link.name: link for link in chain.links}
    coefficients = {**links["nes1"].coefficients, "q": lw.Coefficient.number(1e7)}
    law = lw.Law.parse("alpha*d + beta*d**3 + c*v + q*d**5")
    links["nes1"] = replace(links["nes1"], law=law, coefficients=coefficients)
    true = replace(chain, links=tuple(links.values()))
    clean = lw.simulate(true, release={"v:m1": 3.0}, duration=4.0, rate=1000.0)
    asked = chain.unknown("all")
    fit = lw.identify(clean.with_noise(30.0, seed=5), asked)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert 0.0 < fit.model_error < 0.05
    assert abs(present(fit.chi_square_per_sample) - 1.0) < 3.0 * np.sqrt(2.0 / fit.samples)
    assert (fit.diagnosis[0].where, fit.diagnosis[0].term) == ("nes1", "d**5")
    assert "Most of what is left would be explained by a force like d**5 in nes1" in fit.message
    off, covariance = np.abs(fit.values - truth(chain, asked)), np.asarray(fit.covariance)
    number = [parameter.name for parameter in fit.parameters].index("nes1.beta")
    without = covariance - present(fit.for_dropped_terms)  # which blocks widen
    assert off[number] > CHANCE * np.sqrt(without[number, number])
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))
