"""Blocks of the normal equations of structures of many masses: of groups of columns that meet in a row, no others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.neighbourhoods import Neighbourhood


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
    def empty(
        cls, K: int, groups: tuple[Neighbourhood, Neighbourhood], sizes: tuple[int, int], kind: type
    ) -> PairBlocks:
        """Room for K segments and as many columns of each group."""
        first, second = groups
        below = 0 if first is second else sizes[0] - len(first.states)
        return cls(
            np.empty((K, len(first.states), sizes[1]), kind),
            np.empty((K, below, len(second.states)), kind),
        )

    def within(self, first: Indices, second: Indices, states: int) -> PairBlocks:
        """Those of some places in the border of each group, of which the second has so many `states`."""
        return PairBlocks(
            np.concatenate(
                [
                    self.upper[..., :states],
                    self.upper[..., states + below(second, self.upper.shape[2] - states)],
                ],
                axis=2,
            ),
            self.lower[:, below(first, self.lower.shape[1])],
        )

    def put(self, part: slice, product: NDArray[Any], pieces: Sequence[slice]) -> Floats:
        """Store the product (k, P, P') of a chunk; returns the corners (b, q, q') of its pieces."""
        (_, a, _), (_, below, b) = self.upper.shape, self.lower.shape
        self.upper[part] = product[:, :a]
        if below:
            self.lower[part] = product[:, a:, :b]
        return sums_over(product[:, a:, b:], pieces)


@dataclass(frozen=True, eq=False)
class LocalQuadraticForm:
    """One quadratic form over scaled unknowns: `pairs` of blocks, `gradient` (K, m) of the nodes, and by blocks of segments
    the border's `corners` (B, p, p) and `corner_gradients` (B, p).
    """

    pairs: Sequence[PairBlocks]
    gradient: Floats
    corners: Floats
    corner_gradients: Floats

    def within(
        self, meeting: Sequence[MeetingGroups], groups: Sequence[Neighbourhood], border: Indices
    ) -> LocalQuadraticForm:
        """That of these unknowns of the border alone, in arrays of its own."""
        places = [group.places_of(border) for group in groups]
        pairs = [
            blocks.within(places[pair.first], places[pair.second], len(groups[pair.second].states))
            for pair, blocks in zip(meeting, self.pairs, strict=True)
        ]
        corners = self.corners[:, border[:, None], border]
        return LocalQuadraticForm(pairs, self.gradient, corners, self.corner_gradients[:, border])

    @property
    def corner(self) -> Floats:
        """(p, p) of all segments."""
        return np.asarray(self.corners.sum(axis=0))

    @property
    def corner_gradient(self) -> Floats:
        """(p,) of all segments."""
        return np.asarray(self.corner_gradients.sum(axis=0))


def below(numbers: Indices, limit: int) -> Indices:
    """The numbers that are less than a limit."""
    return numbers[numbers < limit]


def sums_over(values: NDArray[Any], pieces: Sequence[slice]) -> Floats:
    """(b, ...) sums of values (k, ...) of segments over pieces of these."""
    return np.stack([values[piece].sum(axis=0, dtype=float) for piece in pieces])


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
