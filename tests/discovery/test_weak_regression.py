"""Weak equations as one quadratic model: blocks of rows that are perhaps repeated."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.discovery.screen import _add


@pytest.mark.parametrize("which", [[4, 0, 2], [2, 0, 2, 1, 0]])
def test_blocks_add_up_at_rows_that_repeat(which: list[int]) -> None:
    random = np.random.default_rng(len(which))
    block = random.normal(size=(len(which), len(which)))
    expected = random.normal(size=(5, 5))
    total = expected.copy()
    rows = np.array(which)
    np.add.at(expected, (rows[:, None], rows), block)
    _add(total, rows, block)
    np.testing.assert_allclose(total, expected, rtol=0.0, atol=1e-12)
