"""A quadratic model of the cost in all candidate coefficients, and the least cost of any subset of them.

cost(c) = cost(0) - 2 g'c + c'H c over the p coefficients; those outside of a subset are zero. `scatter` is the covariance of
g: H itself for a likelihood, another matrix for equations whose columns are noisy (the weak form). Then

    z = c_j / deviation(c_j),   deviation^2 = diag(H^-1 scatter H^-1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from linkwise.arrays import Floats, Indices

_DEPENDENT = 1e-9  # of a column's square: a column with a smaller residual depends on the others


class Solution(NamedTuple):
    """The values (s,) of the coefficients of a subset, and their z scores (s,)."""

    values: Floats
    z: Floats


class Additions(NamedTuple):
    """Each coefficient outside of a subset, added to it alone.

    `numbers` (r,) of the coefficients, their `values` and `z` scores (r,), and `independent` (r,), the part of each column's
    square that the subset does not explain. Where that part is rounding, z is 0 and the value NaN.
    """

    numbers: Indices
    values: Floats
    z: Floats
    independent: Floats


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """H `h` (p, p) and g `g` (p,) for the coefficients `names` (p,); `scatter` (p, p), None if it equals `h`.

    `by_blocks`, of (p, p) each, are covariances of g from blocks of the records; no variance is less than theirs.
    """

    names: tuple[str, ...]
    h: Floats
    g: Floats
    scatter: Floats | None = None
    by_blocks: tuple[Floats, ...] = ()

    def solve(self, chosen: Sequence[int] | Indices) -> Solution:
        """The best values of the coefficients `chosen`, by number.

        Raises numpy.linalg.LinAlgError if their columns are linearly dependent.
        """
        inside = np.asarray(chosen, dtype=np.intp)
        inverse = inverse_of(self.h[np.ix_(inside, inside)])
        values = inverse @ self.g[inside]
        covariance = (
            inverse if self.scatter is None else inverse @ self.scatter[np.ix_(inside, inside)] @ inverse
        )
        variance = (
            covariance.diagonal()
        )  # negative where the noise of the columns explains more than there is
        for blocks in self.by_blocks:
            variance = np.maximum(variance, (inverse @ blocks[np.ix_(inside, inside)] @ inverse).diagonal())
        return Solution(values, values / np.sqrt(np.where(variance < 0.0, np.nan, variance)))

    def determines(self, chosen: Sequence[int] | Indices) -> bool:
        """Whether `solve` finds one best value of each coefficient: two points of a host may move alike to rounding."""
        inside = np.asarray(chosen, dtype=np.intp)
        try:
            _factor_of(self.h[np.ix_(inside, inside)])
        except np.linalg.LinAlgError:
            return False
        return True

    def cost(self, chosen: Sequence[int] | Indices) -> float:
        """The least cost of the coefficients `chosen`, relative to that of no coefficients."""
        inside = np.asarray(chosen, dtype=np.intp)
        return -float(self.g[inside] @ self.solve(inside).values)

    def additions(self, chosen: Sequence[int] | Indices) -> Additions:
        """Every coefficient that is not `chosen`, added to the chosen ones alone."""
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross = self.h[np.ix_(inside, others)]
        solved = inverse_of(self.h[np.ix_(inside, inside)]) @ np.column_stack([cross, self.g[inside]])
        projection, fitted = solved[:, :-1], solved[:, -1]
        gradient = self.g[others] - cross.T @ fitted
        square = self.h[others, others]
        residual = square - np.einsum("ij,ij->j", cross, projection)
        variance = residual
        if self.scatter is not None:
            variance = _left_of(self.scatter, inside, others, projection)
        for blocks in self.by_blocks:
            variance = np.maximum(variance, _left_of(blocks, inside, others, projection))
        determined = (residual > _DEPENDENT * square) & (variance > 0.0)
        return Additions(
            numbers=others,
            values=np.where(determined, gradient / np.where(determined, residual, 1.0), np.nan),
            z=np.where(determined, gradient / np.sqrt(np.where(determined, variance, 1.0)), 0.0),
            independent=residual / np.where(square > 0.0, square, 1.0),
        )

    def exchanges(self, chosen: Sequence[int] | Indices) -> tuple[Indices, Floats]:
        """The numbers (r,) of all coefficients that are not `chosen`, and the z scores (s, r) that each would have where it
        takes the place of each of the s chosen ones.

        That of one place differs from `additions` by one rank. Without `scatter` and blocks z scores are gains.
        """
        assert self.scatter is None and not self.by_blocks
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross = self.h[np.ix_(inside, others)]
        inverse = inverse_of(self.h[np.ix_(inside, inside)])
        projection, values = inverse @ cross, inverse @ self.g[inside]
        own = inverse.diagonal()[:, None]
        gradient = self.g[others] - cross.T @ values + projection * (values[:, None] / own)
        square = self.h[others, others]
        residual = square - np.einsum("ij,ij->j", cross, projection) + projection**2 / own
        determined = residual > _DEPENDENT * square
        return others, np.where(determined, gradient / np.sqrt(np.where(determined, residual, 1.0)), 0.0)


def _left_of(scatter: Floats, inside: Indices, others: Indices, projection: Floats) -> Floats:
    """The variances (r,) of the slopes of the `others` less the `projection` (s, r) on those `inside`."""
    middle = scatter[np.ix_(inside, inside)] @ projection - 2.0 * scatter[np.ix_(inside, others)]
    return np.asarray(scatter[others, others] + np.einsum("ij,ij->j", projection, middle))


def inverse_of(matrix: Floats) -> Floats:
    """The inverse of a positive definite matrix, which is scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    factor, scale = _factor_of(matrix)
    return np.asarray(cho_solve((factor, True), np.eye(len(matrix))) * np.outer(scale, scale))


def _factor_of(matrix: Floats) -> tuple[Floats, Floats]:
    """The Cholesky factor, in the lower triangle, of a matrix scaled to unit diagonal, and the `scale` of its columns."""
    diagonal = matrix.diagonal()
    if not np.all(diagonal > 0.0):
        raise np.linalg.LinAlgError("a column is zero")
    scale = 1.0 / np.sqrt(diagonal)
    factor, _ = cho_factor(matrix * np.outer(scale, scale), lower=True, check_finite=False)
    return factor, scale
