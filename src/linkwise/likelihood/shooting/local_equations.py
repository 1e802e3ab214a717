"""Normal equations of structures of many masses, assembled node by node from the products of `neighbourhoods`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.bordered_system import (
    BlockEquations,
    BlockFactor,
    BorderEquations,
    Damping,
    NodeBlocks,
)
from linkwise.likelihood.shooting.neighbourhoods import (
    LocalQuadraticForm,
    LocalRows,
    MeetingGroups,
    Neighbourhood,
    PairBlocks,
    below,
    common_rows,
    corners_of,
    in_one_piece,
    sums_over,
)
from linkwise.likelihood.shooting.normal_equations import NEGLIGIBLE, block_ends, blocks_of, border_columns

Solved = TypeVar("Solved")


@dataclass(frozen=True, eq=False)
class LocalLinearization:
    """Gauss-Newton model of a misfit as `Linearization` is, without the blocks that are zero.

    Attributes
    ----------
    groups : sequence of Neighbourhood
        The groups of columns.
    pairs : sequence of MeetingGroups
        Those that meet.
    products : sequence of PairBlocks
        What each of these pairs contributes to the data part; what it contributes to the defects follows from `ends`.
    data, defects : LocalQuadraticForm
        The data part, and the defects for q = 1 without the diagonal of the later node.
    ends : sequence of array
        For each group the ends of the segments by its moving columns, (K, r, P).
    missed : array of shape (K, m)
        The defects.
    joined : array of shape (K,)
        1 where a segment is linked with the next, else 0.
    unconstrained : array of shape (K,)
        1 for segments without data, which do not move, else 0.
    """

    groups: Sequence[Neighbourhood]
    pairs: Sequence[MeetingGroups]
    products: Sequence[PairBlocks]
    data: LocalQuadraticForm
    defects: LocalQuadraticForm
    ends: Sequence[NDArray[Any]]
    missed: Floats
    joined: Floats
    unconstrained: Floats

    def within(self, border: Indices) -> LocalLinearization:
        """That of these unknowns of the border alone, in arrays of its own."""
        groups, K = [group.within(border) for group in self.groups], len(self.missed)
        places = [group.places_of(border) for group in self.groups]
        products = PairBlocks.room(K, self.pairs, groups)
        for pair, blocks, whole in zip(self.pairs, products, self.products, strict=True):
            blocks.put_within(whole, *(places[number] for number in pair.groups))
        ends = in_one_piece([(K, len(group.rows), group.moving) for group in groups])
        for group, own, some, before in zip(self.groups, ends, places, self.ends, strict=True):
            a = len(group.states)
            own[..., :a] = before[..., :a]
            own[..., a:] = before[..., a + below(some, group.moving - a)]
        return replace(
            self,
            groups=groups,
            products=products,
            data=self.data.within(self.pairs, self.groups, border),
            defects=self.defects.within(self.pairs, self.groups, border),
            ends=ends,
        )

    def equations(self, q: float) -> LocalSystem:
        """Normal equations with squared defects weighted by 1 / q^2."""
        return LocalSystem(self, 1.0 / q**2)

    def factor(self, q: float) -> BlockFactor | None:
        """Factor of `equations`; of nodes that the samples hardly determine, with the least diagonal that makes it one."""
        return self._first_of(self.equations(q).factor, q)

    def border(self, q: float) -> BorderEquations | None:
        """What `factor` has of the border, without room for all of it."""
        return self._first_of(self.equations(q).border, q)

    def _first_of(self, of: Callable[[Damping | None], Solved | None], q: float) -> Solved | None:
        """What there is with the least that has to be added to the diagonal of the nodes; None where nothing helps."""
        nothing = np.zeros(len(self.data.prior))
        for strength in (0.0, *NEGLIGIBLE):
            nodes = strength * self.diagonal(1.0 / q**2)
            solved = of(Damping(nodes, nothing) if strength else None)
            if solved is not None:
                return solved
        return None

    def damping(self, strength: float) -> Damping | None:
        """`strength` times the diagonal at q = 1, so that a trust region means the same at every q."""
        if strength == 0.0:
            return None
        border = self.data.corner_diagonal + self.defects.corner_diagonal
        return Damping(strength * self.diagonal(1.0), strength * border)

    def diagonal(self, weight: float) -> Floats:
        """(K, m) of the nodes."""
        nodes = np.zeros(self.missed.shape)
        for pair, data in zip(self.pairs, self.products, strict=True):
            if pair.first == pair.second:
                states = self.groups[pair.first].states
                ends = self.ends[pair.first][:, :, : len(states)].astype(float)
                nodes[:, states] = np.einsum("kii->ki", data.upper[:, :, : len(states)])
                nodes[:, states] += weight * np.einsum("kri,kri->ki", ends, ends)
        nodes += self.unconstrained[:, None]
        nodes[1:] += weight * self.joined[:-1, None]
        return nodes

    def products_of_ends(self, some: slice) -> list[PairBlocks]:
        """What pairs contribute to the defects of some segments, for q = 1, of their moving columns alone."""
        ends = [own[some].astype(float) for own in self.ends]
        products = []
        for pair in self.pairs:
            first, second = common_rows([ends[number] for number in pair.groups], pair.rows)
            a, b = (len(self.groups[number].states) for number in pair.groups)
            upper = first[:, :, :a].transpose(0, 2, 1) @ second
            below = first[:, :, a:] if pair.first != pair.second else first[:, :, :0]
            products.append(PairBlocks(upper, below.transpose(0, 2, 1) @ second[:, :, :b]))
        return products


@dataclass(frozen=True, eq=False)
class LocalSystem(BlockEquations):
    """The normal equations of `linear` with squared defects weighted by `weight`, and with a `damping`, if there is one."""

    linear: LocalLinearization
    weight: float
    damping: Damping | None = None

    def factor(self, damping: Damping | None = None) -> BlockFactor | None:
        """Cholesky factor of the equations, damped where `damping` is given; None where they are not positive definite."""
        return replace(self, damping=damping).block_factor(damped=damping is not None)

    def border(self, damping: Damping | None = None) -> BorderEquations | None:
        """What the factor has of the border, without room for all of it."""
        return replace(self, damping=damping).block_border(damped=damping is not None)

    def with_nodes_of(self, factor: BlockFactor, border: Indices) -> BlockFactor:
        """The factor, from that of equations with more unknowns in the border, of which `border` are those of these."""
        schur, reduced = factor.schur[np.ix_(border, border)], factor.reduced[border]
        return replace(factor, equations=self, schur=schur, reduced=reduced)

    @property
    def shape(self) -> tuple[int, int]:
        K, m = self.linear.missed.shape
        return K, m

    @cached_property
    def corner(self) -> Floats:
        corner = self.linear.data.corner + self.weight * self.linear.defects.corner
        if self.damping is not None:
            corner[range(len(corner)), range(len(corner))] += self.damping.border
        return np.asarray(corner)

    @cached_property
    def corner_gradient(self) -> Floats:
        return np.asarray(
            self.linear.data.corner_gradient + self.weight * self.linear.defects.corner_gradient
        )

    @property
    def gradient(self) -> Floats:
        """(K, m) gradient of the nodes."""
        gradient = self.linear.data.gradient + self.weight * self.linear.defects.gradient
        gradient[1:] -= self.weight * self.linear.missed[:-1]
        return gradient

    def drop(self, nodes: Floats, border: Floats) -> float:
        """g's: the reduction of the cost that a full Gauss-Newton step s = (nodes, border) predicts."""
        return float(np.vdot(self.gradient, nodes) + self.corner_gradient @ border)

    def blocks(self, first: int, last: int) -> NodeBlocks:
        linear, weight = self.linear, self.weight
        some, m = slice(first, last), linear.missed.shape[1]
        diagonal = np.zeros((last - first, m, m))
        of_ends = linear.products_of_ends(some)
        for pair, data, defects in zip(linear.pairs, linear.products, of_ends, strict=True):
            at_first, at_second = (linear.groups[number].states for number in pair.groups)
            own = weight * defects.upper[:, :, : len(at_second)]
            own += data.upper[some, :, : len(at_second)]
            diagonal[:, at_first[:, None], at_second] = own
            if pair.first != pair.second:
                diagonal[:, at_second[:, None], at_first] = own.transpose(0, 2, 1)
        before = slice(max(first - 1, 0), last - 1)  # segments that end at these nodes
        later = slice(before.start + 1 - first, None)
        on_diagonal = np.einsum("kii->ki", diagonal)
        on_diagonal += linear.unconstrained[some, None]
        on_diagonal[later] += weight * linear.joined[before, None]
        if self.damping is not None:
            on_diagonal += self.damping.nodes[some]
        return NodeBlocks(diagonal, self._rights(first, last, of_ends), self.coupling(first, last))

    def rights(self, first: int, last: int) -> Floats:
        """(c, p + 1, m) border and gradient of some nodes."""
        return self._rights(first, last, self.linear.products_of_ends(slice(first, last)))

    def _rights(self, first: int, last: int, of_ends: Sequence[PairBlocks]) -> Floats:
        linear, weight, p = self.linear, self.weight, len(self.linear.data.prior)
        some = slice(first, last)
        right = np.zeros((last - first, p + 1, linear.missed.shape[1]))
        for pair, data, defects in zip(linear.pairs, linear.products, of_ends, strict=True):
            first_group, second_group = (linear.groups[number] for number in pair.groups)
            b = len(second_group.states)
            upper = _weighted_sum(data.upper[some, :, b:], defects.upper[:, :, b:], weight, 2)
            right[:, second_group.border[:, None], first_group.states] = upper.transpose(0, 2, 1)
            if pair.first != pair.second:
                lower = _weighted_sum(data.lower[some], defects.lower, weight, 1)
                right[:, first_group.border[:, None], second_group.states] = lower
        before = slice(max(first - 1, 0), last - 1)  # segments that end at these nodes
        later = slice(before.start + 1 - first, None)
        for ends, group in zip(linear.ends, linear.groups, strict=True):
            if len(group.moving_border):
                moved = ends[before, :, len(group.states) :].astype(float).transpose(0, 2, 1) * weight
                right[later][:, group.moving_border[:, None], group.rows] -= moved
        right[:, p] = linear.data.gradient[some] + weight * linear.defects.gradient[some]
        right[later, p] -= weight * linear.missed[before]
        return right

    def coupling(self, first: int, last: int) -> Floats:
        blocks = np.zeros((last - first, *self.shape[1:] * 2))
        for ends, group in zip(self.linear.ends, self.linear.groups, strict=True):
            states = ends[first:last, :, : len(group.states)].astype(float)
            blocks[:, group.rows[:, None], group.states] = states * -self.weight
        return blocks

    def remainder(self, border: Floats) -> Floats:
        linear, weight = self.linear, self.weight
        left = self.gradient
        for pair, blocks in zip(linear.pairs, linear.products, strict=True):
            first, second = (linear.groups[number] for number in pair.groups)
            left[:, first.states] -= blocks.upper[:, :, len(second.states) :] @ border[second.border]
            if pair.first != pair.second:
                left[:, second.states] -= border[first.border] @ blocks.lower
        moved = np.zeros(left.shape)
        for ends, group in zip(linear.ends, linear.groups, strict=True):
            moved[:, group.rows] += ends[:, :, len(group.states) :] @ border[group.moving_border]
        for ends, group in zip(linear.ends, linear.groups, strict=True):
            states = ends[:, :, : len(group.states)]
            left[:, group.states] -= weight * (moved[:, None, group.rows] @ states)[:, 0]
        left[1:] += weight * moved[:-1]
        return left

    def across(self, nodes: Floats) -> Floats:
        linear, weight = self.linear, self.weight
        added = np.zeros(len(self.linear.data.prior))
        for pair, blocks in zip(linear.pairs, linear.products, strict=True):
            first, second = (linear.groups[number] for number in pair.groups)
            upper = blocks.upper[:, :, len(second.states) :]
            added[second.border] += np.tensordot(nodes[:, first.states], upper, 2)
            if pair.first != pair.second:
                added[first.border] += np.einsum("kqb,kb->q", blocks.lower, nodes[:, second.states])
        defects = self.followed_defects(slice(0, len(nodes)), nodes[:, None])[:, 0]
        for ends, group in zip(linear.ends, linear.groups, strict=True):
            of_ends = np.tensordot(defects[:, group.rows], ends[:, :, len(group.states) :], 2)
            added[group.moving_border] += weight * of_ends
        return added

    def followed_defects(self, some: slice, nodes: Floats) -> Floats:
        """(k, c, m) by how much the defects at the ends of some segments fall where all nodes (K, c, m) move."""
        linear = self.linear
        defects = np.zeros(nodes[some].shape)
        later = nodes[some.start + 1 : some.stop + 1]
        defects[: len(later)] -= later
        for ends, group in zip(linear.ends, linear.groups, strict=True):
            states = ends[some, :, : len(group.states)].astype(float)
            defects[:, :, group.rows] += nodes[some][:, :, group.states] @ states.transpose(0, 2, 1)
        return defects


