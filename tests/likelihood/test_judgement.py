"""Answers that fit well and are wrong: what must take trust away, and what must not."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from present import present
from problems import chain_record, truth
from random_signals import autoregressive, differenced, random_force
from structures import NES, link, oscillator, row_of_masses, structure, with_links
from within import assert_within, errors

import linkwise as lw
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.checks.verdicts import motion_that_runs_away
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.shooting.residuals import evaluate

DURATION, RATE, SNR = 3.0, 1000.0, 20.0


def record(structure: lw.Structure, speed: float = 1.0, *, duration: float = DURATION) -> lw.Record:
    return lw.simulate(structure, release={"v:m1": speed}, duration=duration, rate=RATE)


def with_errors(clean: lw.Record, errors: np.ndarray) -> lw.Record:
    """`clean` with `errors` (N, C) of unit variance at 20 dB."""
    size = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0 ** (-SNR / 20.0)
    return replace(clean, values=clean.values + size * errors)


@pytest.mark.parametrize("noise", [partial(autoregressive, correlation=0.5), differenced])
def test_coloured_noise_is_not_trusted_by_the_weak_form(
    noise: Callable[[np.random.Generator, tuple[int, int]], np.ndarray], chain: lw.Structure
) -> None:
    clean = record(chain)
    noisy = with_errors(clean, noise(np.random.default_rng(3), clean.values.shape))
    fit = lw.identify(noisy, chain.unknown("all"), method="weak")
    assert not fit.trusted and fit.coefficient("nes1.alpha").interval is None


def test_a_fading_colour_is_not_trusted(chain: lw.Structure) -> None:
    """Intervals allow for noise that is coloured throughout alike, not for one that comes and goes."""
    clean = record(chain)
    errors = autoregressive(np.random.default_rng(3), clean.values.shape, 0.5)
    errors[:, 0] *= np.linspace(2.0, 0.1, len(errors))
    fit = lw.identify(with_errors(clean, errors), chain.unknown("all"))
    assert fit.verdicts[0].forbids and fit.grade is lw.Grade.APPROXIMATE


def test_noise_with_heavy_tails_is_not_trusted_by_the_weak_form(chain: lw.Structure) -> None:
    """Student's t with 3 degrees of freedom: maximum likelihood bears it, a bias taken out as of normal noise is wrong."""
    clean = record(chain)
    errors = np.random.default_rng(4).standard_t(3, size=clean.values.shape) / np.sqrt(3.0)
    noisy = with_errors(clean, errors)
    weak = lw.identify(noisy, chain.unknown("all"), method="weak")
    assert weak.verdicts == (lw.Verdict.OUTLIERS,)
    assert lw.identify(noisy, chain.unknown("all")).trusted


@pytest.mark.slow
def test_outliers_that_exceed_the_noise_ask_for_a_robust_loss(chain: lw.Structure) -> None:
    """Noise of the same kind whose largest errors, by chance, make chi-square 1.3 and a coefficient 4 deviations off."""
    clean = record(chain, duration=6.0)
    errors = np.random.default_rng([47105, 9]).standard_t(3, size=clean.values.shape) / np.sqrt(3.0)
    noisy, loss = with_errors(clean, errors), lw.likelihood.Student()
    unknown = chain.unknown("all")
    fit = lw.identify(noisy, unknown, as_stated=True)
    assert fit.verdicts == (lw.Verdict.OUTLIERS,) and "Use a robust loss" in fit.message
    robust = lw.identify(noisy, unknown, method=lw.MaximumLikelihood(loss=loss))
    assert robust.verdicts == (lw.Verdict.CONVERGED,)
    errors = (robust.values - truth(chain, unknown)) / np.sqrt(robust.covariance.diagonal())
    assert np.max(np.abs(errors)) < 4.0  # standard errors: by chance once in 3000 fits


def test_few_samples_a_period_are_told_by_the_weak_form(chain: lw.Structure) -> None:
    """At 200 Hz and 60 dB integrals between the samples are off by more than noise, and a damping by 13 %."""
    clean = chain_record(2, rate=200.0)
    fit = lw.identify(clean.with_noise(60.0, seed=47000), chain.unknown("all"), method="weak")
    assert fit.verdicts == (lw.Verdict.NOISE_MISMATCH,)
    assert "or the samples are too far apart to follow the motion" in fit.message
    assert (
        abs(fit.coefficient("spring1.c").value / (chain.coefficient("spring1.c").value or np.nan) - 1.0)
        > 0.05
    )


