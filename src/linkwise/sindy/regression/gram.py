"""The Gram matrix of a linear system, formed once for all targets, thresholds and supports.

Columns are scaled to unit norm, so "small" means the same in every unit. The normal equations square the condition
number, and with it lose half of the digits; they come back by one more pass over the rows: it computes the residual of
an anchor solution to all digits, and every later fit is a correction of that anchor. Its error is then relative to the
correction, not to the target. The same holds for the residual over rows that were held out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.blas import dsymm, dsymv, dtrsm
from scipy.linalg.lapack import dpotri

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.sindy.regression.cholesky import CholeskyFactor, cholesky, ridged, vanishing
from linkwise.sindy.regression.linear_system import LinearSystem
from linkwise.sindy.regression.sums import ResidualProducts, held_out, mirror, products, residual_products

_PASSES = 3  # over the rows at most to refine the anchor; one does unless columns are all but dependent
_ROUNDING = 1e-13  # a residual this far below its target cannot be refined
_SMALL = 8  # a support below this part of all columns is first tried without the anchor
_CANCELLING = 3e-5  # residual, as a share of its target, below which ||b||^2 - c'A'b has lost too many digits
_STATIONARY = 1e-13  # slope, as a share of the target, at which a solution needs no refinement
_REFINEMENTS = 3


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over R rows about an anchor: `matrix` (p, p) is A'A, `slope` (p, T) is A'(b - A anchor), `squares` (T,) is
    ||b - A anchor||^2, `norms` (T,) is ||b||, all for scaled columns.
    """

    rows: int
    matrix: Floats
    slope: Floats
    squares: Floats
    norms: Floats

    def moved(self, change: Floats) -> Sums:
        """The same sums about an anchor that is `change` (p, T) further."""
        pull = dsymm(1.0, self.matrix, change, lower=1)
        squares = np.maximum(self.squares + np.sum(change * (pull - 2 * self.slope), axis=0), 0.0)
        return Sums(self.rows, self.matrix, self.slope - pull, squares, self.norms)

    def squares_at(self, change: Floats, target: int) -> float:
        """||b - A (anchor + change)||^2 of one target, `change` (p,)."""
        pull = dsymv(1.0, self.matrix, change, lower=1)
        return max(float(self.squares[target] + change @ (pull - 2 * self.slope[:, target])), 0.0)

    def confined(self, kept: Indices, change: Floats, target: int) -> Sums:
        """The sums of some columns and one target about an anchor that is `change` (p,) further and zero in the rest."""
        pull = dsymv(1.0, self.matrix, change, lower=1)
        slope = self.slope[:, target]
        squares = max(float(self.squares[target] + change @ (pull - 2 * slope)), 0.0)
        return Sums(
            self.rows,
            self.matrix[np.ix_(kept, kept)].T,  # symmetric: the transpose is the same in Fortran order
            (slope - pull)[kept, None],
            np.array([squares]),
            self.norms[target : target + 1],
        )


