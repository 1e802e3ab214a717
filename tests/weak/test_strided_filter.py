"""Blocked correlation of signals with kernels equals a loop over windows."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.weak.window import strided_filter


@pytest.mark.parametrize(
    ("samples", "length", "stride"), [(100, 17, 3), (64, 64, 5), (301, 40, 80), (50, 3, 1)]
)
def test_blocked_filter_equals_a_loop(samples: int, length: int, stride: int) -> None:
    rng = np.random.default_rng(5)
    signals, kernels = rng.normal(size=(2, samples)), rng.normal(size=(3, length))
    filtered = strided_filter(signals, kernels, stride)
    rows = (samples - length) // stride + 1
    assert filtered.shape == (3, 2, rows)
    for row in range(rows):
        piece = signals[:, row * stride : row * stride + length]
        assert filtered[:, :, row] == pytest.approx(kernels @ piece.T, abs=1e-12 * length)
