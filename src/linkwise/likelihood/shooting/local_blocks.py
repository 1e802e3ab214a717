"""Blocks of the normal equations of structures of many masses: of groups of columns that meet in a row, no others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.local_rows import as_slice
from linkwise.likelihood.shooting.neighbourhoods import Neighbourhood

_TOGETHER = 8  # segments whose products are summed in the precision of the rows


@dataclass(frozen=True, eq=False)
class MeetingGroups:
    """Two groups of columns, by number, whose columns meet in some rows: the places of these rows in each of them."""

    first: int
    second: int
    channels: tuple[Indices, Indices]
    rows: tuple[Indices, Indices]

    @property
    def groups(self) -> tuple[int, int]:
        """The two."""
        return self.first, self.second


@dataclass(frozen=True, eq=False)
class PairBlocks:
    """What two groups of columns contribute: states (K, a, P') of the first with columns of the second, and the border of the
    first with the states (K, q, b) of the second; the latter none where both are the same group, as it is in the former.
    """

    upper: NDArray[Any]
    lower: NDArray[Any]

    @classmethod
    def room(
        cls, K: int, pairs: Sequence[MeetingGroups], groups: Sequence[Neighbourhood]
    ) -> list[PairBlocks]:
        """Room for K segments and all columns of pairs of groups, in single precision."""
        shapes = []
        for pair in pairs:
            first, second = (groups[number] for number in pair.groups)
            q = 0 if pair.first == pair.second else len(first.border)
            shapes += [(K, len(first.states), second.size), (K, q, len(second.states))]
        arrays = in_one_piece(shapes)
        return [cls(*both) for both in zip(arrays[::2], arrays[1::2], strict=True)]

    def put_within(self, whole: PairBlocks, first: Indices, second: Indices) -> None:
        """Store those of `whole` of some places in the border of each group."""
        states = self.lower.shape[2]
        self.upper[..., :states] = whole.upper[..., :states]
        np.take(whole.upper, states + second, axis=2, out=self.upper[..., states:])
        if len(self.lower[0]):
            self.lower[:] = whole.lower[:, first]

    def put(self, part: slice, rows: tuple[NDArray[Any], NDArray[Any]]) -> None:
        """Store the products of `rows` (k, r, P) and (k, r, P') of a chunk."""
        (_, a, _), (_, below, b) = self.upper.shape, self.lower.shape
        first, second = rows
        np.matmul(first[:, :, :a].transpose(0, 2, 1), second, out=self.upper[part])
        if below:
            np.matmul(first[:, :, a:].transpose(0, 2, 1), second[:, :, :b], out=self.lower[part])


@dataclass(frozen=True, eq=False)
class LocalQuadraticForm:
    """The gradient of one quadratic form over scaled unknowns, and its matrix within the border.

    Attributes
    ----------
    gradient : array of shape (K, m)
        That of the nodes.
    corners : sequence of array
        By blocks of segments the products (B, q, q') of the border of the two groups of each pair.
    places : sequence of tuple of array of int
        The columns of the border, (q,) and (q',), of each pair; of a group with itself one array twice.
    corner_gradients : array of shape (B, p)
        By blocks of segments the gradient of the border.
    prior : array of shape (p,)
        What is added to the diagonal of the border.
    """

    gradient: Floats
    corners: Sequence[Floats]
    places: Sequence[tuple[Indices, Indices]]
    corner_gradients: Floats
    prior: Floats

    def within(
        self, meeting: Sequence[MeetingGroups], groups: Sequence[Neighbourhood], border: Indices
    ) -> LocalQuadraticForm:
        """That of these unknowns of the border alone, in arrays of its own."""
        own = [group.places_of(border) for group in groups]
        corners, places = [], []
        for pair, corner, both in zip(meeting, self.corners, self.places, strict=True):
            chosen = [below(own[number], len(where)) for number, where in zip(pair.groups, both, strict=True)]
            corners.append(corner[:, chosen[0][:, None], chosen[1]])
            first = np.searchsorted(border, both[0][chosen[0]])
            apart = pair.first != pair.second
            second = np.searchsorted(border, both[1][chosen[1]]) if apart else first
            places.append((first, second))
        return LocalQuadraticForm(
            self.gradient, corners, places, self.corner_gradients[:, border], self.prior[border]
        )

    @property
    def corner(self) -> Floats:
        """(p, p) matrix of the border, of all segments."""
        total = self._placed([corner.sum(axis=0, keepdims=True) for corner in self.corners])[0]
        total[np.diag_indices(len(total))] += self.prior
        return np.asarray(total)

    @property
    def corner_diagonal(self) -> Floats:
        """(p,) of `corner`."""
        diagonal = self.prior.copy()
        for corner, (first, second) in zip(self.corners, self.places, strict=True):
            if first is second:
                diagonal[first] += np.einsum("bqq->q", corner)
        return diagonal

    @property
    def corners_by_blocks(self) -> Floats:
        """(B, p, p) matrix of the border by blocks of segments, the first with what is known beforehand."""
        by_blocks = self._placed(self.corners)
        by_blocks[0][np.diag_indices(len(self.prior))] += self.prior
        return by_blocks

    @property
    def corner_gradient(self) -> Floats:
        """(p,) of all segments."""
        return np.asarray(self.corner_gradients.sum(axis=0))

    def _placed(self, corners: Sequence[Floats]) -> Floats:
        p = len(self.prior)
        placed = np.zeros((len(corners[0]), p, p))
        for corner, (first, second) in zip(corners, self.places, strict=True):
            placed[:, first[:, None], second] = corner
            if first is not second:
                placed[:, second[:, None], first] = corner.transpose(0, 2, 1)
        return placed


def below(numbers: Indices, limit: int) -> Indices:
    """The numbers that are less than a limit."""
    return numbers[numbers < limit]


def sums_over(values: NDArray[Any], pieces: Sequence[slice]) -> Floats:
    """(b, ...) sums of values (k, ...) of segments over pieces of these."""
    return np.stack([values[piece].sum(axis=0, dtype=float) for piece in pieces])


def in_one_piece(shapes: Sequence[tuple[int, ...]]) -> list[NDArray[Any]]:
    """Arrays in single precision of one allocation: many small ones leave holes, which the system does not get back."""
    ends = np.cumsum([0, *(prod(shape) for shape in shapes)]).tolist()
    whole = np.empty(ends[-1], np.float32)
    return [whole[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True)]


def corners_of(
    rows: tuple[NDArray[Any], NDArray[Any]], states: tuple[int, int], pieces: Sequence[slice]
) -> Floats:
    """(b, q, q') products of the border in `rows` (k, r, a + q) and (k, r, b + q') of two groups, over pieces of a chunk."""
    (first, second), (a, b) = rows, states
    return np.stack([_summed(first[piece, :, a:], second[piece, :, b:]) for piece in pieces])


def common_rows(
    rows: Sequence[NDArray[Any]], common: tuple[Indices, Indices]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows (k, r, P) and (k, r, P') of two groups: those (k, r, ..., P) that they have in `common`."""
    first, second = (
        block[:, own] if isinstance(own := as_slice(which), slice) else np.take(block, own, axis=1)
        for block, which in zip(rows, common, strict=True)
    )
    k, r = len(first), int(np.prod(first.shape[1:-1]))
    return first.reshape(k, r, first.shape[-1]), second.reshape(k, r, second.shape[-1])


def _summed(first: NDArray[Any], second: NDArray[Any]) -> Floats:
    """(q, q') sum over segments of the products of rows (k, r, q) and (k, r, q').

    Few segments are multiplied together, so that sums of single precision remain short.
    """
    k, r = first.shape[:2]
    whole = k - k % _TOGETHER
    total = np.zeros((first.shape[2], second.shape[2]))
    for some, size in ((slice(whole), _TOGETHER), (slice(whole, k), 1)):
        count = (some.stop - (some.start or 0)) // size
        left, right = (rows[some].reshape(count, size * r, rows.shape[2]) for rows in (first, second))
        total += (left.transpose(0, 2, 1) @ right).sum(axis=0, dtype=float)
    return total


class Order:
    """The order of the unknowns, group by group, in the blocks: `states` (m,) and `border` (p,) by their numbers."""

    def __init__(self, groups: Sequence[Neighbourhood]) -> None:
        self.states = np.concatenate([group.states for group in groups])
        self.border = np.concatenate([group.border for group in groups])
        self.places = np.argsort(self.states)
        self.of_states = _slices([len(group.states) for group in groups])
        self.of_border = _slices([len(group.border) for group in groups])


def _slices(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(a, b) for a, b in pairwise(ends)]
