"""A c = b: the waist between every way to equations (derivatives, weak form) and every way to coefficients.

Columns are named and carry the unit of their coefficient, rows carry weights, known terms are already in b. Several
targets may share the columns. A regressor reads rows in blocks and never asks whether they are stored (`DenseSystem`) or
computed when asked for (`StreamedSystem`), so a library that does not fit in memory is no special case.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError

Rows = slice | Indices  # a piece of the rows, or their numbers

_BLOCK_BYTES = 8 * 2**20  # large enough to fill the pipelines of one BLAS call, small enough to stay in cache

# p x p: of all rows, of those held out and of the others, two factors, an inverse, and one in the making
_MATRICES = 7
_BLOCKS = 4  # as they come, split in two, and what they leave


def fit_bytes(columns: int) -> int:
    """Bytes that a fit of so many columns takes at its peak, beside the data."""
    return 8 * _MATRICES * columns**2 + _BLOCKS * _BLOCK_BYTES


class LinearSystem(ABC):
    """Weighted rows of A c = b with p named columns and T named targets, read block by block."""

    names: tuple[str, ...]  # (p,) of the columns
    units: tuple[
        str, ...
    ]  # (p,) of their coefficients; with several targets, of the columns: "" where unknown
    targets: tuple[str, ...]  # (T,)

    @property
    @abstractmethod
    def rows(self) -> int:
        """Number of rows R."""

    @abstractmethod
    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        """Weighted rows `piece`: A (B, p) in C or Fortran order, and b (B, T)."""

    @property
    def fit_bytes(self) -> int:
        """What a fit of any regressor takes at its peak, beside the data: so many p x p matrices and a few blocks of rows."""
        return fit_bytes(len(self.names))

    def blocks(self, rows: Indices | None = None) -> Iterator[tuple[Floats, Floats]]:
        """All rows, or those of these numbers, in order, in blocks of about 8 MB, each as `rows_of` gives them."""
        step = int(np.clip(_BLOCK_BYTES // (8 * max(len(self.names), 1)), 64, 65536))
        for first in range(0, self.rows if rows is None else len(rows), step):
            last = first + step
            yield self.rows_of(slice(first, min(last, self.rows)) if rows is None else rows[first:last])


@dataclass(frozen=True, eq=False)
class DenseSystem(LinearSystem):
    """Stored equations: matrix (R, p), target (R,) or (R, T), weights (R,) that multiply whole rows (default 1).

    `names` and `units` name the p columns and the units of their coefficients, `targets` the T right-hand sides. A
    target (R,) is kept as (R, 1). Raises IdentificationError where shapes disagree, a name appears twice, or an entry
    is not finite.
    """

    matrix: Floats
    target: Floats
    names: tuple[str, ...]
    weights: Floats | None = None
    units: tuple[str, ...] = ()
    targets: tuple[str, ...] = ("b",)

    def __post_init__(self) -> None:
        target = self.target[:, None] if self.target.ndim == 1 else self.target
        object.__setattr__(self, "target", target)
        object.__setattr__(self, "units", self.units or ("",) * len(self.names))
        rows, columns = self.matrix.shape
        _require_named(self.names, self.units, self.targets)
        if columns != len(self.names) or target.shape != (rows, len(self.targets)):
            raise IdentificationError(
                f"equations of {rows} rows and {columns} columns were given {len(self.names)} column names and a target of "
                f"shape {target.shape} with {len(self.targets)} names; every column and every target needs its name"
            )
        if self.weights is not None and self.weights.shape != (rows,):
            raise IdentificationError(
                f"{rows} rows need {rows} weights, got an array of shape {self.weights.shape}"
            )
        _require_finite(self.matrix, target, self.weights, self.names)

    @property
    def rows(self) -> int:
        return len(self.matrix)

    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        matrix, target = self.matrix[piece], self.target[piece]
        if self.weights is None:
            return matrix, target
        weights = self.weights[piece, None]
        return matrix * weights, target * weights

    def with_known(self, values: dict[str, float]) -> DenseSystem:
        """The same equations with the named columns moved to the right-hand side at these coefficients.

        Raises IdentificationError for a name that is no column.
        """
        for name in values:
            if name not in self.names:
                raise IdentificationError(
                    f"no column is called {name!r}; the columns are {', '.join(self.names)}"
                )
        known = [self.names.index(name) for name in values]
        left = [column for column, name in enumerate(self.names) if name not in values]
        moved = self.matrix[:, known] @ np.array(list(values.values()), dtype=np.float64)
        return DenseSystem(
            self.matrix[:, left],
            self.target - moved[:, None],
            tuple(self.names[column] for column in left),
            weights=self.weights,
            units=tuple(self.units[column] for column in left),
            targets=self.targets,
        )


@dataclass(frozen=True, eq=False)
class StreamedSystem(LinearSystem):
    """Equations whose rows are computed when they are read: `compute(piece)` gives A (B, p) and b (B, T), weights applied,
    for a slice or an array of row numbers.

    `count` is the number of rows R. The matrix is never stored: memory stays at one block.
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
        return self.count

    def rows_of(self, piece: Rows) -> tuple[Floats, Floats]:
        return self.compute(piece)

    def stored(self) -> DenseSystem:
        """The same equations with all rows in memory."""
        matrix, target = self.compute(slice(0, self.count))
        return DenseSystem(matrix, target, self.names, units=self.units, targets=self.targets)


def _require_named(names: tuple[str, ...], units: tuple[str, ...], targets: tuple[str, ...]) -> None:
    for kind, given in (("column", names), ("target", targets)):
        twice = (
            sorted({name for name in given if given.count(name) > 1}) if len(set(given)) < len(given) else []
        )
        if twice:
            raise IdentificationError(f"two {kind}s are called {twice[0]!r}; names must differ")
    if len(units) != len(names):
        raise IdentificationError(f"{len(names)} columns need {len(names)} units, got {len(units)}")


def _require_finite(matrix: Floats, target: Floats, weights: Floats | None, names: tuple[str, ...]) -> None:
    bad_rows = ~np.isfinite(target).all(axis=1)
    if weights is not None:
        bad_rows |= ~np.isfinite(weights)
    # A sum is finite only where every entry is, or overflows; only then look for the place.
    if bad_rows.any():
        raise IdentificationError(
            f"row {int(np.flatnonzero(bad_rows)[0])} of the equations has no finite right-hand side or weight"
        )
    sums = matrix.sum(axis=0)
    if not np.isfinite(sums).all():
        column = int(np.flatnonzero(~np.isfinite(sums))[0])
        raise IdentificationError(
            f"column {names[column]!r} of the equations holds values that are not finite"
        )