def _weighted_sum(data: NDArray[Any], defects: NDArray[Any], weight: float, axis: int) -> Floats:
    """data + weight * defects, of which the latter have the first places along an axis only."""
    total = np.empty(data.shape)
    own = (slice(None),) * axis + (slice(defects.shape[axis]),)
    beyond = (slice(None),) * axis + (slice(defects.shape[axis], None),)
    np.multiply(defects, weight, out=total[own])
    total[own] += data[own]
    total[beyond] = data[beyond]
    return total


_AT_ONCE = 400_000  # numbers in the sensitivities of a group in a chunk
_HELD = 8_000_000  # numbers in the rows of all groups in a chunk


def local_linearization(
    rows: LocalRows, executor: Executor | None = None, blocks: int = 1
) -> LocalLinearization:
    """Gauss-Newton blocks at a point, chunk by chunk of segments.

    Parameters
    ----------
    rows : LocalRows
        The Jacobian.
    executor : Executor, optional
        Threads.
    blocks : int, optional
        Consecutive blocks of segments by which the corner is summed.

    Returns
    -------
    LocalLinearization
        The blocks.
    """
    segments, groups = rows.segments, rows.groups
    pairs, K, m = _pairs(groups), segments.count, segments.system.dimension
    ends_of_blocks = block_ends(K, blocks)
    products = PairBlocks.room(K, pairs, groups)
    gradients = np.zeros((2, K, m))
    joined = np.append(segments.linked, False).astype(float)
    missed = np.zeros((K, m))
    missed[:-1] = rows.misfit.defects.reshape(m, -1).T * joined[:-1, None]
    ends = in_one_piece([(K, len(group.rows), group.moving) for group in groups])

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(part: slice) -> list[list[Floats]]:
        pieces = [piece for _, piece in blocks_of(part, ends_of_blocks)]
        by_group, residuals = rows.part(part)
        for end, group_rows in zip(ends, by_group, strict=True):
            end[part] = group_rows.ends * joined[part, None, None].astype(np.float32)
        exact = [end[part].astype(float) for end in ends]
        slopes = []
        for number, (group, own) in enumerate(zip(groups, by_group, strict=True)):
            a = len(group.states)
            by_data = _gradient(own.data, residuals[:, group.channels].astype(np.float32))
            by_ends = _gradient(exact[number], missed[part][:, group.rows])
            gradients[0][part, group.states], gradients[1][part, group.states] = (
                by_data[:, :a],
                by_ends[:, :a],
            )
            slopes.append([sums_over(by_data[:, a:], pieces), sums_over(by_ends[:, a:], pieces)])
        corners = []
        for pair, own_products in zip(pairs, products, strict=True):
            shown = common_rows([by_group[i].data for i in pair.groups], pair.channels)
            moved = common_rows([exact[i] for i in pair.groups], pair.rows)
            own_products.put(part, shown)
            states = len(groups[pair.first].states), len(groups[pair.second].states)
            corners.append([corners_of(rows_of_both, states, pieces) for rows_of_both in (shown, moved)])
        return slopes + corners

    parts = _chunks(groups, K, len(segments.samples))
    by_part = map(work, parts) if executor is None else executor.map(work, parts)
    sums = _by_blocks(
        by_part, [[block for block, _ in blocks_of(part, ends_of_blocks)] for part in parts], blocks
    )
    of_data, of_defects = (
        _form(gradient, [totals[kind] for totals in sums], groups, pairs)
        for kind, gradient in enumerate(gradients)
    )
    _add_prior(of_data, rows)
    unconstrained = segments.unconstrained.astype(float)
    return LocalLinearization(
        groups, pairs, products, of_data, of_defects, ends, missed, joined, unconstrained
    )


