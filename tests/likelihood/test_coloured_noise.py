"""Noise of sensors that is correlated from sample to sample: told from laws that are wrong, and counted in every interval."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy
from problems import chain_record, truth
from structures import link, structure

import linkwise as lw
from linkwise.likelihood.coloured_noise import ColouredNoise, _parzen, _resonates, in_time
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.profile import profile_ends
from linkwise.likelihood.shooting.anneal import AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.eliminated_states import EliminatedRows
from linkwise.likelihood.starts.values import starting_values
from linkwise.progress import silent

SNR = 30.0


def autoregressive(rng: np.random.Generator, shape: tuple[int, int], correlation: float) -> np.ndarray:
    """First-order noise of unit power in the first channel, white noise in the others."""
    noise = rng.normal(size=shape)
    driven = scipy.signal.lfilter([1.0], [1.0, -correlation], noise[:, 0])
    noise[:, 0] = driven * np.sqrt(1.0 - correlation**2)
    return noise


def differenced(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    return np.asarray(np.diff(rng.normal(size=(shape[0] + 1, shape[1])), axis=0) / np.sqrt(2.0))


NOISE: dict[str, Callable[[np.random.Generator, tuple[int, int]], np.ndarray]] = {
    "AR(1) of 0.5": lambda rng, shape: autoregressive(rng, shape, 0.5),
    "AR(1) of 0.9": lambda rng, shape: autoregressive(rng, shape, 0.9),
    "differenced": differenced,
}


def noisy(noise: str, seed: int, *, duration: float = 3.0) -> lw.Record:
    clean = chain_record(2, duration=duration)
    size = np.sqrt(np.mean(clean.values**2, axis=0)) * 10.0 ** (-SNR / 20.0)
    drawn = NOISE[noise](np.random.default_rng([seed, 20261122]), clean.values.shape)
    return replace(clean, values=clean.values + size * drawn)


def in_segments(series: np.ndarray) -> np.ndarray:
    """(5, C, K) segments of a series (N, C)."""
    return series.reshape(-1, 5, series.shape[1]).transpose(1, 2, 0)


def estimated_noise(series: np.ndarray) -> ColouredNoise | None:
    segments = in_segments(series)
    return ColouredNoise.of(segments, np.ones(segments.shape[2] - 1, dtype=bool))


@pytest.mark.parametrize("noise", list(NOISE))
def test_intervals_allow_for_coloured_noise(noise: str) -> None:
    chain = lw.bnes_chain(2)
    unknown = chain.unknown("all")
    z = []
    for seed in range(3):
        fit = lw.identify(noisy(noise, seed), unknown)
        assert fit.verdicts == (lw.Verdict.CONVERGED,) and fit.model_error == 0.0
        coloured = "x:m1, x:m2" if noise == "differenced" else "x:m1"
        assert f"which is correlated from sample to sample in {coloured}; all intervals" in fit.message
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


def test_a_search_that_did_not_converge_is_taken_up_with_coloured_noise() -> None:
    """Three steps are too few for white noise; from where they end the coloured noise is found, and its optimum."""
    record, unknown = noisy("AR(1) of 0.9", 3), lw.bnes_chain(2).unknown("nes")
    theta, spread = starting_values([record], unknown)
    short = LikelihoodOptions(steps=3)
    white = likelihood_fit(
        [record],
        unknown,
        theta,
        spread=spread,
        options=replace(short, coloured_noise=False, model_error=False),
    )
    assert white.status is AnnealingStatus.EXHAUSTED
    fit = likelihood_fit([record], unknown, theta, spread=spread, options=short)
    assert fit.status is AnnealingStatus.CONVERGED and fit.optimum.coloured is not None
    assert fit.model_error == 0.0
    whole = likelihood_fit([record], unknown, theta, spread=spread)
    errors = np.sqrt(whole.covariance.diagonal())
    # each search ends where the cost would fall by no more than its tolerance
    assert np.max(np.abs(fit.values - whole.values) / errors) < 2.0 * np.sqrt(AnnealingSchedule.tolerance)


def test_a_profile_counts_the_colour() -> None:
    record, unknown = noisy("AR(1) of 0.9", 3, duration=6.0), lw.bnes_chain(2).unknown("nes")
    theta, spread = starting_values([record], unknown)
    fit = likelihood_fit([record], unknown, theta, spread=spread)
    assert fit.optimum.of_white is not None
    for factor in (1.0, 2.0):
        deviation = factor * float(np.sqrt(fit.covariance[0, 0]))
        lower, upper = profile_ends(fit.optimum, "nes1.alpha", deviation, silent)
        assert (upper - lower) / (2.0 * 1.96 * deviation) == pytest.approx(1.0, abs=0.05)  # a parabola nearly


def test_an_error_of_the_sensor_is_seen_beneath_the_colour() -> None:
    record = noisy("AR(1) of 0.9", 4)
    values = record.values.copy()
    values[:, 0] *= 1.05
    fit = lw.identify(replace(record, values=values), lw.bnes_chain(2).unknown("nes"))
    assert not fit.trusted and fit.diagnosis[0].is_instrument


def test_noise_that_is_stated_and_larger_is_not_excused() -> None:
    record = noisy("AR(1) of 0.9", 5)
    sizes = 0.5 * 10.0 ** (-SNR / 20.0) * np.sqrt(np.mean(record.values**2, axis=0))
    stated = replace(record, noise=dict(zip(record.channels, map(float, sizes), strict=True)))
    assert lw.identify(stated, lw.bnes_chain(2).unknown("nes")).verdicts[0] is lw.Verdict.NOISE_MISMATCH


@pytest.mark.parametrize("correlation", [-0.4, 0.5, 0.9])
def test_an_autoregression_is_found(correlation: float) -> None:
    series = autoregressive(np.random.default_rng(1), (6000, 2), correlation)
    series[700:710] = 0.0  # missing
    noise = estimated_noise(series)
    assert noise is not None
    assert noise.channels.tolist() == [0] and noise.samples.tolist() == [5990, 5990]
    error = np.sqrt((1.0 - correlation**2) / 6000)
    assert noise.coefficients[0][0] == pytest.approx(correlation, abs=4.0 * error)
    size = np.sqrt(2.0 / 6000 * (1.0 + correlation**2) / (1.0 - correlation**2))
    assert noise.variances[0] == pytest.approx(1.0, abs=4.0 * size + 0.05)  # never below what is left is flat


def _fading(series: np.ndarray) -> np.ndarray:
    return series * np.linspace(1.5, 0.5, len(series))[:, None]


def _resonant(rng: np.random.Generator) -> np.ndarray:
    """A motion at a seventh of the rate with 1 % of damping under white forces."""
    pole = 0.99 * np.exp(2j * np.pi / 7.0)
    return np.asarray(
        scipy.signal.lfilter([1.0], np.poly([pole, pole.conj()]), rng.normal(size=(6000, 1)), axis=0)
    )


@pytest.mark.parametrize("kind", ["white", "drift", "fading", "resonant"])
def test_what_is_no_coloured_noise_of_a_sensor(kind: str) -> None:
    rng = np.random.default_rng(2)
    series = {
        "white": rng.normal(size=(6000, 2)),
        "drift": np.cumsum(rng.normal(size=(6000, 1)), axis=0),
        "fading": _fading(autoregressive(rng, (6000, 1), 0.5)),
        "resonant": _resonant(rng),
    }[kind]
    assert estimated_noise(series) is None


def _ringing(seed: int, damping: float) -> np.ndarray:
    """A mode at a fifth of the rate beside white noise: at so few samples a period its poles are far from the circle."""
    rng, frequency = np.random.default_rng(seed), 2.0 * np.pi / 5.0
    pole = np.exp((-damping + 1j) * frequency)
    mode = scipy.signal.lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.normal(size=(6000, 1)), axis=0)
    return np.asarray(mode + 0.5 * rng.normal(size=(6000, 1)))


def test_a_damped_mode_at_few_samples_a_period_is_no_noise() -> None:
    """Laws that miss a link leave it; it was taken for noise that remembers less than twenty samples."""
    assert estimated_noise(_ringing(1, 0.05)) is None
    assert estimated_noise(_ringing(1, 0.3)) is not None


@pytest.mark.parametrize("samples", [2.2, 2.5, 2.8, 3.0, 4.0, 5.0, 8.0, 15.0])
@pytest.mark.parametrize(("damping", "is_mode"), [(0.03, True), (0.14, True), (0.16, False), (0.5, False)])
def test_a_mode_resonates_up_to_its_damping_at_any_number_of_samples_a_period(
    samples: float, damping: float, is_mode: bool
) -> None:
    pole = np.exp(2.0 * np.pi / samples * (-damping + 1j * np.sqrt(1.0 - damping**2)))
    coefficients = np.asarray(-np.poly([pole, pole.conj()]).real[1:], dtype=np.float64)
    assert _resonates(coefficients) is is_mode


@pytest.mark.parametrize("kind", ["average", "filter", "notch"])
def test_spectra_with_edges_and_notches_are_noise(kind: str) -> None:
    white = np.random.default_rng(5).normal(size=6010)
    series = {
        "average": np.convolve(white, np.ones(3), mode="valid")[:6000],
        "filter": scipy.signal.sosfilt(scipy.signal.butter(8, 0.5, output="sos"), white)[10:]
        + 0.05 * np.random.default_rng(6).normal(size=6000),
        "notch": scipy.signal.lfilter(*scipy.signal.iirnotch(0.3, 2.0), white)[10:],
    }[kind]
    assert estimated_noise(series[:, None]) is not None


@pytest.mark.parametrize("damping", [0.22, 0.4])
def test_a_missing_link_is_no_coloured_noise(damping: float) -> None:
    """Two masses that are linked, identified as if each had its own spring, beside a third that is alone: the mode in which
    the two move against each other, at five samples a period, was taken for noise of their sensors, and the answer trusted.
    """
    masses = {"m1": 0.44, "m2": 0.4, "m3": 0.86}
    lower = link("lower", "m1-ground", "k*d + c*v", k=20.0, c=0.26)
    upper = link("upper", "m2-m1", "k*d + c*v", k=40.0, c=damping)
    other = link("other", "m3-ground", "k*d + c*v", k=40.0, c=0.14)
    release = {"v:m2": 0.04, "x:m1": 0.002, "x:m3": 0.003}
    record = lw.simulate(structure(masses, lower, upper, other), release=release, duration=11.0, rate=11.3)
    apart = structure(masses, lower, replace(upper, between=("m2", lw.model.GROUND)), other)
    fit = lw.identify(record.with_noise(26.0, seed=5_101_880), apart.unknown("all"))
    assert fit.verdicts[0] is lw.Verdict.NOISE_MISMATCH and not fit.trusted


def test_scores_of_coloured_noise_scatter_as_its_correlations_say() -> None:
    """By the spectrum, against the double sum over all pairs of samples; the chains of segments are told apart."""
    rng = np.random.default_rng(3)
    series = autoregressive(rng, (2000, 2), 0.8)
    noise = estimated_noise(series)
    assert noise is not None
    linked = np.ones(9, dtype=bool)
    linked[3] = False
    rows = rng.normal(size=(10, 10, 3))  # 10 segments of 5 samples in 2 channels
    parts = [
        EliminatedRows(part, rows[part], rows[part, :, 0], np.zeros((0,)), np.zeros((0,)))
        for part in (slice(0, 6), slice(6, 10))
    ]
    covariance = noise.score_covariance(parts, linked, samples=5)
    spectrum = noise._spectrum(0, 1 << 15)
    lags = np.fft.ifft(spectrum).real
    own = rows.reshape(10, 5, 2, 3)
    first, second = own[:4, :, 0].reshape(-1, 3), own[4:, :, 0].reshape(-1, 3)
    expected = sum(
        columns.T @ scipy.linalg.toeplitz(lags[: len(columns)]) @ columns for columns in (first, second)
    )
    white = own[:, :, 1].reshape(-1, 3)
    expected = expected + noise.innovations[1] * (white.T @ white)
    assert np.allclose(covariance, expected, rtol=1e-3)  # 0.95^200 and less is left between chains


def test_series_in_time_keep_chains_apart() -> None:
    values = np.arange(30.0).reshape(3, 2, 5)
    series = in_time(values, np.array([True, False, True, True]))
    assert series.shape == (2, 15 + 200)
    assert series[0, :6].tolist() == [0.0, 10.0, 20.0, 1.0, 11.0, 21.0]
    assert np.isnan(series[:, 6:206]).all() and series[1, 206:209].tolist() == [7.0, 17.0, 27.0]


@pytest.mark.parametrize("highest", [1, 2, 7, 60])
def test_the_window_is_that_of_parzen(highest: int) -> None:
    """As `scipy.signal` has it, but for rounding."""
    window = scipy.signal.windows.parzen(2 * highest + 1)[highest:]
    assert _parzen(highest) == pytest.approx(window, rel=0.0, abs=1e-12)
