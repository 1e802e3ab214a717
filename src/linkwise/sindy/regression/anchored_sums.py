"""Sums over the rows of a linear system about an approximate solution, its anchor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dsymm, dsymv

from linkwise.arrays import Floats, Indices


@dataclass(frozen=True, eq=False)
class AnchoredSums:
    """Sums over R rows about an anchor, for scaled columns.

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
        """The same sums about another anchor.

        Parameters
        ----------
        change : array of shape (p, T)
            Change of the anchor.

        Returns
        -------
        AnchoredSums
            The sums about the new anchor.
        """
        product = dsymm(1.0, self.matrix, change, lower=1)
        squares = np.maximum(self.squares + np.sum(change * (product - 2 * self.slope), axis=0), 0.0)
        return AnchoredSums(self.rows, self.matrix, self.slope - product, squares, self.norms)

    def squares_at(self, change: Floats, target: int) -> float:
        """Sum of squared residuals away from the anchor.

        Parameters
        ----------
        change : array of shape (p,)
            Difference from the anchor.
        target : int
            Index of the target.

        Returns
        -------
        float
            ||b - A (anchor + change)||^2 of the target.
        """
        product = dsymv(1.0, self.matrix, change, lower=1)
        return max(float(self.squares[target] + change @ (product - 2 * self.slope[:, target])), 0.0)

    def restricted(self, retained: Indices, change: Floats, target: int) -> AnchoredSums:
        """Sums of some columns and one target about an anchor that is zero in the other columns.

        Parameters
        ----------
        retained : array of shape (k,)
            Indices of the columns.
        change : array of shape (p,)
            Change of the anchor.
        target : int
            Index of the target.

        Returns
        -------
        AnchoredSums
            The sums of k columns and one target.
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
