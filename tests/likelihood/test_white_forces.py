"""Ambient forces that are white in continuous time: what they move within a sample, and what accelerations show of them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy
from present import some
from shaken_chain import DAMPING, NOISE, RATE, STEADY, STIFFNESS, SUBSTEPS, chain, motion

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.likelihood.marginal import _MeanSlope
from linkwise.verdict import Verdict

DENSITY = np.sqrt(2.0 / RATE)  # N/sqrt(Hz), one-sided, of 1 N a sample


def _matrices(n: int) -> tuple[Floats, Floats]:
    """Of the equations of a chain of n masses of 1 kg, and what forces do to them."""
    incidence = np.eye(n) - np.eye(n, k=1)
    pulls = incidence @ incidence.T
    matrix = np.block([[np.zeros((n, n)), np.eye(n)], [-STIFFNESS * pulls, -DAMPING * pulls]])
    return matrix, np.vstack([np.zeros((n, n)), np.eye(n)])


def _step_in_white_noise(matrix: Floats, process: Floats) -> tuple[Floats, Floats]:
    """The transition over a sample, and the covariance of what noise adds, of a spectral density (Van Loan 1978)."""
    m = len(matrix)
    whole = scipy.linalg.expm(np.block([[-matrix, process], [np.zeros((m, m)), matrix.T]]) / RATE)
    transition = whole[m:, m:].T
    return transition, transition @ whole[:m, m:]


def _process(forces: Floats, deviations: tuple[float, ...]) -> Floats:
    process: Floats = forces @ np.diag(np.array(deviations) ** 2 / RATE) @ forces.T
    return process


@cache
def velocities(deviations: tuple[float, ...], seconds: float, seed: int) -> lw.Record:
    """Velocities in white forces of so many N a sample, with noise of 3 % of them."""
    rng, n = np.random.default_rng(seed), len(deviations)
    matrix, forces = _matrices(n)
    process = _process(forces, deviations)
    transition, added = _step_in_white_noise(matrix, process)
    sizes, axes = np.linalg.eigh(added)
    steps = rng.standard_normal((int(seconds * RATE), 2 * n)) * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T
    still = scipy.linalg.solve_continuous_lyapunov(matrix, -process)
    state, shown = rng.multivariate_normal(np.zeros(2 * n), still), np.empty((len(steps), n))
    for number, step in enumerate(steps):
        shown[number] = state[n:]
        state = transition @ state + step
    noise = 0.03 * np.sqrt(np.mean(shown**2, axis=0)) * rng.standard_normal(shown.shape)
    return lw.Record(0.0, RATE, tuple(f"v:m{i}" for i in range(1, n + 1)), shown + noise)


@cache
def accelerations(corner: float, seconds: float, seed: int) -> lw.Record:
    """Accelerations of two masses in white forces of 1 N a sample, up to a corner in Hz, with noise of 1 %."""
    rng, count = np.random.default_rng(seed), int(seconds * RATE)
    matrix, forces = _matrices(2)
    spectrum = np.fft.rfft(rng.standard_normal((count, 2)), axis=0)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)
    spectrum[frequency > corner] = 0.0
    turns = 2j * np.pi * frequency[:, None, None] * np.eye(4)
    states = np.linalg.solve(turns - matrix, (spectrum @ forces.T)[:, :, None])[:, :, 0]
    shown = np.fft.irfft((states @ matrix.T + spectrum @ forces.T)[:, 2:], count, axis=0)
    noise = 0.01 * np.sqrt(np.mean(shown**2, axis=0)) * rng.standard_normal(shown.shape)
    return lw.Record(0.0, RATE, ("a:m1", "a:m2"), shown + noise)


@pytest.mark.parametrize("seed", [5799001, 5799002])
def test_a_white_force_on_one_mass_is_not_taken_for_one_on_its_neighbour(seed: int) -> None:
    fit = lw.identify(velocities((1.0, 0.0), 100.0, seed), chain(2).unknown("all"), ambient=["m1"])
    assert fit.trusted, fit.message
    [force] = some(fit.random_forces)
    # of some 3000 forces that the record determines: four times 1 / sqrt(6000)
    assert force.spectral_density == pytest.approx(DENSITY, rel=0.05)


def test_the_estimates_are_at_the_maximum_of_the_likelihood_of_white_noise_by_a_kalman_filter() -> None:
    record = velocities((1.0,), 40.0, 5799003)
    y = record.channel("v:m1")
    noise = 0.03 * float(np.sqrt(np.mean(y**2)))
    stated = lw.Record(record.start, record.rate, record.channels, record.values, noise={"v:m1": noise})
    fit = lw.identify(stated, chain(1).unknown("all"), ambient={"m1": DENSITY})
    assert fit.trusted, fit.message

    def cost(moved: Floats) -> float:
        return _kalman_cost(y, noise, *(fit.values + moved))

    for unit in np.diag(np.sqrt(fit.covariance.diagonal())):
        slope = 0.5 * (cost(unit) - cost(-unit))
        curvature = cost(unit) + cost(-unit) - 2.0 * cost(0.0 * unit)
        # a twentieth is where the search is said to have settled; as much for the relaxation of the flow beside the force
        assert abs(slope / curvature) < 0.1


def _kalman_cost(y: Floats, noise: float, stiffness: float, damping: float) -> float:
    """-2 log likelihood of velocities of one mass in a white force."""
    matrix, process = np.array([[0.0, 1.0], [-stiffness, -damping]]), np.diag([0.0, 1.0 / RATE])
    onward, added = _step_in_white_noise(matrix, process)
    mean, spread, total = np.zeros(2), np.diag([1e-2, 1e1]), 0.0  # at first far wider than the motion
    for sample in y:
        power = spread[1, 1] + noise**2
        surprise = sample - mean[1]
        total += surprise**2 / power + np.log(power)
        gain = spread[:, 1] / power
        mean, spread = mean + gain * surprise, spread - np.outer(gain, spread[1])
        mean, spread = onward @ mean, onward @ spread @ onward.T + added
    return float(total)


def test_accelerations_that_are_flat_up_to_half_the_rate_give_stiffness_and_damping() -> None:
    fit = lw.identify(accelerations(50.0, 60.0, 5799004), chain(2).unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    for parameter in some(fit.parameters):
        estimate = fit.coefficient(parameter.name)
        assert estimate.standard_error is not None and estimate.value is not None
        true = STIFFNESS if ".k" in parameter.name else DAMPING
        assert abs(estimate.value - true) < 4.0 * estimate.standard_error, parameter.name
    for force in some(fit.random_forces):
        assert force.spectral_density == pytest.approx(DENSITY, rel=0.05)


def test_accelerations_behind_a_filter_are_told_by_the_spectrum_of_the_forces() -> None:
    fit = lw.identify(accelerations(40.0, 60.0, 5799005), chain(2).unknown("all"), ambient="all")
    assert fit.verdicts[0] is Verdict.MEASUREMENT_ERROR, fit.message
    assert fit.diagnosis[0].kind == "coloured force"
    assert "below 50 Hz, as behind a filter against aliasing)" in fit.message
    assert "resample the accelerations at twice the frequency up to which the filter is flat" in fit.message


def test_slopes_that_scatter_are_averaged_and_those_that_go_on_are_not() -> None:
    rng, one = np.random.default_rng(5799006), np.ones(3)
    scattering, slope = _MeanSlope(), np.zeros(3)
    for _ in range(400):
        slope = scattering.following(one + rng.standard_normal(3), slope, one, settled=True)
    assert slope == pytest.approx(one, abs=0.3)  # of 400 draws: six times their standard error
    onward, slope = _MeanSlope(), np.zeros(3)
    for _ in range(20):
        slope = onward.following(one, slope, one, settled=True)
    assert slope == pytest.approx(one, abs=1e-12)
    unsettled, slope = _MeanSlope(), np.zeros(3)
    for target in (one, -one, one):
        slope = unsettled.following(target, slope, one, settled=False)
    assert slope == pytest.approx(one, abs=1e-12)


def test_laws_that_are_not_linear_are_judged_by_the_whole_record() -> None:
    """Parts in which the motion is larger or smaller move a damper like v*abs(v) by several standard errors."""
    record = _displacements(120.0, 5799007)
    fit = lw.identify(record, chain(2, "k*d + c*v + c2*v*abs(v)").unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    for link in ("l1", "l2"):
        estimate = fit.coefficient(f"{link}.c2")
        assert estimate.standard_error is not None and estimate.value is not None
        assert abs(estimate.value) < 4.0 * estimate.standard_error


def _displacements(seconds: float, seed: int) -> lw.Record:
    """Displacements of two masses in white forces of 1 N a sample, which are constant in a quarter of it."""
    rng = np.random.default_rng(seed)
    forces = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + int(seconds * RATE)) * SUBSTEPS, 2))
    x = motion(forces)[STEADY:, :2]
    return lw.Record(0.0, RATE, ("x:m1", "x:m2"), x + NOISE * rng.standard_normal(x.shape))
