"""Damping that a record leaves open: of which laws, and beside what is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.efficient_scores import efficient_scores
from linkwise.weak.estimate import weak_search
from linkwise.weak.fit import with_priors

SINES = "12*sin(20*t) + 8*sin(33*t + 1) + 6*sin(47*t)"


def test_laws_with_a_jump_in_the_rate_are_nonlinear_in_it() -> None:
    """The slope of sign(v) does not hold v, yet damping beyond such a law takes no trust from it, at 35 dB."""
    truth = oscillator("k*d + c*v + f*sign(v)", k=900.0, c=2.0, f=0.3)
    asked = truth.unknown("all")
    right = [truth.coefficient(parameter.name).value or 0.0 for parameter in asked.parameters]
    exact = lw.simulate(truth, forces={"m1": SINES}, duration=8.0, rate=200.0)
    squares = []
    for seed in range(861, 867):
        fit = lw.identify(exact.with_noise(35.0, seed=seed), asked, method="weak")
        assert fit.trusted, fit.message
        squares.append(np.mean((fit.values - right) ** 2 / fit.covariance.diagonal()))
    assert np.mean(squares) < 2.0


def linear(relative: float) -> lw.Structure:
    """A spring and a damper, of which c = 2 N s/m is known to within a part of it beforehand."""
    return oscillator(
        "k*d + c*v", k=lw.Coefficient.unknown(), c=lw.Coefficient.unknown(2.0, sigma=2.0 * relative)
    )


def steady(seed: int, snr_db: float = 20.0, friction: float = 0.0) -> lw.Record:
    """Ten seconds of a sine, which leaves the damper 20 % open beside friction at 20 dB."""
    truth = oscillator("k*d + c*v + F*tanh(v/s)", k=400.0, c=2.0, F=friction, s=0.002)
    exact = lw.simulate(truth, forces={"m1": "5*sin(19*t)"}, duration=10.0, rate=200.0)
    return exact.with_noise(snr_db, seed=seed)


def undecided(fit: lw.Estimate) -> bool:
    return "does not rule out a force like" in fit.message


@pytest.mark.parametrize("relative", [0.01, 0.003])
def test_what_is_known_of_a_damper_bounds_friction(relative: float) -> None:
    """The record alone leaves it open; a prior of more than what it leaves open changes nothing."""
    squares = []
    for seed in range(871, 877):
        record = steady(seed)
        assert undecided(lw.identify(record, linear(10.0), method="weak"))
        fit = lw.identify(record, linear(relative), method="weak")
        assert fit.trusted, fit.message
        squares.append(np.mean((fit.values - [400.0, 2.0]) ** 2 / fit.covariance.diagonal()))
    assert np.mean(squares) < 2.0


def test_terms_move_coefficients_with_priors_as_far_as_told() -> None:
    """Friction of half its limit, beside a prior as wide as the standard error of the record, to first order."""
    asked = linear(0.004)
    plain = lw.identify(steady(881), asked, method="weak")
    equations, fit, _ = weak_search(steady(881), asked, read_displacements(steady(881), asked))
    joined, _ = with_priors(fit, asked.parameters)
    assert joined.response is not None and 0.2 < joined.response[1, 1] < 0.8
    scores = efficient_scores(steady(881), asked, equations, joined)
    alone = efficient_scores(steady(881), linear(10.0), equations, fit)
    assert scores is not None and alone is not None
    number = scores.terms.index("sign(v)")
    assert scores.limits[number] < 0.3 * alone.limits[number]
    hidden = lw.identify(steady(881, friction=0.5 * float(scores.limits[number])), asked, method="weak")
    change = (hidden.values[1] - plain.values[1]) / (0.5 * scores.changes[1, number])
    assert abs(change - 1.0) < 0.15


def test_friction_that_a_prior_leaves_open_takes_trust_away() -> None:
    """A damper known to 10 % tells less of friction of 0.03 N than it would have to."""
    for seed in range(891, 894):
        fit = lw.identify(steady(seed, friction=0.03), linear(0.1), method="weak")
        assert undecided(fit), fit.message


def test_a_prior_that_is_wrong_is_not_told_as_a_term() -> None:
    wrong = oscillator("k*d + c*v", k=lw.Coefficient.unknown(), c=lw.Coefficient.unknown(2.2, sigma=0.02))
    for seed in range(901, 904):
        fit = lw.identify(steady(seed), wrong, method="weak")
        assert fit.verdicts == (lw.Verdict.MEASUREMENT_ERROR,) and "contradicts" in fit.message


@pytest.mark.parametrize(("snr_db", "quadratic"), [(20.0, 0.5), (35.0, 0.0)])
def test_three_sines_of_a_base_show_at_35_db_that_a_damper_is_linear(snr_db: float, quadratic: float) -> None:
    """At 20 dB they do not: quadratic damping moves a damper by 13 %, 9 standard errors, and its score is chance."""
    truth = oscillator("k*d + c*v + q*v*abs(v)", to="base", k=900.0, c=2.0, q=quadratic)
    base = "0.004*sin(21*t) + 0.003*sin(33*t + 1) + 0.003*sin(47*t + 2)"
    exact = lw.simulate(truth, base=base, duration=8.0, rate=200.0)
    asked = oscillator("k*d + c*v", to="base").unknown("all")
    for seed in range(911, 915):
        fit = lw.identify(exact.with_noise(snr_db, seed=seed), asked, method="weak")
        assert fit.trusted is not bool(quadratic), fit.message
        if quadratic:
            assert fit.values[1] > 2.2
