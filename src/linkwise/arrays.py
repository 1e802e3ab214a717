"""Names for the types of arrays that signatures use; shapes stand in the docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


def finite(value: float) -> float | None:
    """The number as plain data, None where it is NaN or infinite."""
    return float(value) if np.isfinite(value) else None
