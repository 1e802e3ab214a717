"""Columns over states, named, counted and evaluated, and the regressors on them: against QR, on noise, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from present import some
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.errors import IdentificationError
from linkwise.signals.states import States, differentiate
from linkwise.sindy.library import Monomials, link_columns, monomial_equations
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.linear_system import DenseSystem, StreamedSystem
from linkwise.sindy.regression.regressor import L1, LeastSquares, Stlsq

COUNT = 400
SAME = 1e-9  # same numerics: rounding times the condition number of the columns
ROUNDING = 1e-11  # what rounding leaves of equations that hold exactly


def _states(structure: lw.Structure, *, forces: bool = False, base: bool = False, seed: int = 0) -> States:
    """Arbitrary motion, and the accelerations that the structure has in it: Eq. 1 holds point by point, whatever the orbit."""
    random = np.random.default_rng(seed)
    x = 0.02 * random.normal(size=(COUNT, structure.size))
    v = random.normal(size=x.shape)
    push = random.normal(size=x.shape) if forces else np.zeros_like(x)
    ground = 0.01 * random.normal(size=COUNT) if base else None
    rate = random.normal(size=COUNT) if base else None
    d, d_rate = structure.elongations(x, ground), structure.elongations(v, rate)
    force = np.column_stack([link.force(d[:, k], d_rate[:, k]) for k, link in enumerate(structure.links)])
    a = (push - (structure.incidence @ force.T).T) / structure.mass_values
    driven = structure.mass_names if forces else ()
    return States(np.arange(COUNT) / 1000, structure.mass_names, x, v, a, push, driven, ground, rate)


def test_monomials_are_counted_named_and_evaluated_in_the_same_order() -> None:
    # C(2n + 3, 3) for n = 2, 4, 6, 8, 10 masses: METHODS section 3.
    counts = [len(Monomials(tuple(f"y{j}" for j in range(2 * n)), 3)) for n in (2, 4, 6, 8, 10, 50)]
    assert counts == [35, 165, 455, 969, 1771, 176851]
    library = Monomials(("x1", "v1", "x2"), 3)
    assert library.names[:6] == ("1", "x1", "v1", "x2", "x1**2", "x1*v1")
    assert "x1**2*x2" in library.names and "x1*v1*x2" in library.names and library.names[-1] == "x2**3"
    assert len(library.names) == len(library) == len(set(library.names))
    values = np.random.default_rng(0).normal(size=(50, 3))
    columns = library.evaluate(values)
    assert columns.flags.f_contiguous
    for column, name in enumerate(library.names[1:], start=1):
        expected = np.ones(50)
        for factor in name.replace("**", "^").split("*"):
            variable, _, power = factor.partition("^")
            expected = expected * values[:, library.variables.index(variable)] ** int(power or 1)
        np.testing.assert_allclose(columns[:, column], expected, rtol=1e-12)


def test_a_library_that_cannot_be_is_refused() -> None:
    message = "an order of 0 or more and names that differ, got order -1 in a, b"
    with pytest.raises(lw.IdentificationError, match=message):
        Monomials(("a", "b"), -1)
    with pytest.raises(lw.IdentificationError, match="names that differ"):
        Monomials(("a", "a"), 2)


def test_a_library_of_a_mass_and_its_neighbours_holds_its_equation() -> None:
    states = _states(lw.bnes_chain(6))
    own = monomial_equations(states, 3, columns_of=("m3", "m4"), equations_of=("m4",))
    assert len(own.names) == 35
    fit = LeastSquares().fit(own)
    assert fit.targets == ("x4'", "x4''") and np.all(fit.residual < ROUNDING)
    sink = Stlsq().fit(own).terms("x4''")
    assert sink["x4"] == pytest.approx(1e4, rel=SAME) and sink["x4**3"] == pytest.approx(-1e8, rel=SAME)
    alone = monomial_equations(states, 3, columns_of=("m4",), equations_of=("m4",))
    fit = LeastSquares().fit(alone)
    assert fit.residual[fit.targets.index("x4''")] > 0.1  # the primary mass is missing


def test_masses_without_states_are_refused() -> None:
    states = _states(lw.bnes_chain(2))
    with pytest.raises(lw.IdentificationError, match=r"no states of m3; there are states of m1, m2"):
        monomial_equations(states, 3, columns_of=("m1", "m3"))
    with pytest.raises(lw.IdentificationError, match="no mass was chosen; there are states of"):
        monomial_equations(states, 3, equations_of=())
    with pytest.raises(lw.RecordError, match="mass m3 of the structure has no channel"):
        link_columns(states, lw.bnes_chain(4).unknown("nes"))


@pytest.mark.parametrize("which", [("nes",), ("all",), ("all", "mass:m2"), ("spring1.k", "nes2.beta")])
def test_the_links_of_the_chain_come_back_exactly(which: tuple[str, ...]) -> None:
    chain = lw.bnes_chain(4)
    unknown = chain.unknown(*which)
    equations = link_columns(_states(chain), unknown)
    assert equations.names == tuple(parameter.name for parameter in unknown.parameters)
    assert equations.units == tuple(parameter.unit for parameter in unknown.parameters)
    assert equations.rows == 4 * COUNT
    fit = LeastSquares().fit(equations)
    for name, value in zip(some(fit.names), fit.coefficients[:, 0], strict=True):
        truth = chain.coefficient(name).value
        assert value == pytest.approx(truth, rel=SAME), name
    assert fit.residual[0] < ROUNDING


def test_a_known_nonlinear_coefficient_is_no_obstacle_and_an_unknown_one_is() -> None:
    friction = oscillator("k*d + F*tanh(v/s)", mass=0.5, name="spring", k=900.0, F=0.2, s=0.05)
    states = _states(friction)
    fit = LeastSquares().fit(link_columns(states, friction.unknown("spring.k", "spring.F")))
    assert fit.terms("force")["spring.F"] == pytest.approx(0.2, rel=SAME)
    message = r"k\*d \+ F\*tanh\(v/s\) of link spring is not linear in its unknown .*ml"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, friction.unknown("all"))


def test_what_cannot_be_identified_is_refused() -> None:
    chain = lw.bnes_chain(2)
    states = _states(chain)
    message = r"every coefficient of .* is known: there is nothing to identify"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, chain)
    with pytest.raises(lw.IdentificationError, match="nothing sets their scale"):
        link_columns(states, chain.unknown("all", "mass:m1", "mass:m2"))
    alone = replace(states, masses=("m1", "q"))
    message = r"mass m2 of the structure has no channel, .* there are states of m1, q"
    with pytest.raises(lw.RecordError, match=message):
        link_columns(alone, chain.unknown("all"))


def test_link_columns_beyond_memory_say_how_large_they_are() -> None:
    long = np.broadcast_to(0.0, (10**8, 2))
    states = States(long[:, 0], ("m1", "m2"), long, long, long, long)
    message = r"5 unknowns over 2 masses and 100000000 samples are 8\.0 GB of columns; use the weak form"
    with pytest.raises(lw.IdentificationError, match=message):
        link_columns(states, lw.bnes_chain(2).unknown("all"))


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
