"""Bordered block-tridiagonal equations, in a band and in blocks, against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from present import present

from linkwise.likelihood.shooting.bordered_system import BorderedSystem, excess
from linkwise.likelihood.shooting.normal_equations import covariance
from linkwise.likelihood.shooting.segments import Scales


def system(nodes: int, m: int, p: int) -> BorderedSystem:
    """Normal equations J'J of a Jacobian whose rows touch two neighbouring nodes and the border."""
    random = np.random.default_rng(5)
    diagonal, coupling = np.zeros((nodes, m, m)), np.zeros((nodes - 1, m, m))
    right, corner = np.zeros((nodes, m, p + 1)), np.zeros((p, p))
    for k in range(nodes):
        rows = random.normal(size=(3 * m + p, 2 * m + p))
        own, later, border = np.split(rows, [m, 2 * m], axis=1)
        diagonal[k] += own.T @ own
        right[k, :, :p] += own.T @ border
        corner += border.T @ border
        if k + 1 < nodes:
            diagonal[k + 1] += later.T @ later
            coupling[k] = later.T @ own
            right[k + 1, :, :p] += later.T @ border
    right[..., p] = random.normal(size=(nodes, m))
    return BorderedSystem.of((diagonal, coupling, right), corner, random.normal(size=p))


def dense(equations: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
    """The whole matrix, nodes first, and the gradient."""
    (nodes, m, _), (diagonal, coupling, right) = equations.shape, equations.nodes
    size, p = nodes * m, len(equations.corner)
    matrix = np.zeros((size + p, size + p))
    for k in range(nodes):
        own, after = slice(m * k, m * (k + 1)), slice(m * (k + 1), m * (k + 2))
        matrix[own, own] = diagonal[k]
        if k + 1 < nodes:
            matrix[after, own], matrix[own, after] = coupling[k], coupling[k].T
    matrix[:size, size:] = right[..., :-1].reshape(size, p)
    matrix[size:, :size] = matrix[:size, size:].T
    matrix[size:, size:] = equations.corner
    return matrix, np.concatenate([right[..., -1].ravel(), equations.corner_gradient])


@pytest.mark.parametrize(
    ("nodes", "m", "p"),  # the last is assembled in two parts
    [(1, 4, 3), (2, 4, 3), (3, 4, 3), (37, 5, 2), (40, 3, 1), (1, 128, 5), (6, 128, 5), (12, 64, 60)],
)
def test_steps_of_a_dense_matrix(nodes: int, m: int, p: int) -> None:
    """With all that is free, with some or all of the border held, and held elsewhere."""
    equations = system(nodes, m, p)
    (matrix, gradient), size = dense(equations), nodes * m
    factor = present(equations.factor())
    by_nodes, by_border = factor.gradient
    schur = matrix[size:, size:] - matrix[size:, :size] @ np.linalg.solve(
        matrix[:size, :size], matrix[:size, size:]
    )
    largest = np.max(np.abs(equations.corner))
    np.testing.assert_allclose(factor.schur, schur, rtol=1e-8, atol=1e-8 * largest)
    for free, held in (
        (np.ones(p, bool), None),
        (np.arange(p) != 1, None),
        (np.zeros(p, bool), None),
        (np.arange(p) != 1, np.linspace(0.1, 0.2, p)),
    ):
        moving = np.append(np.ones(size, bool), free)
        step = np.zeros(size + p)
        step[size:] = np.zeros(p) if held is None else held * ~free
        pulled = gradient - matrix @ step
        step[moving] = np.linalg.solve(matrix[np.ix_(moving, moving)], pulled[moving])
        states, border = present(factor.solve(free, held))
        # same numerics: condition 1e3 at most
        np.testing.assert_allclose(
            np.append(states, border), step, rtol=1e-8, atol=1e-8 * np.max(np.abs(step))
        )
        predicted = 2.0 * gradient @ step - step @ matrix @ step  # of a quadratic cost, exactly
        fall = (
            np.vdot(by_nodes, states)
            + by_border @ border
            - excess(factor.schur, factor.reduced, border, free)
        )
        assert fall == pytest.approx(predicted, rel=1e-8, abs=1e-12)
        determinant = np.linalg.slogdet(matrix[np.ix_(moving, moving)])[1]
        assert factor.log_determinant(free) == pytest.approx(determinant, rel=1e-8)
    more = np.random.default_rng(6).normal(size=len(gradient))
    moved = factor.moved(more[:size].reshape(nodes, m), more[size:])
    expected = np.linalg.solve(matrix, gradient + more)
    np.testing.assert_allclose(
        np.concatenate([part.ravel() for part in present(moved.solve(np.ones(p, bool)))]),
        expected,
        rtol=1e-8,
        atol=1e-8 * np.max(np.abs(expected)),
    )


@pytest.mark.parametrize(("nodes", "m", "p"), [(7, 4, 3), (12, 64, 60)])
def test_some_of_the_border_alone_can_be_kept(nodes: int, m: int, p: int) -> None:
    equations, kept = system(nodes, m, p), np.array([0, p - 1])
    factor, some = present(equations.factor()), present(equations.factor(kept=kept))
    np.testing.assert_allclose(some.schur, factor.schur, rtol=1e-12, atol=1e-12)
    states, border = present(some.within(kept).solve(np.ones(2, bool)))
    held = np.isin(np.arange(p), kept)
    expected = present(factor.solve(held))
    np.testing.assert_allclose(states, expected[0], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(border, expected[1][held], rtol=1e-8, atol=1e-12)


def test_covariances_and_blocks_of_the_inverse_are_those_of_a_dense_one() -> None:
    equations, unit = system(7, 4, 3), np.array([30.0, 1e6, 0.02])
    matrix, _ = dense(equations)
    scales = Scales(np.ones(1), np.ones(4), unit)
    factor = present(equations.factor())
    whole = np.linalg.inv(matrix)[-3:, -3:] * np.outer(unit, unit)
    assert covariance(factor, scales, np.ones(3, bool)) == pytest.approx(whole, rel=1e-8)
    held = covariance(factor, scales, np.array([True, True, False]))
    expected = np.linalg.inv(matrix[:-1, :-1])[-2:, -2:] * np.outer(unit[:2], unit[:2])
    assert held[:2, :2] == pytest.approx(expected, rel=1e-8)
    assert not held[2].any() and not held[:, 2].any()
    inverse = np.linalg.inv(matrix[:28, :28]).reshape(7, 4, 7, 4)
    blocks, couplings = factor.inverse_blocks()
    for k, block in enumerate(blocks):
        np.testing.assert_allclose(block, inverse[k, :, k], rtol=1e-8, atol=1e-12)
    for k, block in enumerate(couplings):
        np.testing.assert_allclose(block, inverse[k + 1, :, k], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(("node", "m"), [(0, 4), (3, 4), (6, 4), (5, 128)])
def test_what_is_not_positive_definite_has_no_factor_unless_it_is_damped(node: int, m: int) -> None:
    """At either end, or between."""

    def equations() -> BorderedSystem:
        good = system(7, m, 5)
        diagonal, coupling, right = good.nodes
        diagonal[node] -= 1e3 * np.eye(m)
        return BorderedSystem.of((diagonal, coupling, right), good.corner, good.corner_gradient)

    assert equations().factor() is None
    added = np.full((7, m), 1e4), np.full(5, 1e4)
    states, border = present(present(equations().factor(added)).solve(np.ones(5, bool)))
    matrix, gradient = dense(equations())
    expected = np.linalg.solve(matrix + 1e4 * np.eye(len(matrix)), gradient)
    assert np.append(states, border) == pytest.approx(expected, rel=1e-8, abs=1e-10)


def test_a_border_that_nothing_determines_has_no_solution_and_no_covariance() -> None:
    """The corner less what the nodes take from it is negative; or rounding leaves a negative or any positive variance."""
    equations, scales = system(7, 4, 3), Scales(np.ones(1), np.ones(2), np.ones(2))
    factor = present(equations.factor())
    bad = replace(factor, schur=factor.schur - 1e4 * np.eye(3))
    assert bad.solve(np.ones(3, bool)) is None and bad.solve(np.zeros(3, bool)) is not None
    schur = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])
    for other in (None, replace(factor, schur=schur)):
        assert np.isinf(covariance(other, scales, np.ones(2, dtype=bool))).all()
