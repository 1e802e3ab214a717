"""Equivalent springs and dampers against their closed forms."""

import numpy as np
import pytest
from structures import link

from linkwise.estimates import equivalent
from linkwise.estimates.link_estimate import LinkEstimate

AMPLITUDES = np.array([0.001, 0.01, 0.05])
FREQUENCY = 7.0
OMEGA = 2.0 * np.pi * FREQUENCY


def link_estimate(
    law: str, covariance: np.ndarray | None = None, free: tuple[str, ...] = (), **values: float
) -> LinkEstimate:
    subject = link("link", "m1-ground", law, **values)
    return LinkEstimate(subject, (), (-0.05, 0.05), (-1.0, 1.0), free, covariance, 1.0)


def test_linear_links_powers_and_quadratic_damping_have_their_closed_forms() -> None:
    answer = equivalent(link_estimate("k*d + c*v", k=300.0, c=2.0), AMPLITUDES, FREQUENCY)
    np.testing.assert_allclose(answer.stiffness, 300.0, rtol=1e-12)
    np.testing.assert_allclose(answer.damping, 2.0, rtol=1e-12)
    powers = link_estimate("k*d + k3*d**3 + c3*v*d**2", k=300.0, k3=1e5, c3=50.0)
    answer = equivalent(powers, AMPLITUDES, FREQUENCY)
    np.testing.assert_allclose(answer.stiffness, 300.0 + 0.75e5 * AMPLITUDES**2, rtol=1e-12)
    rounding = 1e-12 * 300.0 / OMEGA  # of the spring, which the integral takes out
    np.testing.assert_allclose(answer.damping, 50.0 * AMPLITUDES**2 / 4.0, rtol=1e-12, atol=rounding)
    answer = equivalent(link_estimate("c2*v*abs(v)", c2=3.0), AMPLITUDES, FREQUENCY)
    quadratic = 8.0 / (3.0 * np.pi) * 3.0 * OMEGA * AMPLITUDES
    np.testing.assert_allclose(answer.damping, quadratic, rtol=1e-4)  # kink of abs
    # identity: rounding of a force of c2 omega^2
    np.testing.assert_allclose(answer.stiffness, 0.0, atol=1e-12 * OMEGA**2)


def test_the_band_is_that_of_the_coefficients_and_none_without_a_covariance() -> None:
    spring = link_estimate("k*d + c*v", np.diag([4.0, 0.01]), ("k", "c"), k=300.0, c=2.0)
    answer = equivalent(spring, AMPLITUDES, FREQUENCY)
    # the quantile is written with seven digits
    np.testing.assert_allclose(answer.stiffness_band[:, 1] - 300.0, 1.959964 * 2.0, rtol=1e-6)
    np.testing.assert_allclose(answer.damping_band[:, 1] - 2.0, 1.959964 * 0.1, rtol=1e-6)
    answer = equivalent(link_estimate("k*d", None, ("k",), k=300.0), 0.01, FREQUENCY)
    assert np.isnan(answer.damping_band).all()
    assert answer.stiffness == pytest.approx(300.0)
