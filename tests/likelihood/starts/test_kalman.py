"""Smoothed states of linear systems."""

import dataclasses

import numpy as np
import pytest
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.starts.kalman import innovations, smooth
from linkwise.likelihood.starts.linear_part import LinearModel


def _dense(model: LinearModel, samples: Floats, inputs: Floats) -> tuple[Floats, Floats, float]:
    """States (N, m), their covariance (m, m) in the middle, and log likelihood, by least squares in all that is random."""
    count, m = len(samples), len(model.transition)
    means, roots = np.zeros((count, m)), np.zeros((count, m, count * m))
    roots[0, :, :m] = np.sqrt(model.first)
    for k in range(1, count):
        means[k] = model.transition @ means[k - 1] + model.drive @ (0.5 * (inputs[k] + inputs[k - 1]))
        roots[k] = model.transition @ roots[k - 1]
        roots[k, :, k * m : (k + 1) * m] += np.sqrt(model.process)
    known, noise = np.isfinite(samples), np.sqrt(model.noise)
    errors = ((samples - inputs @ model.direct.T - means @ model.observation.T) / noise)[known]
    rows = ((model.observation / noise[:, None]) @ roots)[known]
    q, r = np.linalg.qr(np.concatenate([np.eye(count * m), rows]))
    both = np.concatenate([np.zeros(count * m), errors])
    optimum = scipy.linalg.solve_triangular(r, q.T @ both)
    middle = roots[count // 2] @ np.linalg.inv(r)
    misfit = float(both @ both - np.sum((q.T @ both) ** 2))
    total = -0.5 * misfit - np.log(np.abs(r.diagonal())).sum() - np.sum(known @ np.log(noise))
    return means + roots @ optimum, middle @ middle.T, float(total)


def _driven(process: float) -> tuple[LinearModel, Floats, Floats]:
    """Two masses on springs under a force that is known and one that is random, with gaps in their sensors."""
    rng = np.random.default_rng(5)
    stiffness = np.array([[900.0, -400.0], [-400.0, 600.0]])
    rates = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -0.02 * stiffness]])
    drive = np.array([[0.0], [0.0], [1.0], [0.0]])
    augmented = scipy.linalg.expm(np.block([[rates, drive], [np.zeros((1, 5))]]) / 100.0)
    model = LinearModel(
        transition=augmented[:4, :4],
        process=process * np.diag([0.0, 0.0, 1.0, 0.5]),
        observation=np.array([[1.0, 0.0, 0.0, 0.0], rates[3]]),
        noise=np.array([1e-6, 4e-2]),
        drive=augmented[:4, 4:],
        direct=np.zeros((2, 1)),
        first=np.diag([1.0, 1.0, 900.0, 900.0]),
    )
    inputs, state = rng.normal(size=(90, 1)), np.array([0.3, -0.1, 2.0, 1.0])
    samples = np.empty((90, 2))
    for k in range(90):
        samples[k] = model.observation @ state + np.sqrt(model.noise) * rng.normal(size=2)
        mean = 0.5 * inputs[k : k + 2].sum() if k < 89 else 0.0
        state = model.transition @ state + model.drive[:, 0] * mean
        state = state + np.sqrt(np.diag(model.process)) * rng.normal(size=4)
    samples[40:55, 0] = samples[48:52, 1] = np.nan
    return model, samples, inputs


@pytest.mark.parametrize("process", [1e-2, 1e-12, 0.0])
def test_agrees_with_the_conditional_mean_of_all_states_as_one_vector(process: float) -> None:
    model, samples, inputs = _driven(process)
    states, covariance, total = _dense(model, samples, inputs)
    smoothed = smooth(model, samples, inputs)
    size = np.sqrt(np.mean(states**2, axis=0))
    scale = np.sqrt(np.diag(covariance))
    steady = 0.02 if process == 1e-2 else 1e-7  # the steady gain stands for one that differs by a hundredth
    assert np.abs((smoothed.states - states) / scale).max() < steady
    assert np.abs((smoothed.covariance - covariance) / np.outer(scale, scale)).max() < steady
    assert np.abs(smoothed.states - states).max() < 0.01 * size.max()
    known = np.isfinite(samples)
    assert abs(smoothed.log_likelihood - total) < steady * known.sum()
    white = innovations(model, samples, inputs)
    assert np.all(white[~known] == 0.0)
    if process == 0.0:
        assert np.mean(white[known] ** 2) == pytest.approx(1.0, abs=4.0 / np.sqrt(samples.size))
    # a frequency or damping of the wrong sign: the state at the start alone would not tell the end of the record
    growing = dataclasses.replace(model, transition=1.5 * model.transition)
    assert np.isfinite(smooth(growing, samples, inputs).states).all()
