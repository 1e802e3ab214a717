"""The Gram matrix of a linear system, formed once for all targets, thresholds and supports.

Columns are scaled to unit norm, so "small" means the same in every unit. The normal equations square the condition
number, and with it lose half of the digits; they come back by one more pass over the rows: it computes the residual of an
anchor solution to all digits, and every later fit is a correction of that anchor. Its error is then relative to the
correction, not to the target.

Every fifth of a hundred runs of neighbouring rows is held out. Neighbouring samples are strongly correlated: predicting a
whole run is a test, predicting a row between two fitted ones is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.blas import dgemm, dsymm, dsymv, dsyrk, dtrsm
from scipy.linalg.lapack import dpotri

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.sindy.regression.cholesky import CholeskyFactor, cholesky, ridged, vanishing
from linkwise.sindy.regression.linear_system import LinearSystem


@dataclass(frozen=True, eq=False)
class AnchoredSums:
    """Sums over R rows about an anchor, for scaled columns: `matrix` A'A (p, p), `slope` A'(b - A anchor) (p, T),
    `squares` ||b - A anchor||^2 and `norms` ||b|| (T,).
    """

    rows: int
    matrix: Floats
    slope: Floats
    squares: Floats
    norms: Floats

    def shifted(self, change: Floats) -> AnchoredSums:
        """The same sums about an anchor that differs by `change` (p, T)."""
        product = dsymm(1.0, self.matrix, change, lower=1)
        squares = np.maximum(self.squares + np.sum(change * (product - 2 * self.slope), axis=0), 0.0)
        return AnchoredSums(self.rows, self.matrix, self.slope - product, squares, self.norms)

    def squares_at(self, change: Floats, target: int) -> float:
        """Sum of squared residuals ||b - A (anchor + change)||^2 of a target, at a `change` (p,) of the anchor."""
        product = dsymv(1.0, self.matrix, change, lower=1)
        return max(float(self.squares[target] + change @ (product - 2 * self.slope[:, target])), 0.0)

    def restricted(self, retained: Indices, change: Floats, target: int) -> AnchoredSums:
        """Sums of k `retained` columns and one target about an anchor, changed by `change` (p,), that is zero in the other
        columns.
        """
        product = dsymv(1.0, self.matrix, change, lower=1)
        slope = self.slope[:, target]
        squares = max(float(self.squares[target] + change @ (product - 2 * slope)), 0.0)
        return AnchoredSums(
            self.rows,
            self.matrix[np.ix_(retained, retained)].T,  # symmetric, and so in Fortran order
            (slope - product)[retained, None],
            np.array([squares]),
            self.norms[target : target + 1],
        )


_RUNS = 100
_ONE_IN = 5
_TILE = 128
_FEWEST = 25  # rows below which none are held out: validation needs five


class Products(NamedTuple):
    """Products over some rows: `matrix` A'A (p, p), `moments` A'b (p, T) and `squares` ||b||^2 (T,)."""

    matrix: Floats
    moments: Floats
    squares: Floats


class ResidualProducts(NamedTuple):
    """Products of residuals over some rows: `squares` ||b - A c||^2 (T,) and `slope` A'(b - A c) (p, T)."""

    squares: Floats
    slope: Floats