@pytest.mark.slow
def test_a_low_rate_needs_no_model_error(chain: lw.Structure) -> None:
    """Four samples a period of the sink at 200 Hz: the steps of the flow are finer than the samples."""
    unknown = chain.unknown("all")
    fit = lw.identify(chain_record(2, duration=DURATION, rate=200.0).with_noise(30.0, seed=1000), unknown)
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.model_error == 0.0
    assert_within(fit, chain, 5.0)


def test_a_link_that_gives_energy_takes_trust_away(chain: lw.Structure) -> None:
    """A damper that pushes: the fit is right, and an answer that no passive link could give."""
    driven = with_links(chain, link("nes1", "m2-m1", NES, alpha=-100.0, beta=1e6, c=-0.02))
    clean = lw.simulate(driven, release={"v:m1": 1.0}, duration=1.0, rate=RATE)
    fit = lw.identify(clean.with_noise(30.0, seed=1), chain.unknown("all"))
    assert fit.verdicts == (lw.Verdict.CONVERGED, lw.Verdict.ENERGY_FED) and not fit.trusted
    assert fit.supplies["nes1"] > 0.0 and set(fit.supplies) == {"nes1"}
    assert "feeds energy into the motion" in str(fit) and "NOT to be trusted" in str(fit)
    assert fit.to_dict()["verdicts"] == ["CONVERGED", "ENERGY_FED"]


@pytest.mark.slow
def test_a_search_of_many_steps_is_done_once_more() -> None:
    """Four masses at 10 dB, seed 2: the first search ends 67 in -2 log likelihood above the second, 9 standard errors off."""
    chain = lw.bnes_chain(4)
    fit = lw.identify(record(chain, 3.0, duration=6.0).with_noise(10.0, seed=2), chain.unknown("all"))
    assert np.max(np.abs(errors(fit, chain))) < 5.0


@pytest.mark.slow
def test_steps_of_the_flow_bend_no_coefficient() -> None:
    """Eight samples a period, 40 dB: an error of 2 % of the noise in each of many segments would add up."""
    outer, inner = {"k": 2e4, "k3": 1e8, "c": 1.0}, {"k": 9e3, "k3": 3e7, "c": 0.5}
    law = "k*d + k3*d**3 + c*v"
    structure = row_of_masses([1.0, 0.3], outer=(law, outer), inner=(law, inner))
    rate = 8.0 * float(np.nanmax(lw.analysis.modes(structure).frequencies))
    clean = lw.simulate(structure, release={"v:m1": 1.0, "v:m2": -1.0}, duration=6000 / rate, rate=rate)
    unknown = structure.unknown("all")
    errors = []
    for seed in range(2):
        fit = lw.identify(clean.with_noise(40.0, seed=seed), unknown)
        assert fit.trusted, fit.explanation
        errors.append((fit.values - truth(structure, unknown)) / np.sqrt(fit.covariance.diagonal()))
    assert np.sqrt(np.mean(np.square(errors))) < 1.66  # 12 normal errors: beyond once in 1000


def test_a_negative_variance_is_not_trusted(fitted: lw.Estimate) -> None:
    """Errors in variables may take more from a variance than there is."""
    size = len(fitted.values)
    covariance = np.diag(np.full(size, 1e-4))
    assert replace(fitted, covariance=covariance).trusted
    covariance[0, 0] = -1e-4
    bad = replace(fitted, covariance=covariance)
    assert lw.Verdict.COVARIANCE_NOT_POSITIVE in bad.verdicts and not bad.trusted
    assert bad.coefficient(bad.parameters[0].name).standard_error is None


def test_a_record_too_short_for_blocks_is_not_trusted_with_a_missing_term(chain: lw.Structure) -> None:
    """Intervals count what follows the motion only where blocks of the record can be compared."""
    law = "alpha*d + beta*d**3 + q*d**5 + c*v"
    quintic = with_links(chain, link("nes1", "m2-m1", law, alpha=-100.0, beta=1e6, q=3e7, c=0.02))
    short = record(quintic)[:490].with_noise(50.0, seed=1)  # 98 segments of the 100 that blocks need
    fit = lw.identify(short, chain.unknown("nes"))
    assert 0.0 < fit.diagnosis[0].share < 0.05  # a longer record would be trusted with such a term
    assert fit.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert "but what is left follows the motion: a force like d**5 in nes1" in fit.message