def _by_blocks(
    by_part: Iterable[list[list[Floats]]], numbers: Sequence[Sequence[int]], blocks: int
) -> list[list[Floats]]:
    """The sums over blocks of segments, of each group and then of each pair, of both forms.

    They come part by part of the segments, for the blocks, by `numbers`, that each part meets.
    """
    sums: list[list[Floats]] = []
    for own_numbers, of_part in zip(numbers, by_part, strict=True):
        if not sums:
            sums = [[np.zeros((blocks, *own.shape[1:])) for own in both] for both in of_part]
        for totals, both in zip(sums, of_part, strict=True):
            for total, own in zip(totals, both, strict=True):
                total[own_numbers[0] : own_numbers[-1] + 1] += own
    return sums


def _add_prior(form: LocalQuadraticForm, rows: LocalRows) -> None:
    prior, scales, point = rows.segments.prior, rows.scales, rows.misfit.point
    if prior is not None:
        columns = border_columns(scales, len(point.theta), len(form.prior))
        form.prior[columns] += prior.curvature(scales.theta)
        form.corner_gradients[0, columns] += prior.gradient(point.border, scales.theta)


def _form(
    gradient: Floats,
    sums: Sequence[Floats],
    groups: Sequence[Neighbourhood],
    pairs: Sequence[MeetingGroups],
) -> LocalQuadraticForm:
    """The form with `sums` over blocks of segments: gradients (B, q) of groups, corners (B, q, q') of pairs."""
    p = sum(len(group.border) for group in groups)
    gradients = np.zeros((len(sums[0]), p))
    for group, total in zip(groups, sums, strict=False):
        gradients[:, group.border[: total.shape[1]]] = total
    corners, places = sums[len(groups) :], []
    for pair, total in zip(pairs, corners, strict=True):
        first = groups[pair.first].border[: total.shape[1]]
        second = first if pair.first == pair.second else groups[pair.second].border[: total.shape[2]]
        places.append((first, second))
    return LocalQuadraticForm(gradient, corners, places, gradients, np.zeros(p))


