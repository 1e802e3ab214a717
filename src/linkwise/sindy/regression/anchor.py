"""A least squares solution refined by its residual over the rows, about which later fits are corrections."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_solve

from linkwise.arrays import Floats
from linkwise.sindy.regression.cholesky import CholeskyFactor
from linkwise.sindy.regression.linear_system import LinearSystem
from linkwise.sindy.regression.sums import ResidualProducts, residual_products

_PASSES = 3  # at most over the rows to refine the anchor; one is enough unless columns are nearly dependent
_ROUNDING = 1e-13  # a residual this far below its target cannot be refined


def anchored_solution(
    system: LinearSystem, factor: CholeskyFactor, moments: Floats, inverse: Floats, norms: Floats
) -> tuple[Floats, Floats, list[ResidualProducts]]:
    """Least squares solution by iterative refinement.

    Parameters
    ----------
    system : LinearSystem
        The equations.
    factor : CholeskyFactor
        Factor of the Gram matrix of scaled columns, with a ridge where they are dependent.
    moments : array of shape (p, T)
        A'b in scaled columns.
    inverse : array of shape (p,)
        1 / ||A_j||; zero for columns that are zero throughout.
    norms : array of shape (T,)
        ||b||.

    Returns
    -------
    anchor : array of shape (p, T)
        An approximate solution, in scaled coefficients.
    change : array of shape (p, T)
        A last correction, not applied.
    products : list of ResidualProducts
        Products of the residuals of `anchor`, in the parts of `products`.
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
