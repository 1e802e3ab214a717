"""Block tridiagonal equations eliminated from both ends, against the banded factor of the same equations."""

from __future__ import annotations

import numpy as np
import pytest
from present import present

from linkwise.likelihood.shooting.block_factor import BlockEquations, NodeBlocks
from linkwise.likelihood.shooting.bordered_system import BorderedSystem


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


@pytest.mark.parametrize(("nodes", "m"), [(1, 4), (8, 4), (5, 128)])
def test_the_border_alone_is_that_of_the_factor(nodes: int, m: int) -> None:
    """And tells by how much any step of the border reduces the cost where the nodes follow: 2 g's - s'H s."""
    banded = system(nodes, m, 3)
    equations = blocks(banded)
    border, factor = present(equations.border()), present(equations.factor())
    np.testing.assert_array_equal(border.schur, factor.schur)
    np.testing.assert_array_equal(border.reduced, factor.reduced)
    held = np.array([False, True, True])
    for free, fixed in ((np.ones(3, bool), np.zeros(3)), (held, np.array([0.3, 0.0, 0.0]))):
        states, step = present(factor.solve(free, fixed))
        reduction = banded.drop(states, step) - factor.excess(step, free)
        assert border.reduction(step) == pytest.approx(reduction, rel=1e-8)


@pytest.mark.parametrize(("node", "m"), [(0, 4), (3, 4), (6, 4), (5, 128)])
def test_equations_that_are_not_positive_definite_have_no_factor(node: int, m: int) -> None:
    """At either end, or where both meet; found by either thread."""
    banded = system(7, m, 2)
    banded.diagonal[node] -= 1e4 * np.eye(m)
    assert blocks(banded).factor() is None and blocks(banded).border() is None