def _pairs(groups: Sequence[Neighbourhood]) -> list[MeetingGroups]:
    """The pairs of groups whose columns meet."""
    pairs = []
    for first, first_group in enumerate(groups):
        for second in range(first, len(groups)):
            second_group = groups[second]
            _, *channels = np.intersect1d(first_group.channels, second_group.channels, return_indices=True)
            _, *rows = np.intersect1d(first_group.rows, second_group.rows, return_indices=True)
            if len(channels[0]) or len(rows[0]):
                pairs.append(MeetingGroups(first, second, (channels[0], channels[1]), (rows[0], rows[1])))
    return pairs


def _chunks(groups: Sequence[Neighbourhood], K: int, samples: int) -> list[slice]:
    """The segments in an even number of parts of about equal length, for two threads.

    The sensitivities of the largest group stay in a core's cache, and the rows of all groups, of so many `samples` of a
    segment, do not take more memory where there are more masses.
    """
    largest = max(2 * len(group.masses) * group.size for group in groups)
    numbers = sum((samples * len(group.channels) + len(group.rows)) * group.size for group in groups)
    pairs = max(1, -(-K * largest // (2 * _AT_ONCE)), -(-K * numbers // (2 * _HELD)))
    size = max(16, -(-K // (2 * pairs * 16)) * 16)
    return [slice(first, min(first + size, K)) for first in range(0, K, size)]


def _gradient(rows: NDArray[Any], missed: NDArray[Any]) -> NDArray[Any]:
    """(k, P) products of rows (k, ..., P) with what they leave (k, ...)."""
    k, size = len(rows), rows.shape[-1]
    return np.asarray((missed.reshape(k, 1, -1) @ rows.reshape(k, -1, size))[:, 0])
