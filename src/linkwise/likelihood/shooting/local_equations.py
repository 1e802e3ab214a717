"""Gauss-Newton normal equations of structures of many masses, assembled node by node from the blocks that are not zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.block_factor import BlockEquations, BlockFactor, NodeBlocks
from linkwise.likelihood.shooting.bordered_system import Damping
from linkwise.likelihood.shooting.local_blocks import LocalQuadraticForm, MeetingGroups, Order, below
from linkwise.likelihood.shooting.neighbourhoods import Neighbourhood
from linkwise.likelihood.shooting.normal_equations import NEGLIGIBLE


@dataclass(frozen=True, eq=False)
class LocalLinearization:
    """Gauss-Newton model of a misfit as `Linearization` is, without the blocks that are zero.

    Attributes
    ----------
    groups : sequence of Neighbourhood
        The groups of columns.
    pairs : sequence of MeetingGroups
        Those that meet.
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
    data: LocalQuadraticForm
    defects: LocalQuadraticForm
    ends: Sequence[NDArray[Any]]
    missed: Floats
    joined: Floats
    unconstrained: Floats

    def within(self, border: Indices) -> LocalLinearization:
        """That of these unknowns of the border alone, in arrays of its own."""
        ends = []
        for group, own in zip(self.groups, self.ends, strict=True):
            a = len(group.states)
            moving = a + below(group.places_of(border), group.moving - a)
            ends.append(np.concatenate([own[..., :a], own[..., moving]], axis=2))
        return replace(
            self,
            groups=[group.within(border) for group in self.groups],
            data=self.data.within(self.pairs, self.groups, border),
            defects=self.defects.within(self.pairs, self.groups, border),
            ends=ends,
        )

    def equations(self, q: float) -> LocalSystem:
        """Normal equations with squared defects weighted by 1 / q^2."""
        return LocalSystem(self, Order(self.groups), 1.0 / q**2)

    def factor(self, q: float) -> LocalFactor | None:
        """Factor of `equations`; of nodes that the samples hardly determine, with the least diagonal that makes it one."""
        equations = self.equations(q)
        nothing = np.zeros(len(self.data.prior))
        for strength in (0.0, *NEGLIGIBLE):
            nodes = strength * self.diagonal(1.0 / q**2)
            factor = equations.factor(Damping(nodes, nothing) if strength else None)
            if factor is not None:
                return factor
        return None

    def damping(self, strength: float) -> Damping | None:
        """`strength` times the diagonal at q = 1, so that a trust region means the same at every q."""
        if strength == 0.0:
            return None
        border = self.data.corner_diagonal + self.defects.corner_diagonal
        return Damping(strength * self.diagonal(1.0), strength * border)

    def diagonal(self, weight: float) -> Floats:
        """(K, m) of the nodes, in the order of the blocks."""
        order = Order(self.groups)
        nodes = np.zeros(self.missed.shape)
        for pair, data, defects in zip(self.pairs, self.data.pairs, self.defects.pairs, strict=True):
            if pair.first == pair.second:
                own = order.of_states[pair.first]
                size = own.stop - own.start
                nodes[:, own] = np.einsum("kii->ki", data.upper[:, :, :size])
                nodes[:, own] += weight * np.einsum("kii->ki", defects.upper[:, :, :size])
        nodes += self.unconstrained[:, None]
        nodes[1:] += weight * self.joined[:-1, None]
        return nodes


