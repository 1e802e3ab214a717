"""Regressors on linear systems: against QR, on noise, and what cannot be determined."""

from typing import Any

import numpy as np
import pytest
from present import some
from problems import chain_record

from linkwise.errors import IdentificationError
from linkwise.signals.states import differentiate
from linkwise.sindy.library import monomial_equations
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.linear_system import DenseSystem, StreamedSystem
from linkwise.sindy.regression.regressor import L1, LeastSquares, Stlsq

TRUE = {  # Eq. 1 with Table 1, solved for the accelerations of the 2-mass chain
    "x1'": {"v1": 1.0},
    "x2'": {"v2": 1.0},
    "x1''": {
        "x1": -29900.0, "x2": -100.0, "v1": -1.02, "v2": 0.02,
        "x1**3": -1e6, "x1**2*x2": 3e6, "x1*x2**2": -3e6, "x2**3": 1e6,
    },
    "x2''": {"x1": -1e4, "x2": 1e4, "v1": 2.0, "v2": -2.0, "x1**3": 1e8, "x1**2*x2": -3e8, "x1*x2**2": 3e8, "x2**3": -1e8},
}  # fmt: skip


@pytest.fixture(scope="module")
def chain() -> StreamedSystem:
    """All cubic monomials of the paper's 2-mass chain: 6 s at 1 kHz, no noise, x, v and a measured."""
    record = chain_record(2, sensors=("x", "v", "a"))
    return monomial_equations(differentiate(record), 3)


def _problem(
    noise: float, seed: int = 0, columns: int = 12, rows: int = 400
) -> tuple[DenseSystem, np.ndarray]:
    """Correlated columns of scales from 1e-6 to 1e6, two targets, four true terms each."""
    random = np.random.default_rng(seed)
    mixed = random.normal(size=(rows, columns))
    mixed = mixed @ (np.eye(columns) + 0.3 * random.normal(size=(columns, columns)))
    scales = np.logspace(-6, 6, columns)
    truth = np.zeros((columns, 2))
    truth[[0, 3, 7, 11], 0] = np.array([1.0, -0.5, 2.0, 0.1]) / scales[[0, 3, 7, 11]]
    truth[[1, 3, 8, 10], 1] = np.array([-1.0, 0.3, 0.7, -2.0]) / scales[[1, 3, 8, 10]]
    matrix = mixed * scales
    target = matrix @ truth + noise * random.normal(size=(rows, 2))
    names = tuple(f"c{j}" for j in range(columns))
    return DenseSystem(matrix, target, names, targets=("p", "q")), truth


def test_the_default_finds_the_true_terms_of_the_chain_and_nothing_else(chain: StreamedSystem) -> None:
    fit = Stlsq().fit(chain)
    for target, terms in TRUE.items():
        named_terms = fit.terms(target)
        assert set(named_terms) == set(terms)
        for name, value in some(terms.items()):
            # Identity: the data satisfy the equations to rounding; 1e-11 leaves room for the weak dampers' share of 5e-4.
            assert named_terms[name] == pytest.approx(value, rel=1e-11), (target, name)
    assert np.all(fit.residual < 1e-12)


