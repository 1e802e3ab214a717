"""Noise that is coloured, found too large, or beside a model error."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy
from duffing_ring import NOISE, SIZE, VALUES, noisy, ring
from present import present
from problems import chain_record, truth
from random_signals import autoregressive, differenced, random_force
from record_faults import changed
from structures import link, oscillator, structure
from within import errors

import linkwise as lw

pytestmark = pytest.mark.slow


SNR = 30.0


COLOURS: dict[str, Callable[[np.random.Generator, tuple[int, int]], np.ndarray]] = {
    "AR(1) of 0.9": lambda rng, shape: autoregressive(rng, shape, 0.9),
    "differenced": differenced,
}


def coloured(noise: str, seed: int, *, duration: float = 3.0) -> lw.Record:
    clean = chain_record(2, duration=duration)
    size = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0 ** (-SNR / 20.0)
    drawn = COLOURS[noise](np.random.default_rng([seed, 20261122]), clean.values.shape)
    return replace(clean, values=clean.values + size * drawn)


@pytest.mark.parametrize("noise", list(COLOURS))
def test_intervals_allow_for_coloured_noise(noise: str) -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("all")
    z = []
    for seed in range(2):
        fit = lw.identify(coloured(noise, seed), unknown)
        assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.model_error == 0.0
        channels = "x:m1, x:m2" if noise == "differenced" else "x:m1"
        assert f"which is correlated from sample to sample in {channels}; all intervals" in fit.message
        z.append((fit.values - truth(chain, unknown)) / np.sqrt(fit.covariance.diagonal()))
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], np.size(z)) / np.size(z)
    assert low < np.mean(np.square(z)) < high


def test_intervals_of_a_chaotic_chain_allow_for_coloured_noise() -> None:
    """Four masses: the channel's floor at high frequencies says a quarter of its noise where the chaotic motion is."""
    chain = lw.bnes_chain(4)
    clean = chain_record(4, duration=4.0)
    errors = np.random.default_rng(1).normal(size=clean.values.shape)
    errors[:, :2] = autoregressive(np.random.default_rng(2), (len(clean), 2), 0.9)
    size = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0 ** (-20.0 / 20.0)
    unknown = chain.unknown("all")
    fit = lw.identify(replace(clean, values=clean.values + size * errors), unknown)
    assert fit.verdicts == (lw.Verdict.CONVERGED,) and "in x:m1; all" in fit.message
    z = (fit.values - truth(chain, unknown)) / np.sqrt(fit.covariance.diagonal())
    assert np.max(np.abs(z)) < 4.0  # standard errors: of 10 by chance once in 1600


def test_a_profile_counts_the_colour() -> None:
    fit = lw.identify(coloured("AR(1) of 0.9", 3, duration=6.0), lw.bnes_chain(2).unknown("nes"))
    assert "correlated from sample to sample" in fit.message
    low, high = present(fit.coefficient("nes1.alpha").interval)
    lower, upper = lw.likelihood.profile_interval(fit, "nes1.alpha")
    assert (upper - lower) / (high - low) == pytest.approx(1.0, abs=0.05)  # a parabola nearly


def test_an_error_of_the_sensor_is_seen_beneath_the_colour() -> None:
    record = coloured("AR(1) of 0.9", 4)
    scaled = changed(record, x_m1=lambda x: 1.05 * x)
    fit = lw.identify(scaled, lw.bnes_chain(2).unknown("nes"), as_stated=True)
    assert not fit.trusted and fit.diagnosis[0].is_instrument


def test_noise_that_is_stated_and_larger_is_not_excused() -> None:
    record = coloured("AR(1) of 0.9", 5)
    sizes = 0.5 * 10.0 ** (-SNR / 20.0) * np.sqrt(np.mean(record.values**2, axis=0))
    stated = replace(record, noise=dict(zip(record.channels, map(float, sizes), strict=True)))
    assert lw.identify(stated, lw.bnes_chain(2).unknown("nes")).verdicts[0] is lw.Verdict.NOISE_MISMATCH


def test_a_missing_link_is_no_coloured_noise() -> None:
    """The mode in which two masses move against each other, at five samples a period, was taken for noise and trusted."""
    masses = {"m1": 0.44, "m2": 0.4, "m3": 0.86}
    lower = link("lower", "m1-ground", "k*d + c*v", k=20.0, c=0.26)
    upper = link("upper", "m2-m1", "k*d + c*v", k=40.0, c=0.22)
    other = link("other", "m3-ground", "k*d + c*v", k=40.0, c=0.14)
    release = {"v:m2": 0.04, "x:m1": 0.002, "x:m3": 0.003}
    record = lw.simulate(structure(masses, lower, upper, other), release=release, duration=11.0, rate=11.3)
    apart = structure(masses, lower, replace(upper, between=("m2", lw.model.GROUND)), other)
    fit = lw.identify(record.with_noise(26.0, seed=5_101_880), apart.unknown("all"))
    assert fit.verdicts[0] is lw.Verdict.NOISE_MISMATCH and not fit.trusted


