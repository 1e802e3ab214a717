"""Bordered block-tridiagonal equations: banded ones against dense matrices, and blocks from both ends against the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present

from linkwise.likelihood.shooting.bordered_system import (
    BlockEquations,
    BorderedSystem,
    BorderEquations,
    Damping,
    NodeBlocks,
)
from linkwise.likelihood.shooting.linear_model import covariance
from linkwise.likelihood.shooting.segments import Scales

M, P = 4, 3


def dense(equations: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
    """The whole matrix, nodes first, and the gradient."""
    nodes, m = equations.diagonal.shape[:2]
    size = nodes * m
    matrix = np.zeros((size + P, size + P))
    for k in range(nodes):
        own = slice(m * k, m * (k + 1))
        matrix[own, own] = equations.diagonal[k]
        if k + 1 < nodes:
            after = slice(m * (k + 1), m * (k + 2))
            matrix[after, own] = equations.coupling[k]
            matrix[own, after] = equations.coupling[k].T
    matrix[:size, size:] = equations.right[..., :-1].reshape(size, P)
    matrix[size:, :size] = matrix[:size, size:].T
    matrix[size:, size:] = equations.corner
    return matrix, np.concatenate([equations.right[..., -1].ravel(), equations.corner_gradient])


@pytest.fixture(params=[1, 2, 7], ids="{} nodes".format)
def equations(request: pytest.FixtureRequest) -> BorderedSystem:
    """Normal equations J'J of a Jacobian whose rows touch two neighbouring nodes and the border."""
    random, nodes = np.random.default_rng(5), request.param
    size = nodes * M
    rows = []
    for k in range(nodes):
        block = np.zeros((3 * M, size + P))
        reach = min(M * (k + 2), size)
        block[:, M * k : reach] = random.normal(size=(3 * M, reach - M * k))
        block[:, size:] = random.normal(size=(3 * M, P))
        rows.append(block)
    jacobian = np.concatenate(rows)
    matrix, gradient = jacobian.T @ jacobian, jacobian.T @ random.normal(size=len(jacobian))
    cut = matrix[:size, :size].reshape(nodes, M, nodes, M)
    return BorderedSystem(
        diagonal=np.stack([cut[k, :, k] for k in range(nodes)]),
        coupling=np.stack([cut[k + 1, :, k] for k in range(nodes - 1)]) if nodes > 1 else np.empty((0, M, M)),
        right=np.column_stack([matrix[:size, size:], gradient[:size]]).reshape(nodes, M, P + 1),
        corner=matrix[size:, size:],
        corner_gradient=gradient[size:],
    )


def test_blocks_of_the_inverse_are_those_of_a_dense_one(equations: BorderedSystem) -> None:
    size = equations.diagonal.shape[0] * M
    inverse = np.linalg.inv(dense(equations)[0][:size, :size])
    blocks = present(equations.factor()).inverse_blocks()
    assert len(blocks) == len(equations.diagonal)
    for k, block in enumerate(blocks):
        own = slice(M * k, M * (k + 1))
        np.testing.assert_allclose(block, inverse[own, own], rtol=1e-8, atol=1e-12)


def test_solves_as_a_dense_matrix_does(equations: BorderedSystem) -> None:
    matrix, gradient = dense(equations)
    nodes, border = present(present(equations.factor()).solve(np.ones(P, bool)))
    expected = np.linalg.solve(matrix, gradient)
    # same numerics: condition 1e3 at most
    assert np.concatenate([nodes.ravel(), border]) == pytest.approx(expected, rel=1e-8, abs=1e-10)
    assert equations.drop(nodes, border) == pytest.approx(gradient @ expected, rel=1e-8)


def test_a_factor_takes_another_gradient(equations: BorderedSystem) -> None:
    random, shape = np.random.default_rng(6), equations.diagonal.shape[:2]
    of_nodes, of_border = random.normal(size=shape), random.normal(size=P)
    right = equations.right.copy()
    right[..., -1] += of_nodes
    changed = replace(equations, right=right, corner_gradient=equations.corner_gradient + of_border)
    moved = present(present(equations.factor()).moved(of_nodes, of_border).solve(np.ones(P, bool)))
    for part, expected in zip(moved, present(present(changed.factor()).solve(np.ones(P, bool))), strict=True):
        np.testing.assert_allclose(part, expected, rtol=1e-8, atol=1e-10)  # same numerics


