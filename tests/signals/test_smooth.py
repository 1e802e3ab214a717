"""Savitzky-Golay and the smoothing spline: exact where they must be, of their order elsewhere, and better than the noise."""

import numpy as np
import pytest

from linkwise.errors import RecordError
from linkwise.signals.states import savitzky_golay, smoothing_spline

RATE = 500.0
TIME = np.arange(1500) / RATE


def _motion(frequency: float = 11.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, first and second derivative of two channels (N, 2)."""
    w = 2 * np.pi * np.array([frequency, 0.3 * frequency])
    phase = TIME[:, None] * w + 0.4
    return np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)


@pytest.mark.parametrize("half", [3, 10])
def test_savitzky_golay_reproduces_polynomials_of_its_degree_up_to_both_ends(half: int) -> None:
    polynomial = np.polynomial.Polynomial(np.random.default_rng(0).normal(size=6))
    smoothed = savitzky_golay(polynomial(TIME), RATE, half=half)
    for order, values in enumerate(smoothed):
        exact = polynomial.deriv(order)(TIME) if order else polynomial(TIME)
        # Identity; each derivative multiplies rounding by the rate over the half window.
        np.testing.assert_allclose(values[:, 0], exact, atol=1e-11 * RATE**order)


def test_savitzky_golay_converges_with_its_declared_order() -> None:
    # Degree 5, symmetric window: value and slope are off by half^6, the second derivative by half^4.
    exact = _motion(2.0)
    errors = []
    for half in (16, 32):
        smoothed = savitzky_golay(exact[0], RATE, half=half)
        inner = slice(half, -half)
        pairs = zip(smoothed, exact, strict=True)
        errors.append([np.max(np.abs(found[inner, 0] - true[inner, 0])) for found, true in pairs])
    orders = np.log2(np.array(errors[1]) / np.array(errors[0]))
    # the declared orders, which differ by two; measured to 0.12
    np.testing.assert_allclose(orders, [6, 6, 4], atol=0.3)


@pytest.mark.parametrize("half", [2, 800])
def test_a_window_that_cannot_be_is_refused(half: int) -> None:
    message = rf"window for degree 5 must .* at most 1500 samples .*, got {2 * half + 1}"
    with pytest.raises(RecordError, match=message):
        savitzky_golay(TIME, RATE, half=half)


def test_the_spline_reproduces_cubics_at_any_smoothing() -> None:
    # The penalty is on fourth differences, so cubics cost nothing.
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    for smoothing in (1e-8, 1.0, 1e6, 1e12):
        spline = smoothing_spline(cubic(TIME), RATE, smoothing=smoothing)
        np.testing.assert_allclose(spline.value()[:, 0], cubic(TIME), atol=1e-8)
        np.testing.assert_allclose(spline.first()[:, 0], cubic.deriv()(TIME), atol=1e-8 * RATE)
        # identity, as the two above: the second derivative multiplies rounding by the square of the rate
        np.testing.assert_allclose(spline.second()[:, 0], cubic.deriv(2)(TIME), atol=1e-8 * RATE**2)


def test_smoothers_refuse_gaps_and_short_records() -> None:
    holed = np.sin(TIME)
    holed[[30, 31]] = np.nan
    message = "2 samples are missing, the first at index 30; smoothers cannot bridge a gap"
    with pytest.raises(RecordError, match=message):
        smoothing_spline(holed, RATE)
    with pytest.raises(RecordError, match="2 samples are missing"):
        savitzky_golay(holed, RATE, half=5)
    with pytest.raises(RecordError, match="10 samples are too few for a smoothing spline, which needs 16"):
        smoothing_spline(np.arange(10.0), RATE)
    with pytest.raises(RecordError, match=r"smoothing must be between 1e-8 and 1e12, got 0\.0"):
        smoothing_spline(TIME, RATE, smoothing=0.0)