@dataclass(frozen=True, eq=False)
class LocalSystem:
    """The normal equations of `linear` with squared defects weighted by `weight`, unknowns in `order`."""

    linear: LocalLinearization
    order: Order
    weight: float

    def factor(self, damping: Damping | None = None) -> LocalFactor | None:
        """Cholesky factor of the equations, damped where `damping` is given; None where they are not positive definite."""
        factor = self._of_blocks(damping).factor()
        return None if factor is None else LocalFactor(factor, self.order, damping is not None)

    def with_nodes_of(self, factor: LocalFactor, border: Indices) -> LocalFactor:
        """The factor, from that of equations with more unknowns in the border, of which `border` are those of these."""
        chosen = border[self.order.border]
        own = replace(
            factor.blocks,
            equations=self._of_blocks(None),
            schur=factor.schur[np.ix_(chosen, chosen)],
            reduced=factor.reduced[chosen],
        )
        return LocalFactor(own, self.order, factor.damped)

    def _of_blocks(self, damping: Damping | None) -> BlockEquations:
        border = self.order.border
        corner = self.linear.data.corner + self.weight * self.linear.defects.corner
        if damping is not None:
            corner[range(len(corner)), range(len(corner))] += damping.border
        return BlockEquations(
            self.linear.missed.shape,
            lambda first, last: self.blocks(first, last, damping),
            self.remainder,
            self.across,
            self.coupling,
            corner[np.ix_(border, border)],
            self.corner_gradient[border],
        )

    @property
    def corner_gradient(self) -> Floats:
        """(p,) gradient of the border."""
        return np.asarray(
            self.linear.data.corner_gradient + self.weight * self.linear.defects.corner_gradient
        )

    @property
    def gradient(self) -> Floats:
        """(K, m) gradient of the nodes, in the order of the blocks."""
        gradient = self.linear.data.gradient + self.weight * self.linear.defects.gradient
        gradient[1:] -= self.weight * self.linear.missed[:-1]
        return gradient

    def drop(self, nodes: Floats, border: Floats) -> float:
        """g's: the reduction of the cost that a full Gauss-Newton step s = (nodes, border) predicts."""
        return float(np.vdot(self.gradient, nodes[:, self.order.states]) + self.corner_gradient @ border)

    def blocks(self, first: int, last: int, damping: Damping | None) -> NodeBlocks:
        """The blocks of some nodes."""
        linear, order, weight = self.linear, self.order, self.weight
        some, m = slice(first, last), linear.missed.shape[1]
        diagonal = np.zeros((last - first, m, m))
        for pair, data, defects in zip(linear.pairs, linear.data.pairs, linear.defects.pairs, strict=True):
            at_first, at_second = order.of_states[pair.first], order.of_states[pair.second]
            b = at_second.stop - at_second.start
            own = diagonal[:, at_first, at_second]
            np.multiply(defects.upper[some, :, :b], weight, out=own)
            own += data.upper[some, :, :b]
        before = slice(max(first - 1, 0), last - 1)  # segments that end at these nodes
        later = slice(before.start + 1 - first, None)
        on_diagonal = np.einsum("kii->ki", diagonal)
        on_diagonal += linear.unconstrained[some, None]
        on_diagonal[later] += weight * linear.joined[before, None]
        if damping is not None:
            on_diagonal += damping.nodes[some]
        return NodeBlocks(diagonal, self.rights(first, last), self.coupling(first, last))

    def rights(self, first: int, last: int) -> Floats:
        """(c, p + 1, m) border and gradient of some nodes."""
        linear, order, weight = self.linear, self.order, self.weight
        some, p = slice(first, last), len(order.border)
        right = np.zeros((last - first, p + 1, linear.missed.shape[1]))
        for pair, data, defects in zip(linear.pairs, linear.data.pairs, linear.defects.pairs, strict=True):
            at_first, at_second = order.of_states[pair.first], order.of_states[pair.second]
            b = at_second.stop - at_second.start
            upper = _weighted_sum(data.upper[some, :, b:], defects.upper[some, :, b:], weight, 2)
            right[:, order.of_border[pair.second], at_first] = upper.transpose(0, 2, 1)
            if pair.first != pair.second:
                lower = _weighted_sum(data.lower[some], defects.lower[some], weight, 1)
                right[:, order.of_border[pair.first], at_second] = lower
        before = slice(max(first - 1, 0), last - 1)  # segments that end at these nodes
        later = slice(before.start + 1 - first, None)
        for number, group in enumerate(linear.groups):
            rows, a = order.places[group.rows], len(group.states)
            columns = np.arange(p)[order.of_border[number]][: group.moving - a]
            if len(columns):
                ends = linear.ends[number][before, :, a:].astype(float).transpose(0, 2, 1) * weight
                right[later][:, columns[:, None], rows] -= ends
        right[:, p] = linear.data.gradient[some] + weight * linear.defects.gradient[some]
        right[later, p] -= weight * linear.missed[before]
        return right

    def coupling(self, first: int, last: int) -> Floats:
        """(c, m, m) blocks of the node that follows each of some nodes (rows) with it (columns)."""
        size = len(self.order.states)
        blocks = np.zeros((last - first, size, size))
        for ends, group, own in zip(self.linear.ends, self.linear.groups, self.order.of_states, strict=True):
            states = ends[first:last, :, : len(group.states)].astype(float)
            blocks[:, self.order.places[group.rows], own] = states * -self.weight
        return blocks

    def remainder(self, border: Floats) -> Floats:
        """What a border (p,), in the order of the blocks, leaves of the gradient of the nodes, (K, m)."""
        linear, order, weight = self.linear, self.order, self.weight
        left = self.gradient
        for form, factor in ((linear.data, 1.0), (linear.defects, weight)):
            for pair, blocks in zip(linear.pairs, form.pairs, strict=True):
                at_first, at_second = order.of_states[pair.first], order.of_states[pair.second]
                b = at_second.stop - at_second.start
                by_second = border[order.of_border[pair.second]][: blocks.upper.shape[2] - b]
                left[:, at_first] -= factor * (blocks.upper[:, :, b:] @ by_second)
                if pair.first != pair.second:
                    by_first = border[order.of_border[pair.first]][: blocks.lower.shape[1]]
                    left[:, at_second] -= factor * (by_first @ blocks.lower)
        for number, group in enumerate(linear.groups):
            a = len(group.states)
            ends = linear.ends[number][:-1, :, a:] @ border[order.of_border[number]][: group.moving - a]
            left[1:, order.places[group.rows]] += weight * ends
        return left

    def across(self, nodes: Floats) -> Floats:
        """What nodes (K, m) add to the equations of the border, (p,), both in the order of the blocks."""
        linear, order, weight = self.linear, self.order, self.weight
        added = np.zeros(len(order.border))
        for form, factor in ((linear.data, 1.0), (linear.defects, weight)):
            for pair, blocks in zip(linear.pairs, form.pairs, strict=True):
                at_first, at_second = order.of_states[pair.first], order.of_states[pair.second]
                b = at_second.stop - at_second.start
                of_second = np.tensordot(nodes[:, at_first], blocks.upper[:, :, b:], 2)
                added[order.of_border[pair.second]][: len(of_second)] += factor * of_second
                if pair.first != pair.second:
                    of_first = np.einsum("kqb,kb->q", blocks.lower, nodes[:, at_second])
                    added[order.of_border[pair.first]][: len(of_first)] += factor * of_first
        for number, group in enumerate(linear.groups):
            a = len(group.states)
            of_ends = np.tensordot(nodes[1:, order.places[group.rows]], linear.ends[number][:-1, :, a:], 2)
            added[order.of_border[number]][: group.moving - a] -= weight * of_ends
        return added


