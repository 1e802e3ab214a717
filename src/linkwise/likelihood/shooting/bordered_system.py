"""Equations that are block tridiagonal with a border, and their Cholesky factors:

    | H  E | |s|   |g|      H: an (m, m) block per node and one per neighbouring pair of nodes
    | E' C | |t| = |c|      E: (K m, p) border, C: (p, p) corner

Flops and memory are linear in K. Nodes of few states with a narrow border are factored by LAPACK's banded routine, others
node by node, by products of blocks and in place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from scipy.linalg import blas, cho_solve, cholesky, lapack

from linkwise.arrays import Bools, Floats, Indices

_AT_ONCE = 200_000  # numbers in the equations of nodes that are assembled together
_WIDE = 300  # numbers in the right-hand sides of a node, from which products of blocks are faster than a band


Damping: TypeAlias = tuple[Floats, Floats]
"""The Levenberg-Marquardt term of the diagonal: nodes (K, m), border (p,)."""


Nodes: TypeAlias = tuple[Floats, Floats, Floats]
"""Blocks of K nodes: diagonal (K, m, m), symmetric; coupling (K, m, m) or one less, of the nodes that follow (rows) with them;
and right (K, m, p + 1), the columns of the border and, last, the gradient.
"""
Factored: TypeAlias = "tuple[BandedRoot | BlockRoot, Floats, Floats, Floats]"
"""Root of the nodes; the border and, last, the gradient behind it (K, m, p + 1); the gradient of the nodes (K, m); and the
products (p + 1, p + 1) of the columns behind the root, of all.
"""


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """The equations of K nodes of m states with a border of p unknowns, whose nodes are assembled where they are asked for.

    Where there is a `shift`, they are of nodes relative to one by the border; steps and gradients are of the nodes themselves.
    """

    shape: tuple[int, int, int]  # K, m and p + 1
    put: Callable[[slice, Nodes], None]  # the blocks of some nodes into room for them
    corner: Floats  # (p, p)
    corner_gradient: Floats  # (p,)
    shift: Floats | None = None  # (m, p), the same of all nodes
    piece: int | None = None  # nodes that are known together, asked for in order

    @classmethod
    def of(cls, nodes: Nodes, corner: Floats, corner_gradient: Floats) -> BorderedSystem:
        """Those of blocks that are known."""

        def put(some: slice, room: Nodes) -> None:
            for own, values in zip(room, nodes, strict=True):
                own[:] = values[some]

        K, m, c = nodes[2].shape
        return cls((K, m, c), put, corner, corner_gradient)

    @property
    def nodes(self) -> Nodes:
        """The blocks of all nodes, in arrays of their own."""
        K, m, c = self.shape
        diagonal, coupling, right = np.empty((K, m, m)), np.empty((K - 1, m, m)), np.empty((K, m, c))
        for some in self._parts:
            self.put(some, (diagonal[some], coupling[some], right[some]))
        return diagonal, coupling, right

    @property
    def _parts(self) -> list[slice]:
        """The nodes in parts that are assembled together."""
        K, m, c = self.shape
        size = max(1, _AT_ONCE // (m * (3 * m + 2 * c)))
        firsts = [first for piece in self._pieces for first in piece[::size]]
        return [slice(*ends) for ends in pairwise([*firsts, K])]

    @property
    def _pieces(self) -> list[range]:
        K, size = self.shape[0], self.piece or self.shape[0]
        return [range(first, min(first + size, K)) for first in range(0, K, size)]

    def factor(self, damping: Damping | None = None, kept: Indices | None = None) -> BorderedFactor | None:
        """Cholesky factor of the equations, damped where `damping` is given; None where they are not positive definite.

        It has the equations of all unknowns of the border, and of those that are `kept`, by default all, what the nodes need
        to follow them.
        """
        _, m, c = self.shape
        p, added = c - 1, None if damping is None else damping[0]
        factored = self._by_band(added) if m * c < _WIDE else self._by_blocks(added, kept)
        if factored is None:
            return None
        root, forward, nodes, moment = factored
        corner = self.corner if damping is None else self.corner + np.diag(damping[1])
        schur = corner - moment[:p, :p]
        if not np.isfinite(schur).all():  # of tangents that overflowed
            return None
        slope = self.corner_gradient - moment[p, :p]
        border = self.corner_gradient - (0.0 if self.shift is None else self.shift.T @ nodes.sum(axis=0))
        if kept is not None and forward.shape[2] == c:
            forward = forward[..., np.append(kept, p)]
        pull = forward[..., -1].copy()
        return BorderedFactor(
            root, forward, pull, schur, slope, (nodes, border), damping is not None, self.shift
        )

    def _by_band(self, added: Floats | None) -> Factored | None:
        """The factor by a band, with something `added` (K, m) to the diagonal."""
        diagonal, coupling, right = self.nodes
        root = BandedRoot.of(diagonal, coupling, added)
        if root is None:
            return None
        forward = root.forward(right)
        rows = forward.reshape(-1, right.shape[2])
        return root, forward, right[..., -1].copy(), rows.T @ rows

    def _by_blocks(self, added: Floats | None, kept: Indices | None) -> Factored | None:
        """The factor by blocks, in the room of a part of the nodes but for what is left of each."""
        K, m, c = self.shape
        root = BlockRoot((np.empty((K, m, m)), np.empty((K - 1, m, m))))
        forward = np.empty((K, m, c if kept is None else len(kept) + 1))
        nodes, moment = np.empty((K, m)), np.zeros((c, c), order="F")
        before: Floats | None = None
        for some in self._parts:
            right = forward[some] if kept is None else np.empty((some.stop - some.start, m, c))
            diagonal, coupling = (blocks[some] for blocks in root.blocks)
            self.put(some, (diagonal, coupling, right))
            nodes[some] = right[..., -1]
            if added is not None:
                np.einsum("kii->ki", diagonal)[:] += added[some]
            if not root.eliminate(some, right, before):
                return None
            before = right[-1]
            blas.dsyrk(1.0, right.reshape(-1, c).T, 1.0, moment, lower=1, overwrite_c=1)
            if kept is not None:
                forward[some] = right[..., np.append(kept, -1)]
        return root, forward, nodes, np.tril(moment) + np.tril(moment, -1).T


@dataclass(frozen=True, eq=False)
class BandedRoot:
    """The Cholesky factor of the nodes as a band `chol` (2 m, K m) of LAPACK's, of `nodes` nodes."""

    chol: Floats
    nodes: int

    @classmethod
    def of(cls, diagonal: Floats, coupling: Floats, added: Floats | None) -> BandedRoot | None:
        """From blocks (K, m, m) and (K - 1, m, m), something `added` (K, m) to the diagonal; None if not positive definite."""
        K, m, _ = diagonal.shape
        band = np.empty((K, m, 2 * m))
        for column in range(m):
            band[:, column, : m - column] = diagonal[:, column:, column]
            band[:-1, column, m - column : 2 * m - column] = coupling[:, :, column]
            band[-1, column, m - column :] = 0.0
            band[:, column, 2 * m - column :] = 0.0
        if added is not None:
            band[:, :, 0] += added
        chol, info = lapack.dpbtrf(band.reshape(K * m, 2 * m).T, lower=1, overwrite_ab=1)
        return None if info else cls(chol, K)

    def forward(self, right: Floats) -> Floats:
        """(K, m, c) what solves L x = `right`."""
        solved, _ = lapack.dtbtrs(self.chol, right.reshape(-1, right.shape[2]), uplo="L")
        return np.ascontiguousarray(solved).reshape(right.shape)

    def backward(self, right: Floats) -> Floats:
        """(K, m, c) what solves L' x = `right`."""
        solved, _ = lapack.dtbtrs(self.chol, right.reshape(-1, right.shape[2]), uplo="L", trans="T")
        return np.ascontiguousarray(solved).reshape(right.shape)

    @property
    def log_determinant(self) -> float:
        """Of L L'."""
        return 2.0 * float(np.log(self.chol[0]).sum())

    @property
    def blocks(self) -> tuple[Floats, Floats]:
        """The triangles (K, m, m) of the nodes, and the blocks (K - 1, m, m) of each with the one before."""
        K, m = self.nodes, len(self.chol) // 2
        root, below = np.zeros((K, m, m)), np.empty((K - 1, m, m))
        for column in range(m):
            band = self.chol[:, column::m].T
            root[:, column:, column] = band[:, : m - column]
            below[:, :, column] = band[:-1, m - column : 2 * m - column]
        return root, below


