"""Sums of products of the linearised rows: of the states of nodes by segments, of the border by blocks of segments.

Columns of errors of sensors touch the rows of one channel each, so that only these are multiplied with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.local_rows import as_slice
from linkwise.likelihood.shooting.tangent_forces import Single


@dataclass(frozen=True, eq=False)
class NormalBlocks:
    """One quadratic form over scaled unknowns: state (K, m, m), right (K, m, p + 1) border and gradient, and by blocks of
    segments the corner (B, p, p) and its gradient (B, p).
    """

    state: Floats
    right: Floats
    corners: Floats
    corner_gradients: Floats

    @classmethod
    def empty(cls, K: int, m: int, p: int, blocks: int = 1) -> NormalBlocks:
        return cls(
            np.empty((K, m, m)), np.zeros((K, m, p + 1)), np.zeros((blocks, p, p)), np.zeros((blocks, p))
        )

    def within(self, border: Indices) -> NormalBlocks:
        """Those of these unknowns of the border alone, in arrays of their own."""
        return replace(
            self,
            right=self.right[..., np.append(border, -1)],
            corners=self.corners[:, border[:, None], border],
            corner_gradients=self.corner_gradients[:, border],
        )

    @property
    def corner(self) -> Floats:
        """(p, p) of all segments."""
        return np.asarray(self.corners.sum(axis=0))

    @property
    def corner_gradient(self) -> Floats:
        """(p,) of all segments."""
        return np.asarray(self.corner_gradients.sum(axis=0))

    def put(self, part: slice, rows: Floats | Single, pieces: Sequence[slice], columns: Indices) -> Floats:
        """Store [J r]'[J r] of the Jacobian and residuals `rows` (k, r, m + c) of a chunk, by states and c `columns`.

        Returns corners and gradients (b, c, c) of its pieces. Rows in single precision are multiplied segment by segment and
        the products summed in double precision; those in double precision are multiplied at once.
        """
        m, single = self.state.shape[1], rows.dtype == np.float32
        product = (rows if single else rows[..., :m]).transpose(0, 2, 1) @ rows
        self.state[part] = product[:, :m, :m]
        put_columns(self.right[part], columns, product[:, :m, m:])
        if single:
            return np.stack([product[piece, m:, m:].sum(axis=0, dtype=float) for piece in pieces])
        borders = (rows[piece, :, m:].reshape(-1, len(columns)) for piece in pieces)
        return np.stack([border.T @ border for border in borders])

    def add_corners(self, blocks: Indices, columns: Indices, corners: Floats) -> None:
        """Add corners and gradients (b, c, c) of `columns`, as of `put`, to those of b `blocks`."""
        border, which = as_slice(columns[:-1]), as_slice(blocks)
        if isinstance(border, slice) and isinstance(which, slice):
            self.corners[which, border, border] += corners[:, :-1, :-1]
            self.corner_gradients[which, border] += corners[:, -1, :-1]
            return
        places, numbers = columns[:-1], blocks[:, None]
        self.corners[numbers[:, None], places[:, None], places] += corners[:, :-1, :-1]
        self.corner_gradients[numbers, places] += corners[:, -1, :-1]

    def put_errors(
        self, part: slice, rows: Floats | Single, errors: Sequence[ChannelErrors], columns: Indices
    ) -> Floats:
        """Store products of `errors` of sensors with `rows` (k, M C, m + c) as of `put`.

        Returns those in the border and its gradient (p + 1, p + 1).
        """
        m, size = self.state.shape[1], self.right.shape[2]
        corner = np.zeros((size, size))
        for of_channel in errors:
            own, values = of_channel.columns, of_channel.values
            by_sample = rows.reshape(*values.shape[:2], -1, rows.shape[2])
            shown = by_sample[:, :, of_channel.channel]
            product = shown.transpose(0, 2, 1) @ values
            self.right[part][..., own] = product[:, :m]
            across = product[:, m:].sum(axis=0, dtype=float)
            corner[columns[:, None], own] = across
            corner[own[:, None], columns] = across.T
            corner[own[:, None], own] = (values.transpose(0, 2, 1) @ values).sum(axis=0, dtype=float)
        return corner


def put_columns(out: Floats, columns: Indices, values: Floats | Single) -> None:
    """Store values (..., c) in some columns of `out` (..., p + 1), of which the last one is the gradient's."""
    out[..., as_slice(columns[:-1])] = values[..., :-1]
    out[..., -1] = values[..., -1]


@dataclass(frozen=True, eq=False)
class ChannelErrors:
    """Whitened `values` (k, M, e) that e errors add to a `channel` in a chunk, and their `columns` (e,) in the border."""

    channel: int
    columns: Indices
    values: Single
