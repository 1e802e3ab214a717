"""What late sensors show of the motion of the base."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.likelihood.shooting.late_base import LateBase, values_at_delays
from linkwise.likelihood.shooting.late_sensors import LARGEST

RATE = 100.0


def late_sine(frequency: float, delay: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a sine of amplitude 1 and of its rate over 2 pi times the frequency, away from the ends of the record."""
    time = np.arange(400) / RATE
    values = values_at_delays(np.sin(2.0 * np.pi * frequency * time), RATE)
    base = LateBase.through([0], values[:, :, None, None], np.array([1.0 / RATE]))
    shown, rate = base.at(0, delay)
    phase = 2.0 * np.pi * frequency * (time - delay)
    inside = slice(40, -40)  # the reach of the windowed sinc
    slope = rate[:, 0] / (2.0 * np.pi * frequency)
    return (shown[:, 0] - np.sin(phase))[inside], (slope - np.cos(phase))[inside]


@pytest.mark.parametrize("samples", [-1.5, -0.4, 0.0, 0.5, 1.2])
def test_a_late_signal_is_as_if_it_were_recorded_late(samples: float) -> None:
    """At a sixth of the sampling rate Chebyshev's error is (pi / 2)^9 / (2^8 9!); slopes have 9^2 over pi / 2 of it.

    Twice that leaves room for the signal between its samples, of which the windowed sinc leaves 7e-6.
    """
    error = 2.0 * (np.pi / 2.0) ** 9 / (2.0**8 * 362880.0) + 1e-5
    value, rate = late_sine(RATE / 6.0, samples / RATE)
    assert np.abs(value).max() < error
    assert np.abs(rate).max() < 81.0 / (np.pi / 2.0) * error


def test_beyond_the_largest_delay_it_runs_straight_on() -> None:
    values = values_at_delays(np.sin(0.3 * np.arange(100)), RATE)
    base = LateBase.through([2], values[:, :, None, None], np.array([1.0 / RATE]))
    end, rate = base.at(2, LARGEST / RATE)
    beyond, slope = base.at(2, (LARGEST + 1.0) / RATE)
    np.testing.assert_allclose(slope, rate, rtol=1e-12)
    np.testing.assert_allclose(beyond, end - rate / RATE, rtol=1e-9, atol=1e-12)


def test_no_delay_is_the_signal_itself() -> None:
    values = np.random.default_rng(1).normal(size=50)
    through = values_at_delays(values, RATE)
    base = LateBase.through([0], through[:, :, None, None], np.array([1.0 / RATE]))
    np.testing.assert_allclose(base.at(0, 0.0)[0][:, 0], values, rtol=1e-12, atol=1e-12)
