"""Sums of products of the linearised rows: of the states of nodes by segments, of the border by blocks of segments.

Columns of errors of sensors touch the rows of one channel each, so that only these are multiplied with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
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

    def put(
        self,
        part: slice,
        rows: Floats,
        pieces: Sequence[slice],
        columns: Indices,
        *,
        wide: bool,
    ) -> Floats:
        """Store [J r]'[J r] of the Jacobian and residuals `rows` (k, r, m + c) of a chunk, by states and c `columns`.

        Returns corners and gradients (b, p + 1, p + 1) of its pieces. With `wide`, for a border much wider than the states,
        they are one product over all rows, in double precision, in place of a sum of k products.
        """
        m, size = self.state.shape[1], self.right.shape[2]
        product = (rows[..., :m] if wide else rows).transpose(0, 2, 1) @ rows
        self.state[part] = product[:, :m, :m]
        self.right[part][..., columns] = product[:, :m, m:]
        corners = np.zeros((len(pieces), size, size))
        for corner, piece in zip(corners, pieces, strict=True):
            if wide:
                border = rows[piece, :, m:].astype(float).reshape(-1, len(columns))
                corner[columns[:, None], columns] = border.T @ border
            else:
                corner[columns[:, None], columns] = product[piece, m:, m:].sum(axis=0, dtype=float)
        return corners

    def add_errors(
        self,
        part: slice,
        rows: Floats,
        errors: Sequence[ChannelErrors],
        pieces: Sequence[slice],
        columns: Indices,
        corners: Floats,
    ) -> None:
        """Store products of `errors` of sensors with `rows` (k, M, C, m + c) as of `put`, those of the border in `corners`."""
        m = self.state.shape[1]
        for of_channel in errors:
            own, values, shown = of_channel.columns, of_channel.values, rows[:, :, of_channel.channel]
            self.right[part][..., own] = shown[..., :m].transpose(0, 2, 1) @ values
            for corner, piece in zip(corners, pieces, strict=True):
                border, added = (
                    array.astype(float).reshape(-1, array.shape[-1])
                    for array in (shown[piece, :, m:], values[piece])
                )
                across = border.T @ added
                corner[columns[:, None], own] = across
                corner[own[:, None], columns] = across.T
                corner[own[:, None], own] = added.T @ added


@dataclass(frozen=True, eq=False)
class ChannelErrors:
    """Whitened `values` (k, M, e) that e errors add to a `channel` in a chunk, and their `columns` (e,) in the border."""

    channel: int
    columns: Indices
    values: Single
