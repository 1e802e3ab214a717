"""The local model of a fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from linkwise.likelihood.shooting.linear_model import GaussNewtonModel, firm_border


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