@pytest.mark.slow
def test_a_term_that_overturns_a_coefficient_leaves_an_approximate_answer() -> None:
    """Quadratic damping of 4 % of the force and no other, told as the linear damping that comes closest."""
    rng = np.random.default_rng(4102)
    force = random_force(rng, 10.0, 200.0, band_limited=True)
    unknown = oscillator("k*d + c*v + k3*d**3", k=987.0, c=6.0, k3=4e5).unknown("all")
    fits = []
    for linear in (0.0, 3.0):
        whole = oscillator("k*d + c*v + k3*d**3 + q*v*abs(v)", k=987.0, c=linear, k3=4e5, q=1.0)
        clean = lw.simulate(whole, forces={"m1": force}, duration=10.0, rate=200.0)
        fits.append(lw.identify(clean.with_noise(40.0, seed=4102), unknown, as_stated=True))
    assert fits[0].diagnosis[0].overturned == ("link.c",)
    assert fits[0].verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert {fit.grade for fit in fits} == {lw.Grade.APPROXIMATE}  # of a linear damper that comes closest
    assert present(fits[0].coefficient("link.c").interval)[0] > 0.0
    assert fits[1].verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert "With it, link.c would change by" in fits[1].message


def test_a_record_that_is_too_short_for_an_approximate_answer_says_how_much_longer_would_do() -> None:
    law = "k*d + c*v"
    whole, asked = oscillator(f"{law} + q*d**3", k=987.0, c=6.0, q=4e6), oscillator(law, k=987.0, c=6.0)

    def answer(duration: float) -> lw.Estimate:
        force = random_force(np.random.default_rng(5), duration, 200.0)
        clean = lw.simulate(whole, forces={"m1": force}, duration=duration, rate=200.0)
        return lw.identify(clean.with_noise(40.0, seed=5), asked.unknown("all"), as_stated=True)

    short = answer(1.5)
    told = present(re.search(r"to compare parts of it: take ([\d.]+) times as much of such", short.message))
    assert short.grade is lw.Grade.REFUSED
    assert answer(1.5 * float(told[1])).grade is lw.Grade.APPROXIMATE


@pytest.mark.slow
def test_an_approximate_answer_is_that_of_the_closest_law_over_any_record() -> None:
    """A quintic spring of 5 % of the force is missing: values of 10 s differ from those of 40 s by chance."""
    law = "k*d + c*v + k3*d**3"
    whole = oscillator(f"{law} + q*d**5", k=987.0, c=6.0, k3=4e5, q=3.5e7)
    unknown = oscillator(law, k=987.0, c=6.0, k3=4e5).unknown("all")

    def answer(duration: float, seed: int) -> lw.Estimate:
        force = random_force(np.random.default_rng(seed), duration, 200.0)
        clean = lw.simulate(whole, forces={"m1": force}, duration=duration, rate=200.0)
        return lw.identify(clean.with_noise(40.0, seed=seed), unknown, as_stated=True)

    long, *short = (answer(duration, seed) for duration, seed in [(40.0, 8100), (10.0, 8101), (10.0, 8102)])
    assert {fit.grade for fit in (long, *short)} == {lw.Grade.APPROXIMATE}
    assert "Intervals are approximate: of the laws of this form" in long.explanation
    for fit in short:
        deviations = np.sqrt((fit.covariance + long.covariance).diagonal())
        assert np.max(np.abs(fit.values - long.values) / deviations) < 3.0
        low, high = present(fit.coefficient("link.k3").interval)
        assert present(fit.coefficient("link.k3").value) > 4e5 and high - low < 1.2e5


def test_a_decay_that_is_soon_at_rest_is_not_compared_with_itself_without_its_motion() -> None:
    """Residuals hint at sign(v), which is all but the friction of the law; without the first block nothing tells a spring."""
    law = "k*d + c*v + F*tanh(v/0.002)"
    whole = structure({"m1": 2.0}, link("link", "m1-ground", law, k=5000.0, c=1.0, F=0.6))
    clean = lw.simulate(whole, release={"x:m1": 0.0025}, duration=8.0, rate=500.0).between(0.014, 8.0)
    noise = 1e-6 * np.random.default_rng(3).normal(size=clean.values.shape)
    fit = lw.identify(replace(clean, values=clean.values + noise), whole.unknown("all"))
    assert fit.trusted
    assert abs(present(fit.coefficient("link.k").value) - 5000.0) < 0.3
    assert 0.1 < present(fit.coefficient("link.k").standard_error) < 0.2


