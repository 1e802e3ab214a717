"""Searches of a few unknowns, and whether they say that they converged."""

import numpy as np
import pytest

from linkwise.arrays import Floats
from linkwise.modal.least_squares import LinearProblem, SearchEnd, least_squares

RESIDUALS = np.array([3.0, 1.0])


def _search(start: Floats, *, upper: float, rough: float = 0.0) -> SearchEnd:
    """The least of |x - RESIDUALS|^2 + 1, x at most `upper`; a `rough` cost is higher wherever it is not asked first."""
    asked: list[Floats] = []

    def cost(point: Floats) -> float:
        asked.append(point)
        return float(np.sum((point - RESIDUALS) ** 2)) + 1.0 + rough

    def equations(point: Floats) -> LinearProblem:
        return LinearProblem(cost(point) - rough, RESIDUALS - point, np.eye(2))

    return least_squares(
        start, equations, cost, lambda point: np.minimum(point, upper), steps=50, least_gain=1e-9
    )


def test_a_search_converges_at_the_least_sum() -> None:
    point, converged = _search(np.zeros(2), upper=10.0)
    assert converged
    assert point == pytest.approx(RESIDUALS, abs=1e-4)  # 1e-9 of a cost of 1 is 3e-5 of a unit
    # the slope at the bound promises a gain that no step within the bounds has
    point, converged = _search(np.array([2.0, 1.0]), upper=2.0)
    assert converged
    assert point == pytest.approx([2.0, 1.0], abs=1e-12)


def test_a_search_whose_steps_do_not_hold_their_promise_has_not() -> None:
    assert not _search(np.zeros(2), upper=10.0, rough=100.0).converged
