"""Matrices of Nastran in OUTPUT4 files, text or binary."""

from __future__ import annotations

from pathlib import Path

from pyyeti.nastran import op4

from linkwise.model.matrix_files.file_matrix import FileMatrix


def read_matrices(path: Path) -> dict[str, FileMatrix]:
    """Every matrix by its name in capitals, such as "KAA"."""
    return {name.upper(): FileMatrix(matrix) for name, matrix in op4.read(str(path), sparse=None).items()}
