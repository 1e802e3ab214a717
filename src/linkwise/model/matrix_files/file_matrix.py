"""A matrix as a file holds it, with the degrees of freedom that its rows stand for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from linkwise.arrays import Floats

_DIRECTIONS = {0: "", 1: "x", 2: "y", 3: "z", 4: "rx", 5: "ry", 6: "rz"}
_CODE = 1024  # directions of a node, at most, in a number that stands for both


@dataclass(frozen=True, eq=False)
class FileMatrix:
    """A matrix of any kind of values, dense or sparse, of shape (n, m).

    `names` are those of its rows, by node and direction such as "12z", or empty where the file only counts them.
    """

    matrix: Any
    names: tuple[str, ...] = ()


def degree_of_freedom(node: int, direction: int) -> str:
    """Name of a degree of freedom: node and direction, such as "12z" or "12rx"; "12" of a scalar point."""
    return f"{node}{_DIRECTIONS.get(direction, f'.{direction}')}"


def require_last_line(content: bytes) -> None:
    """Raise ValueError for text that ends within a line, of which an entry may be lost."""
    if not content.endswith((b"\n", b"\r")):
        raise ValueError("it ends within a line and may be cut off; write it again, or end the last line")


def of_entries(rows: Floats, columns: Floats, values: Floats) -> FileMatrix:
    """The matrix of entries between degrees of freedom, of one triangle or both.

    Parameters
    ----------
    rows, columns : array of shape (n, 2)
        Node and direction of each entry.
    values : array of shape (n,)
        The entries; an entry whose mirror image is not given stands for both.

    Raises ValueError for a node or a direction that is not a whole number, or an entry that is given twice.
    """
    places = np.concatenate([rows, columns])
    if not (places == np.round(places)).all() or not ((places[:, 1] >= 0) & (places[:, 1] < _CODE)).all():
        raise ValueError("a node or a direction is not a whole number")
    codes = places[:, 0].astype(np.int64) * _CODE + places[:, 1].astype(np.int64)
    present, numbers = np.unique(codes, return_inverse=True)
    row, column = np.split(numbers, 2)
    names = tuple(degree_of_freedom(*divmod(int(code), _CODE)) for code in present)
    return FileMatrix(both_triangles(row, column, values, len(names)), names)


def both_triangles(
    rows: np.ndarray[tuple[int], np.dtype[np.int64]],
    columns: np.ndarray[tuple[int], np.dtype[np.int64]],
    values: Floats,
    size: int,
) -> scipy.sparse.csc_array:
    """The matrix (size, size) of entries (n,), of which those that lack their mirror image get it.

    Raises ValueError for an entry that is given twice.
    """
    places, mirrored = rows * size + columns, columns * size + rows
    unique, counts = np.unique(places, return_counts=True)
    if (counts > 1).any():
        row, column = divmod(int(unique[counts > 1][0]), size)
        raise ValueError(f"the entry of row {row + 1} and column {column + 1} is given twice")
    single = ~np.isin(mirrored, unique)
    return scipy.sparse.csc_array(
        (
            np.concatenate([values, values[single]]),
            (np.concatenate([rows, columns[single]]), np.concatenate([columns, rows[single]])),
        ),
        shape=(size, size),
    )
