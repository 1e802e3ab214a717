"""The Gram matrix of a linear system, formed once for all targets, thresholds and supports.

Columns are scaled to unit norm, so "small" means the same in every unit. The normal equations square the condition
number, and with it lose half of the digits; they come back by one more pass over the rows: it computes the residual of
an anchor solution to all digits, and every later fit is a correction of that anchor. Its error is then relative to the
correction, not to the target. The same holds for the residual over rows that were held out.

Every fifth of a hundred runs of neighbouring rows is held out. Neighbouring samples are strongly correlated: predicting a
whole run is a test, predicting a row between two fitted ones is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular
from scipy.linalg.blas import dsymm, dsymv, dtrsm
from scipy.linalg.lapack import dpotri

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.sindy.regression.linear_system import LinearSystem, mirror, product

CholeskyFactor = tuple[Floats, bool]  # the factor and True for lower, as `cho_solve` takes it

_DEPENDENT = 3e-8  # pivot below which a column is dependent on the others, up to rounding
_RIDGE = 1e-14  # added to the unit diagonal of dependent columns


def cholesky(block: Floats) -> CholeskyFactor | None:
    """Factor of a Gram matrix (p, p) of unit columns; None where the columns are dependent."""
    try:
        factor: CholeskyFactor = cho_factor(block, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return factor if np.min(np.diagonal(factor[0])) > _DEPENDENT else None


def _ridged(block: Floats) -> CholeskyFactor:
    """Factor of a Gram matrix (p, p), with the smallest ridge that makes it definite where columns are dependent."""
    factor, ridge = cholesky(block), _RIDGE
    while factor is None:
        factor, ridge = cholesky(block + ridge * np.eye(len(block))), 100 * ridge
    return factor


def _vanishing(block: Floats) -> Floats:
    """The combination (p,) of dependent columns that vanishes, its largest entry 1, by inverse iteration on (p, p)."""
    combination = np.random.default_rng(0).normal(size=len(block))
    for _ in range(3):
        combination = cho_solve(_ridged(block), combination / np.abs(combination).max())
    return np.asarray(combination / np.abs(combination).max())


@dataclass(frozen=True, eq=False)
class AnchoredSums:
    """Sums over R rows about an approximate solution, the anchor, for scaled columns.

    Attributes
    ----------
    rows : int
        Number of rows R.
    matrix : array of shape (p, p)
        A'A.
    slope : array of shape (p, T)
        A'(b - A anchor).
    squares : array of shape (T,)
        ||b - A anchor||^2.
    norms : array of shape (T,)
        ||b||.
    """

    rows: int
    matrix: Floats
    slope: Floats
    squares: Floats
    norms: Floats

    def shifted(self, change: Floats) -> AnchoredSums:
        """The same sums about an anchor that has changed by `change` (p, T)."""
        moved = dsymm(1.0, self.matrix, change, lower=1)
        squares = np.maximum(self.squares + np.sum(change * (moved - 2 * self.slope), axis=0), 0.0)
        return replace(self, slope=self.slope - moved, squares=squares)

    def squares_at(self, change: Floats, target: int) -> float:
        """||b - A (anchor + change)||^2 of one target, for a change (p,)."""
        moved = dsymv(1.0, self.matrix, change, lower=1)
        return max(float(self.squares[target] + change @ (moved - 2 * self.slope[:, target])), 0.0)

    def restricted(self, retained: Indices, change: Floats, target: int) -> AnchoredSums:
        """Sums of k columns and one target, about an anchor that `change` (p,) takes to zero in the other columns."""
        moved = dsymv(1.0, self.matrix, change, lower=1)
        return AnchoredSums(
            self.rows,
            self.matrix[np.ix_(retained, retained)].T,  # symmetric, and so in Fortran order
            (self.slope[:, target] - moved)[retained, None],
            np.array([self.squares_at(change, target)]),
            self.norms[target : target + 1],
        )


_RUNS = 100
_ONE_IN = 5
_FEWEST = 25  # rows below which none are held out: validation needs five


def held_out_rows(rows: int) -> Bools:
    """True (R,) in the middle one of every five runs of rows; nowhere for fewer than 25 rows."""
    if rows < _FEWEST:
        return np.zeros(rows, dtype=bool)
    run = np.arange(rows) * min(_RUNS, rows - rows % _ONE_IN) // rows
    return np.asarray(run % _ONE_IN == _ONE_IN // 2)


def _products(system: LinearSystem, numbers: Indices | None = None) -> tuple[Floats, Floats, Floats]:
    """A'A (p, p), A'b (p, T) and ||b||^2 (T,) over the rows of these numbers, or over all."""
    sums = system.gram_sums()
    moments, squares = np.zeros((len(system.names), len(system.targets))), np.zeros(len(system.targets))
    for rows, target in system.blocks(numbers):
        sums.add(rows)
        moments += product(rows, target, transposed=True)
        squares += np.sum(target**2, axis=0)
    return sums.matrix(), moments, squares


def _residual(
    system: LinearSystem, coefficients: Floats, numbers: Indices | None = None
) -> tuple[Floats, Floats]:
    """A'(b - A c) (p, T) and ||b - A c||^2 (T,) of coefficients (p, T), from the rows of these numbers, or from all."""
    slope, squares = np.zeros_like(coefficients), np.zeros(len(system.targets))
    for rows, target in system.blocks(numbers):
        residual = target - product(rows, coefficients)
        slope += product(rows, residual, transposed=True)
        squares += np.sum(residual**2, axis=0)
    return slope, squares


