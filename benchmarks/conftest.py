"""The unit in which benchmarks tell time, so that figures of different machines can be compared."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

_TIMES = 5


@pytest.fixture(scope="module")
def unit() -> float:
    """U in s: one NumPy product of two different matrices, 1771 x 6000 by 6000 x 1771; the best of five, in the same run."""
    random = np.random.default_rng(0)
    left, right = random.normal(size=(1771, 6000)), random.normal(size=(6000, 1771))
    times = []
    for _ in range(_TIMES):
        started = perf_counter()
        left @ right
        times.append(perf_counter() - started)
    return min(times)
