"""Cholesky factors of Gram matrices of unit columns, with care for columns that are dependent."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from linkwise.arrays import Floats

CholeskyFactor = tuple[Floats, bool]  # the factor and True for lower, as `cho_solve` takes it

_DEPENDENT = 3e-8  # pivot below which a column is dependent on the others, up to rounding
_RIDGE = 1e-14  # added to the unit diagonal of dependent columns


def cholesky(block: Floats) -> CholeskyFactor | None:
    """Cholesky factor of a Gram matrix (p, p) of unit columns; None where the columns are dependent."""
    try:
        factor: CholeskyFactor = cho_factor(block, lower=True, check_finite=False)
    except LinAlgError:
        return None
    return factor if np.min(np.diagonal(factor[0])) > _DEPENDENT else None


def ridged(block: Floats) -> CholeskyFactor:
    """Cholesky factor of a Gram matrix (p, p) of unit columns with the smallest ridge that makes it definite, none where
    the columns are independent.
    """
    factor, ridge = cholesky(block), _RIDGE
    while factor is None:
        factor, ridge = cholesky(block + ridge * np.eye(len(block))), 100 * ridge
    return factor


def vanishing(block: Floats) -> Floats:
    """The combination (p,) of dependent columns that vanishes up to rounding, its largest entry 1, by inverse iteration on
    their Gram matrix (p, p), of unit columns.
    """
    combination = np.random.default_rng(0).normal(size=len(block))
    for _ in range(3):
        combination = cho_solve(ridged(block), combination / np.abs(combination).max())
    return np.asarray(combination / np.abs(combination).max())
