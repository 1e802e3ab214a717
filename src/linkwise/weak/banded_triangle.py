"""Solutions of many columns with the Cholesky factor of a banded matrix.

LAPACK solves a banded triangle column by column, at the speed of memory. In blocks as wide as the band it has one triangle and
one square a block, and all columns go through both at once by products of blocks (Golub and Van Loan, "Matrix computations",
4th edition 2013, section 4.5.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas

from linkwise.arrays import Floats


@dataclass(frozen=True, eq=False)
class BandedTriangle:
    """A lower triangle L of N rows in K blocks of b rows, of which the last is filled up with those of the unit matrix.

    Attributes
    ----------
    diagonal : array of shape (K, b, b)
        Its blocks, transposed: upper triangles; what is below these is of no meaning.
    below : array of shape (K - 1, b, b)
        What each block but the first has of the one before it, transposed.
    size : int
        N.
    """

    diagonal: Floats
    below: Floats
    size: int

    @classmethod
    def of(cls, bands: Floats) -> BandedTriangle:
        """The blocks of a triangle.

        Parameters
        ----------
        bands : array of shape (b, N)
            Its bands, the diagonal first, as `scipy.linalg.cholesky_banded` gives them.

        Returns
        -------
        BandedTriangle
            The triangle.
        """
        b, size = bands.shape
        columns, full, count = bands.T, size // b, -(-size // b)
        whole, last = columns[: full * b].reshape(full, b, b), columns[full * b :]
        diagonal, below = np.empty((count, b, b)), np.zeros((count - 1, b, b))
        if len(last):
            diagonal[full] = np.eye(b)
        for number in range(b):
            diagonal[:full, number, number:] = whole[:, number, : b - number]
            below[:, number, :number] = whole[: count - 1, number, b - number :]
        for number, column in enumerate(last):
            diagonal[full, number, number : len(last)] = column[: len(last) - number]
        return cls(diagonal, below, size)

    def forward(self, columns: Floats) -> Floats:
        """Solve with the triangle.

        Parameters
        ----------
        columns : array of shape (N, s)
            The columns.

        Returns
        -------
        array of shape (N, s)
            The solution y of L y = columns.
        """
        blocks = self._blocks(columns)
        for number, own in enumerate(blocks):
            if number:
                own -= self.below[number - 1].T @ blocks[number - 1]
            blas.dtrsm(1.0, self.diagonal[number].T, own.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        return np.asarray(blocks.reshape(-1, columns.shape[1])[: self.size])

    def backward(self, columns: Floats) -> Floats:
        """Solve with the transpose of the triangle.

        Parameters
        ----------
        columns : array of shape (N, s)
            The columns.

        Returns
        -------
        array of shape (N, s)
            The solution y of L' y = columns.
        """
        blocks = self._blocks(columns)
        for number in range(len(blocks) - 1, -1, -1):
            own = blocks[number]
            if number + 1 < len(blocks):
                own -= self.below[number] @ blocks[number + 1]
            blas.dtrsm(1.0, self.diagonal[number].T, own.T, side=1, lower=1, overwrite_b=1)
        return np.asarray(blocks.reshape(-1, columns.shape[1])[: self.size])

    def _blocks(self, columns: Floats) -> Floats:
        """(K, b, s) a copy of columns (N, s), filled up with zeros."""
        count, b, _ = self.diagonal.shape
        blocks = np.zeros((count * b, columns.shape[1]))
        blocks[: self.size] = columns
        return blocks.reshape(count, b, -1)
