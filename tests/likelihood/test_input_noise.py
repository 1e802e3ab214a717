"""Noise of the channels of inputs that nobody stated: told by the residuals, and not where it is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
from present import present
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.input_noise import (
    _multipliers,
    for_noise_of_inputs,
    noise_of_inputs,
)
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.variance_score import normal_score
from linkwise.verdict import Verdict

RATE, COUNT = 100.0, 801
STIFFNESS, DAMPING = 900.0, 1.0  # of a mass of 1 kg: 4.8 Hz, of which 8 s hold 38 periods


def mounted(end: str) -> lw.Structure:
    return oscillator("k*d + c*v", to=end, name="l1", k=STIFFNESS, c=DAMPING)


@cache
def driven(channel: str, noise: float, seed: int) -> lw.Record:
    """Displacements at 40 dB of a mass on a base, or under a force, in random motion whose channel has relative `noise`."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(COUNT, 1.0 / RATE)
    spectrum = np.exp(2j * np.pi * rng.random(len(frequency))) * ((frequency > 1.0) & (frequency < 12.0))
    signal = np.fft.irfft(spectrum, COUNT)
    moving = channel.endswith("base")
    given = lw.model.Sampled(0.0, RATE, (3e-3 if moving else 1.0) * signal / signal.std())
    length = (COUNT - 1) / RATE
    if moving:
        sensors = ("rel:x", channel)
        clean = lw.simulate(mounted("base"), duration=length, rate=RATE, base=given, sensors=sensors)
    else:
        clean = lw.simulate(mounted("ground"), duration=length, rate=RATE, forces={"m1": given})
    record = clean.with_noise(40.0, seed=seed)
    values = record.values.copy()
    column = values[:, record.channels.index(channel)]
    column += noise * column.std() * rng.standard_normal(COUNT)
    return replace(record, values=values)


@pytest.mark.parametrize(
    ("channel", "end", "noise"), [("a:base", "base", 0.004), ("force:m1", "ground", 0.012)]
)
def test_noise_that_nobody_stated_takes_trust_and_is_named(channel: str, end: str, noise: float) -> None:
    record = driven(channel, noise, 21)
    fit = lw.identify(record, mounted(end).unknown("all"))
    assert not fit.trusted
    [cause] = [cause for cause in fit.diagnosis if cause.kind == "input noise"]
    assert (cause.where, cause.is_instrument) == (channel, True)
    assert f"allow for noise of {channel}" in fit.message
    true = noise * record.channel(channel).std()
    # of the dozen residuals that tell it the coefficients have fitted some: to within a factor of three
    assert true / 3.0 < cause.size < 3.0 * true
    # a gain is what the cause takes off -2 log likelihood: that of a chi-square, which is above half the square of its excess
    assert cause.gain > 3.3**2
    assert lw.identify(record, mounted(end).unknown("all"), input_noise=[channel]).trusted


@pytest.mark.parametrize("seed", [2, 3, 4])
@pytest.mark.parametrize(("channel", "end"), [("a:base", "base"), ("force:m1", "ground")])
def test_clean_inputs_have_no_noise(channel: str, end: str, seed: int) -> None:
    fit = lw.identify(driven(channel, 0.0, seed), mounted(end).unknown("all"))
    assert fit.trusted, fit.message
    assert "input noise" not in [cause.kind for cause in fit.diagnosis]


