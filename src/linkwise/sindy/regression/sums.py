"""Sums over the rows of a linear system, formed block by block, apart for rows that are held out.

Every fifth of a hundred runs of neighbouring rows is held out. Neighbouring samples are strongly correlated: predicting a
whole run is a test, predicting a row between two fitted ones is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk

from linkwise.arrays import Bools, Floats
from linkwise.sindy.regression.linear_system import LinearSystem

_RUNS = 100
_ONE_IN = 5
_TILE = 128
_FEWEST = 25  # rows below which none are held out: validation needs five


class Products(NamedTuple):
    """Products over some rows.

    Attributes
    ----------
    matrix : array of shape (p, p)
        A'A.
    moments : array of shape (p, T)
        A'b.
    squares : array of shape (T,)
        ||b||^2.
    """

    matrix: Floats
    moments: Floats
    squares: Floats


class ResidualProducts(NamedTuple):
    """Products of residuals over some rows.

    Attributes
    ----------
    squares : array of shape (T,)
        ||b - A c||^2.
    slope : array of shape (p, T)
        A'(b - A c).
    """

    squares: Floats
    slope: Floats


def held_out_rows(rows: int) -> Bools:
    """Rows that are held out for validation.

    Parameters
    ----------
    rows : int
        Number of rows R.

    Returns
    -------
    array of bool, shape (R,)
        True in the middle one of every five runs; nowhere for fewer than 25 rows.
    """
    if rows < _FEWEST:
        return np.zeros(rows, dtype=bool)
    run = np.arange(rows) * min(_RUNS, rows - rows % _ONE_IN) // rows
    return np.asarray(run % _ONE_IN == _ONE_IN // 2)


def products(system: LinearSystem) -> list[Products]:
    """Products of the rows for training, and of those held out where there are any.

    Parameters
    ----------
    system : LinearSystem
        The equations.

    Returns
    -------
    list of Products
        One or two parts; one symmetric rank-k update per block of rows.
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
    """Products of the residuals of given coefficients, computed from the rows themselves.

    Parameters
    ----------
    system : LinearSystem
        The equations.
    coefficients : array of shape (p, T)
        The coefficients c.

    Returns
    -------
    list of ResidualProducts
        In the parts of `products`.
    """
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
    """Copy the lower triangle of a square matrix to its upper one in place, in tiles that fit in the cache.

    Parameters
    ----------
    matrix : array of shape (p, p)
        The matrix, overwritten.
    """
    edges = range(0, len(matrix), _TILE)
    for row in edges:
        for column in range(0, row, _TILE):
            tile = matrix[row : row + _TILE, column : column + _TILE]
            matrix[column : column + _TILE, row : row + _TILE] = tile.T
        corner = matrix[row : row + _TILE, row : row + _TILE]
        corner[...] = np.tril(corner) + np.tril(corner, -1).T


def blas_product(rows: Floats, right: Floats, *, transposed: bool = False) -> Floats:
    """rows @ right, or rows.T @ right, by SciPy's BLAS.

    NumPy links a BLAS of its own; threads of the two libraries that wait for work would slow each other down.

    Parameters
    ----------
    rows : array of shape (B, p)
        In C or Fortran order.
    right : array of shape (p, T), or (B, T) if transposed
        The right factor.
    transposed : bool, optional
        Multiply by the transpose of `rows`.

    Returns
    -------
    array of shape (B, T), or (p, T) if transposed
        The product.
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
