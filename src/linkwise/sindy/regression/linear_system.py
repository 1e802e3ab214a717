"""Linear systems A c = b: the interface between formulations of equations and regressors.

Columns are named and carry the unit of their coefficient, rows may be weighted, known terms are already in b. Several
targets may share the columns. A regressor reads rows in blocks, whether they are stored (`DenseSystem`) or computed on
demand (`StreamedSystem`), so a library may be larger than memory.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError

Rows = slice | Indices  # rows of a system: a slice or row numbers

_BLOCK_BYTES = 8 * 2**20  # large enough to fill the pipelines of one BLAS call, small enough to stay in cache

# p x p: Gram matrices of all rows, of those held out and of the others, two factors, an inverse, one temporary
_MATRICES = 7
_BLOCKS = 4  # the block, its two parts and the residuals


def fit_bytes(columns: int) -> int:
    """Peak memory in bytes of a fit with p columns, beside the data: seven p x p matrices and a few blocks of rows."""
    return 8 * _MATRICES * columns**2 + _BLOCKS * _BLOCK_BYTES


@final
class GramSums:
    """A'A of rows that come in blocks, of `columns` columns.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> system = lw.sindy.DenseSystem(np.array([[3.0, 0.0], [4.0, 1.0]]), np.ones(2), ("a", "b"))
    >>> sums = system.gram_sums()
    >>> sums.add(system.matrix)
    >>> sums.matrix().tolist()
    [[25.0, 4.0], [4.0, 1.0]]
    """

    def __init__(self, columns: int) -> None:
        self._sum = np.zeros((columns, columns), order="F")

    def add(self, rows: Floats) -> None:
        """Add the products of rows.

        Parameters
        ----------
        rows : array of shape (B, p)
            Rows of A, in C or Fortran order.
        """
        turned = rows.flags.c_contiguous
        columns = rows.T if turned else rows
        dsyrk(1.0, columns, beta=1.0, c=self._sum, trans=not turned, lower=1, overwrite_c=1)

    def matrix(self) -> Floats:
        """The sums so far.

        Returns
        -------
        array of shape (p, p)
            A'A, in Fortran order.
        """
        mirror(self._sum)
        return self._sum


def mirror(matrix: Floats) -> None:
    """Copy the lower triangle of a square matrix (p, p) to its upper one in place."""
    for row in range(len(matrix)):
        matrix[row, row + 1 :] = matrix[row + 1 :, row]


def product(rows: Floats, right: Floats, *, transposed: bool = False) -> Floats:
    """rows @ right, or rows.T @ right, of rows (B, p) in C or Fortran order, by SciPy's BLAS.

    NumPy links a BLAS of its own; threads of the two libraries that wait for work would slow each other down.
    """
    turned = rows.flags.c_contiguous
    return np.asarray(dgemm(1.0, rows.T if turned else rows, right, trans_a=transposed != turned))


class LinearSystem(ABC):
    """Weighted rows of A c = b with p named columns and T named targets, read block by block.

    Attributes
    ----------
    names : tuple of str
        Names of the p columns.
    units : tuple of str
        Units of their p coefficients; with several targets, of the columns. "" where unknown.
    targets : tuple of str
        Names of the T right-hand sides.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    targets: tuple[str, ...]

    @property
    @abstractmethod
    def rows(self) -> int:
        """Number of rows R."""

    @abstractmethod
    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        """Weighted rows.

        Parameters
        ----------
        piece : slice or array of int
            The B rows.

        Returns
        -------
        matrix : array of shape (B, p)
            Rows of A, in C or Fortran order.
        target : array of shape (B, T)
            Rows of b.
        """

    def gram_sums(self) -> GramSums:
        """Sums for the Gram matrix of rows of this system.

        Returns
        -------
        GramSums
            Of no row yet.
        """
        return GramSums(len(self.names))

    def blocks(self, rows: Indices | None = None) -> Iterator[tuple[Floats, Floats]]:
        """Iterate over rows in blocks of about 8 MB.

        Parameters
        ----------
        rows : array of int, optional
            Numbers of the rows, in order; all by default.

        Yields
        ------
        matrix, target : array
            As `rows_of` returns them.
        """
        step = int(np.clip(_BLOCK_BYTES // (8 * max(len(self.names), 1)), 64, 65536))
        for first in range(0, self.rows if rows is None else len(rows), step):
            last = first + step
            yield self.rows_of(slice(first, min(last, self.rows)) if rows is None else rows[first:last])


@dataclass(frozen=True, eq=False)
class DenseSystem(LinearSystem):
    """Linear system A c = b in memory.

    Parameters
    ----------
    matrix : array of shape (R, p)
        A.
    target : array of shape (R,) or (R, T)
        b, kept with two dimensions.
    names : tuple of str
        Names of the p columns.
    weights : array of shape (R,), optional
        Factors of whole rows; 1 by default.
    units : tuple of str, optional
        Units of the p coefficients.
    targets : tuple of str, optional
        Names of the T right-hand sides.

    Raises
    ------
    IdentificationError
        If shapes do not match, a name is used twice, or an entry is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> matrix = np.column_stack([np.ones(50), np.arange(50.0)])
    >>> system = lw.sindy.DenseSystem(matrix, matrix @ [1.0, 2.0], ("a", "b"), units=("N", "N/s"), targets=("f",))
    >>> {name: round(value, 9) for name, value in lw.sindy.LeastSquares().fit(system).terms("f").items()}
    {'a': 1.0, 'b': 2.0}
    """

    matrix: Floats
    target: Floats
    names: tuple[str, ...]
    weights: Floats | None = None
    units: tuple[str, ...] = ()
    targets: tuple[str, ...] = ("b",)

    def __post_init__(self) -> None:
        target = self.target[:, None] if self.target.ndim == 1 else self.target
        vars(self).update(target=target, units=self.units or ("",) * len(self.names))
        rows, columns = self.matrix.shape
        _require_named(self.names, self.units, self.targets)
        if columns != len(self.names) or target.shape != (rows, len(self.targets)):
            raise IdentificationError(
                f"equations of {rows} rows and {columns} columns were given {len(self.names)} column names and a target of "
                f"shape {target.shape} with {len(self.targets)} names; every column and every target needs its name"
            )
        if self.weights is not None and self.weights.shape != (rows,):
            message = f"{rows} rows need {rows} weights, got an array of shape {self.weights.shape}"
            raise IdentificationError(message)
        _require_finite(self.matrix, target, self.weights, self.names)

    @property
    def rows(self) -> int:
        """Number of rows R."""
        return len(self.matrix)

    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        matrix, target = self.matrix[piece], self.target[piece]
        if self.weights is None:
            return matrix, target
        weights = self.weights[piece, None]
        return matrix * weights, target * weights


@dataclass(frozen=True, eq=False)
class StreamedSystem(LinearSystem):
    """Linear system A c = b whose rows are computed when they are read: one block is in memory at a time.

    Parameters
    ----------
    compute : callable
        ``compute(piece)`` returns weighted rows of A, shape (B, p), and b, shape (B, T), for a slice or row numbers.
    count : int
        Number of rows R.
    names : tuple of str
        Names of the p columns.
    units : tuple of str
        Units of the p coefficients; "" where unknown.
    targets : tuple of str
        Names of the T right-hand sides.

    Raises
    ------
    IdentificationError
        If a name is used twice or the number of units differs from that of the columns.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> system = lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=2)
    >>> system.rows, system.stored().matrix.shape
    (1001, (1001, 15))
    """

    compute: Callable[[Rows], tuple[Floats, Floats]]
    count: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    targets: tuple[str, ...]

    def __post_init__(self) -> None:
        _require_named(self.names, self.units, self.targets)

    @property
    def rows(self) -> int:
        """Number of rows R."""
        return self.count

    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        return self.compute(piece)

    def stored(self) -> DenseSystem:
        """Compute all rows.

        Returns
        -------
        DenseSystem
            The same equations in memory.
        """
        matrix, target = self.compute(slice(0, self.count))
        return DenseSystem(matrix, target, self.names, units=self.units, targets=self.targets)


def _require_named(names: tuple[str, ...], units: tuple[str, ...], targets: tuple[str, ...]) -> None:
    for kind, given in (("column", names), ("target", targets)):
        if repeated := sorted(name for name, times in Counter(given).items() if times > 1):
            raise IdentificationError(f"two {kind}s are called {repeated[0]!r}; names must differ")
    if len(units) != len(names):
        raise IdentificationError(f"{len(names)} columns need {len(names)} units, got {len(units)}")


def _require_finite(matrix: Floats, target: Floats, weights: Floats | None, names: tuple[str, ...]) -> None:
    bad_rows = ~np.isfinite(target).all(axis=1)
    if weights is not None:
        bad_rows |= ~np.isfinite(weights)
    if bad_rows.any():
        row = int(np.argmax(bad_rows))
        raise IdentificationError(f"row {row} of the equations has no finite right-hand side or weight")
    # a sum is finite where every entry is, unless it overflows
    bad_columns = ~np.isfinite(matrix.sum(axis=0))
    if bad_columns.any():
        name = names[int(np.argmax(bad_columns))]
        raise IdentificationError(f"column {name!r} of the equations holds values that are not finite")
