"""When a frequency or a damping has moved: by more than errors, and by more than what matters."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Bools

SIGNIFICANT = 4.0
"""Standard errors by which it must differ: by chance once in 16 000."""
FREQUENCY, DAMPING = 5e-4, 0.05
"""Relative changes that matter: less is what temperature and sensors do."""


def differ(
    values: ArrayLike, errors: ArrayLike, others: ArrayLike, other_errors: ArrayLike, least: float
) -> Bools:
    """Whether `values` differ from `others` by more than errors, and by more than `least` of the others."""
    change = np.abs(np.subtract(values, others))
    return np.asarray(
        (change > SIGNIFICANT * np.hypot(errors, other_errors)) & (change > least * np.abs(others))
    )
