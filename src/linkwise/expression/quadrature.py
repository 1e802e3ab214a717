"""Numerical integrals of compiled expressions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.expression.program import Program

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
# over the whole range; with 10 nodes a panel, exact to rounding for all but the steepest integrands
_PANELS = 128
_BLOCK = 65536  # panels evaluated at once, which bounds the memory
_BISECTIONS = 60  # to the last bit of a double


def integral_from_zero(program: Program, upper: ArrayLike, parameters: Sequence[ArrayLike]) -> Floats:
    """The integral of the program's first output over its first input, from 0 to each of `upper`.

    The program's other outputs are the kinks of the first: their zeros become panel borders. `parameters` are its other
    inputs; all arrays broadcast. Composite Gauss-Legendre quadrature, order 20 between kinks; NaN where `upper`
    is not finite.
    """
    columns = np.broadcast_arrays(*(np.asarray(array, dtype=np.float64) for array in (upper, *parameters)))
    ends = columns[0].ravel()
    result = np.full(ends.shape, np.nan)
    if all(np.size(value) == 1 for value in parameters):
        sets, which = (
            np.array([[float(np.ravel(value)[0]) for value in parameters]]),
            np.zeros(ends.shape, dtype=np.intp),
        )
    else:
        sets, which = np.unique(
            np.stack([column.ravel() for column in columns[1:]], axis=1), axis=0, return_inverse=True
        )
    for index, values in enumerate(sets):
        chosen = (which.ravel() == index) & np.isfinite(ends)
        if chosen.any():
            result[chosen] = _from_zero(program, ends[chosen], values)
    return result.reshape(columns[0].shape)


def _from_zero(program: Program, upper: Floats, parameters: Floats) -> Floats:
    low, high = min(0.0, float(upper.min())), max(0.0, float(upper.max()))
    grid = np.linspace(low, high, _PANELS + 1)
    borders = np.unique(np.concatenate([grid, upper, [0.0], _zeros(program, grid, parameters)]))
    total = np.zeros(borders.size)
    for first in range(0, borders.size - 1, _BLOCK):
        ends = borders[first : first + _BLOCK + 1]
        half = 0.5 * np.diff(ends)[:, None]
        points = ends[:-1, None] + half * (1.0 + _NODES)
        total[first + 1 : first + ends.size] = (program(points, *parameters)[0] * half) @ _WEIGHTS
    np.cumsum(total, out=total)
    return np.asarray(total[np.searchsorted(borders, upper)] - total[np.searchsorted(borders, 0.0)])


def _zeros(program: Program, grid: Floats, parameters: Floats) -> Floats:
    """Zeros of the kinks between points of the grid, by bisection."""
    zeros = [np.empty(0)]
    for index, values in enumerate(program(grid, *parameters)[1:], start=1):
        change = np.flatnonzero(values[:-1] * values[1:] < 0.0)
        if change.size == 0:
            continue
        left, right, sign = grid[change], grid[change + 1], np.sign(values[change])
        for _ in range(_BISECTIONS):
            middle = 0.5 * (left + right)
            before = np.sign(program(middle, *parameters)[index]) == sign
            left, right = np.where(before, middle, left), np.where(before, right, middle)
        zeros.append(right)
    return np.concatenate(zeros)
