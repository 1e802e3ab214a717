"""First modes of a test: how many are found where the structure is linear, and where it is not quite."""

import numpy as np
import pytest
from structures import CANTILEVER
from tapped_beam import DAMPING, shaken, tapped

import linkwise as lw
from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.pursuit import Projection, pursued_modes
from linkwise.progress import silent


def pursued(record: lw.Record) -> np.ndarray:
    return pursued_modes(ModalMeasurement.of([record]), None, silent).frequencies


def test_modes_of_a_linear_structure_are_found() -> None:
    # within a tenth of the half-power bandwidth
    assert pursued(tapped().with_noise(40.0, seed=11)) == pytest.approx(CANTILEVER, rel=0.2 * DAMPING)


@pytest.mark.slow
def test_no_modes_are_added_for_what_is_not_linear() -> None:
    """A cubic spring leaves 20 times the noise, which narrow modes beside the true ones would fit little by little."""
    frequencies = pursued(shaken(11, cubic=2e3).with_noise(60.0, seed=11))
    assert frequencies[1:] == pytest.approx(CANTILEVER[1:], rel=0.2 * DAMPING)  # the spring moves the first
    assert len(frequencies) == len(CANTILEVER)


@pytest.mark.slow
def test_no_modes_are_added_for_what_is_strong_in_a_band_alone() -> None:
    """As what a joint leaves at its resonance: narrow modes would each fit a few of its lines."""
    record, rng = shaken(12), np.random.default_rng(12)
    lines = np.fft.rfftfreq(len(record), record.step)
    spectrum = rng.standard_normal((2, len(lines), 2)) @ [1.0, 1.0j]
    noise = np.fft.irfft(np.where((lines > 9.0) & (lines < 13.0), spectrum, 0.0), len(record)).T
    values = record.values.copy()
    values[:, :2] += 0.3 * noise / noise.std(axis=0) * values[:, :2].std(axis=0)
    left = lw.Record(record.start, record.rate, record.channels, values).with_noise(60.0, seed=12)
    frequencies = pursued(left)
    assert len(frequencies) == len(CANTILEVER)
    assert frequencies == pytest.approx(CANTILEVER, rel=DAMPING)  # within the half-power bandwidth


def test_derivatives_of_what_is_left_are_those_of_differences() -> None:
    record = tapped().with_noise(30.0, seed=12)
    values = record.values.copy()
    values[100:130, 0] = np.nan
    measured = ModalMeasurement.of([lw.Record(record.start, record.rate, record.channels, values)])
    logs = np.log([[3.6, 0.012], [22.0, 0.009]])
    levels = np.array([0.3, 0.2])
    linear = Projection(measured, logs).equations(levels)
    step = 1e-5
    for number in range(4):
        change = np.zeros(4)
        change[number] = step
        moved = (logs + sign * change.reshape(2, 2) for sign in (1.0, -1.0))
        ahead, behind = (Projection(measured, each).cost(levels) for each in moved)
        # half the slope downwards; central differences of the second order
        expected = -(ahead - behind) / (4.0 * step)
        assert linear.slope[number] == pytest.approx(expected, rel=1e-5, abs=1e-6 * linear.cost)
