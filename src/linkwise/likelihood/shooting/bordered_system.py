"""Block tridiagonal normal equations with a border, and their Cholesky factors.

    | H  E | |s|   |g|      H: an (m, m) block per node and one per neighbouring pair of nodes
    | E' C | |t| = |c|      E: (K m, p) border, C: (p, p) corner

Flops and memory are linear in K. `BorderedSystem` is factored by LAPACK's banded routine; a wide border goes through the
factor node by node, by products of blocks. `BlockEquations`, for many masses, are eliminated node by node: dense blocks, of
which none but the roots are kept.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import blas, cho_solve, cholesky, lapack

from linkwise.arrays import Bools, Floats, Indices

_WIDE = 600  # numbers in the right-hand sides of a node, from which products of blocks are faster than single columns


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
        """Of the nodes (K, m) and the border (p,)."""
        nodes = self.right[..., -1]
        if self.shift is None:
            return nodes, self.corner_gradient
        return nodes, self.corner_gradient - self.shift.T @ nodes.sum(axis=0)

    def factor(self, damping: Damping | None = None, *, overwrite: bool = False) -> BorderedFactor | None:
        """Cholesky factor of the equations, damped where `damping` is given; None where they are not positive definite.

        With `overwrite`, `right` may become a part of the factor.
        """
        K, m, _ = self.diagonal.shape
        p = len(self.corner)
        band = np.empty((K, m, 2 * m))
        for column in range(m):
            band[:, column, : m - column] = self.diagonal[:, column:, column]
            band[:-1, column, m - column : 2 * m - column] = self.coupling[:, :, column]
            band[-1, column, m - column :] = 0.0
            band[:, column, 2 * m - column :] = 0.0
        if damping is not None:
            band[:, :, 0] += damping.nodes
        chol, info = lapack.dpbtrf(band.reshape(K * m, 2 * m).T, lower=1, overwrite_ab=1)
        if info:
            return None
        forward = _forward(chol, self.right, overwrite=overwrite)
        rows = forward.reshape(K * m, p + 1)
        moment = rows.T @ rows
        corner = self.corner if damping is None else self.corner + np.diag(damping.border)
        schur = corner - moment[:p, :p]
        if not np.isfinite(schur).all():  # of tangents that overflowed
            return None
        slope = self.corner_gradient - moment[p, :p]
        return BorderedFactor(chol, forward, schur, slope, damped=damping is not None, shift=self.shift)

    def drop(self, nodes: Floats, border: Floats) -> float:
        """g's: the reduction of the cost that a full Gauss-Newton step s = (nodes, border) predicts."""
        gradient = self.gradient
        return float(np.vdot(gradient[0], nodes) + gradient[1] @ border)


@dataclass(frozen=True, eq=False)
class BorderEquations:
    """Equations of the border with the nodes eliminated, `schur` (p, p) and `reduced` (p,); by how much the nodes alone would
    reduce the cost, and whether the equations were `damped`.
    """

    schur: Floats
    reduced: Floats
    by_nodes: float
    damped: bool = False

    def reduction(self, border: Floats) -> float:
        """By how much a step with this border (p,) reduces the cost where the nodes follow."""
        return self.by_nodes + float(border @ (2.0 * self.reduced - self.schur @ border))


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
    """Factor of the nodes, `chol` (banded) and `forward` (K, m, p + 1); equations of the border, `schur` (p, p) and
    `reduced` (p,); whether it was `damped`, and the `shift` (m, p) of the nodes by the border, if there is one.
    """

    chol: Floats
    forward: Floats
    schur: Floats
    reduced: Floats
    damped: bool = False
    shift: Floats | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """K and m."""
        K, m, _ = self.forward.shape
        return K, m

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
        right = self.forward[..., -1] - self.forward[..., :-1] @ border
        solved, _ = lapack.dtbtrs(self.chol, right.reshape(-1, 1), uplo="L", trans="T")
        nodes = solved.reshape(self.shape)
        return nodes if self.shift is None else nodes + self.shift @ border, border

    def moved(self, nodes: Floats, border: Floats) -> BorderedFactor:
        """The factor of equations whose gradient is larger by `nodes` (K, m) and `border` (p,)."""
        if self.shift is not None:
            border = border + self.shift.T @ nodes.sum(axis=0)
        change, _ = lapack.dtbtrs(self.chol, nodes.reshape(-1, 1), uplo="L")
        forward = self.forward.copy()
        forward[..., -1] += change.reshape(self.shape)
        moment = np.tensordot(change.reshape(self.shape), forward[..., :-1], 2)
        return replace(self, forward=forward, reduced=self.reduced + border - moment)

    def inverse_blocks(self) -> Floats:
        """(K, m, m) diagonal blocks of H^-1, from the last node to the first (Takahashi, Fagan and Chen 1973)."""
        K, m = self.shape
        root, below = _blocks(self.chol, K, m)
        inverse = np.linalg.inv(root)
        carried = below @ inverse[:-1]
        blocks = inverse.transpose(0, 2, 1) @ inverse
        for k in range(K - 2, -1, -1):
            blocks[k] += carried[k].T @ blocks[k + 1] @ carried[k]
        return np.asarray(blocks)

    def log_determinant(self, free: Bools) -> float:
        """Of the whole matrix, border restricted to `free`."""
        _, border = np.linalg.slogdet(self.schur[np.ix_(free, free)])
        return 2.0 * float(np.log(self.chol[0]).sum()) + float(border)


