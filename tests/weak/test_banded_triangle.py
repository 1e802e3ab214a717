"""A banded triangle in blocks agrees with LAPACK's solutions of its bands."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

from linkwise.weak.likely_motion import BandedTriangle


@pytest.mark.parametrize(
    ("bands", "rows"), [(1, 6), (4, 4), (5, 20), (7, 50), (7, 55)], ids=lambda number: str(number)
)
def test_both_solutions_together_are_those_of_the_banded_matrix(bands: int, rows: int) -> None:
    """Where blocks fill the rows and where the last one does not."""
    rng = np.random.default_rng(bands * 100 + rows)
    lower = np.tril(np.triu(rng.standard_normal((rows, rows)), 1 - bands))
    lower[range(rows), range(rows)] = 3.0 + rng.random(rows)
    stored = np.zeros((bands, rows))
    for below in range(bands):
        stored[below, : rows - below] = np.diagonal(lower, -below)
    triangle, columns = BandedTriangle.of(stored), rng.standard_normal((rows, 3))
    forward = triangle.forward(columns)
    np.testing.assert_allclose(lower @ forward, columns, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lower.T @ triangle.backward(forward), forward, rtol=1e-12, atol=1e-12)
    expected = scipy.linalg.cho_solve_banded((stored, True), columns)
    np.testing.assert_allclose(triangle.backward(forward), expected, rtol=1e-10, atol=1e-12)
