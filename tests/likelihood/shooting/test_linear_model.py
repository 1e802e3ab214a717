"""The local model of a fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from linkwise.likelihood.shooting.bordered_system import BorderEquations
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel, covariance, firm_border
from linkwise.likelihood.shooting.segments import Scales


@pytest.mark.parametrize(
    ("firm_from", "expected"), [(1e-6, 1e-5), (5e-5, 1e-4), (1.0, 1e-5)], ids=["at once", "looser", "nowhere"]
)
def test_a_covariance_comes_from_equations_to_which_nothing_is_added(
    firm_from: float, expected: float
) -> None:
    """What is added to the nodes would count as information; the least relaxation that needs none is taken."""
    linear = SimpleNamespace(factor=lambda q: SimpleNamespace(q=q, damped=q < firm_from))
    factor = firm_border(cast(GaussNewtonModel, linear), 1e-5)
    assert factor is not None and cast(SimpleNamespace, factor).q == pytest.approx(expected)


def test_a_covariance_is_the_inverse_of_what_is_free_in_its_own_units() -> None:
    theta, free = np.array([1e4, 2.0, 1e-3]), np.array([True, False, True])
    schur = np.array([[4.0, 1.0, 1.0], [1.0, 9.0, 2.0], [1.0, 2.0, 5.0]])
    found = covariance(BorderEquations(schur, np.zeros(3), 0.0), Scales(np.ones(1), np.ones(2), theta), free)
    expected = np.array([[5.0, 0.0, -1.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 4.0]]) / 19.0
    np.testing.assert_allclose(found, expected * np.outer(theta, theta), rtol=1e-12)


def test_rounding_that_leaves_no_positive_definite_equations_leaves_no_covariance() -> None:
    """Their inverse has a negative variance, or, of the next rounding, any positive one."""
    scales, free = Scales(np.ones(1), np.ones(2), np.ones(2)), np.ones(2, dtype=bool)
    schur = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])
    assert np.isinf(covariance(BorderEquations(schur, np.zeros(2), 0.0), scales, free)).all()
