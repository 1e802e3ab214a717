"""Matrices in MAT files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from linkwise.model.matrix_files.file_matrix import FileMatrix


def read_matrices(path: Path) -> dict[str, FileMatrix]:
    """Every matrix of numbers by the name of its variable."""
    return {
        name: FileMatrix(value)
        for name, value in scipy.io.loadmat(path, spmatrix=False).items()
        if not name.startswith("__") and _is_matrix(value)
    }


def _is_matrix(value: object) -> bool:
    if scipy.sparse.issparse(value):
        return True
    return isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiuc"
