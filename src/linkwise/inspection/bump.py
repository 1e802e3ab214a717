"""Integrals against smooth test functions: relations between a signal and its integrals without any derivative of samples."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_POWER = 8  # of the test function (1 - u^2)^p, which is zero with its first p - 1 derivatives at both ends


def bumps(width: int, derivatives: int, step: float, late: float = 0.0) -> Floats:
    """The test function and its derivatives at 2 `width` + 1 samples `step` s apart, shape (derivatives + 1, 2 width + 1).

    It is moved by `late` samples, less than one.
    """
    base = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** _POWER
    u = np.clip((np.arange(-width, width + 1) - late) / width, -1.0, 1.0)
    scale = 1.0 / (width * step)
    rows = [base.deriv(order)(u) * scale**order if order else base(u) for order in range(derivatives + 1)]
    return np.array(rows) * step


def projections(values: Floats, tests: Floats, hop: int) -> Floats:
    """Integrals (K, W) of samples (N,) against each of K test functions (K, 2 w + 1), moved by `hop` samples W times."""
    frames = np.lib.stride_tricks.sliding_window_view(values, tests.shape[1])[::hop]
    return np.asarray((frames @ tests.T).T)