def test_an_approximate_answer_knows_a_stated_stiffness_as_well_as_stated() -> None:
    """A free decay tells ratios alone; the noise that is found over each horizon is no error of what is stated."""
    whole = oscillator("k*d + c*v + k3*d**3", k=400.0, c=0.5, k3=3e4)
    record = lw.simulate(whole, release={"x:m1": 0.05}, duration=8.0, rate=200.0).with_noise(50.0, seed=1)
    known = lw.Coefficient.unknown(start=400.0, sigma=4.0)
    linear = structure({"m1": lw.Coefficient.unknown()}, link("link", "m1-ground", "k*d + c*v", k=known))
    fit = lw.identify(record, linear, as_stated=True)
    assert fit.grade is lw.Grade.APPROXIMATE
    assert fit.coefficient("link.k").standard_error == pytest.approx(4.0, rel=1e-3)
    assert present(fit.coefficient("m1.mass").standard_error) > 0.01


def test_values_by_which_motion_soon_runs_away_from_the_record_are_refused() -> None:
    """Beside a model error one damper brakes, and the other drives the mass: samples alone would not tell them apart."""
    law, force = "k*d + c*v", random_force(np.random.default_rng(6), 4.0, 200.0)
    clean = lw.simulate(
        oscillator(f"{law} + q*d**3", k=987.0, c=6.0, q=4e5), forces={"m1": force}, duration=4.0, rate=200.0
    )
    records, asked = [clean.with_noise(40.0, seed=6)], oscillator(law, k=987.0, c=6.0).unknown("all")
    fit = likelihood_fit(records, asked, np.array([987.0, 6.0]))
    assert fit.model_error > 0.0
    before = Judgement(lw.Verdict.MODEL_ERROR_NEEDED, "")
    best, optimum = Examined(fit, [asked], records), fit.optimum
    assert motion_that_runs_away(best, before) is None
    for factors in (
        [1.0, -10.0],
        [0.4, 1.0],
    ):  # whose residuals are 7e4 and 2.7 times the power of the motion
        point = replace(optimum.point, theta=fit.values * factors)
        misfit = evaluate(optimum.segments, point, optimum.scales, optimum.loss)
        wrong = replace(best, fit=replace(fit, optimum=replace(optimum, misfit=misfit)))
        judgement = present(motion_that_runs_away(wrong, before))
        assert judgement.verdict is lw.Verdict.NOT_CONVERGED
        assert "state starts of link.k and link.c within some 20 %" in judgement.message


@pytest.mark.parametrize(
    ("left", "growth", "k3"),
    [(0.5, 0.0, 0.0), (0.2, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 10.0, 0.0), (0.1, 0.0, 1e8), (1.0, 0.0, 1e8)],
)
def test_an_exponential_window_is_told_by_the_noise_that_falls_with_it(
    left: float, growth: float, k3: float
) -> None:
    """A motion that decays has more damping then, by 17 to 60 %; noise that grows with the motion is no window.

    Of a cubic spring the amplitude is wrong by then as well, which terms of laws explain in part.
    """
    spring = oscillator("k*d + c*v", name="spring", k=5000.0, c=2.0)
    if k3:
        spring = oscillator("k*d + c*v + k3*d**3", name="spring", k=5000.0, c=2.0, k3=k3)
    clean = lw.simulate(spring, release={"v:m1": 0.5}, duration=4.0, rate=500.0)
    level = 10.0 ** (-SNR / 20.0) * 0.2 * clean.values.std()
    louder = np.sqrt(1.0 + growth * np.exp(-2.0 * clean.time))
    noise = np.random.default_rng(31).normal(size=len(clean)) * level * louder
    windowed = (clean.values + noise[:, None]) * left ** (clean.time / 4.0)[:, None]
    fit = lw.identify(replace(clean, values=windowed, simulated=None), spring.unknown("all"))
    if left == 1.0:
        assert "window" not in {cause.kind for cause in fit.diagnosis} and fit.grade is not lw.Grade.REFUSED
        return
    assert fit.grade is lw.Grade.REFUSED and [cause.kind for cause in fit.diagnosis] == ["window"]
    [window] = fit.diagnosis
    assert abs(window.size + 0.25 * np.log(left)) < 4.0 * window.standard_error
