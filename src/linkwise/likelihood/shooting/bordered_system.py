"""Block tridiagonal normal equations with a border, and their Cholesky factors.

    | H  E | |s|   |g|      H: an (m, m) block per node and one per neighbouring pair of nodes
    | E' C | |t| = |c|      E: (K m, p) border, C: (p, p) corner

Flops and memory are linear in K. Nodes of few states with a narrow border are factored by LAPACK's banded routine, others
node by node, by products of blocks and in place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas, cho_solve, cholesky, lapack

from linkwise.arrays import Bools, Floats, Indices

_WIDE = 600  # numbers in the right-hand sides of a node, from which products of blocks are faster than a band


@dataclass(frozen=True, eq=False)
class Damping:
    """The Levenberg-Marquardt term of the diagonal: nodes (K, m), border (p,)."""

    nodes: Floats
    border: Floats


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """The equations; `right` holds for each node the columns of the border and, last, the gradient.

    Where there is a `shift`, they are of nodes relative to one by the border; steps and gradients are of the nodes themselves.
    """

    diagonal: Floats  # (K, m, m) symmetric
    coupling: Floats  # (K - 1, m, m), rows: the later node
    right: Floats  # (K, m, p + 1)
    corner: Floats  # (p, p)
    corner_gradient: Floats  # (p,)
    shift: Floats | None = None  # (m, p), the same of all nodes

    @property
    def gradient(self) -> tuple[Floats, Floats]:
        """Of the nodes (K, m) and the border (p,), in arrays of its own."""
        nodes = self.right[..., -1].copy()
        if self.shift is None:
            return nodes, self.corner_gradient
        return nodes, self.corner_gradient - self.shift.T @ nodes.sum(axis=0)

    def factor(self, damping: Damping | None = None) -> BorderedFactor | None:
        """Cholesky factor of the equations, damped where `damping` is given; None where they are not positive definite.

        `diagonal`, `coupling` and `right` may become parts of the factor.
        """
        K, m, c = self.right.shape
        p = c - 1
        kind = BandedRoot if m * c < _WIDE else BlockRoot
        root = kind.of(self.diagonal, self.coupling, None if damping is None else damping.nodes)
        if root is None:
            return None
        forward = root.forward(self.right)
        rows = forward.reshape(K * m, p + 1)
        moment = rows.T @ rows
        corner = self.corner if damping is None else self.corner + np.diag(damping.border)
        schur = corner - moment[:p, :p]
        if not np.isfinite(schur).all():  # of tangents that overflowed
            return None
        slope = self.corner_gradient - moment[p, :p]
        pull = forward[..., -1].copy()
        return BorderedFactor(root, forward, pull, schur, slope, damping is not None, self.shift)


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


@dataclass(frozen=True, eq=False)
class BlockRoot:
    """The same by blocks: triangles (K, m, m) of the nodes, and blocks (K - 1, m, m) of each with the one before."""

    blocks: tuple[Floats, Floats]

    @classmethod
    def of(cls, diagonal: Floats, coupling: Floats, added: Floats | None) -> BlockRoot | None:
        """As of `BandedRoot`, in place."""
        root, below = diagonal, coupling
        if added is not None:
            np.einsum("kii->ki", root)[:] += added
        for node, own in enumerate(root):
            if node:
                blas.dsyrk(-1.0, below[node - 1].T, 1.0, own.T, trans=1, overwrite_c=1)
            _, info = lapack.dpotrf(own.T, lower=0, overwrite_a=1)
            if info:
                return None
            if node < len(below):
                blas.dtrsm(1.0, own.T, below[node].T, trans_a=1, overwrite_b=1)
        return cls((root, below))

    def forward(self, right: Floats) -> Floats:
        """As of `BandedRoot`, in place of `right`."""
        root, below = self.blocks
        for node, own in enumerate(right):
            if node:
                blas.dgemm(-1.0, right[node - 1].T, below[node - 1].T, 1.0, own.T, overwrite_c=1)
            blas.dtrsm(1.0, root[node].T, own.T, side=1, overwrite_b=1)
        return right

    def backward(self, right: Floats) -> Floats:
        """As of `BandedRoot`, in place of `right`."""
        root, below = self.blocks
        for node in range(len(right) - 1, -1, -1):
            if node < len(below):
                right[node] -= below[node].T @ right[node + 1]
            blas.dtrsm(1.0, root[node].T, right[node].T, side=1, trans_a=1, overwrite_b=1)
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
    equations of the border, `schur` (p, p) and `reduced` (p,); whether it was `damped`, and the `shift` (m, p) of the nodes by
    the border, if there is one.
    """

    root: BandedRoot | BlockRoot
    forward: Floats
    pull: Floats
    schur: Floats
    reduced: Floats
    damped: bool = False
    shift: Floats | None = None

    def within(self, border: Indices) -> BorderedFactor:
        """That of equations with these unknowns of the border alone, in arrays of its own."""
        columns = np.append(border, -1)
        chosen = np.ix_(border, border)
        return replace(
            self,
            forward=self.forward[..., columns],
            schur=self.schur[chosen],
            reduced=self.reduced[border],
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