def _as_fortran(blocks: Floats) -> Floats:
    """(K, b, a) the same (K, a, b), each as the routines of BLAS take it without a copy."""
    return blocks.transpose(0, 2, 1)


@dataclass(frozen=True, eq=False)
class BlockRoot:
    """The same by blocks: triangles (K, m, m) of the nodes, and blocks (K - 1, m, m) of each with the one before."""

    blocks: tuple[Floats, Floats]

    def eliminate(self, some: slice, right: Floats, before: Floats | None) -> bool:
        """Replace the blocks of some nodes by their factor, and `right` (k, m, c) of these by what solves L x = `right`.

        `before` (m, c) is that of the node before them. Whether they are positive definite.
        """
        root, below = map(_as_fortran, self.blocks)
        for k, own in zip(range(some.start, some.stop), _as_fortran(right), strict=True):
            if before is not None:
                blas.dtrsm(1.0, root[k - 1], below[k - 1], trans_a=1, overwrite_b=1)
                blas.dsyrk(-1.0, below[k - 1], 1.0, root[k], trans=1, overwrite_c=1)
                blas.dgemm(-1.0, before.T, below[k - 1], 1.0, own, overwrite_c=1)
            _, info = lapack.dpotrf(root[k], lower=0, overwrite_a=1)
            if info:
                return False
            blas.dtrsm(1.0, root[k], own, side=1, overwrite_b=1)
            before = own.T
        return True

    def forward(self, right: Floats) -> Floats:
        """As of `BandedRoot`, in place of `right`."""
        root, below = map(_as_fortran, self.blocks)
        before: Floats | None = None
        for own, triangle, joined in zip(_as_fortran(right), root, (None, *below), strict=True):
            if joined is not None:
                blas.dgemm(-1.0, before, joined, 1.0, own, overwrite_c=1)
            blas.dtrsm(1.0, triangle, own, side=1, overwrite_b=1)
            before = own
        return right

    def backward(self, right: Floats) -> Floats:
        """As of `BandedRoot`, in place of `right`."""
        root, below = map(_as_fortran, self.blocks)
        after: Floats | None = None
        for own, triangle, joined in zip(
            _as_fortran(right)[::-1], root[::-1], (None, *below[::-1]), strict=True
        ):
            if joined is not None:
                blas.dgemm(-1.0, after, joined, 1.0, own, trans_b=1, overwrite_c=1)
            blas.dtrsm(1.0, triangle, own, side=1, trans_a=1, overwrite_b=1)
            after = own
        return right

    @property
    def log_determinant(self) -> float:
        """Of L L'."""
        return 2.0 * float(np.log(np.einsum("kii->ki", self.blocks[0])).sum())


