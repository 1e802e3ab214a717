"""Polynomials that smooth a motion leave polynomials as they are, also at its ends."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.weak.window import Window, smoothed_motion


@pytest.mark.parametrize("deviation", [1.8, 6.0])
def test_polynomials_of_degree_six_pass_unchanged(deviation: float) -> None:
    window, time = Window.of_deviation(deviation, 0.01), 0.01 * np.arange(200)
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.5, -1.5, 0.7, 0.2])
    exact, slope = polynomial(time), polynomial.deriv()(time)
    smooth, rates = smoothed_motion(np.stack([exact, 2.0 * exact]), window)
    np.testing.assert_allclose(smooth, [exact, 2.0 * exact], rtol=0.0, atol=1e-8 * np.abs(exact).max())
    np.testing.assert_allclose(rates, [slope, 2.0 * slope], rtol=0.0, atol=1e-8 * np.abs(slope).max())


def test_noise_is_reduced() -> None:
    noise = np.random.default_rng(3).standard_normal((1, 2000))
    smooth, _ = smoothed_motion(noise, Window.of_deviation(6.0, 0.01))
    assert smooth.std() < 0.6 * noise.std()