def test_damping_stands_on_the_diagonal(equations: BorderedSystem) -> None:
    matrix, gradient = dense(equations)
    random = np.random.default_rng(6)
    added = random.uniform(1.0, 2.0, len(gradient))
    damping = Damping(added[:-P].reshape(equations.diagonal.shape[:2]), added[-P:])
    nodes, border = present(present(equations.factor(damping)).solve(np.ones(P, bool)))
    expected = np.linalg.solve(matrix + np.diag(added), gradient)
    assert np.concatenate([nodes.ravel(), border]) == pytest.approx(expected, rel=1e-8, abs=1e-10)


def test_what_is_held_does_not_move(equations: BorderedSystem) -> None:
    matrix, gradient = dense(equations)
    free = np.array([True, False, True])
    nodes, border = present(present(equations.factor()).solve(free))
    moving = np.concatenate([np.ones(len(gradient) - P, bool), free])
    expected = np.zeros_like(gradient)
    expected[moving] = np.linalg.solve(matrix[np.ix_(moving, moving)], gradient[moving])
    assert border[1] == 0.0
    assert np.concatenate([nodes.ravel(), border]) == pytest.approx(expected, rel=1e-8, abs=1e-10)
    nodes, border = present(present(equations.factor()).solve(np.zeros(P, bool)))
    assert not border.any()
    assert nodes.ravel() == pytest.approx(np.linalg.solve(matrix[:-P, :-P], gradient[:-P]), rel=1e-8)


def test_what_is_held_elsewhere_moves_the_others_and_the_cost(equations: BorderedSystem) -> None:
    matrix, gradient = dense(equations)
    free, fixed_values = np.array([True, False, True]), np.array([9.0, -0.7, 9.0])
    factor = present(equations.factor())
    nodes, border = present(factor.solve(free, fixed_values))
    moving = np.concatenate([np.ones(len(gradient) - P, bool), free])
    step = np.zeros_like(gradient)
    step[~moving] = -0.7
    right = gradient[moving] + 0.7 * matrix[moving][:, ~moving].sum(axis=1)
    step[moving] = np.linalg.solve(matrix[np.ix_(moving, moving)], right)
    assert np.concatenate([nodes.ravel(), border]) == pytest.approx(step, rel=1e-8, abs=1e-10)
    predicted = 2.0 * gradient @ step - step @ matrix @ step  # of a quadratic cost, exactly
    assert equations.drop(nodes, border) - factor.excess(border, free) == pytest.approx(predicted, rel=1e-8)


def test_covariance_is_the_corner_of_the_inverse(equations: BorderedSystem) -> None:
    matrix, _ = dense(equations)
    unit = np.array([30.0, 1e6, 0.02])
    scales = Scales(np.ones(1), np.ones(M), unit)
    computed = covariance(equations.factor(), scales, np.ones(P, bool))
    assert computed == pytest.approx(np.linalg.inv(matrix)[-P:, -P:] * np.outer(unit, unit), rel=1e-8)
    with_fixed = covariance(equations.factor(), scales, np.array([True, True, False]))
    expected = np.linalg.inv(matrix[:-1, :-1])[-2:, -2:] * np.outer(unit[:2], unit[:2])
    assert with_fixed[:2, :2] == pytest.approx(expected, rel=1e-8)
    assert not with_fixed[2].any() and not with_fixed[:, 2].any()


def test_log_determinant_is_that_of_the_whole(equations: BorderedSystem) -> None:
    matrix, _ = dense(equations)
    factor = present(equations.factor())
    # same numerics
    assert factor.log_determinant(np.ones(P, bool)) == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-10)
    free = np.array([False, True, True])
    moving = np.concatenate([np.ones(len(matrix) - P, bool), free])
    expected = np.linalg.slogdet(matrix[np.ix_(moving, moving)])[1]
    # same numerics
    assert factor.log_determinant(free) == pytest.approx(expected, rel=1e-10)