def border_step(schur: Floats, reduced: Floats, free: Bools, fixed_values: Floats | None) -> Floats | None:
    """The border (p,) that the equations of the border ask for, entries outside `free` (p,) kept at `fixed_values` (p,), by
    default at zero; None where they are not positive definite.
    """
    border = np.zeros(len(reduced)) if fixed_values is None else np.where(free, 0.0, fixed_values)
    if free.any():
        try:
            root = cholesky(schur[np.ix_(free, free)], lower=True)
        except np.linalg.LinAlgError:
            return None
        right = reduced[free] - schur[np.ix_(free, ~free)] @ border[~free]
        border[free] = cho_solve((root, True), right)
    return border


def excess(schur: Floats, reduced: Floats, border: Floats, free: Bools) -> float:
    """s'(H s - g) of a step whose `border` (p,) is held outside `free`: what `drop` takes for zero."""
    return float(border[~free] @ (schur[~free] @ border - reduced[~free]))


@dataclass(frozen=True, eq=False)
class BorderedFactor:
    """Factor of the nodes, `root`, with the border, `forward` (K, m, p + 1), and the gradient, `pull` (K, m), behind it;
    equations of the border, `schur` (p, p) and `reduced` (p,); the `gradient` of nodes (K, m) and border (p,); whether it was
    `damped`, and the `shift` (m, p) of the nodes by the border, if there is one.
    """

    root: BandedRoot | BlockRoot
    forward: Floats
    pull: Floats
    schur: Floats
    reduced: Floats
    gradient: tuple[Floats, Floats]
    damped: bool = False
    shift: Floats | None = None

    def within(self, border: Indices) -> BorderedFactor:
        """That of equations with these unknowns of the border alone, which were kept."""
        chosen = np.ix_(border, border)
        return replace(
            self,
            schur=self.schur[chosen],
            reduced=self.reduced[border],
            gradient=(self.gradient[0], self.gradient[1][border]),
            shift=None if self.shift is None else self.shift[:, border],
        )

    def solve(self, free: Bools, fixed_values: Floats | None = None) -> tuple[Floats, Floats] | None:
        """Nodes (K, m) and border (p,), entries outside `free` (p,) kept at `fixed_values` (p,), by default at zero.

        None where the equations are not positive definite.
        """
        border = border_step(self.schur, self.reduced, free, fixed_values)
        if border is None:
            return None
        right = self.pull - self.forward[..., :-1] @ border
        nodes = self.root.backward(right[..., None])[..., 0]
        return nodes if self.shift is None else nodes + self.shift @ border, border

    def moved(self, nodes: Floats, border: Floats) -> BorderedFactor:
        """The factor of equations whose gradient is larger by `nodes` (K, m) and `border` (p,)."""
        if self.shift is not None:
            border = border + self.shift.T @ nodes.sum(axis=0)
        change = self.root.forward(nodes[..., None].copy())[..., 0]
        moment = np.tensordot(change, self.forward[..., :-1], 2)
        return replace(self, pull=self.pull + change, reduced=self.reduced + border - moment)

    def inverse_blocks(self) -> tuple[Floats, Floats]:
        """Blocks of H^-1, (K, m, m) of the nodes and (K - 1, m, m) of each with the one before, from the last to the first
        (Takahashi, Fagan and Chen 1973).
        """
        root, below = self.root.blocks
        inverse = np.linalg.inv(root)
        carried = below @ inverse[:-1]
        blocks = inverse.transpose(0, 2, 1) @ inverse
        for k in range(len(below) - 1, -1, -1):
            blocks[k] += carried[k].T @ blocks[k + 1] @ carried[k]
        return np.asarray(blocks), np.asarray(-blocks[1:] @ carried)

    def log_determinant(self, free: Bools) -> float:
        """Of the whole matrix, border restricted to `free`."""
        _, border = np.linalg.slogdet(self.schur[np.ix_(free, free)])
        return self.root.log_determinant + float(border)
