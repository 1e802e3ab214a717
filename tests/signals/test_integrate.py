"""Integration of samples over time, against SciPy and against its declared order."""

import numpy as np
import pytest

from linkwise.signals.states import DRIFT_FREQUENCY, drift_frequency, integral


def test_the_integral_has_its_order() -> None:
    errors = []
    for count in (101, 201):
        time = np.linspace(0.0, 2.0, count)
        errors.append(np.abs(integral(np.cos(3.0 * time), time[1]) - np.sin(3.0 * time) / 3.0).max())
    assert errors[0] / errors[1] == pytest.approx(2.0**4, rel=0.05)  # order four, as of parabolas


@pytest.mark.parametrize(("frequency", "cutoff"), [(0.5, 0.1), (5.0, 1.0), (40.0, DRIFT_FREQUENCY)])
def test_drift_is_below_the_motion(frequency: float, cutoff: float) -> None:
    time = np.arange(20_000) / 1000.0
    sine = np.sin(2.0 * np.pi * frequency * time)
    for drift in (0.0, 0.05 * time, 0.5 * np.sin(0.4 * time)):  # of the sensor, weaker than the motion
        assert drift_frequency(sine + drift, 1000.0) == pytest.approx(cutoff, rel=0.02)
    assert drift_frequency(np.full(100, 9.81), 1000.0) == DRIFT_FREQUENCY  # at rest