_PASSES = 3  # at most over the rows to refine the anchor; one is enough unless columns are nearly dependent
_ROUNDING = 1e-13  # a residual this far below its target cannot be refined


def _anchored(
    system: LinearSystem, factor: CholeskyFactor, moments: Floats, inverse: Floats, norms: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """A least squares solution by iterative refinement, from A'b (p, T), 1 / ||A_j|| (p,) and ||b|| (T,).

    Returns the anchor (p, T), a last correction that is not applied, and the products of the anchor's residuals as
    `_residual` gives them, in scaled columns.
    """
    anchor = np.asarray(cho_solve(factor, moments))
    for last in (*[False] * (_PASSES - 1), True):
        slope, squares = _residual(system, anchor * inverse[:, None])
        slope *= inverse[:, None]
        change = np.asarray(cho_solve(factor, slope))
        gain = np.sum(change * slope, axis=0)
        if last or np.all((gain < squares / 2) | (squares <= (_ROUNDING * norms) ** 2)):
            break
        anchor = anchor + change
    return anchor, change, slope, squares


@dataclass(frozen=True, eq=False)
class Gram:
    """Gram matrix of a system in columns of unit norm, and the anchor that restores its digits.

    Scaled coefficients are z_j = c_j ||A_j||, the norm taken over all rows of the system.

    Attributes
    ----------
    system : LinearSystem
        The equations.
    names : tuple of str
        Names of the p columns.
    sums : AnchoredSums
        Sums of the rows that are fitted, about the anchor.
    moments : array of shape (p, T)
        A'b.
    scale : array of shape (p,)
        ||A_j||.
    alive : array of bool, shape (p,)
        False for columns that are zero throughout; these have a one on the diagonal, so that the matrix is not singular.
    anchor : array of shape (p, T)
        Least squares solution of the rows that are fitted.
    factor : CholeskyFactor or None
        Cholesky factor of the matrix; None where columns are dependent or it is not needed.
    held_out : AnchoredSums or None
        Sums of the rows held out, about the same anchor, in `training`; None where they are among those fitted.
    """

    system: LinearSystem
    names: tuple[str, ...]
    sums: AnchoredSums
    moments: Floats
    scale: Floats
    alive: Bools
    anchor: Floats
    factor: CholeskyFactor | None
    held_out: AnchoredSums | None = None

    @classmethod
    def of(cls, system: LinearSystem) -> Gram:
        """Form the Gram matrix of a system in two passes over its rows, and up to two more where columns are nearly dependent.

        Parameters
        ----------
        system : LinearSystem
            The equations.

        Returns
        -------
        Gram
            Its Gram matrix.

        Raises
        ------
        IdentificationError
            If the system has no rows or no columns, or every column is zero.
        """
        if not system.rows or not system.names:
            message = f"a fit needs equations and unknowns, got {system.rows} equations in {len(system.names)} unknowns"
            raise IdentificationError(message)
        whole, moments, squares = _products(system)
        scale = np.sqrt(np.diagonal(whole))
        alive = scale > 0
        if not alive.any():
            message = "every column of the equations is zero throughout: the record shows no motion to fit"
            raise IdentificationError(message)
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=alive)
        whole *= inverse[:, None]
        whole *= inverse
        whole[~alive, ~alive] = 1.0
        moments, norms = inverse[:, None] * moments, np.sqrt(squares)
        factor = cholesky(whole)
        anchor, change, slope, left = _anchored(system, factor or _ridged(whole), moments, inverse, norms)
        sums = AnchoredSums(system.rows, whole, slope, left, norms).shifted(change)
        return cls(system, system.names, sums, moments, scale, alive, anchor + change, factor)

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
        """The same without the rows held out, in the same scaled coefficients (whose columns then have a norm near 0.9).

        Raises
        ------
        IdentificationError
            If there are too few rows to hold any out.
        """
        numbers = np.flatnonzero(held_out_rows(self.rows))
        if not numbers.size:
            message = f"{self.rows} equations are too few to choose a threshold or a penalty on rows held out; give one"
            raise IdentificationError(message)
        inverse = self.unscaled(np.ones((len(self.names), 1)))
        matrix, _, squares = _products(self.system, numbers)
        matrix *= inverse
        matrix *= inverse[:, 0]
        slope, left = _residual(self.system, self.anchor * inverse, numbers)
        held_out = AnchoredSums(len(numbers), matrix, inverse * slope, left, np.sqrt(squares))
        matrix = np.asfortranarray(self.matrix - matrix)
        rows = AnchoredSums(
            self.rows - len(numbers),
            matrix,
            self.sums.slope - held_out.slope,
            np.maximum(self.sums.squares - held_out.squares, 0.0),
            np.sqrt(np.maximum(self.norms**2 - held_out.norms**2, 0.0)),
        )
        change = np.asarray(cho_solve(_ridged(matrix), rows.slope))
        return replace(
            self,
            sums=rows.shifted(change),
            moments=rows.slope + dsymm(1.0, matrix, self.anchor, lower=1),
            anchor=self.anchor + change,
            factor=None,
            held_out=held_out.shifted(change),
        )

    def solution(self, target: int) -> Solution:
        """Least squares of one target on all columns that are not zero throughout."""
        nothing, columns = np.zeros(0, dtype=np.intp), len(self.names)
        # not of dependent columns, nor of a restricted matrix, which no other target shares, nor of rows of training, of
        # which a path drops more and more columns
        eliminated = _Eliminated(nothing, np.empty((0, columns)), np.empty((0, 0))) if self.factor else None
        return Solution(self, target, self.alive, np.zeros(columns), eliminated)

    def unscaled(self, scaled: Floats) -> Floats:
        """Scaled coefficients (p, T) in their own units; zero for columns that are zero throughout."""
        return scaled * np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.alive)[:, None]

    @cached_property
    def inverse(self) -> Floats:
        """(p, p) inverse of the matrix, from its factor, which must exist."""
        assert self.factor is not None
        inverse: Floats = dpotri(self.factor[0], lower=1)[0]
        mirror(inverse)
        return inverse


