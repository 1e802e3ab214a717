"""Damping that a record leaves open: which laws are tested for it."""

from __future__ import annotations

import numpy as np
from structures import oscillator

import linkwise as lw

SINES = "12*sin(20*t) + 8*sin(33*t + 1) + 6*sin(47*t)"


def test_laws_with_a_jump_in_the_rate_are_nonlinear_in_it() -> None:
    """The slope of sign(v) does not hold v, yet damping beyond such a law takes no trust from it, at 35 dB."""
    truth = oscillator("k*d + c*v + f*sign(v)", k=900.0, c=2.0, f=0.3)
    asked = truth.unknown("all")
    right = [truth.coefficient(parameter.name).value or 0.0 for parameter in asked.parameters]
    exact = lw.simulate(truth, forces={"m1": SINES}, duration=8.0, rate=200.0)
    squares = []
    for seed in range(861, 867):
        fit = lw.identify(exact.with_noise(35.0, seed=seed), asked, method="weak")
        assert fit.trusted, fit.message
        squares.append(np.mean((fit.values - right) ** 2 / fit.covariance.diagonal()))
    assert np.mean(squares) < 2.0