def test_the_threshold_means_the_same_in_every_unit(chain: StreamedSystem) -> None:
    stored = chain.stored()
    factors = np.logspace(-9, 9, len(stored.names))
    scaled = DenseSystem(stored.matrix * factors, 1e-6 * stored.target, stored.names, targets=stored.targets)
    for regressor in (Stlsq(), Stlsq(0.02)):
        plain, rescaled = regressor.fit(stored), regressor.fit(scaled)
        np.testing.assert_array_equal(plain.support, rescaled.support)
        shared = plain.support
        changed = (rescaled.coefficients * factors[:, None] * 1e6)[shared]
        # the same numerics in other units: 1e-15 of what cancels, whose weakest share is 1e-4; measured 7e-14
        np.testing.assert_allclose(changed, plain.coefficients[shared], rtol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_gram_matrix_gives_what_qr_gives(noise: float) -> None:
    equations, _ = _problem(noise)
    fit = LeastSquares().fit(equations)
    scale = np.linalg.norm(equations.matrix, axis=0)
    direct = np.linalg.lstsq(equations.matrix / scale, equations.target)[0] / scale[:, None]
    # the condition of the columns is some 20, of their Gram matrix 400: measured 6e-14 of the largest
    scaled = fit.coefficients * scale[:, None]
    np.testing.assert_allclose(scaled, direct * scale[:, None], rtol=1e-9, atol=1e-9)
    residual = equations.target - equations.matrix @ fit.coefficients
    left = np.linalg.norm(residual, axis=0) / np.linalg.norm(equations.target, axis=0)
    np.testing.assert_allclose(fit.residual, left, rtol=1e-8, atol=1e-14)
    freedom = 400 - 12
    covariance = np.linalg.inv((equations.matrix / scale).T @ (equations.matrix / scale))
    errors = np.sqrt(np.outer(np.diag(covariance), np.sum(residual**2, axis=0) / freedom)) / scale[:, None]
    # without noise the errors are rounding alone, of which only the size is known
    np.testing.assert_allclose(fit.standard_error, errors, rtol=1e-6, atol=1e-14 / scale.min())


def test_the_digits_lost_in_the_normal_equations_come_back() -> None:
    # The condition number of these columns is 1e7, of their Gram matrix 1e14: without the residual pass two digits are left.
    random = np.random.default_rng(1)
    matrix = np.linalg.qr(random.normal(size=(500, 8)))[0] @ np.diag(np.logspace(0, -7, 8))
    matrix = matrix @ np.linalg.qr(random.normal(size=(8, 8)))[0]
    truth = random.normal(size=8)
    fit = LeastSquares().fit(DenseSystem(matrix, matrix @ truth, tuple("abcdefgh")))
    # 1e-16 times the condition number, and a digit and a half; measured 2e-11
    np.testing.assert_allclose(fit.coefficients[:, 0], truth, rtol=1e-7)


def test_too_few_rows_to_hold_any_out_and_settings_outside_their_range_are_refused() -> None:
    equations, _ = _problem(0.1, rows=24)
    for regressor in (Stlsq(), L1()):
        with pytest.raises(IdentificationError, match="24 equations are too few to choose a threshold"):
            regressor.fit(equations)
    assert Stlsq(1e-3).fit(equations).support.any()
    with pytest.raises(IdentificationError, match=r"threshold must be .* below 1, got 1\.5"):
        Stlsq(1.5)
    with pytest.raises(IdentificationError, match=r"penalty must be above 0 .*, got 0\.0"):
        L1(0.0)


def test_noise_alone_has_no_terms() -> None:
    random = np.random.default_rng(1000)
    matrix = random.normal(size=(2000, 30))
    system = DenseSystem(matrix, random.normal(size=2000), tuple(f"c{j}" for j in range(30)))
    # Of 30 candidates the best is chosen by 1600 rows and judged by 400 others: a fluke must beat log(400) there.
    assert Stlsq().fit(system).support.sum() == 0


@pytest.mark.parametrize("penalty", [0.3, 0.1, 0.01, 1e-3, 1e-5])
def test_the_l1_solution_meets_the_conditions_of_optimality(chain: StreamedSystem, penalty: float) -> None:
    gram = Gram.of(chain)
    fit = L1(penalty, debias=False).fit_gram(gram, chain.units, chain.targets)
    for target in range(4):
        norm = gram.norms[target]
        scaled = fit.coefficients[:, target] * gram.scale / norm
        gradient = gram.moments[:, target] / norm - gram.matrix @ scaled
        active = scaled != 0
        # Identity, but for the digits that a Gram matrix of condition 300 takes.
        np.testing.assert_allclose(gradient[active], penalty * np.sign(scaled[active]), rtol=1e-9, atol=1e-12)
        # optimality, to the digits of the line above
        assert np.max(np.abs(gradient)) <= penalty * (1 + 1e-9)


def test_two_columns_that_move_together_are_named() -> None:
    equations, _ = _problem(0.01)
    doubled = np.column_stack([equations.matrix, 3 * equations.matrix[:, 4]])
    twins = DenseSystem(doubled, equations.target, (*equations.names, "twin"), targets=("p", "q"))
    message = r"the columns c4, twin are collinear .* only a combination"
    with pytest.raises(IdentificationError, match=message):
        LeastSquares().fit(twins)
    assert L1().fit(twins).support.sum() >= 8  # of two copies it takes one


def test_a_column_of_zeros_takes_no_part() -> None:
    equations, truth = _problem(0.0)
    matrix, names = np.column_stack([np.zeros(400), equations.matrix]), ("zero", *equations.names)
    with_zero = DenseSystem(matrix, equations.target, names, targets=("p", "q"))
    fit = Stlsq().fit(with_zero)
    np.testing.assert_array_equal(fit.support[1:], truth != 0)
    assert not fit.support[0].any()
    with pytest.raises(IdentificationError, match="every column of the equations is zero throughout"):
        LeastSquares().fit(DenseSystem(np.zeros((9, 2)), np.ones(9), ("a", "b")))
    with pytest.raises(IdentificationError, match="0 equations in 2 unknowns"):
        LeastSquares().fit(DenseSystem(np.zeros((0, 2)), np.ones(0), ("a", "b")))


def test_the_equations_are_written_as_one_would_write_them(chain: StreamedSystem) -> None:
    fit = Stlsq().fit(chain)
    lines = fit.text(4).splitlines()
    assert lines[0] == "x1' = 1*v1"
    start = "x1'' = -2.99e+04*x1 + 1e+06*x2**3 - 3e+06*x1*x2**2 - 100*x2 - 1.02*v1 + 3e+06*x1**2*x2"
    assert lines[1].startswith(start)
    with pytest.raises(IdentificationError, match="unknown equation 'y'; choose from x1', x1'', x2', x2''"):
        fit.terms("y")
    matrix = np.column_stack([np.ones(50), np.linspace(-1, 1, 50)])
    constant = DenseSystem(matrix, matrix @ [-2.0, 0.5], ("1", "x1"), targets=("x1''",))
    fit = LeastSquares().fit(constant)
    assert fit.text(3) == "x1'' = -2 + 0.5*x1"


RANDOM = np.random.default_rng(0)
MATRIX = RANDOM.normal(size=(50, 3))
TARGET = MATRIX @ np.array([1.0, -2.0, 3.0])
NAMES = ("a", "b", "c")


def _spoilt(array: np.ndarray, place: int | tuple[int, int], value: float) -> np.ndarray:
    copy = array.copy()
    copy[place] = value
    return copy


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
