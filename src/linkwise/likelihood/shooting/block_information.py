"""Score and information of consecutive blocks of segments on the border, the states eliminated as the whole record does.

With H of the states, border E and corner C of all segments, F = H^-1 E says how the states follow the unknowns. The segments
of a block contribute H_b, E_b and C_b, and their information is C_b - E_b' F + F' (H_b F - E_b). The last difference is zero
but at the first and the last node of the block, where it is what the link with the neighbouring segment transmits: the
product E_b' F remains, of sparse E_b where the structure has many masses.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import lapack

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.linear_model import Factor, GaussNewtonModel
from linkwise.likelihood.shooting.local_equations import LocalFactor, LocalLinearization, LocalSystem
from linkwise.likelihood.shooting.normal_equations import Linearization, block_ends

_AT_ONCE = 64  # unknowns whose states are held together, of many masses; as many nodes


@dataclass(frozen=True, eq=False)
class FactoredModel:
    """Gauss-Newton blocks at a point, and the `factor` of their equations at a relaxation, without damping."""

    linear: GaussNewtonModel
    factor: Factor

    @property
    def in_blocks(self) -> bool:
        """Whether the corner of `linear` is that of several blocks."""
        return len(self.linear.data.corner_gradients) > 1

    @classmethod
    def within(cls, linear: GaussNewtonModel, factor: Factor, border: Indices, q: float) -> FactoredModel:
        """That of these unknowns of the border alone, in arrays of its own, from a linearization with more of them."""
        own = linear.within(border)
        if isinstance(own, LocalLinearization):
            assert isinstance(factor, LocalFactor)
            return cls(own, own.equations(q).with_nodes_of(factor, border))
        assert isinstance(factor, BorderedFactor)
        return cls(own, factor.within(border))


def block_information(linear: GaussNewtonModel | FactoredModel, q: float) -> tuple[Floats, Floats] | None:
    """Scores (B, p) and information (B, p, p) of as many blocks as the corner of `linear` has.

    None where the equations are singular.
    """
    if isinstance(linear, FactoredModel):
        factor, linear = linear.factor, linear.linear
    else:
        own = linear.equations(q).factor()
        if own is None:
            return None
        factor = own
    if isinstance(linear, LocalLinearization):
        assert isinstance(factor, LocalFactor)
        return _local(linear, factor, q)
    assert isinstance(factor, BorderedFactor)
    return _dense(linear, factor, q)


def _dense(linear: Linearization, factor: BorderedFactor, q: float) -> tuple[Floats, Floats]:
    weight, follow = 1.0 / q**2, followed_states(factor)
    K, _, p = follow.shape
    gradient, corner = _corners(linear, weight)
    ends = block_ends(K, len(corner))
    for block, (first, last) in enumerate(pairwise(ends)):
        inner = slice(first, min(last, K - 1))  # segments that another follows
        own = weight * linear.defects.right[first:last] + linear.data.right[first:last]
        along = _product(own, follow[first:last])
        moved = linear.joined[inner, :, None] * follow[first + 1 : inner.stop + 1]
        along -= weight * _product(linear.right_ends[inner], moved)
        corner[block] -= along[:p]
        gradient[block] -= along[p]
    for block, node in enumerate(ends[1:-1]):
        moved = linear.joined[node - 1, :, None] * follow[node]
        link = moved + linear.right_ends[node - 1, :, :p] - linear.state_ends[node - 1] @ follow[node - 1]
        _transmit(corner, block, weight * moved.T @ link)
    return gradient, 0.5 * (corner + corner.transpose(0, 2, 1))


def followed_states(factor: BorderedFactor) -> Floats:
    """(K, m, p): by how much the scaled states fall where an unknown grows by one unit and the states follow."""
    (K, m), p = factor.shape, len(factor.schur)
    forward = factor.forward[..., :p].reshape(K * m, p)
    follow, _ = lapack.dtbtrs(factor.chol, forward, uplo="L", trans="T")
    return np.ascontiguousarray(follow).reshape(K, m, p)


def _corners(linear: GaussNewtonModel, weight: float) -> tuple[Floats, Floats]:
    """The gradients (B, p) and the corners (B, p, p) of the border, by blocks."""
    data, defects = linear.data, linear.defects
    gradients = data.corner_gradients + weight * defects.corner_gradients
    if isinstance(linear, Linearization):
        return gradients, linear.data.corners + weight * linear.defects.corners
    return gradients, linear.data.corners_by_blocks + weight * linear.defects.corners_by_blocks


def _transmit(corner: Floats, block: int, passed: Floats) -> None:
    """Move what the link behind a block transmits from the next block to it."""
    corner[block] += passed
    corner[block + 1] -= passed


def _local(linear: LocalLinearization, factor: LocalFactor, q: float) -> tuple[Floats, Floats]:
    equations = linear.equations(q)
    weight, border = 1.0 / q**2, equations.order.border
    gradient, corner = _corners(linear, weight)
    gradient, corner = gradient[:, border], corner[:, border[:, None], border]
    (K, m), p = linear.missed.shape, len(border)
    ends = block_ends(K, len(corner))
    nodes = np.array(ends[1:-1], dtype=int)
    at_nodes, links = np.empty((len(nodes), p, m)), np.empty((len(nodes), p, m))
    for first in range(0, p, _AT_ONCE):
        some = slice(first, min(first + _AT_ONCE, p))
        right = np.empty((K, some.stop - first, m))
        for begin in range(0, K, _AT_ONCE):
            end = min(begin + _AT_ONCE, K)
            right[begin:end] = equations.rights(begin, end)[:, some]
        follow = factor.blocks.nodes(right)
        _subtract_products(equations, follow, some, gradient, corner)
        at_nodes[:, some] = follow[nodes]
        links[:, some] = follow[nodes] * linear.joined[nodes - 1, None, None]
        for number, node in enumerate(nodes.tolist()):
            coupling = (
                equations.coupling(node - 1, node)[0] / weight
            )  # the end by the node before, sign reversed
            links[number, some] += follow[node - 1] @ coupling.T
    for number, group in enumerate(linear.groups):
        own, a = equations.order.of_border[number], len(group.states)
        columns = np.arange(p)[own][: group.moving - a]
        if len(columns):
            at = equations.order.places[group.rows]
            links[:, columns[:, None], at] += linear.ends[number][nodes - 1, :, a:].transpose(0, 2, 1)
    for block in range(len(nodes)):
        _transmit(corner, block, weight * at_nodes[block] @ links[block].T)
    places = np.argsort(border)
    corner = corner[:, places[:, None], places]
    return gradient[:, places], 0.5 * (corner + corner.transpose(0, 2, 1))


def _subtract_products(
    equations: LocalSystem, follow: Floats, some: slice, gradient: Floats, corner: Floats
) -> None:
    """Take E_b' F and g_b' F from `corner` and `gradient`; F is `follow` (K, c, m), of `some` columns in the blocks' order."""
    linear, order, weight = equations.linear, equations.order, equations.weight
    K, own_gradient = len(follow), linear.data.gradient + weight * linear.defects.gradient
    for block, (first, last) in enumerate(pairwise(block_ends(K, len(corner)))):
        part, own = slice(first, last), corner[block, :, some]
        by_state = [np.ascontiguousarray(follow[part, :, of].transpose(0, 2, 1)) for of in order.of_states]
        for pair, data in zip(linear.pairs, linear.products, strict=True):
            b = len(linear.groups[pair.second].states)
            upper = data.upper[part, :, b:].astype(float)
            own[order.of_border[pair.second]] -= _product(upper, by_state[pair.first])
            if pair.first != pair.second:
                lower = data.lower[part].astype(float).transpose(0, 2, 1)
                own[order.of_border[pair.first]] -= _product(lower, by_state[pair.second])
        defects = weight * equations.followed_defects(part, follow)
        for number, group in enumerate(linear.groups):
            a = len(group.states)
            columns = np.arange(len(own))[order.of_border[number]][: group.moving - a]
            fallen = np.ascontiguousarray(defects[:, :, order.places[group.rows]].transpose(0, 2, 1))
            own[columns] -= _product(linear.ends[number][part, :, a:].astype(float), fallen)
        inner = slice(first, min(last, K - 1))  # segments that another follows
        gradient[block, some] -= np.einsum("km,kcm->c", own_gradient[part], follow[part])
        later = follow[first + 1 : inner.stop + 1]
        gradient[block, some] += weight * np.einsum("km,kcm->c", linear.missed[inner], later)


def _product(rows: Floats, others: Floats) -> Floats:
    """(q, c) sum over segments and rows of (k, r, q) times (k, r, c)."""
    count = rows.shape[0] * rows.shape[1]  # no -1, which columns that there are none of leave open
    return np.asarray(rows.reshape(count, rows.shape[2]).T @ others.reshape(count, others.shape[2]))
