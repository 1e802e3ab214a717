"""Names for the types of arrays that signatures use; shapes stand in the docstrings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
_BISECTIONS = 200  # at most: they end when both ends are neighbouring numbers


def stretches(mask: Bools) -> list[slice]:
    """The runs of True in a mask (N,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask, [0]])))
    return [slice(first, end) for first, end in edges.reshape(-1, 2).tolist()]


def bridged(values: Floats) -> Floats:
    """Samples (N,) with straight lines over those that are missing; zeros without any sample."""
    missing = np.isnan(values)
    if missing.all():
        return np.zeros(len(values))
    index = np.arange(len(values))
    return np.interp(index, index[~missing], values[~missing]) if missing.any() else values


def sign_changes(function: Callable[[Floats], Floats], grid: Floats) -> Floats:
    """Where a function changes its sign between neighbouring points of a grid (N,) at which it is finite, to the last bit."""
    values = function(grid)
    signs = np.sign(np.where(np.isfinite(values), values, 0.0))
    before = np.flatnonzero(signs[:-1] * signs[1:] < 0.0)
    left, right, sign = grid[before], grid[before + 1], signs[before]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (left + right)
        if np.all((middle == left) | (middle == right)):
            break
        same = np.sign(function(middle)) == sign
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return np.where(np.abs(function(right)) < np.abs(function(left)), right, left)


def finite(value: float) -> float | None:
    """The number as plain data, None where it is NaN or infinite."""
    return float(value) if np.isfinite(value) else None
