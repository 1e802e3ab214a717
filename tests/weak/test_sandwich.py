"""The covariance of many coefficients near its diagonal, against matrices that are inverted whole."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from linkwise.weak.scatter import sandwich


def symmetric(pairs: list[tuple[int, int]], count: int, seed: int) -> np.ndarray:
    """(count, count) symmetric with random entries at `pairs`, and a diagonal that makes it positive definite."""
    random = np.random.default_rng(seed)
    matrix = np.zeros((count, count))
    for first, second in pairs:
        matrix[first, second] = matrix[second, first] = random.normal()
    return matrix + np.diag(1.0 + np.abs(matrix).sum(axis=1))


@pytest.mark.parametrize(
    "pairs",
    [
        [(k, k + 1) for k in range(40)] + [(k, k + 3) for k in range(38)],
        [(20, k) for k in range(41) if k != 20],
        [(k, (k + 1) % 41) for k in range(41)],
        [],
    ],
    ids=["chain", "star", "ring", "apart"],
)
def test_entries_near_the_diagonal_are_those_of_the_whole_covariance(pairs: list[tuple[int, int]]) -> None:
    units = 10.0 ** np.random.default_rng(1).uniform(-8, 8, 41)  # of stiffnesses, dampings and masses
    h = symmetric(pairs, 41, 2) * np.outer(units, units)
    j = symmetric(pairs, 41, 3) * np.outer(units, units)
    rows, columns = np.nonzero(h)
    inverse = np.linalg.inv(symmetric(pairs, 41, 2))
    whole = (inverse @ symmetric(pairs, 41, 3) @ inverse) / np.outer(units, units)
    entries = sandwich(csc_array(h), csc_array(j), rows, columns)
    deviation = np.sqrt(whole.diagonal())
    assert entries / (deviation[rows] * deviation[columns]) == pytest.approx(
        (whole / np.outer(deviation, deviation))[rows, columns], abs=1e-12
    )


def test_a_covariance_of_nothing_but_rounding_is_zero() -> None:
    assert not sandwich(csc_array(np.eye(3)), csc_array((3, 3)), np.arange(3), np.arange(3)).any()
