"""Equations in both forms: stored, and computed when read."""

from typing import Any

import numpy as np
import pytest

from linkwise.errors import IdentificationError
from linkwise.sindy.regression.linear_system import DenseSystem, StreamedSystem

RANDOM = np.random.default_rng(0)
MATRIX = RANDOM.normal(size=(50, 3))
TARGET = MATRIX @ np.array([1.0, -2.0, 3.0])
NAMES = ("a", "b", "c")


def _spoilt(array: np.ndarray, place: int | tuple[int, int], value: float) -> np.ndarray:
    copy = array.copy()
    copy[place] = value
    return copy


def test_a_single_target_becomes_a_column_and_blocks_are_the_weighted_rows_in_order() -> None:
    equations = DenseSystem(MATRIX, TARGET, NAMES)
    assert equations.target.shape == (50, 1)
    assert equations.units == ("", "", "")
    assert equations.rows == 50
    weights = RANDOM.uniform(1.0, 2.0, 50)
    blocks = list(DenseSystem(MATRIX, TARGET, NAMES, weights=weights).blocks())
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in blocks]), MATRIX * weights[:, None])
    np.testing.assert_array_equal(np.concatenate([b for _, b in blocks])[:, 0], TARGET * weights)


def test_wide_equations_come_in_more_than_one_block_of_bounded_size() -> None:
    wide = np.ones((1000, 20000))
    blocks = list(DenseSystem(wide, np.ones(1000), tuple(map(str, range(20000)))).blocks())
    assert len(blocks) > 5
    assert sum(len(rows) for rows, _ in blocks) == 1000
    assert max(rows.nbytes for rows, _ in blocks) <= 64 * 20000 * 8


def test_streamed_equations_are_the_stored_ones() -> None:
    streamed = StreamedSystem(
        lambda piece: (MATRIX[piece], TARGET[piece, None]), 50, NAMES, ("", "", ""), ("b",)
    )
    stored = streamed.stored()
    np.testing.assert_array_equal(stored.matrix, MATRIX)
    np.testing.assert_array_equal(stored.target[:, 0], TARGET)
    assert stored.names == NAMES


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"names": ("a", "b")}, "50 rows and 3 columns were given 2 column names"),
        ({"target": TARGET[:-1]}, r"a target of shape \(49, 1\)"),
        ({"names": ("a", "b", "a")}, "two columns are called 'a'"),
        ({"matrix": _spoilt(MATRIX, (7, 1), np.inf)}, r"column 'b' .* not finite"),
        ({"target": _spoilt(TARGET, 4, np.nan)}, r"row 4 .* no finite right-hand side"),
        ({"weights": np.ones(3)}, r"50 rows need 50 weights, got an array of shape \(3,\)"),
        ({"units": ("N",)}, "3 columns need 3 units, got 1"),
        ({"target": np.column_stack([TARGET, TARGET]), "targets": ("b", "b")}, "two targets are called 'b'"),
        ({"weights": _spoilt(np.ones(50), 2, np.nan)}, r"row 2 .* weight"),
    ],
)
def test_equations_that_do_not_fit_together_are_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(IdentificationError, match=message):
        DenseSystem(**{"matrix": MATRIX, "target": TARGET, "names": NAMES, **given})
