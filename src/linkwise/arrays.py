"""Names for the types of arrays that signatures use; shapes stand in the docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


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


def finite(value: float) -> float | None:
    """The number as plain data, None where it is NaN or infinite."""
    return float(value) if np.isfinite(value) else None