def _blocks(chol: Floats, K: int, m: int) -> tuple[Floats, Floats]:
    """Of a banded factor the triangles (K, m, m) of the nodes, and the blocks (K - 1, m, m) of each with the one before."""
    root, below = np.zeros((K, m, m)), np.empty((K - 1, m, m))
    for column in range(m):
        band = chol[:, column::m].T
        root[:, column:, column] = band[:, : m - column]
        below[:, :, column] = band[:-1, m - column : 2 * m - column]
    return root, below


def _forward(chol: Floats, right: Floats, *, overwrite: bool) -> Floats:
    """(K, m, c) the solution of the equations with a banded factor alone."""
    K, m, c = right.shape
    if m * c < _WIDE:
        solved, _ = lapack.dtbtrs(chol, right.reshape(K * m, c), uplo="L")
        return np.ascontiguousarray(solved).reshape(right.shape)
    forward = right if overwrite else right.copy()
    root, below = _blocks(chol, K, m)
    for node, own in enumerate(forward):
        if node:
            own -= below[node - 1] @ forward[node - 1]
        blas.dtrsm(1.0, root[node].T, own.T, side=1, overwrite_b=1)
    return forward


_AT_ONCE = 32  # nodes that are assembled together at most
_HELD = 2_000_000  # numbers in the blocks of these


@dataclass(frozen=True, eq=False)
class NodeBlocks:
    """Of c nodes that follow each other: `diagonal` (c, m, m), `right` (c, p + 1, m) border and gradient, and `coupling`
    (c, m, m) of the nodes that follow each (rows) with them (columns).
    """

    diagonal: Floats
    right: Floats
    coupling: Floats


class BlockEquations(ABC):
    """K nodes of m states with a border of p unknowns, which are assembled a few nodes at a time."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """K and m."""

    @property
    @abstractmethod
    def corner(self) -> Floats:
        """(p, p) matrix of the border."""

    @property
    @abstractmethod
    def corner_gradient(self) -> Floats:
        """(p,) its gradient."""

    @abstractmethod
    def blocks(self, first: int, last: int) -> NodeBlocks:
        """Those of nodes up to a last one, not included; new arrays, which may be overwritten."""

    @abstractmethod
    def coupling(self, first: int, last: int) -> Floats:
        """(c, m, m) blocks of the node that follows each of such nodes (rows) with it (columns)."""

    @abstractmethod
    def remainder(self, border: Floats) -> Floats:
        """What a border (p,) leaves of the gradient of the nodes, (K, m)."""

    @abstractmethod
    def across(self, nodes: Floats) -> Floats:
        """What nodes (K, m) add to the equations of the border, (p,)."""

    def block_factor(self, *, damped: bool = False) -> BlockFactor | None:
        """The Cholesky factor; None where the equations are not positive definite."""
        K, m = self.shape
        roots = np.empty((K, m, m))
        border = self.block_border(roots)
        return None if border is None else BlockFactor(self, roots, border.schur, border.reduced, damped)

    @property
    def at_once(self) -> int:
        """How many nodes are assembled together."""
        m, p = self.shape[1], len(self.corner)
        return max(4, min(_AT_ONCE, _HELD // (m * (2 * m + p + 1))))

    @np.errstate(over="ignore", invalid="ignore")
    def block_border(self, roots: Floats | None = None, *, damped: bool = False) -> BorderEquations | None:
        """The border with all nodes eliminated, whose `roots` (K, m, m) are filled where they are asked for.

        None where the equations are not positive definite.
        """
        (K, m), p = self.shape, len(self.corner)
        root, moment = np.empty((m, m)), np.zeros((p + 1, p + 1))
        link = right = None  # of the last node with the next (rows), and its border, through its root
        for first in range(0, K, self.at_once):
            blocks = self.blocks(first, min(first + self.at_once, K))
            for own, node in enumerate(range(first, first + len(blocks.diagonal))):
                diagonal = blocks.diagonal[own]
                if link is not None and right is not None:
                    diagonal -= link @ link.T
                    blocks.right[own] -= right @ link.T
                root = root if roots is None else roots[node]
                root[:] = diagonal
                _, info = lapack.dpotrf(root.T, lower=1, overwrite_a=1)
                if info:
                    return None
                link, right = np.array(blocks.coupling[own], order="C"), blocks.right[own]
                for rows in (link, right):
                    _through(root, rows)
            rows = np.concatenate(list(blocks.right), axis=1)
            moment += rows @ rows.T
        schur = self.corner - moment[:p, :p]
        if not np.isfinite(schur).all():  # of tangents that overflowed
            return None
        reduced = self.corner_gradient - moment[p, :p]
        return BorderEquations(schur, reduced, float(moment[p, p]), damped)


def _through(root: Floats, rows: Floats, *, transposed: bool = False) -> None:
    """Solve L x = b, or L' x = b, for each of `rows` (c, m), in place; L is given by its transpose `root` (m, m)."""
    lapack.dtrtrs(root.T, rows.T, lower=1, trans=int(transposed), overwrite_b=1)


