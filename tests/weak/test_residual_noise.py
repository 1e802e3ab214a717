"""The covariance of weak residuals, its inverse, and the likeliest noise agree with those of full matrices."""

from __future__ import annotations

import numpy as np
from problems import chain_record

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.likely_motion import ResidualNoise
from linkwise.weak.window import smoothed_motion

SAMPLES = 90


def noise_of_chain() -> tuple[WeakEquations, ResidualNoise, np.ndarray]:
    """A piece of the record of the two-mass chain: its equations, their noise, and the coefficients."""
    chain = lw.bnes_chain(2)
    record = chain_record(2).with_noise(30.0, seed=4)[:SAMPLES]
    asked = chain.unknown("all")
    motion = read_displacements(record, asked)
    system = weak_equations(record, asked, motion)
    values = np.array([chain.coefficient(name).value for name in system.parameters])
    smooth = smoothed_motion(motion.displacements, system.window)
    noise = ResidualNoise.of(system.patches[0], system, motion.floored_variance, values, smooth)
    return system, noise, values


def passed(noise: ResidualNoise) -> np.ndarray:
    """(R m, 2 N) what a unit of each sample of both masses adds to the residuals."""
    columns = []
    for node in range(2):
        for sample in range(SAMPLES):
            unit = np.zeros((len(noise.variance), SAMPLES))
            unit[node, sample] = 1.0
            columns.append(noise.passed(unit).ravel())
    return np.array(columns).T


def test_the_factor_is_that_of_the_covariance_of_what_samples_add() -> None:
    system, noise, _ = noise_of_chain()
    acting, variance = passed(noise), np.repeat(noise.variance[:2], SAMPLES)
    covariance = (acting * variance) @ acting.T
    size = len(covariance)
    assert size == 2 * system.windows
    lower = np.zeros_like(covariance)
    for below, band in enumerate(noise.factor):
        lower[np.arange(below, size), np.arange(size - below)] = band[: size - below]
    np.testing.assert_allclose(lower @ lower.T, covariance, rtol=0.0, atol=1e-6 * covariance.max())
    some = np.random.default_rng(5).standard_normal((3, system.windows, 2))
    weighted = noise.weighted(noise.whitened(some)).reshape(3, -1)
    np.testing.assert_allclose(weighted @ (lower @ lower.T), some.reshape(3, -1), rtol=1e-6, atol=1e-6)
    likeliest = noise.likeliest(some[0], SAMPLES)
    expected = (variance * (some[0].ravel() @ acting)).reshape(2, SAMPLES)
    np.testing.assert_allclose(likeliest[:2], expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


def test_residuals_change_as_small_displacements_say() -> None:
    """To first order, by a difference of two sets of equations: the slopes are those along the motion itself."""
    chain = lw.bnes_chain(2).unknown("all")
    record = chain_record(2)[:SAMPLES]
    system = weak_equations(record, chain, read_displacements(record, chain))
    exact = system.motion.displacements
    change = np.zeros_like(exact)
    change[:2] = 1e-7 * np.random.default_rng(6).standard_normal((2, SAMPLES))
    _, _, values = noise_of_chain()
    smooth = smoothed_motion(exact, system.window)
    noise = ResidualNoise.of(system.patches[0], system, np.array([1.0, 1.0, 0.0, 0.0]), values, smooth)
    columns = dict(zip(record.channels, record.values.T, strict=True))
    moved = {f"x:m{k + 1}": columns[f"x:m{k + 1}"] + change[k] for k in range(2)}
    other = lw.Record.from_arrays(record.time, moved)
    later = weak_equations(other, chain, read_displacements(other, chain), window=system.window)
    difference = (later.patches[0].residual(values) - system.patches[0].residual(values)).T
    expected = noise.passed(change)
    np.testing.assert_allclose(difference, expected, rtol=0.0, atol=5e-3 * np.abs(expected).max())