def test_what_is_not_positive_has_no_factor(equations: BorderedSystem) -> None:
    negative = equations.diagonal.copy()
    negative[-1] -= 1e3 * np.eye(M)
    bad = replace(equations, diagonal=negative)
    assert bad.factor() is None
    assert np.isinf(covariance(None, Scales(np.ones(1), np.ones(M), np.ones(P)), np.ones(P, bool))).all()
    enough = Damping(np.full(negative.shape[:2], 1e4), np.full(P, 1e4))
    assert bad.factor(enough) is not None


def test_a_border_that_the_nodes_explain_has_no_solution(equations: BorderedSystem) -> None:
    # the corner less what the nodes take from it is negative: nothing determines the border
    bad = replace(equations, corner=equations.corner - 1e4 * np.eye(P))
    assert present(bad.factor()).solve(np.ones(P, bool)) is None
    assert present(bad.factor()).solve(np.zeros(P, bool)) is not None


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
    return BorderedSystem(diagonal, coupling, right, corner, random.normal(size=p))


def blocks(banded: BorderedSystem) -> BlockEquations:
    nodes, m, _ = banded.diagonal.shape
    coupling = np.concatenate([banded.coupling, np.zeros((1, m, m))])

    def some(first: int, last: int) -> NodeBlocks:
        right = banded.right[first:last].transpose(0, 2, 1)
        own = banded.diagonal[first:last].copy(), right.copy(), coupling[first:last].copy()
        return NodeBlocks(*own)

    return BlockEquations(
        (nodes, m),
        some,
        lambda border: banded.right[..., -1] - banded.right[..., :-1] @ border,
        lambda states: np.tensordot(states, banded.right[..., :-1], 2),
        lambda first, last: coupling[first:last],
        banded.corner,
        banded.corner_gradient,
    )


@pytest.mark.parametrize(
    ("nodes", "m", "p"), [(1, 4, 3), (2, 4, 3), (3, 4, 3), (37, 5, 2), (40, 3, 1), (6, 128, 3)]
)
def test_both_ends_meet(nodes: int, m: int, p: int) -> None:
    """The same numerics; nodes of 128 states are eliminated by two threads."""
    banded = system(nodes, m, p)
    by_blocks, by_band = present(blocks(banded).factor()), present(banded.factor())
    free, fixed_values = np.arange(p) != 1, np.linspace(0.1, 0.2, p)
    np.testing.assert_allclose(
        by_blocks.schur, by_band.schur, rtol=1e-8, atol=1e-8 * np.max(np.abs(banded.corner))
    )
    for (states, border), (expected, expected_border) in (
        (present(by_blocks.solve(free, given)), present(by_band.solve(free, given)))
        for given in (None, fixed_values)
    ):
        np.testing.assert_allclose(border, expected_border, rtol=1e-8)
        np.testing.assert_allclose(states, expected, rtol=1e-8, atol=1e-8 * np.max(np.abs(expected)))
        assert by_blocks.excess(border, free) == pytest.approx(
            by_band.excess(border, free), rel=1e-8, abs=1e-12
        )
    added = np.random.default_rng(6).normal(size=banded.right.shape[:2]), np.linspace(-1.0, 1.0, p)
    (states, border), (expected, expected_border) = (
        present(factor.moved(*added).solve(free)) for factor in (by_blocks, by_band)
    )
    np.testing.assert_allclose(border, expected_border, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(states, expected, rtol=1e-8, atol=1e-8 * np.max(np.abs(expected)))
    assert by_blocks.log_determinant(free) == pytest.approx(by_band.log_determinant(free), rel=1e-8)


@pytest.mark.parametrize(("node", "m"), [(0, 4), (3, 4), (6, 4), (5, 128)])
def test_equations_that_are_not_positive_definite_have_no_factor(node: int, m: int) -> None:
    """At either end, or where both meet; found by either thread."""
    banded = system(7, m, 2)
    banded.diagonal[node] -= 1e4 * np.eye(m)
    assert blocks(banded).factor() is None and blocks(banded).border() is None


def test_rounding_that_leaves_no_positive_definite_equations_leaves_no_covariance() -> None:
    """Their inverse has a negative variance, or, of the next rounding, any positive one."""
    scales, free = Scales(np.ones(1), np.ones(2), np.ones(2)), np.ones(2, dtype=bool)
    schur = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-15]])
    assert np.isinf(covariance(BorderEquations(schur, np.zeros(2), 0.0), scales, free)).all()
