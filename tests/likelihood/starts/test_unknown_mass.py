"""Starts where the mass is unknown and no displacement was measured."""

from __future__ import annotations

import numpy as np
import pytest
from random_force import random_force
from structures import asked_oscillator, oscillator

import linkwise as lw

RIG = oscillator("k*d + c*v + k3*d**3", mass=1.3, name="spring", k=1500.0, c=1.5, k3=2e5)
RATE, DURATION = 400.0, 10.0


@pytest.mark.parametrize("sensor", ["v", "a"])
def test_a_duffing_oscillator_of_unknown_mass_by_force_and_velocity(sensor: str) -> None:
    rng = np.random.default_rng(3)
    driven = {"m1": random_force(rng, DURATION, RATE, rms=8.0, highest=20.0, band_limited=True)}
    clean = lw.simulate(RIG, forces=driven, duration=DURATION, rate=RATE, sensors=[sensor])
    unknown = asked_oscillator("k*d + c*v + k3*d**3")
    fit = lw.identify(clean.with_noise(40.0, seed=1), unknown)
    assert fit.trusted
    truth = {"m1.mass": 1.3, "spring.k": 1500.0, "spring.c": 1.5, "spring.k3": 2e5}
    for name, value in truth.items():
        estimate = fit.coefficient(name)
        assert abs(estimate.value - value) < 4.0 * (
            estimate.standard_error or 0.0
        )  # beyond by chance once in 4000
