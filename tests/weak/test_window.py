"""Test functions: sums obey integrals by parts, blocked filters equal loops, and noise is counted at every sample."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.weak.window import Window

WINDOWS = [Window.of_deviation(deviation, 1e-3) for deviation in (1.8, 2.2, 5.0, 20.0)]


@pytest.mark.parametrize("window", WINDOWS, ids=lambda window: f"half {window.half}")
def test_sums_by_parts_are_exact_for_polynomials(window: Window) -> None:
    """Sum phi' t^k = -k sum phi t^(k-1) and sum phi'' t^k = k (k-1) sum phi t^(k-2), to the fifth degree."""
    t = window.step * np.arange(-window.half, window.half + 1)
    phi, first, second = window.kernels
    for k in range(6):
        size_1, size_2 = np.abs(first) @ np.abs(t) ** k, np.abs(second) @ np.abs(t) ** k
        assert abs(first @ t**k + (k * (phi @ t ** (k - 1)) if k else 0.0)) < 1e-12 * size_1
        assert abs(second @ t**k - (k * (k - 1) * (phi @ t ** (k - 2)) if k > 1 else 0.0)) < 1e-12 * size_2


@pytest.mark.parametrize("window", WINDOWS, ids=lambda window: f"half {window.half}")
def test_test_functions_without_a_state(window: Window) -> None:
    """psi = -phi' - a phi, its derivatives, and phi, phi', phi'': sum (psi'' + a phi'') t^k is minus that of phi''' t^k."""
    a, plain, kernels = -40.0, window.kernels, window.without(-40.0).kernels
    scale = kernels[3, window.half] / plain[0, window.half]
    assert kernels[3:] == pytest.approx(scale * plain, rel=1e-12)
    assert kernels[:2] == pytest.approx(-scale * (plain[1:] + a * plain[:2]), rel=1e-9)
    assert np.linalg.norm(kernels[2]) == pytest.approx(1.0)
    t, third = window.step * np.arange(-window.half, window.half + 1), -kernels[2] - a * kernels[5]
    for k in range(6):
        expected = -k * (k - 1) * (k - 2) * (kernels[3] @ t ** (k - 3)) if k > 2 else 0.0
        assert abs(third @ t**k - expected) < 1e-11 * np.abs(third) @ np.abs(t) ** k


def test_sums_by_parts_on_an_oscillation() -> None:
    """sum phi'' x = sum phi x'' for 20 Hz: to the alias of phi, less in a wider window."""
    t = np.arange(600) / 1000.0
    x = np.sin(125.0 * t)
    errors = []
    for window in (Window.of_deviation(deviation, 1e-3) for deviation in (1.8, 3.0, 5.0, 8.0)):
        by_parts = window.filter(x[None], window.kernels[2:])[0, 0]
        direct = window.filter(-(125.0**2) * x[None], window.kernels[:1])[0, 0]
        errors.append(np.abs(by_parts - direct).max() / np.abs(direct).max())
    assert errors[0] < 1e-7 and errors[-1] < 1e-9  # 5.8e-8 and 2.7e-10 here, where nothing is random
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize("window", WINDOWS, ids=lambda window: f"half {window.half}")
def test_slope_differentiates_the_sixth_degree(window: Window) -> None:
    t = window.step * np.arange(-window.half, window.half + 1)
    for k in range(7):  # an identity, to the rounding of sums of terms that cancel
        expected = 1.0 if k == 1 else 0.0
        assert window.slope[0] @ t**k == pytest.approx(
            expected, abs=1e-11 * np.abs(window.slope[0]) @ np.abs(t) ** k
        )


@pytest.mark.parametrize("window", WINDOWS[1:], ids=lambda window: f"half {window.half}")
def test_coverage_is_what_all_windows_make_of_a_sample(window: Window) -> None:
    samples = 3 * window.length + 5
    valid = np.random.default_rng(2).uniform(size=window.rows(samples))
    covered = np.zeros((3, samples))
    for row, weight in enumerate(valid):
        covered[:, row * window.stride : row * window.stride + window.length] += weight * window.kernels
    assert window.coverage(window.kernels, valid, samples) == pytest.approx(covered, abs=1e-13)


@pytest.mark.parametrize("thin", [1, 2])
def test_places_stand_for_all_samples(thin: int) -> None:
    """The sum of squares at the places is that at all samples, to 1 % for a motion of the window's width, and every sample
    counts before the first and after the last centre.
    """
    window = Window.of_deviation(4.0, 1e-3)
    windows = 400
    rows = np.sin(1.0 * np.arange(windows) + np.array([[0.0], [1.0]]))
    everywhere = np.zeros((2, 3, (windows - 1) * window.stride + window.length))
    for row in range(windows):
        own = slice(row * window.stride, row * window.stride + window.length)
        everywhere[:, :, own] += rows[:, row, None, None] * window.kernels
    adjoint = window.adjoint(rows, thin)
    assert len(window.adjoint_windows(windows, thin)) == adjoint.shape[2]
    edges = np.concatenate([everywhere[:, :, : window.half], everywhere[:, :, -window.half :]], axis=2)
    assert adjoint[:, :, -2 * window.half :] == pytest.approx(edges.transpose(1, 0, 2), abs=1e-13)
    energy = np.sum(adjoint**2, axis=2).T, np.sum(everywhere**2, axis=2)
    assert energy[0] == pytest.approx(energy[1], rel=0.01)


def test_a_record_shorter_than_a_window_has_no_rows() -> None:
    window = Window.of_deviation(5.0, 1e-3)
    assert [window.rows(samples) for samples in (1, window.length - 1, window.length)] == [0, 0, 1]
    assert window.rows(window.length + 3 * window.stride) == 4


def test_window_follows_the_band() -> None:
    """Twice the frequency, half the window; never narrower than the sampling or wider than 400 samples of deviation."""
    # a half is rounded to samples: 2 of them, twice rounded
    halves = [Window.for_band(highest, 1000.0, noise_free=False).half for highest in (5.0, 10.0, 20.0)]
    assert halves[0] == pytest.approx(2 * halves[1], abs=2) and halves[1] == pytest.approx(
        2 * halves[2], abs=2
    )
    assert Window.for_band(500.0, 1000.0, noise_free=False).half == 8
    assert (
        Window.for_band(500.0, 1000.0, noise_free=True).half > 8
    )  # wider than over noise, for a smaller alias
    assert Window.for_band(1e-6, 1000.0, noise_free=False) == Window.of_deviation(400.0, 1e-3)
