"""Score tests of columns one at a time: each against a fit beside the coefficients, and columns that are not finite."""

from __future__ import annotations

import numpy as np
import pytest

from linkwise.likelihood.single_tests import finite_columns, single_tests

PARAMETERS, TESTED = 2, 3


def equations(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (N, p + f) of parameters and what is tested, and residuals (N,)."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((60, PARAMETERS + TESTED)), rng.standard_normal(60)


def test_a_gain_is_what_a_fit_of_the_column_takes_off() -> None:
    columns, residuals = equations(1)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    tests = single_tests(curvature, slope, curvature, PARAMETERS)

    def cost(names: list[int]) -> tuple[float, np.ndarray]:
        solution, *_ = np.linalg.lstsq(columns[:, names], residuals)
        return float(np.sum((residuals - columns[:, names] @ solution) ** 2)), solution

    own = list(range(PARAMETERS))
    without, _ = cost(own)
    fitted = [cost([*own, PARAMETERS + number]) for number in range(TESTED)]
    np.testing.assert_allclose(tests.gains, [without - gone for gone, _ in fitted], rtol=1e-8)
    np.testing.assert_allclose(tests.sizes, [solution[-1] for _, solution in fitted], rtol=1e-8)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("white", [True, False])
def test_a_column_that_is_not_finite_leaves_the_others_as_they_are(value: float, white: bool) -> None:
    """One such column ended the tests of all, so that no error of a sensor and no missing term was named."""
    columns, residuals = equations(2)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    scatter = curvature if white else 1.5 * curvature
    apart = single_tests(curvature, slope, scatter, PARAMETERS)
    broken, steep = curvature.copy(), slope.copy()
    infinite = PARAMETERS + 1
    broken[infinite], broken[:, infinite], steep[infinite] = value, value, value
    spread = broken if white else 1.5 * broken
    tests = single_tests(broken, steep, spread, PARAMETERS)
    assert finite_columns(broken, steep, spread, PARAMETERS).tolist() == [True, False, True]
    assert tests.gains[1] == 0.0 and tests.sizes[1] == 0.0
    others = [0, 2]
    np.testing.assert_allclose(tests.gains[others], apart.gains[others], rtol=1e-12)
    np.testing.assert_allclose(tests.sizes[others], apart.sizes[others], rtol=1e-12)
    np.testing.assert_allclose(tests.deviations[others], apart.deviations[others], rtol=1e-12)
    np.testing.assert_allclose(tests.changes[:, others], apart.changes[:, others], rtol=1e-12)


def test_coefficients_that_are_not_finite_are_refused() -> None:
    columns, residuals = equations(3)
    curvature, slope = columns.T @ columns, columns.T @ residuals
    curvature[0, 0] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        single_tests(curvature, slope, curvature, PARAMETERS)