@dataclass(frozen=True, eq=False)
class BlockFactor:
    """Factor of `equations`: transposed `roots` (K, m, m) of the nodes, and equations of the border, `schur` (p, p) and
    `reduced` (p,); whether it was `damped`, and what is `added` (K, m) to the gradient of the nodes, if anything.
    """

    equations: BlockEquations
    roots: Floats
    schur: Floats
    reduced: Floats
    damped: bool = False
    added: Floats | float = 0.0

    def solve(self, free: Bools, fixed_values: Floats | None = None) -> tuple[Floats, Floats] | None:
        """Nodes (K, m) and border (p,), entries outside `free` (p,) kept at `fixed_values` (p,), by default at zero.

        None where the equations are not positive definite.
        """
        border = border_step(self.schur, self.reduced, free, fixed_values)
        if border is None:
            return None
        right = self.equations.remainder(border) + self.added
        return self.nodes(np.array(right[:, None], order="C"))[:, 0], border

    def nodes(self, right: Floats) -> Floats:
        """The solution (K, c, m) of the equations of the nodes alone; `right` (K, c, m) is overwritten."""
        last = len(right) - 1
        for node, link in self._links(range(last)):
            _through(self.roots[node], right[node])
            own = right[node].copy()
            _through(self.roots[node], own, transposed=True)
            right[node + 1] -= own @ link.T
        _through(self.roots[last], right[last])
        _through(self.roots[last], right[last], transposed=True)
        for node, link in self._links(range(last - 1, -1, -1)):
            carried = right[node + 1] @ link
            _through(self.roots[node], carried)
            right[node] -= carried
            _through(self.roots[node], right[node], transposed=True)
        return right

    def moved(self, nodes: Floats, border: Floats) -> BlockFactor:
        """The factor of equations whose gradient is larger by `nodes` (K, m) and `border` (p,)."""
        change = self.nodes(np.array(nodes[:, None], order="C"))[:, 0]
        reduced = self.reduced + border - self.equations.across(change)
        return replace(self, added=self.added + nodes, reduced=reduced)

    def _links(self, nodes: range) -> Iterator[tuple[int, Floats]]:
        """Of each of some nodes the block (m, m) of the one that follows it (rows) with it (columns)."""
        for begin in range(0, len(nodes), _AT_ONCE):
            some = nodes[begin : begin + _AT_ONCE]
            blocks = self.equations.coupling(min(some), max(some) + 1)
            for node in some:
                yield node, blocks[node - min(some)]

    def log_determinant(self, free: Bools) -> float:
        """Of the whole matrix, border restricted to `free`."""
        _, border = np.linalg.slogdet(self.schur[np.ix_(free, free)])
        return 2.0 * float(np.log(np.einsum("kii->ki", self.roots)).sum()) + float(border)
