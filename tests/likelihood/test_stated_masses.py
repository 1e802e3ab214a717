"""Stated masses that are off, for which coefficients make up nearly: refused, held by intervals, or told with an answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import truth
from structures import HARDENING, coefficient, link, structure

import linkwise as lw
from linkwise.likelihood.hypotheses import Hypothesis
from linkwise.likelihood.stated_masses import likely_masses, which_stated

FAR = 4.0  # standard errors
LIGHT = 0.0015  # kg m^2: its reaction on the other disc is all that tells its mass
TRUE = structure(
    {"disc1": 0.05, "disc2": LIGHT},
    link("shaft1", "disc1-ground", HARDENING, k=80.0, k3=120.0, c=0.04),
    link("shaft2", "disc2-disc1", HARDENING, k=2.2, k3=5.0, c=0.002),
    rotations=("disc1", "disc2"),
)
NOISE = 25.0  # dB


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    return lw.simulate(TRUE, release={"v:disc1": 15.0}, duration=5.0, rate=200.0)


def stated(mass: float | lw.Coefficient) -> lw.Structure:
    """The torsion chain with all coefficients unknown and this second disc."""
    discs = (TRUE.masses[0], replace(TRUE.masses[1], mass=coefficient(mass)))
    return replace(TRUE, masses=discs).unknown("all")


def off(fit: lw.Estimate, asked: lw.Structure) -> float:
    """The largest error of a coefficient in standard errors."""
    errors = np.abs(fit.values - truth(TRUE, asked))
    return float(np.max(errors / np.sqrt(np.asarray(fit.covariance).diagonal())))


def told(fit: lw.Estimate) -> str:
    """The sentence on masses that the record does not rule out, empty without one."""
    return " ".join(
        finding for finding in fit.findings if finding.startswith("The records do not rule out a mass")
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_disc_that_is_stated_too_heavy_takes_trust_away_and_is_named(clean: lw.Record, seed: int) -> None:
    """Its gain of 14 to 25 is not significant among all causes, and coefficients are 17 standard errors off."""
    fit = lw.identify(clean.with_noise(22.0, seed=seed), stated(1.05 * LIGHT))
    assert fit.verdicts == (lw.Verdict.MEASUREMENT_ERROR,)
    assert {cause.kind for cause in fit.diagnosis} == {"mass"}
    assert "a mass of disc" in fit.message


@pytest.mark.parametrize("seed", range(1, 9))
def test_a_trusted_answer_holds_an_error_of_a_mass_or_tells_it(clean: lw.Record, seed: int) -> None:
    """All of them were trusted without a word, up to 14 standard errors off."""
    asked = stated(1.02 * LIGHT)
    fit = lw.identify(clean.with_noise(NOISE, seed=seed), asked)
    if not fit.trusted:
        assert fit.diagnosis[0].kind == "mass"
    elif "The residuals hint at a mass of disc" in fit.message:
        assert off(fit, asked) < FAR
    else:
        by_disc = {term.link: term for term in fit.unseen_terms if term.is_mass}
        assert by_disc["disc2"].share > 1.0 - 1.0 / 1.02 and "disc2 that is off by up to" in told(fit)


def test_a_mass_that_is_known_to_within_widens_intervals(clean: lw.Record) -> None:
    """As the answer advises, after which no more is said of it."""
    seed = 2
    exact = stated(1.02 * LIGHT)
    fit = lw.identify(clean.with_noise(NOISE, seed=seed), exact)
    assert fit.trusted and off(fit, exact) > FAR and "disc2" in told(fit)
    asked = stated(lw.Coefficient.unknown(start=1.02 * LIGHT, sigma=0.02 * LIGHT))
    fit = lw.identify(clean.with_noise(NOISE, seed=seed), asked)
    assert fit.trusted and off(fit, asked) < FAR
    assert not any(term.link == "disc2" for term in fit.unseen_terms)


def test_records_that_tell_the_masses_say_nothing_of_them() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    fit = lw.identify(record.with_noise(20.0, seed=3), chain.unknown("all"))
    assert fit.trusted and not told(fit) and "a mass of" not in fit.message


def test_masses_are_likely_where_one_gains_more_than_all_others_and_than_chance() -> None:
    masses = [Hypothesis("mass", "m1"), Hypothesis("mass", "m2")]
    hypotheses = [Hypothesis("term", "s", "d**3"), *masses]
    assert likely_masses(hypotheses, np.array([5.0, 15.0, 14.0])).tolist() == [False, True, True]
    assert likely_masses(hypotheses, np.array([5.0, 15.0, 9.0])).tolist() == [False, True, False]
    assert not likely_masses(hypotheses, np.array([16.0, 15.0, 9.0])).any()  # a term explains more
    assert not likely_masses(hypotheses, np.array([5.0, 13.0, 9.0])).any()  # 12 + 2 ln 2
    assert not likely_masses(hypotheses[:1], np.array([50.0])).any()
    assert which_stated(hypotheses, ["m1.mass", "s.k"]) == [2]
