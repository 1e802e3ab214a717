"""Matrices of Nastran as DMIG entries, in punch and bulk data files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyyeti import nastran

from linkwise.model.matrix_files.file_matrix import FileMatrix, degree_of_freedom, require_last_line


def read_matrices(path: Path) -> dict[str, FileMatrix]:
    """Every square matrix by its name in capitals, such as "KAAX"; entries that are not given are 0.

    Raises ValueError for a file that ends within a line.
    """
    content = path.read_bytes()
    if b"DMIG" not in content.upper():
        return {}
    require_last_line(content)
    matrices = {}
    for name, frame in nastran.rddmig(str(path), square=True, follow_includes=False).items():
        rows = [tuple(map(int, row)) for row in frame.index]
        if rows == [column if isinstance(column, tuple) else () for column in frame.columns]:
            matrices[name.upper()] = FileMatrix(
                np.asarray(frame), tuple(degree_of_freedom(node, direction) for node, direction in rows)
            )
    return matrices