def test_slopes_by_kicks_are_those_of_a_dense_least_squares_problem() -> None:
    record, structure = driven("force:m1", 0.02, 5), mounted("ground").unknown("all")
    fit = likelihood_fit([record], structure, np.array([STIFFNESS, DAMPING]))
    segments, optimum = fit.segments, fit.optimum
    misfit = evaluate(segments, optimum.point, optimum.scales, optimum.loss)
    slopes = _multipliers(optimum, misfit, np.ones(2, dtype=bool))[:, 0]
    samples, sigma = len(segments.samples), float(optimum.scales.sigma[0])

    def response(values: Floats) -> Floats:
        """(N, N + 2) displacements by kicks of the velocity at every sample, and by the state at the first."""
        matrix = np.array([[0.0, 1.0], [-values[0], -values[1]]])
        powers = scipy.linalg.expm(matrix[None] * np.arange(COUNT)[:, None, None] / RATE)
        kicks = scipy.linalg.toeplitz(powers[:, 0, 1], np.zeros(COUNT))
        return np.column_stack([kicks, powers[:, 0]])

    def driven_by_record(values: Floats) -> Floats:
        """(N,) displacements by the recorded force from rest, by quadrature at the points of the flow's steps."""
        moved = replace(optimum.point, theta=values, nodes=np.zeros_like(optimum.point.nodes))
        still = evaluate(segments, moved, optimum.scales, optimum.loss)
        kicks = present(still.trajectories.ends(segments.step))  # of each segment alone, from rest
        matrix = np.array([[0.0, 1.0], [-values[0], -values[1]]])
        onward = scipy.linalg.expm(matrix * samples / RATE)
        state, out = np.zeros(2), []
        inside = [scipy.linalg.expm(matrix * j / RATE)[0] for j in range(samples)]
        alone = still.trajectories.states[: segments.steps : segments.refine, 0, 0]
        for number in range(segments.count):
            out += [alone[j, number] + inside[j] @ state for j in range(samples)]
            state = onward @ state + kicks[:, number]
        return np.array(out[:COUNT])

    values, every = optimum.point.theta, response(optimum.point.theta)
    nodes = optimum.point.nodes[:, 0]
    steps = np.diag(1e-4 * values)

    def model(theta: Floats) -> Floats:
        return driven_by_record(theta) + response(theta)[:, COUNT:] @ nodes

    by_theta = [(model(values + step) - model(values - step)) / 2e-4 for step in steps]
    columns = np.column_stack([*by_theta, every[:, COUNT:]])
    residuals = record.channel("x:m1") - model(values)
    basis = np.linalg.qr(columns)[0]
    left = (residuals - basis @ (basis.T @ residuals)) / sigma**2
    dense = every[:, samples:COUNT:samples].T @ left
    # residuals and Jacobian agree to what the relaxed flow and single precision leave
    assert len(dense) == len(slopes) == segments.count - 1 > 100
    np.testing.assert_allclose(slopes[:, 0], dense, atol=0.02 * np.abs(dense).max())
    named = dict(zip((p.name for p in structure.parameters), values.tolist(), strict=True))
    [noise] = noise_of_inputs(fit, structure.with_values(named), record.channels)
    hinting = replace(noise, score=replace(noise.score, normal=3.0))
    _, added = present(for_noise_of_inputs(fit, [hinting]))
    moved = (
        np.linalg.lstsq(columns, every[:, samples:COUNT:samples] * noise.pattern[:, 0])[0][:2]
        * values[:, None]
    )
    np.testing.assert_allclose(
        added, (noise.score.deviation**2 + noise.score.error) * (moved @ moved.T), rtol=0.02
    )


def test_intervals_hold_noise_that_residuals_hint_at() -> None:
    record, unknown = driven("force:m1", 0.008, 34), mounted("ground").unknown("all")
    fit = lw.identify(record, unknown)
    assert fit.trusted
    assert "The residuals hint at noise of force:m1" in fit.message
    with pytest.raises(lw.IdentificationError, match="nor for noise of an input that the residuals hint at"):
        lw.likelihood.profile_interval(fit, "l1.c")
    stated = lw.identify(record, unknown, input_noise={"force:m1": 0.008})
    # the noise that is hinted at is told to a factor of three; friction, which it looks like a little, is counted besides
    by_noise = np.asarray(fit.covariance) - (0.0 if fit.for_dropped_terms is None else fit.for_dropped_terms)
    ratios = np.sqrt(by_noise.diagonal() / stated.covariance.diagonal())
    assert np.all((ratios > 1.0 / 3.0) & (ratios < 3.0))


def test_a_model_error_of_a_driven_structure_may_be_noise_of_the_input() -> None:
    fit = lw.identify(driven("force:m1", 0.05, 6), mounted("ground").unknown("all"))
    assert fit.fit_verdicts == (Verdict.MODEL_ERROR_NEEDED,)
    assert "Noise of force:m1 has the same effect" in fit.message


def test_noise_that_moves_nothing_has_no_score() -> None:
    """Of a base that a damper alone joins, noise of the displacement is no force in the equations."""
    damper = oscillator("c*v", to="base", name="damper", c=DAMPING).links[0]
    structure = replace(mounted("ground"), links=(*mounted("ground").links, damper))
    base = lw.model.Sampled(
        0.0, RATE, 3e-3 * np.convolve(np.random.default_rng(9).standard_normal(COUNT), np.ones(9), "same")
    )
    clean = lw.simulate(structure, base=base, duration=(COUNT - 1) / RATE, rate=RATE, sensors=("x", "x:base"))
    fit = lw.identify(clean.with_noise(40.0, seed=9), structure.unknown("l1.k", "damper"))
    assert fit.trusted, fit.message
    assert "input noise" not in [cause.kind for cause in fit.diagnosis]


def test_normal_scores_are_finite_wherever_a_sum_of_squares_is() -> None:
    """Chances below the least number come from an asymptotic series, to within the 1 / 100 that its first term leaves out."""
    for freedom in (10.0, 1000.0):
        chi_square = np.linspace(freedom, freedom + 8000.0, 400)
        scores = [normal_score(square - freedom, freedom, freedom) for square in chi_square]
        assert np.isfinite(scores).all() and (np.diff(scores) > 0.0).all()
        assert np.diff(scores, 2).max() < 0.01 * scores[-1]
    # traces by draws of a sum of many terms, where skewness is lost in their scatter: a normal score as it is
    assert normal_score(30.0, 50.0, -1.0) == pytest.approx(3.0, rel=1e-12)
