"""The cost as a parabola in all candidates at once, and what any choice of them makes of it.

cost(c) = c0 - 2 g'c + c'H c over the p coefficients. A choice sets the others to zero. `scatter` is the covariance of g: H
itself for a likelihood, something else for equations whose columns are noisy (the weak form), where

    z = c_j / deviation(c_j),   deviation^2 = diag(H^-1 scatter H^-1)

measures a coefficient in units of its own error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from linkwise.arrays import Floats, Indices

_DEPENDENT = (
    1e-9  # of its own square: a column of which less than this stands out of the others is one of them
)


@dataclass(frozen=True, eq=False)
class Solution:
    """Values (s,) of the chosen coefficients and their deviations in z (s,)."""

    values: Floats
    z: Floats


@dataclass(frozen=True, eq=False)
class QuadraticModel:
    """`h` (p, p), `g` (p,) and `scatter` (p, p), None where it is `h`, of the coefficients `names` (p,)."""

    names: tuple[str, ...]
    h: Floats
    g: Floats
    scatter: Floats | None = None

    def solve(self, chosen: Sequence[int] | Indices) -> Solution:
        """The best of the chosen coefficients, by number. Raises numpy.linalg.LinAlgError where they move together."""
        inside = np.asarray(chosen, dtype=np.intp)
        inverse = _inverse(self.h[np.ix_(inside, inside)])
        values = inverse @ self.g[inside]
        covariance = (
            inverse if self.scatter is None else inverse @ self.scatter[np.ix_(inside, inside)] @ inverse
        )
        return Solution(values, values / np.sqrt(covariance.diagonal()))

    def cost(self, chosen: Sequence[int] | Indices) -> float:
        """-2 log likelihood of the chosen coefficients at their best, less that of none."""
        inside = np.asarray(chosen, dtype=np.intp)
        return -float(self.g[inside] @ self.solve(inside).values)

    def outside(self, chosen: Sequence[int] | Indices) -> tuple[Indices, Floats, Floats, Floats]:
        """Every other coefficient alone beside the chosen ones: numbers (r,), values, z, and what part of each stands out.

        z is 0 and the value NaN where nothing of it stands out of the others.
        """
        inside = np.asarray(chosen, dtype=np.intp)
        others = np.setdiff1d(np.arange(len(self.g)), inside)
        cross = self.h[np.ix_(inside, others)]
        share = _inverse(self.h[np.ix_(inside, inside)]) @ np.column_stack([cross, self.g[inside]])
        part, fitted = share[:, :-1], share[:, -1]
        left = self.g[others] - cross.T @ fitted
        own = self.h[others, others]
        stiff = own - np.einsum("ij,ij->j", cross, part)
        told = stiff > _DEPENDENT * own
        variance = stiff
        if self.scatter is not None:
            middle = self.scatter[np.ix_(inside, inside)] @ part - 2.0 * self.scatter[np.ix_(inside, others)]
            variance = self.scatter[others, others] + np.einsum("ij,ij->j", part, middle)
        told &= variance > 0.0
        safe = np.where(told, variance, 1.0)
        values = np.where(told, left / np.where(told, stiff, 1.0), np.nan)
        return (
            others,
            values,
            np.where(told, left / np.sqrt(safe), 0.0),
            stiff / np.where(own > 0.0, own, 1.0),
        )


def _inverse(matrix: Floats) -> Floats:
    """Of a positive matrix, scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    diagonal = matrix.diagonal()
    if not np.all(diagonal > 0.0):
        raise np.linalg.LinAlgError("a column is empty")
    scale = 1.0 / np.sqrt(diagonal)
    factor = cho_factor(matrix * np.outer(scale, scale), lower=True, check_finite=False)
    return np.asarray(cho_solve(factor, np.eye(len(matrix))) * np.outer(scale, scale))
