"""Bordered block-tridiagonal equations against dense matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present

from linkwise.likelihood.shooting.bordered_system import BorderedSystem, Damping
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


def test_a_border_that_ran_away_has_no_factor(equations: BorderedSystem) -> None:
    corner = equations.corner.copy()
    corner[0, 0] = np.inf
    assert replace(equations, corner=corner).factor() is None


def test_a_wide_border_is_that_of_single_columns(equations: BorderedSystem) -> None:
    """Node by node, by products of blocks, against the band alone; of each column of the border as of a narrow one."""
    random, wide = np.random.default_rng(7), 600 // M
    nodes = len(equations.diagonal)
    right = random.normal(size=(nodes, M, wide + 1))
    corner, slope = 1e3 * np.eye(wide), random.normal(size=wide)
    whole = present(replace(equations, right=right, corner=corner, corner_gradient=slope).factor())
    schur, reduced = np.empty((wide, wide)), np.empty(wide)
    for column in range(wide):
        narrow = replace(
            equations, right=right[..., [column, -1]], corner=np.eye(1), corner_gradient=np.zeros(1)
        )
        forward = present(narrow.factor()).forward.reshape(-1, 2)
        np.testing.assert_allclose(whole.forward.reshape(-1, wide + 1)[:, [column, -1]], forward, rtol=1e-8)
        reduced[column] = slope[column] - forward[:, 0] @ forward[:, 1]
        schur[column] = corner[column] - forward[:, 0] @ whole.forward.reshape(-1, wide + 1)[:, :-1]
    np.testing.assert_allclose(whole.reduced, reduced, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(whole.schur, schur, rtol=1e-8, atol=1e-8)