@dataclass(frozen=True, eq=False)
class LocalFactor:
    """A factor with its unknowns in the order of the structure."""

    blocks: BlockFactor
    order: Order
    damped: bool = False

    @property
    def schur(self) -> Floats:
        """(p, p) equations of the border."""
        places = np.argsort(self.order.border)
        return self.blocks.schur[np.ix_(places, places)]

    @property
    def reduced(self) -> Floats:
        """(p,) gradient of the border."""
        return self.blocks.reduced[np.argsort(self.order.border)]

    def solve(self, free: Bools, fixed_values: Floats | None = None) -> tuple[Floats, Floats] | None:
        """As `BorderedFactor.solve`."""
        border = self.order.border
        solved = self.blocks.solve(free[border], None if fixed_values is None else fixed_values[border])
        if solved is None:
            return None
        return solved[0][:, self.order.places], solved[1][np.argsort(border)]

    def moved(self, nodes: Floats, border: Floats) -> LocalFactor:
        """As `BorderedFactor.moved`."""
        order = self.order
        return replace(self, blocks=self.blocks.moved(nodes[:, order.states], border[order.border]))

    def excess(self, border: Floats, free: Bools) -> float:
        """As `BorderedFactor.excess`."""
        return self.blocks.excess(border[self.order.border], free[self.order.border])

    def log_determinant(self, free: Bools) -> float:
        """As `BorderedFactor.log_determinant`."""
        return self.blocks.log_determinant(free[self.order.border])


def _weighted_sum(data: NDArray[Any], defects: NDArray[Any], weight: float, axis: int) -> Floats:
    """data + weight * defects, of which the latter have the first places along an axis only."""
    total = np.empty(data.shape)
    own = (slice(None),) * axis + (slice(defects.shape[axis]),)
    beyond = (slice(None),) * axis + (slice(defects.shape[axis], None),)
    np.multiply(defects, weight, out=total[own])
    total[own] += data[own]
    total[beyond] = data[beyond]
    return total
