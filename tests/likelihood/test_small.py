"""Maximum likelihood against an independent slow implementation: SciPy's integrator and least squares, single shooting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record
from scipy.integrate import solve_ivp
from scipy.optimize import OptimizeResult, least_squares

import linkwise as lw
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit

NAMES = ("spring1.k", "spring1.c", "nes1.alpha", "nes1.beta", "nes1.c")
TRUE = np.array([3e4, 1.0, -100.0, 1e6, 0.02])
START = TRUE * np.array([1.02, 0.7, 1.1, 0.9, 1.3])


@pytest.fixture(scope="module")
def record() -> lw.Record:
    """0.2 s, over which the chain is not chaotic; its noise is known."""
    clean = chain_record(2, duration=0.2)
    noisy = clean.with_noise(40.0, seed=7)
    return replace(noisy, noise=dict(present(noisy.simulated).noise))


@pytest.fixture(scope="module")
def slow(record: lw.Record) -> OptimizeResult:
    """Unknowns: the first state (4,) and theta (5,); written out by hand, nothing of linkwise in it."""
    x = np.stack([record.channel("x:m1"), record.channel("x:m2")])
    sigma = np.array([[record.noise["x:m1"]], [record.noise["x:m2"]]])
    scale = np.concatenate([[0.01, 0.01, 1.0, 1.0], np.abs(TRUE)])

    def motions(unknown: np.ndarray) -> np.ndarray:
        """(2, R, N) of R sets of unknowns (9, R), which are integrated as one system."""
        k, c, a, b, s = unknown[4:]

        def rates(_: float, states: np.ndarray) -> np.ndarray:
            x1, x2, v1, v2 = states.reshape(4, -1)
            d, v = x2 - x1, v2 - v1
            link = a * d + b * d**3 + s * v
            return np.concatenate([v1, v2, -k * x1 - c * v1 + link, -link / 0.01])

        run = solve_ivp(
            rates, (0.0, record.time[-1]), unknown[:4].ravel(), t_eval=record.time, method="DOP853", rtol=1e-9, atol=1e-12
        )  # fmt: skip
        moved: np.ndarray = run.y.reshape(4, unknown.shape[1], -1)[:2]
        return moved

    def residuals(unknown: np.ndarray) -> np.ndarray:
        scaled: np.ndarray = (x - motions((unknown * scale)[:, None])[:, 0]) / sigma
        return scaled.ravel()

    def jacobian(unknown: np.ndarray) -> np.ndarray:
        """Central differences, in steps of the cube root of the precision of a number."""
        step = 6e-6 * np.maximum(np.abs(unknown), 1.0)
        both = motions(scale[:, None] * (unknown[:, None] + np.hstack([np.diag(step), -np.diag(step)])))
        ahead, behind = np.split(both, 2, axis=1)
        slopes: np.ndarray = (behind - ahead) / (2.0 * step[:, None] * sigma[:, None])
        return slopes.transpose(0, 2, 1).reshape(-1, len(unknown))

    start = np.concatenate([[0.0, 0.0, 1.0, 0.0], START]) / scale
    optimum = least_squares(residuals, start, jac=jacobian, xtol=1e-10, ftol=1e-12)
    assert optimum.success
    covariance = np.linalg.inv(optimum.jac.T @ optimum.jac) * np.outer(scale, scale)
    return OptimizeResult(
        theta=optimum.x[4:] * scale[4:], covariance=covariance[4:, 4:], cost=2.0 * optimum.cost
    )


def fitted(record: lw.Record, structure: lw.Structure, start: np.ndarray) -> LikelihoodFit:
    return likelihood_fit([record], structure, start)


@pytest.fixture(scope="module")
def ours(record: lw.Record) -> LikelihoodFit:
    return fitted(record, lw.bnes_chain(2).unknown("all"), START)


def test_the_optimum_is_the_same(ours: LikelihoodFit, slow: OptimizeResult) -> None:
    assert ours.status.value == "converged"
    error = np.sqrt(np.diag(slow.covariance))
    # the search ends with less than 0.02 of the cost to gain, sqrt(0.02) standard errors along the worst direction
    assert np.abs((ours.values - slow.theta) / error).max() < 0.14
    assert ours.misfit.data == pytest.approx(slow.cost, abs=0.02)  # that end itself


def test_the_covariance_is_the_same(ours: LikelihoodFit, slow: OptimizeResult) -> None:
    error = np.sqrt(np.diag(slow.covariance))
    scaled = (ours.covariance - slow.covariance) / np.outer(error, error)
    assert np.abs(scaled).max() < 0.02  # tangents of order 4 in steps of a sample


def test_started_at_the_slow_optimum_it_stays_there(record: lw.Record, slow: OptimizeResult) -> None:
    """Within sqrt(0.02) = 0.14 of a standard error, at which the search may end."""
    again = fitted(record, lw.bnes_chain(2).unknown("all"), slow.theta)
    error = np.sqrt(np.diag(slow.covariance))
    assert np.abs((again.values - slow.theta) / error).max() < 0.14


@pytest.mark.parametrize("name", ["nes1.alpha", "spring1.k"])
def test_the_curvature_is_the_profiles(record: lw.Record, ours: LikelihoodFit, name: str) -> None:
    """Held one standard error away on either side, the cost of the best others rises by one."""
    number = NAMES.index(name)
    error = np.sqrt(ours.covariance[number, number])
    rises = []
    for sign in (-1.0, 1.0):
        constrained = lw.bnes_chain(2).unknown("all").with_values({name: ours.values[number] + sign * error})
        others = fitted(record, constrained, np.delete(ours.values, number))
        assert others.status.value == "converged"
        q = ours.path[-1].q
        rises.append(others.misfit.cost(q) - ours.misfit.cost(q))
    # the mean of both sides leaves out the cubic term; 0.02 of either search's end and the quartic term remain
    assert np.mean(rises) == pytest.approx(1.0, abs=0.1)


def test_the_covariance_is_that_of_many_noises(slow: OptimizeResult) -> None:
    """Standard errors by the slow way against the scatter of the fast way over 60 noises."""
    clean = chain_record(2, duration=0.2)
    estimates = []
    for seed in range(60):
        noisy = clean.with_noise(40.0, seed=seed)
        noisy = replace(noisy, noise=dict(present(noisy.simulated).noise))
        estimates.append(fitted(noisy, lw.bnes_chain(2).unknown("all"), TRUE).values)
    z = (np.stack(estimates) - TRUE) / np.sqrt(np.diag(slow.covariance))
    # a variance over 60 scatters by sqrt(2/60) = 0.18: 3 deviations
    assert np.mean(z**2, axis=0) == pytest.approx(np.ones(5), abs=0.55)
    assert np.abs(z.mean(axis=0)).max() < 3.0 / np.sqrt(60)
