"""Smoothed states of linear systems."""

from __future__ import annotations

import numpy as np
import scipy

from linkwise.likelihood.starts.kalman import LinearModel, smooth

RATE, COUNT, NOISE = 2000.0, 1000, 1.0


def test_smooths_a_decay_without_random_forces() -> None:
    """Of light and of overdamped modes: covariances of the predicted states sink to rounding."""
    frequency, damping = np.array([5.0, 30.0, 90.0, 180.0]), np.array([0.01, 3.0, 0.01, 3.0])
    omega, zero = 2.0 * np.pi * frequency, np.zeros((4, 4))
    rates = np.block([[zero, np.eye(4)], [-np.diag(omega**2), -2.0 * np.diag(damping * omega)]])
    transition = scipy.linalg.expm(rates / RATE)
    rng = np.random.default_rng(3)
    observation = rng.normal(size=(8, 4)) @ rates[4:]  # accelerations
    states = np.empty((COUNT, 8))
    states[0] = rng.normal(size=8)
    for k in range(1, COUNT):
        states[k] = transition @ states[k - 1]
    samples = states @ observation.T + NOISE * rng.normal(size=(COUNT, 8))
    model = LinearModel(
        transition=transition,
        process=np.zeros((8, 8)),
        observation=observation,
        noise=np.full(8, NOISE**2),
        drive=np.zeros((8, 0)),
        direct=np.zeros((8, 0)),
        first=np.diag([1.0] * 4 + [1e5] * 4),
    )
    smoothed = smooth(model, samples, np.zeros((COUNT, 0)))
    error = np.abs(smoothed.states - states).max(axis=0) / np.abs(states).max(axis=0)
    assert error.max() < 1e-3
