"""Matrices in NPZ files: one sparse matrix of SciPy, or arrays by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from linkwise.model.matrix_files.file_matrix import FileMatrix


def read_matrices(path: Path) -> dict[str, FileMatrix]:
    """The sparse matrix under the name of the file, or every array of two dimensions."""
    with np.load(path, allow_pickle=False) as arrays:
        if {"format", "data", "indices", "indptr", "shape"} <= set(arrays.files):
            return {path.stem: FileMatrix(scipy.sparse.load_npz(path))}
        return {name: FileMatrix(arrays[name]) for name in arrays.files if arrays[name].ndim == 2}
