"""The Gram matrix of a linear system, formed once for all targets, thresholds and supports.

Columns are scaled to unit norm, so "small" means the same in every unit. The normal equations square the condition
number, and with it lose half of the digits; they come back by one more pass over the rows: it computes the residual of
an anchor solution to all digits, and every later fit is a correction of that anchor. Its error is then relative to the
correction, not to the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.blas import dgemm, dsymm, dsyrk

from linkwise.equations import LinearSystem
from linkwise.errors import IdentificationError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PASSES = 3  # over the rows at most to refine the anchor; one does unless columns are all but dependent
_ROUNDING = 1e-13  # a residual this far below its target cannot be refined
_SMALL = 8  # a support below this part of all columns is first tried without the anchor
_CANCELLING = 3e-5  # residual, as a share of its target, below which ||b||^2 - c'A'b has lost too many digits
_DEPENDENT = 3e-8  # a column whose part outside the span of the others is smaller is one of them, rounded
_RIDGE = 1e-14  # added to the unit diagonal of dependent columns


@dataclass(frozen=True, eq=False)
class Gram:
    """Unit-norm Gram matrix of a system with R rows, p columns and T targets, and the anchor that restores its digits.

    In scaled coefficients z_j = c_j ||A_j||: `matrix` (p, p) is A'A, `moments` (p, T) is A'b, `scale` (p,) holds
    ||A_j||, `norms` (T,) holds ||b||, `alive` (p,) is False for columns that are zero throughout. `anchor` (p, T) is an
    approximate solution, `slope` (p, T) is A'(b - A anchor) and `squares` (T,) is ||b - A anchor||^2, both from the
    rows themselves.
    """

    names: tuple[str, ...]
    rows: int
    matrix: Array
    moments: Array
    scale: Array
    norms: Array
    alive: Mask
    anchor: Array
    slope: Array
    squares: Array

    @classmethod
    def of(cls, system: LinearSystem) -> Gram:
        """Two passes over the rows of `system`: one symmetric rank-k update per block, then the anchor's residual (twice more
        where columns are all but dependent).

        Raises IdentificationError where the system has no rows, no columns, or nothing but zeros in them.
        """
        if not system.rows or not system.names:
            raise IdentificationError(
                f"{system.rows} equations in {len(system.names)} unknowns leave nothing to solve"
            )
        raw, raw_moments, norms = _accumulate(system)
        scale = np.sqrt(np.diagonal(raw))
        alive = scale > 0
        if not alive.any():
            raise IdentificationError(
                "every column of the equations is zero throughout: the record shows no motion to fit"
            )
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=alive)
        raw *= inverse[:, None]
        raw *= inverse
        moments = raw_moments * inverse[:, None]
        factor = _factor(raw if alive.all() else raw[np.ix_(alive, alive)])
        anchor, change = np.zeros_like(moments), np.zeros_like(moments)
        anchor[alive] = cho_solve(factor, moments[alive])
        for _ in range(_PASSES):
            squares, slope = _residual(system, anchor * inverse[:, None])
            slope *= inverse[:, None]
            change[alive] = cho_solve(factor, slope[alive])
            gain = np.sum(change * slope, axis=0)
            if np.all((gain < squares / 2) | (squares <= (_ROUNDING * norms) ** 2)):
                break
            anchor += change
            change = np.zeros_like(moments)
        pull = dsymm(1.0, raw, change, lower=1)
        squares = np.maximum(squares + np.sum(change * (pull - 2 * slope), axis=0), 0.0)
        return cls(
            system.names,
            system.rows,
            raw,
            moments,
            scale,
            norms,
            alive,
            anchor + change,
            slope - pull,
            squares,
        )

    def project(self, support: Mask, target: int) -> tuple[Array, float]:
        """Least squares over the columns in `support` (p,) for one target: scaled coefficients (p,), zero elsewhere,
        and the sum of squared residuals.

        The answer is a correction of the anchor, so both keep their digits however small the residual is. A support
        whose columns are dependent to rounding gets the solution of least change from the anchor, with a ridge of
        1e-14.
        """
        kept = np.flatnonzero(support & self.alive)
        anchor, slope = self.anchor[:, target], self.slope[:, target]
        if kept.size == np.count_nonzero(self.alive):
            return anchor, float(self.squares[target])
        factor = _factor(self.matrix[np.ix_(kept, kept)]) if kept.size else None
        if factor and kept.size < len(self.names) / _SMALL:
            scaled, squares = self._directly(kept, factor, target)
            if squares > (_CANCELLING * self.norms[target]) ** 2:
                return scaled, squares
        change = np.where(support, 0.0, -anchor)
        pull = dsymm(1.0, self.matrix, change[:, None], lower=1)[:, 0]
        if factor:
            change[kept] = cho_solve(factor, slope[kept] - pull[kept], check_finite=False)
            pull += self.matrix[:, kept] @ change[kept]
        squares = self.squares[target] + float(change @ (pull - 2 * slope))
        return np.where(support, anchor + change, 0.0), max(squares, 0.0)

    def _directly(
        self, kept: NDArray[np.intp], factor: tuple[Array, bool], target: int
    ) -> tuple[Array, float]:
        """`project` without the anchor: cheaper for few columns, and as good where the residual is not tiny."""
        moments = self.moments[kept, target]
        solved = cho_solve(factor, moments, check_finite=False)
        scaled = np.zeros(len(self.names))
        scaled[kept] = solved
        return scaled, float(self.norms[target] ** 2 - solved @ moments)

    def unscaled(self, scaled: Array) -> Array:
        """Coefficients c in their own units from scaled ones (p,) or (p, T); zero for columns that are zero throughout."""
        inverse = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.alive)
        return scaled * (inverse if scaled.ndim == 1 else inverse[:, None])

    def variances(self, support: Mask) -> Array:
        """Diagonal (p,) of (A'A)^-1 over `support` in the coefficients' own units, zero elsewhere.

        Raises IdentificationError, naming columns, where columns of the support are dependent.
        """
        answer = np.zeros(len(self.names))
        kept = np.flatnonzero(support & self.alive)
        if kept.size:
            block = self.matrix[np.ix_(kept, kept)]
            factor = cholesky(block)
            if factor is None:
                raise self._dependent(kept, block)
            answer[kept] = np.diagonal(cho_solve(factor, np.eye(kept.size))) / self.scale[kept] ** 2
        return answer

    def _dependent(self, kept: NDArray[np.intp], block: Array) -> IdentificationError:
        weakest = np.random.default_rng(0).normal(size=kept.size)
        for _ in range(3):  # inverse iteration: what survives is the combination that vanishes
            weakest = cho_solve(_factor(block), weakest / np.abs(weakest).max())
        shown = kept[np.flatnonzero(np.abs(weakest) > 0.1 * np.abs(weakest).max())]
        named = ", ".join(self.names[column] for column in shown[:8])
        return IdentificationError(
            f"the columns {named} move together in these data: only their sum can be told apart; leave one out, "
            "declare its coefficient known, or use a record that moves them separately"
        )


def _accumulate(system: LinearSystem) -> tuple[Array, Array, Array]:
    """A'A (p, p), A'b (p, T) and ||b|| (T,) over all blocks of rows."""
    columns, targets = len(system.names), len(system.targets)
    total = np.zeros((columns, columns), order="F")
    moments = np.zeros((columns, targets))
    squares = np.zeros(targets)
    for rows, target in system.blocks():
        # syrk reads Fortran order; a block in C order is the transpose of one.
        if rows.flags.c_contiguous:
            total = dsyrk(1.0, rows.T, beta=1.0, c=total, lower=1, overwrite_c=1)
        else:
            total = dsyrk(1.0, rows, beta=1.0, c=total, trans=1, lower=1, overwrite_c=1)
        moments += _times(rows, target, transposed=True)
        squares += np.sum(target**2, axis=0)
    for column in range(columns - 1):
        total[column, column + 1 :] = total[column + 1 :, column]
    return total, moments, np.sqrt(squares)


def _residual(system: LinearSystem, coefficients: Array) -> tuple[Array, Array]:
    """||b - A c||^2 (T,) and A'(b - A c) (p, T), from the rows themselves."""
    squares, slope = np.zeros(coefficients.shape[1]), np.zeros_like(coefficients)
    for rows, target in system.blocks():
        residual = target - _times(rows, coefficients)
        slope += _times(rows, residual, transposed=True)
        squares += np.sum(residual**2, axis=0)
    return squares, slope


def _times(rows: Array, right: Array, *, transposed: bool = False) -> Array:
    """rows @ right, or rows.T @ right, by SciPy's BLAS.

    NumPy brings a BLAS of its own; where each keeps threads, calling both in turn lets them spin in each other's way.
    """
    if rows.flags.c_contiguous:
        return np.asarray(dgemm(1.0, rows.T, right, trans_a=not transposed))
    return np.asarray(dgemm(1.0, rows, right, trans_a=transposed))


def cholesky(block: Array) -> tuple[Array, bool] | None:
    """Cholesky factor of a Gram matrix of unit columns as `cho_solve` wants it; None where its columns are dependent."""
    try:
        factor: tuple[Array, bool] = cho_factor(block, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return factor if np.min(np.diagonal(factor[0])) > _DEPENDENT else None


def _factor(block: Array) -> tuple[Array, bool]:
    """Cholesky factor of a Gram matrix, with the smallest ridge that keeps dependent columns apart."""
    factor, ridge = cholesky(block), _RIDGE
    while factor is None:
        factor, ridge = cholesky(block + ridge * np.eye(len(block))), 100 * ridge
    return factor