class _Eliminated(NamedTuple):
    """The d `columns` that are dropped, their `rows` (d, p) of the inverse, and the Cholesky factor (d, d) of these."""

    columns: Indices
    rows: Floats
    factor: Floats

    def with_(self, dropped: Indices, inverse: Floats) -> _Eliminated:
        """With more columns dropped."""
        rows = inverse.T[dropped]  # symmetric, and whole rows are read
        below = solve_triangular(self.factor, self.rows[:, dropped], lower=True, check_finite=False)
        corner, _ = _ridged(rows[:, dropped] - below.T @ below)
        count = len(self.columns)
        factor = np.zeros((count + len(dropped),) * 2, order="F")
        factor[:count, :count], factor[count:, :count], factor[count:, count:] = self.factor, below.T, corner
        return _Eliminated(np.append(self.columns, dropped), np.concatenate([self.rows, rows]), factor)

    def taken(self, values: Floats) -> Floats:
        """What elimination takes from a product (p,) with the inverse, so that it is zero in the dropped columns."""
        solved = cho_solve((self.factor, True), values[self.columns], check_finite=False)
        return np.asarray(solved @ self.rows)


_STATIONARY = 1e-13  # slope, as a share of the target, at which a solution needs no refinement
_REFINEMENTS = 3


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares of one target on a support, as a correction of the anchor: it keeps its digits however small the residual.

    Attributes
    ----------
    gram : Gram
        The matrix.
    target : int
        Index of the target.
    support : array of bool, shape (p,)
        The columns, without those that are zero throughout; dependent ones get a ridge of 1e-14.
    change : array of shape (p,)
        Difference of the scaled coefficients from the anchor.
    _eliminated : _Eliminated or None
        The other columns, where these are fewer and were eliminated from the inverse.
    """

    gram: Gram
    target: int
    support: Bools
    change: Floats
    _eliminated: _Eliminated | None

    @cached_property
    def scaled(self) -> Floats:
        """(p,) scaled coefficients, zero outside the support."""
        return np.where(self.support, self.gram.anchor[:, self.target] + self.change, 0.0)

    @cached_property
    def squares(self) -> float:
        """Sum of squared residuals."""
        return self.gram.sums.squares_at(self.change, self.target)

    def on(self, support: Bools) -> Solution:
        """Least squares on those columns of the support that are in `support` (p,), too."""
        gram, support = self.gram, support & self.support
        dropped, retained = np.flatnonzero(self.support & ~support), np.flatnonzero(support)
        if not dropped.size:
            return self
        if self._eliminated and np.count_nonzero(gram.alive) < 2 * retained.size:
            return self._without(support, self._eliminated.with_(dropped, gram.inverse))
        change = np.where(support, 0.0, -gram.anchor[:, self.target])
        if retained.size:
            slope = gram.sums.slope[:, self.target] - dsymv(1.0, gram.matrix, change, lower=1)
            factor = _ridged(gram.matrix[np.ix_(retained, retained)].T)
            change[retained] = cho_solve(factor, slope[retained], check_finite=False)
        return Solution(gram, self.target, support, change, None)

    def _without(self, support: Bools, eliminated: _Eliminated) -> Solution:
        """The solution without the eliminated columns, at the cost of their number. The inverse has lost digits, so it is
        refined until the gradient vanishes; each refinement squares the relative error.
        """
        gram, target = self.gram, self.target
        away, norm = -gram.anchor[:, target], max(float(gram.norms[target]), np.finfo(float).tiny)
        change = eliminated.taken(away)
        for _ in range(_REFINEMENTS):
            change[eliminated.columns] = away[eliminated.columns]
            left = gram.sums.slope[:, target] - dsymv(1.0, gram.matrix, change, lower=1)
            left[eliminated.columns] = 0.0
            share = float(np.max(np.abs(left[support]))) / norm
            if share <= _STATIONARY:
                break
            step = dsymv(1.0, gram.inverse, left, lower=1)
            change += step - eliminated.taken(step)
            if share**2 <= _STATIONARY:
                break
        change[eliminated.columns] = away[eliminated.columns]
        return Solution(gram, target, support, change, eliminated)

    def variances(self) -> Floats:
        """Diagonal (p,) of (A'A)^-1 on the support, in the coefficients' own units squared, zero outside the support.

        Raises IdentificationError, which names them, if columns of the support are dependent.
        """
        gram, retained = self.gram, np.flatnonzero(self.support)
        diagonal = np.zeros(len(gram.names))
        if self._eliminated:
            taken = dtrsm(1.0, self._eliminated.factor, self._eliminated.rows.T, side=1, lower=1, trans_a=1)
            inverse = np.diagonal(gram.inverse) - np.einsum("ij,ij->i", taken, taken)
            least = 1.0 / np.diagonal(gram.matrix)  # of a column that is orthogonal to all others
            diagonal[retained] = np.maximum(inverse, least)[retained]
        elif retained.size:
            block = gram.matrix[np.ix_(retained, retained)]
            factor = cholesky(block)
            if factor is None:
                raise self._dependent(retained, block)
            diagonal[retained] = np.diagonal(dpotri(factor[0], lower=1)[0])
        return gram.unscaled(gram.unscaled(diagonal[:, None]))[:, 0]

    def restricted(self) -> Gram:
        """The Gram matrix of the support and this target alone: solving within it then costs no more than its size."""
        gram, retained = self.gram, np.flatnonzero(self.support)
        return Gram(
            gram.system,
            tuple(gram.names[column] for column in retained),
            gram.sums.restricted(retained, self.change, self.target),
            gram.moments[retained, self.target : self.target + 1],
            gram.scale[retained],
            np.ones(len(retained), dtype=bool),
            self.scaled[retained, None],
            None,
            None if gram.held_out is None else gram.held_out.restricted(retained, self.change, self.target),
        )

    def _dependent(self, retained: Indices, block: Floats) -> IdentificationError:
        if retained.size > self.gram.rows:
            return IdentificationError(
                f"{retained.size} terms cannot be determined from {self.gram.rows} equations; use a longer record, a smaller "
                "library (a lower order, the states of a mass and its neighbours), or let a threshold drop terms"
            )
        shown = retained[np.flatnonzero(np.abs(_vanishing(block)) > 0.1)]
        named = ", ".join(self.gram.names[column] for column in shown[:8])
        return IdentificationError(
            f"the columns {named} are collinear in these data, so only a combination of them is determined; leave one out, "
            "declare its coefficient known, or use a record in which they vary independently"
        )