@dataclass(frozen=True, eq=False)
class Gram:
    """Unit-norm Gram matrix of a system with p columns and T targets, and the anchor that restores its digits.

    In scaled coefficients z_j = c_j ||A_j||, the norm taken over all rows of the system: `sums` are those of the rows that are
    fitted, about `anchor` (p, T), their least squares solution; `moments` (p, T) is A'b; `scale` (p,) holds ||A_j||;
    `alive` (p,) is False for columns that are zero throughout, which have a one on the diagonal so that nothing is singular.
    `held` are the sums of the rows that are held out, about the same anchor: among the fitted ones in what `of` gives, beside
    them in `training`, None where there are too few rows. `factor` is the Cholesky factor of the matrix, None where
    columns are dependent or nobody will need it.
    """

    names: tuple[str, ...]
    sums: Sums
    moments: Floats
    scale: Floats
    alive: Bools
    anchor: Floats
    held: Sums | None
    factor: CholeskyFactor | None = None

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
        parts = products(system)
        scale = np.sqrt(sum(np.diagonal(one.matrix) for one in parts))
        alive = scale > 0
        if not alive.any():
            raise IdentificationError(
                "every column of the equations is zero throughout: the record shows no motion to fit"
            )
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=alive)
        for one in parts:
            one.matrix[...] *= inverse[:, None]
            one.matrix[...] *= inverse
        whole = parts[0].matrix
        for one in parts[1:]:
            whole += one.matrix
        whole[~alive, ~alive] = 1.0
        moments = inverse[:, None] * np.sum([one.moments for one in parts], axis=0)
        norms = np.sqrt(np.sum([one.squares for one in parts], axis=0))
        factor = cholesky(whole)
        anchor, change, left = _anchored(system, factor or ridged(whole), moments, inverse, norms)
        rows = Sums(
            system.rows,
            whole,
            np.sum([one.slope for one in left], axis=0),
            np.sum([one.squares for one in left], axis=0),
            norms,
        )
        held = None
        if len(parts) > 1:
            count = int(np.count_nonzero(held_out(system.rows)))
            held = Sums(count, parts[1].matrix, left[1].slope, left[1].squares, np.sqrt(parts[1].squares))
            held = held.moved(change)
        return cls(system.names, rows.moved(change), moments, scale, alive, anchor + change, held, factor)

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

        Raises IdentificationError where the system has too few rows to hold any out.
        """
        if self.held is None:
            raise IdentificationError(
                f"{self.rows} equations are too few to hold some out and choose a threshold or a penalty by them; give one"
            )
        matrix = np.asfortranarray(self.matrix - self.held.matrix)
        rows = Sums(
            self.rows - self.held.rows,
            matrix,
            self.sums.slope - self.held.slope,
            np.maximum(self.sums.squares - self.held.squares, 0.0),
            np.sqrt(np.maximum(self.norms**2 - self.held.norms**2, 0.0)),
        )
        factor = cholesky(matrix)
        change = np.asarray(cho_solve(factor or ridged(matrix), rows.slope))
        moments = rows.slope + dsymm(1.0, matrix, self.anchor, lower=1)
        return Gram(
            self.names,
            rows.moved(change),
            moments,
            self.scale,
            self.alive,
            self.anchor + change,
            self.held.moved(change),
            factor,
        )

    def restricted(self, support: Bools, target: int) -> Gram:
        """Only the columns in `support` (p,) and one target, about the least squares solution there: what is solved within a
        small support then costs no more than its size.
        """
        kept = np.flatnonzero(support & self.alive)
        change = self._corrected(kept, target)
        scaled = self.anchor[:, target] + change
        return Gram(
            tuple(self.names[column] for column in kept),
            self.sums.confined(kept, change, target),
            self.moments[kept, target : target + 1],
            self.scale[kept],
            np.ones(len(kept), dtype=bool),
            scaled[kept, None],
            None if self.held is None else self.held.confined(kept, change, target),
        )

    def project(self, support: Bools, target: int) -> tuple[Floats, float]:
        """Least squares over the columns in `support` (p,) for one target: scaled coefficients (p,), zero elsewhere,
        and the sum of squared residuals.

        The answer is a correction of the anchor, so both keep their digits however small the residual is. A support
        whose columns are dependent to rounding gets the solution of least change from the anchor, with a ridge of
        1e-14.
        """
        kept = np.flatnonzero(support & self.alive)
        dropped = np.flatnonzero(~support & self.alive)
        anchor = self.anchor[:, target]
        if not dropped.size:
            return np.where(self.alive, anchor, 0.0), float(self.sums.squares[target])
        if 0 < kept.size < len(self.names) / _SMALL:
            scaled, squares = self._directly(kept, target)
            if squares > (_CANCELLING * self.norms[target]) ** 2:
                return scaled, squares
        change = self._change(kept, dropped, target)
        return np.where(support & self.alive, anchor + change, 0.0), self.sums.squares_at(change, target)

    def solve(self, support: Bools, target: int) -> Floats:
        """The scaled coefficients (p,) of `project` alone."""
        kept = np.flatnonzero(support & self.alive)
        change = self._change(kept, np.flatnonzero(~support & self.alive), target)
        return np.where(support & self.alive, self.anchor[:, target] + change, 0.0)

    def unscaled(self, scaled: Floats) -> Floats:
        """Coefficients c in their own units from scaled ones (p,) or (p, T); zero for columns that are zero throughout."""
        inverse = np.divide(1.0, self.scale, out=np.zeros_like(self.scale), where=self.alive)
        return scaled * (inverse if scaled.ndim == 1 else inverse[:, None])

    def variances(self, support: Bools) -> Floats:
        """Diagonal (p,) of (A'A)^-1 over `support` in the coefficients' own units, zero elsewhere.

        Raises IdentificationError, naming columns, where columns of the support are dependent.
        """
        answer = np.zeros(len(self.names))
        kept, dropped = np.flatnonzero(support & self.alive), np.flatnonzero(~support & self.alive)
        if kept.size and (inverse := self._worth_inverting(kept, dropped)) is not None:
            answer[kept] = np.diagonal(inverse)[kept]
            if dropped.size:
                pulls = inverse[:, dropped]
                gone = dtrsm(1.0, ridged(pulls[dropped])[0], pulls, side=1, lower=1, trans_a=1, overwrite_b=1)
                answer[kept] -= np.einsum("ij,ij->i", gone, gone)[kept]
            least = 1.0 / np.diagonal(self.matrix)[kept]  # of a column that is orthogonal to all others
            answer[kept] = np.maximum(answer[kept], least) / self.scale[kept] ** 2
        elif kept.size:
            block = self.matrix[np.ix_(kept, kept)]
            factor = cholesky(block)
            if factor is None:
                raise self._dependent(kept, block)
            answer[kept] = np.diagonal(dpotri(factor[0], lower=1)[0]) / self.scale[kept] ** 2
        return answer

    def _worth_inverting(self, kept: Indices, dropped: Indices) -> Floats | None:
        """The inverse of the matrix where fewer columns are dropped than kept; None where not, where columns are
        dependent, and of a restricted matrix, which no other target shares.
        """
        worth = dropped.size < kept.size and self.factor is not None
        return self._inverse if worth else None

    @cached_property
    def _inverse(self) -> Floats | None:
        """(p, p) inverse of the matrix, None where columns are dependent."""
        if self.factor is None:
            return None
        inverse: Floats = dpotri(self.factor[0], lower=1)[0]
        mirror(inverse)
        return inverse

    def _eliminated(self, kept: Indices, dropped: Indices, target: int, inverse: Floats) -> Floats:
        """The change (p,) of the anchor that takes the coefficients in `dropped` to zero: few columns are taken out of the
        inverse of all at the cost of their own number. The inverse has lost digits, so the slope is looked at and the solution
        refined until it is stationary; each refinement squares the share that is left.
        """
        anchor, slope = self.anchor[:, target], self.sums.slope[:, target]
        pulls = inverse[:, dropped]
        corner = ridged(pulls[dropped])
        change = pulls @ cho_solve(corner, -anchor[dropped], check_finite=False)
        for _ in range(_REFINEMENTS):
            change[dropped] = -anchor[dropped]
            left = slope - dsymv(1.0, self.matrix, change, lower=1)
            left[dropped] = 0.0
            share = float(np.max(np.abs(left[kept]))) / max(float(self.norms[target]), np.finfo(float).tiny)
            if share <= _STATIONARY:
                break
            step = dsymv(1.0, inverse, left, lower=1)
            change += step - pulls @ cho_solve(corner, step[dropped], check_finite=False)
            if share**2 <= _STATIONARY:
                break
        change[dropped] = -anchor[dropped]
        return np.asarray(change)

    def _change(self, kept: Indices, dropped: Indices, target: int) -> Floats:
        """The change (p,) of the anchor that takes the coefficients in `dropped` to zero, by the cheaper way."""
        if not dropped.size:
            return np.zeros(len(self.names))
        inverse = self._worth_inverting(kept, dropped)
        if inverse is None:
            return self._corrected(kept, target)
        return self._eliminated(kept, dropped, target, inverse)

    def _corrected(self, kept: Indices, target: int) -> Floats:
        """The change (p,) of the anchor that takes all coefficients but those in `kept` to zero."""
        change = -self.anchor[:, target]
        change[kept] = 0.0
        if kept.size:
            pull = dsymv(1.0, self.matrix, change, lower=1)
            factor = ridged(self.matrix[np.ix_(kept, kept)].T)
            change[kept] = cho_solve(factor, (self.sums.slope[:, target] - pull)[kept], check_finite=False)
        return change

    def _directly(self, kept: Indices, target: int) -> tuple[Floats, float]:
        """`project` without the anchor: cheaper for few columns, and as good where the residual is not tiny."""
        moments = self.moments[kept, target]
        solved = cho_solve(ridged(self.matrix[np.ix_(kept, kept)].T), moments, check_finite=False)
        scaled = np.zeros(len(self.names))
        scaled[kept] = solved
        return scaled, float(self.norms[target] ** 2 - solved @ moments)

    def _dependent(self, kept: Indices, block: Floats) -> IdentificationError:
        if kept.size > self.rows:
            return IdentificationError(
                f"{kept.size} terms cannot be told apart by {self.rows} equations; take a longer record, a smaller library "
                "(a lower order, mixing=2, the states of a mass and its neighbours), or let a threshold drop terms"
            )
        shown = kept[np.flatnonzero(np.abs(vanishing(block)) > 0.1)]
        named = ", ".join(self.names[column] for column in shown[:8])
        return IdentificationError(
            f"the columns {named} move together in these data: only their sum can be told apart; leave one out, "
            "declare its coefficient known, or use a record that moves them separately"
        )


def _anchored(
    system: LinearSystem, factor: CholeskyFactor, moments: Floats, inverse: Floats, norms: Floats
) -> tuple[Floats, Floats, list[ResidualProducts]]:
    """An approximate solution (p, T), a last correction (p, T) to it, and what it leaves of the rows, in scaled columns."""
    anchor = np.asarray(cho_solve(factor, moments))
    for last in (*[False] * (_PASSES - 1), True):
        left = [
            ResidualProducts(one.squares, inverse[:, None] * one.slope)
            for one in residual_products(system, anchor * inverse[:, None])
        ]
        squares = np.sum([one.squares for one in left], axis=0)
        slope = np.sum([one.slope for one in left], axis=0)
        change = np.asarray(cho_solve(factor, slope))
        gain = np.sum(change * slope, axis=0)
        if last or np.all((gain < squares / 2) | (squares <= (_ROUNDING * norms) ** 2)):
            break
        anchor = anchor + change
    return anchor, change, left