RING = ring(*VALUES.reshape(3, SIZE))


def test_noise_that_was_found_is_that_of_the_residuals_where_these_are_less() -> None:
    """10 samples a period, of motion with harmonics: 10 to 30 % more noise is found than there is."""
    fit = lw.identify(noisy(1003), RING.unknown("all"))
    scatter = np.sqrt(2.0 / fit.samples)  # of chi-square
    assert fit.trusted
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=2.0 * scatter)
    sigma = [estimate.sigma for estimate in fit.noise.values()]
    assert np.mean(sigma) == pytest.approx(NOISE, rel=3.0 * scatter / 2.0)


def test_noise_that_is_stated_stays() -> None:
    record = noisy(1003)
    stated = replace(record, noise=dict.fromkeys(record.channels, 2.0 * NOISE))
    fit = lw.identify(stated, RING.unknown("all"))
    assert fit.chi_square_per_sample == pytest.approx(0.25, abs=3.0 * 0.25 * np.sqrt(2.0 / fit.samples))
    assert fit.verdicts[0] is lw.Verdict.NOISE_MISMATCH


@pytest.mark.parametrize("kind", ["x", "a"])
def test_a_record_without_noise_is_identified(kind: str) -> None:
    """What a simulation gives: its channels count as 160 dB, and no search fits rounding."""
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0, sensors=[kind])
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.trusted
    truth = np.array([chain.coefficient(parameter.name).value for parameter in fit.parameters])
    assert fit.values == pytest.approx(truth, rel=1e-6)
    assert (np.abs(fit.values - truth) < 4.0 * np.sqrt(fit.covariance.diagonal())).all()


def test_a_record_without_noise_refuses_another_law() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    other = lw.parse_structure(lw.model.format_structure(chain).replace("beta*d**3", "beta*d**2"))
    fit = lw.identify(record, other.unknown("nes"), as_stated=True)
    assert not fit.trusted


def test_a_channel_without_noise_does_not_hide_noise_that_is_stated_too_large() -> None:
    chain = lw.bnes_chain(2)
    record = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    deviation = 1e-3 * float(np.std(record.channel("x:m1")))
    noise = deviation * np.random.default_rng(7).standard_normal(len(record))
    noisy_first = changed(record, x_m1=lambda x: x + noise)
    stated = replace(noisy_first, noise={"x:m1": 10.0 * deviation})
    assert lw.identify(stated, chain.unknown("nes")).verdicts[0] is lw.Verdict.NOISE_MISMATCH


@pytest.fixture(scope="module")
def dragged() -> tuple[lw.Record, lw.Structure]:
    """An oscillator with drag under a random force, 70 dB, and laws without the drag."""
    rate, duration = 100.0, 40.0
    force = random_force(np.random.default_rng(11), duration, rate, rms=4.0)
    with_drag = oscillator("k*d + c*v + k3*d**3 + q*v*abs(v)", k=400.0, c=1.0, k3=1e5, q=0.05)
    record = lw.simulate(with_drag, forces={"m1": force}, duration=duration, rate=rate)
    without = oscillator("k*d + c*v + k3*d**3", k=400.0, c=1.0, k3=1e5)
    return record.with_noise(70.0, seed=11), without.unknown("all")


def filtered(record: lw.Record) -> lw.Record:
    """All channels through the same low-pass filter at 0.6 of the Nyquist frequency."""
    filter_ = scipy.signal.butter(2, 0.6, output="sos")
    return replace(record, values=scipy.signal.sosfilt(filter_, record.values, axis=0))


def test_small_coloured_residuals_are_judged_by_blocks(dragged: tuple[lw.Record, lw.Structure]) -> None:
    """Filters leave residuals above the noise of their stop band; at 0.5 % of the motion they decide nothing by themselves."""
    record, structure = dragged
    whole, seen = lw.identify(record, structure), lw.identify(filtered(record), structure)
    assert whole.grade is seen.grade is lw.Grade.APPROXIMATE and present(seen.chi_square_per_sample) > 2.0
    z = (seen.values - whole.values) / np.sqrt(seen.covariance.diagonal())
    assert np.max(np.abs(z)) < 3.0


def test_a_sensor_that_was_filtered_without_phase_shows_no_noise_and_is_answered() -> None:
    clean = chain_record(2, duration=3.0)
    record = clean.with_noise(30.0, seed=76)
    low_pass = scipy.signal.butter(4, 100.0, fs=record.rate, output="sos")
    filtered = changed(record, x_m2=lambda x: scipy.signal.sosfiltfilt(low_pass, x))
    chain = lw.bnes_chain(2)
    fit = lw.identify(filtered, chain.unknown("all"))
    assert fit.grade is lw.Grade.APPROXIMATE and fit.diagnosis[0].kind == "filter"
    assert np.abs(errors(fit, chain)).max() < 4.0  # standard errors, of five coefficients