def held_out_rows(rows: int) -> Bools:
    """True (R,) for rows that are held out for validation: the middle one of every five runs; none of fewer than 25 rows."""
    if rows < _FEWEST:
        return np.zeros(rows, dtype=bool)
    run = np.arange(rows) * min(_RUNS, rows - rows % _ONE_IN) // rows
    return np.asarray(run % _ONE_IN == _ONE_IN // 2)


def products(system: LinearSystem) -> list[Products]:
    """Products of the rows for training, and of those held out where there are any; one symmetric rank-k update per block
    of rows.
    """
    columns, targets = len(system.names), len(system.targets)
    parts = [
        Products(np.zeros((columns, columns), order="F"), np.zeros((columns, targets)), np.zeros(targets))
        for _ in range(1 + bool(held_out_rows(system.rows).any()))
    ]
    for part, rows, target in _blocks(system):
        # syrk reads Fortran order; a block in C order is the transpose of one. It overwrites c.
        transposed = rows.flags.c_contiguous
        dsyrk(
            1.0,
            rows.T if transposed else rows,
            beta=1.0,
            c=parts[part].matrix,
            trans=not transposed,
            lower=1,
            overwrite_c=1,
        )
        parts[part].moments[...] += blas_product(rows, target, transposed=True)
        parts[part].squares[...] += np.sum(target**2, axis=0)
    for part_products in parts:
        mirror(part_products.matrix)
    return parts


def residual_products(system: LinearSystem, coefficients: Floats) -> list[ResidualProducts]:
    """Products of the residuals of coefficients c (p, T), computed from the rows themselves, in the parts of `products`."""
    parts = [
        ResidualProducts(np.zeros(coefficients.shape[1]), np.zeros_like(coefficients))
        for _ in range(1 + bool(held_out_rows(system.rows).any()))
    ]
    for part, rows, target in _blocks(system):
        residual = target - blas_product(rows, coefficients)
        parts[part].slope[...] += blas_product(rows, residual, transposed=True)
        parts[part].squares[...] += np.sum(residual**2, axis=0)
    return parts


def mirror(matrix: Floats) -> None:
    """Copy the lower triangle of a square matrix to its upper one in place, in tiles that fit in the cache."""
    edges = range(0, len(matrix), _TILE)
    for row in edges:
        for column in range(0, row, _TILE):
            tile = matrix[row : row + _TILE, column : column + _TILE]
            matrix[column : column + _TILE, row : row + _TILE] = tile.T
        corner = matrix[row : row + _TILE, row : row + _TILE]
        corner[...] = np.tril(corner) + np.tril(corner, -1).T


def blas_product(rows: Floats, right: Floats, *, transposed: bool = False) -> Floats:
    """`rows` (B, p) @ `right` (p, T), or rows.T @ right (B, T) if `transposed`, by SciPy's BLAS.

    NumPy links a BLAS of its own; threads of the two libraries that wait for work would slow each other down.
    """
    if rows.flags.c_contiguous:
        return np.asarray(dgemm(1.0, rows.T, right, trans_a=not transposed))
    return np.asarray(dgemm(1.0, rows, right, trans_a=transposed))


def _blocks(system: LinearSystem) -> Iterator[tuple[int, Floats, Floats]]:
    """All rows in blocks, first those for training (0), then those held out (1)."""
    held_out = held_out_rows(system.rows)
    for part, chosen in enumerate((~held_out, held_out)):
        for rows, target in system.blocks(np.flatnonzero(chosen)):
            yield part, rows, target


_PASSES = 3  # at most over the rows to refine the anchor; one is enough unless columns are nearly dependent
_ROUNDING = 1e-13  # a residual this far below its target cannot be refined


def anchored_solution(
    system: LinearSystem, factor: CholeskyFactor, moments: Floats, inverse: Floats, norms: Floats
) -> tuple[Floats, Floats, list[ResidualProducts]]:
    """Least squares solution by iterative refinement in scaled coefficients: an approximate one, the anchor (p, T), a last
    correction that is not applied, and the products of the residuals of the anchor in the parts of `products`. `factor` is
    that of the Gram matrix of scaled columns, with a ridge where they are dependent, `moments` (p, T) are A'b in scaled
    columns, `inverse` (p,) is 1 / ||A_j||, zero for columns that are zero throughout, `norms` (T,) are ||b||.
    """
    anchor = np.asarray(cho_solve(factor, moments))
    for last in (*[False] * (_PASSES - 1), True):
        left = [
            ResidualProducts(part.squares, inverse[:, None] * part.slope)
            for part in residual_products(system, anchor * inverse[:, None])
        ]
        squares = np.sum([part.squares for part in left], axis=0)
        slope = np.sum([part.slope for part in left], axis=0)
        change = np.asarray(cho_solve(factor, slope))
        gain = np.sum(change * slope, axis=0)
        if last or np.all((gain < squares / 2) | (squares <= (_ROUNDING * norms) ** 2)):
            break
        anchor = anchor + change
    return anchor, change, left


_SMALL = 8  # a support below one in eight columns is first solved without the anchor
_CANCELLING = 3e-5  # residual, as a share of its target, below which ||b||^2 - c'A'b has lost too many digits
_STATIONARY = 1e-13  # slope, as a share of the target, at which a solution needs no refinement
_REFINEMENTS = 3


@dataclass(frozen=True, eq=False)
class Gram:
    """Gram matrix of a system in p columns of unit norm, and the anchor that restores its digits.

    Scaled coefficients are z_j = c_j ||A_j||, the norm `scale` (p,) taken over all rows of the system.

    `sums` are those of the rows that are fitted, about the `anchor` (p, T), their least squares solution; `moments` (p, T)
    are A'b. `held_out` are sums of the rows held out about the same anchor, None where there are too few rows; they are
    among the fitted rows in the result of `of` and apart from them in `training`. Columns that are zero throughout are not
    `alive` (p,) and have a one on the diagonal, so that the matrix is not singular. `factor` is None where columns are
    dependent or it is not needed.
    """

    names: tuple[str, ...]
    sums: AnchoredSums
    moments: Floats
    scale: Floats
    alive: Bools
    anchor: Floats
    held_out: AnchoredSums | None
    factor: CholeskyFactor | None = None

    @classmethod
    def of(cls, system: LinearSystem) -> Gram:
        """Form the Gram matrix of a system in two passes over its rows, and up to two more where columns are nearly
        dependent; IdentificationError if it has no rows or no columns, or every column is zero.
        """
        if not system.rows or not system.names:
            raise IdentificationError(
                f"a fit needs equations and unknowns, got {system.rows} equations in {len(system.names)} unknowns"
            )
        parts = products(system)
        scale = np.sqrt(sum(np.diagonal(part.matrix) for part in parts))
        alive = scale > 0
        if not alive.any():
            raise IdentificationError(
                "every column of the equations is zero throughout: the record shows no motion to fit"
            )
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=alive)
        for part in parts:
            part.matrix[...] *= inverse[:, None]
            part.matrix[...] *= inverse
        whole = parts[0].matrix
        for part in parts[1:]:
            whole += part.matrix
        whole[~alive, ~alive] = 1.0
        moments = inverse[:, None] * np.sum([part.moments for part in parts], axis=0)
        norms = np.sqrt(np.sum([part.squares for part in parts], axis=0))
        factor = cholesky(whole)
        anchor, change, left = anchored_solution(system, factor or ridged(whole), moments, inverse, norms)
        rows = AnchoredSums(
            system.rows,
            whole,
            np.sum([part.slope for part in left], axis=0),
            np.sum([part.squares for part in left], axis=0),
            norms,
        )
        held_out = None
        if len(parts) > 1:
            count = int(np.count_nonzero(held_out_rows(system.rows)))
            held_out = AnchoredSums(
                count, parts[1].matrix, left[1].slope, left[1].squares, np.sqrt(parts[1].squares)
            )
            held_out = held_out.shifted(change)
        return cls(
            system.names, rows.shifted(change), moments, scale, alive, anchor + change, held_out, factor
        )

    @property
    def rows(self) -> int:
        """Number of rows that are fitted."""
        return self.sums.rows

    @property
    def matrix(self) -> Floats:
        """(p, p) A'A."""
        return self.sums.matrix

    @property
    def norms(self) -> Floats:
        """(T,) ||b||."""
        return self.sums.norms

    @cached_property
    def training(self) -> Gram:
        """The same without the rows held out, in the same scaled coefficients (whose columns then have a norm near 0.9);
        IdentificationError if there are too few rows to hold any out.
        """
        if self.held_out is None:
            raise IdentificationError(
                f"{self.rows} equations are too few to choose a threshold or a penalty on rows held out; give one"
            )
        matrix = np.asfortranarray(self.matrix - self.held_out.matrix)
        rows = AnchoredSums(
            self.rows - self.held_out.rows,
            matrix,
            self.sums.slope - self.held_out.slope,
            np.maximum(self.sums.squares - self.held_out.squares, 0.0),
            np.sqrt(np.maximum(self.norms**2 - self.held_out.norms**2, 0.0)),
        )
        factor = cholesky(matrix)
        change = np.asarray(cho_solve(factor or ridged(matrix), rows.slope))
        moments = rows.slope + dsymm(1.0, matrix, self.anchor, lower=1)
        return Gram(
            self.names,
            rows.shifted(change),
            moments,
            self.scale,
            self.alive,
            self.anchor + change,
            self.held_out.shifted(change),
            factor,
        )

    def restricted(self, support: Bools, target: int) -> Gram:
        """Restrict to the columns of a `support` (p,) and one target, about the least squares solution on it: solving
        within a small support then costs no more than its size.
        """
        retained = np.flatnonzero(support & self.alive)
        change = self._corrected(retained, target)
        scaled = self.anchor[:, target] + change
        return Gram(
            tuple(self.names[column] for column in retained),
            self.sums.restricted(retained, change, target),
            self.moments[retained, target : target + 1],
            self.scale[retained],
            np.ones(len(retained), dtype=bool),
            scaled[retained, None],
            None if self.held_out is None else self.held_out.restricted(retained, change, target),
        )

    def project(self, support: Bools, target: int) -> tuple[Floats, float]:
        """Least squares on a `support` (p,): scaled coefficients (p,), zero outside, and the sum of squared residuals, as
        a correction of the anchor, which keeps its digits however small the residual is. Dependent columns get a ridge of
        1e-14.
        """
        retained = np.flatnonzero(support & self.alive)
        dropped = np.flatnonzero(~support & self.alive)
        anchor = self.anchor[:, target]
        if not dropped.size:
            return np.where(self.alive, anchor, 0.0), float(self.sums.squares[target])
        if 0 < retained.size < len(self.names) / _SMALL:
            scaled, squares = self._directly(retained, target)
            if squares > (_CANCELLING * self.norms[target]) ** 2:
                return scaled, squares
        change = self._change(retained, dropped, target)
        return np.where(support & self.alive, anchor + change, 0.0), self.sums.squares_at(change, target)

    def solve(self, support: Bools, target: int) -> Floats:
        """Scaled coefficients of `project` alone."""
        retained = np.flatnonzero(support & self.alive)
        change = self._change(retained, np.flatnonzero(~support & self.alive), target)
        return np.where(support & self.alive, self.anchor[:, target] + change, 0.0)

    def unscaled(self, scaled: Floats) -> Floats:
        """Scaled coefficients (p,) or (p, T) in their own units; zero for columns that are zero throughout."""
        inverse = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.alive)
        return scaled * (inverse if scaled.ndim == 1 else inverse[:, None])

    def variances(self, support: Bools) -> Floats:
        """Diagonal (p,) of (A'A)^-1 on a support, in the coefficients' own units squared, zero outside;
        IdentificationError if columns of the support are dependent, which it names.
        """
        diagonal = np.zeros(len(self.names))
        retained, dropped = np.flatnonzero(support & self.alive), np.flatnonzero(~support & self.alive)
        if retained.size and (inverse := self._worth_inverting(retained, dropped)) is not None:
            diagonal[retained] = np.diagonal(inverse)[retained]
            if dropped.size:
                cross = inverse[:, dropped]
                eliminated = dtrsm(
                    1.0, ridged(cross[dropped])[0], cross, side=1, lower=1, trans_a=1, overwrite_b=1
                )
                diagonal[retained] -= np.einsum("ij,ij->i", eliminated, eliminated)[retained]
            least = 1.0 / np.diagonal(self.matrix)[retained]  # of a column that is orthogonal to all others
            diagonal[retained] = np.maximum(diagonal[retained], least) / self.scale[retained] ** 2
        elif retained.size:
            block = self.matrix[np.ix_(retained, retained)]
            factor = cholesky(block)
            if factor is None:
                raise self._dependent(retained, block)
            diagonal[retained] = np.diagonal(dpotri(factor[0], lower=1)[0]) / self.scale[retained] ** 2
        return diagonal

    def _worth_inverting(self, retained: Indices, dropped: Indices) -> Floats | None:
        """The inverse of the matrix where fewer columns are dropped than kept; None where not, where columns are
        dependent, and of a restricted matrix, which no other target shares.
        """
        worth = dropped.size < retained.size and self.factor is not None
        return self._inverse if worth else None

    @cached_property
    def _inverse(self) -> Floats | None:
        """(p, p) inverse of the matrix, None where columns are dependent."""
        if self.factor is None:
            return None
        inverse: Floats = dpotri(self.factor[0], lower=1)[0]
        mirror(inverse)
        return inverse

    def _eliminated(self, retained: Indices, dropped: Indices, target: int, inverse: Floats) -> Floats:
        """The change (p,) of the anchor that takes the coefficients in `dropped` to zero, by elimination from the inverse: its
        cost is that of the columns dropped. The inverse has lost digits, so the solution is refined until the gradient
        vanishes; each refinement squares the relative error.
        """
        anchor, slope = self.anchor[:, target], self.sums.slope[:, target]
        cross = inverse[:, dropped]
        corner = ridged(cross[dropped])
        change = cross @ cho_solve(corner, -anchor[dropped], check_finite=False)
        for _ in range(_REFINEMENTS):
            change[dropped] = -anchor[dropped]
            left = slope - dsymv(1.0, self.matrix, change, lower=1)
            left[dropped] = 0.0
            share = float(np.max(np.abs(left[retained]))) / max(
                float(self.norms[target]), np.finfo(float).tiny
            )
            if share <= _STATIONARY:
                break
            step = dsymv(1.0, inverse, left, lower=1)
            change += step - cross @ cho_solve(corner, step[dropped], check_finite=False)
            if share**2 <= _STATIONARY:
                break
        change[dropped] = -anchor[dropped]
        return np.asarray(change)

    def _change(self, retained: Indices, dropped: Indices, target: int) -> Floats:
        """The change (p,) of the anchor that takes the coefficients in `dropped` to zero, by the cheaper algorithm."""
        if not dropped.size:
            return np.zeros(len(self.names))
        inverse = self._worth_inverting(retained, dropped)
        if inverse is None:
            return self._corrected(retained, target)
        return self._eliminated(retained, dropped, target, inverse)

    def _corrected(self, retained: Indices, target: int) -> Floats:
        """The change (p,) of the anchor that takes all coefficients but those in `retained` to zero."""
        change = -self.anchor[:, target]
        change[retained] = 0.0
        if retained.size:
            product = dsymv(1.0, self.matrix, change, lower=1)
            factor = ridged(self.matrix[np.ix_(retained, retained)].T)
            change[retained] = cho_solve(
                factor, (self.sums.slope[:, target] - product)[retained], check_finite=False
            )
        return change

    def _directly(self, retained: Indices, target: int) -> tuple[Floats, float]:
        """`project` without the anchor: cheaper for few columns, and as accurate where the residual is not tiny."""
        moments = self.moments[retained, target]
        solved = cho_solve(ridged(self.matrix[np.ix_(retained, retained)].T), moments, check_finite=False)
        scaled = np.zeros(len(self.names))
        scaled[retained] = solved
        return scaled, float(self.norms[target] ** 2 - solved @ moments)

    def _dependent(self, retained: Indices, block: Floats) -> IdentificationError:
        if retained.size > self.rows:
            return IdentificationError(
                f"{retained.size} terms cannot be determined from {self.rows} equations; use a longer record, a smaller "
                "library (a lower order, mixing=2, the states of a mass and its neighbours), or let a threshold drop terms"
            )
        shown = retained[np.flatnonzero(np.abs(vanishing(block)) > 0.1)]
        named = ", ".join(self.names[column] for column in shown[:8])
        return IdentificationError(
            f"the columns {named} are collinear in these data, so only a combination of them is determined; leave one out, "
            "declare its coefficient known, or use a record in which they vary independently"
        )
