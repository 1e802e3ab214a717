"""What a regression needs of the rows of a linear system, summed block by block, apart for rows that are held out.

Held out is every fifth of a hundred runs of neighbouring rows. Neighbours are too much alike to be parted: what
is predicted in a run that was not seen is a test, what is predicted between two rows that were seen is none.
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
_FEWEST = 25  # rows below which none are held out: five must be left to judge by


class Products(NamedTuple):
    """A'A (p, p), A'b (p, T) and ||b||^2 (T,) over some rows."""

    matrix: Floats
    moments: Floats
    squares: Floats


class ResidualProducts(NamedTuple):
    """||b - A c||^2 (T,) and A'(b - A c) (p, T) over some rows."""

    squares: Floats
    slope: Floats


def held_out(rows: int) -> Bools:
    """(R,) True for the rows that are held out: the middle one of every five runs; none of fewer than 25 rows."""
    if rows < _FEWEST:
        return np.zeros(rows, dtype=bool)
    run = np.arange(rows) * min(_RUNS, rows - rows % _ONE_IN) // rows
    return np.asarray(run % _ONE_IN == _ONE_IN // 2)


def products(system: LinearSystem) -> list[Products]:
    """Of the rows that are seen, and of those held out where there are any: one symmetric rank-k update per block and part."""
    columns, targets = len(system.names), len(system.targets)
    parts = [
        Products(np.zeros((columns, columns), order="F"), np.zeros((columns, targets)), np.zeros(targets))
        for _ in range(1 + bool(held_out(system.rows).any()))
    ]
    for part, rows, target in _blocks(system):
        # syrk reads Fortran order; a block in C order is the transpose of one. What it is given it overwrites.
        turned = rows.flags.c_contiguous
        dsyrk(
            1.0,
            rows.T if turned else rows,
            beta=1.0,
            c=parts[part].matrix,
            trans=not turned,
            lower=1,
            overwrite_c=1,
        )
        parts[part].moments[...] += blas_product(rows, target, transposed=True)
        parts[part].squares[...] += np.sum(target**2, axis=0)
    for one in parts:
        mirror(one.matrix)
    return parts


def residual_products(system: LinearSystem, coefficients: Floats) -> list[ResidualProducts]:
    """Of coefficients c (p, T), from the rows themselves, in the parts of `products`."""
    parts = [
        ResidualProducts(np.zeros(coefficients.shape[1]), np.zeros_like(coefficients))
        for _ in range(1 + bool(held_out(system.rows).any()))
    ]
    for part, rows, target in _blocks(system):
        residual = target - blas_product(rows, coefficients)
        parts[part].slope[...] += blas_product(rows, residual, transposed=True)
        parts[part].squares[...] += np.sum(residual**2, axis=0)
    return parts


def mirror(matrix: Floats) -> None:
    """Copy the lower triangle of a square matrix over its upper one, in tiles that stay in the cache."""
    edges = range(0, len(matrix), _TILE)
    for row in edges:
        for column in range(0, row, _TILE):
            tile = matrix[row : row + _TILE, column : column + _TILE]
            matrix[column : column + _TILE, row : row + _TILE] = tile.T
        corner = matrix[row : row + _TILE, row : row + _TILE]
        corner[...] = np.tril(corner) + np.tril(corner, -1).T


def blas_product(rows: Floats, right: Floats, *, transposed: bool = False) -> Floats:
    """rows @ right, or rows.T @ right, by SciPy's BLAS.

    NumPy brings a BLAS of its own; where each keeps threads, calling both in turn lets them spin in each other's way.
    """
    if rows.flags.c_contiguous:
        return np.asarray(dgemm(1.0, rows.T, right, trans_a=not transposed))
    return np.asarray(dgemm(1.0, rows, right, trans_a=transposed))


def _blocks(system: LinearSystem) -> Iterator[tuple[int, Floats, Floats]]:
    """All rows in blocks, first those that are seen (0), then those held out (1)."""
    held = held_out(system.rows)
    for part, chosen in enumerate((~held, held)):
        for rows, target in system.blocks(np.flatnonzero(chosen)):
            yield part, rows, target
