"""Matrices in MTX files: those of MatrixMarket, and those that Abaqus writes with *MATRIX OUTPUT.

Abaqus writes an entry to a line, as row and column, or as node and direction of each. Of a symmetric matrix it writes one
triangle.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.matrix_files.file_matrix import FileMatrix, both_triangles, of_entries, require_last_line

_OF_COORDINATES, _OF_NODES = 3, 5  # numbers to a line


def read_matrices(path: Path) -> dict[str, FileMatrix]:
    """The matrix under the name of the file."""
    first = _first_line(path)
    if first.startswith("%%MatrixMarket"):
        return {path.stem: FileMatrix(scipy.io.mmread(path, spmatrix=False))}
    if first.startswith("*"):
        raise StructureError(
            f"holds keywords such as {first.split()[0][:30]}, as of a substructure or of elements; let Abaqus write the "
            "matrices of the whole model with *MATRIX GENERATE and *MATRIX OUTPUT",
            str(path),
        )
    columns = len(first.replace(",", " ").split())
    if columns not in (_OF_COORDINATES, _OF_NODES):
        raise StructureError(
            f"is neither a MatrixMarket file nor a matrix of Abaqus: its first line holds {columns} values, not row, column "
            "and entry, or node, direction, node, direction and entry",
            str(path),
        )
    with path.open("rb") as content:
        content.seek(-1, os.SEEK_END)
        require_last_line(content.read())
    table = _table(path, "," if "," in first else None)
    if columns == _OF_NODES:
        return {path.stem: of_entries(table[:, :2], table[:, 2:4], table[:, 4])}
    places = table[:, :2]
    if not (places == np.round(places)).all() or not (places >= 1).all():
        raise ValueError("a row or a column is not a whole number from 1")
    rows, columns_of_entries = (places - 1).astype(np.int64).T
    size = int(places.max())
    return {path.stem: FileMatrix(both_triangles(rows, columns_of_entries, table[:, 2], size))}


def _table(path: Path, delimiter: str | None) -> Floats:
    """The entries, a row each; ValueError for a line of another length, or with what is no number."""
    try:
        return np.loadtxt(path, delimiter=delimiter, comments="**", ndmin=2)
    except ValueError as error:  # which goes on to name an argument of the function
        raise ValueError(str(error).partition("; use `usecols`")[0]) from None


def _first_line(path: Path) -> str:
    """The first line that is neither empty nor a comment of Abaqus."""
    with path.open(encoding="utf-8") as lines:
        return next((line.strip() for line in lines if line.strip() and not line.startswith("**")), "")
