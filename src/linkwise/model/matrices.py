"""Matrices of finite-element models from files: MAT, NPZ and MatrixMarket.

A matrix is named "FILE:NAME", or "FILE" where the file holds one. MAT files are read in a process of their own, since the
library that reads them may crash on a damaged file.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scipy

from linkwise.argument_types import checked
from linkwise.errors import StructureError
from linkwise.text import near_miss

_SECONDS = 600.0  # that a file may take
_CHILD = "import sys; sys.path[:] = {path!r}; from linkwise.model.matrices import main; main()"


@checked
def read_matrix(named: str, folder: str | Path = ".") -> scipy.sparse.csc_array:
    """Read a matrix of a finite-element model.

    Parameters
    ----------
    named : str
        ``"FILE:NAME"``, or ``"FILE"`` where the file holds one matrix; a MAT, NPZ or MatrixMarket (MTX) file.
    folder : str or Path, optional
        The folder from which a relative name counts.

    Returns
    -------
    scipy.sparse.csc_array
        The matrix.

    Raises
    ------
    StructureError
        If the file cannot be read, or holds no such matrix.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     np.savez(Path(folder) / "beam.npz", M=np.eye(3))
    ...     lw.read_matrix("beam.npz:M", folder).shape
    (3, 3)
    """
    file, name = _file_and_name(named)
    path = Path(folder) / file
    source = str(path)
    if not path.is_file():
        raise StructureError("there is no such file", source)
    try:
        matrices = _read(path)
    except StructureError:
        raise
    except Exception as error:  # format libraries raise all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"cannot be read as a {path.suffix} file: {reason[:200]}", source) from None
    if name is None and len(matrices) == 1:
        name = next(iter(matrices))
    if name not in matrices:
        problem = f"holds no matrix {name!r}{near_miss(name, matrices)}" if name else "holds several matrices"
        raise StructureError(
            f"{problem}; choose from {', '.join(matrices) or 'none'}, as in {file}:NAME", source
        )
    if matrices[name].dtype.kind not in "fiu":
        raise StructureError(f"{name} holds {matrices[name].dtype} values, not real numbers", source)
    matrix = scipy.sparse.csc_array(matrices[name]).astype(float)
    if matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix.data).all():
        raise StructureError(
            f"{name} is not a square matrix of finite numbers: it has {matrix.shape[0]} rows and {matrix.shape[1]} columns",
            source,
        )
    return matrix


def _file_and_name(named: str) -> tuple[str, str | None]:
    """The file and the name in it; a colon in second place is that of a drive."""
    file, colon, name = named.rpartition(":")
    return (file, name) if colon and len(file) > 1 else (named, None)


def _read(path: Path) -> dict[str, Any]:
    """All matrices of a file by name."""
    match path.suffix.lower():
        case ".npz":
            return _of_npz(path)
        case ".mtx":
            return {path.stem: scipy.io.mmread(path, spmatrix=False)}
        case ".mat":
            return _in_a_child(path)
    raise StructureError("matrices are read from .mat, .npz and .mtx files", str(path))


def _of_npz(path: Path) -> dict[str, Any]:
    with np.load(path, allow_pickle=False) as arrays:
        if {"format", "data", "indices", "indptr", "shape"} <= set(arrays.files):
            return {path.stem: scipy.sparse.load_npz(path)}
        return {name: arrays[name] for name in arrays.files if arrays[name].ndim == 2}


def _in_a_child(path: Path) -> dict[str, Any]:
    """The matrices of a MAT file, read by `main` in another process."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _CHILD.format(path=sys.path), str(path), folder]
        try:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise StructureError(f"reading did not end after {_SECONDS:g} s", str(path)) from None
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["the library that reads it crashed"])[-1]
            raise StructureError(f"cannot be read as a MAT file: {last[:200]}", str(path))
        return {file.stem: scipy.sparse.load_npz(file) for file in sorted(Path(folder).glob("*.npz"))}


def main() -> None:
    """Write every matrix of the MAT file that the command names into the folder that it names."""
    path, folder = sys.argv[1:]
    for name, value in scipy.io.loadmat(path, spmatrix=False).items():
        numeric = scipy.sparse.issparse(value) or (
            isinstance(value, np.ndarray) and value.dtype.kind in "fiuc"
        )
        if numeric and len(value.shape) == 2 and not name.startswith("__"):
            scipy.sparse.save_npz(Path(folder) / f"{name}.npz", scipy.sparse.csc_array(value))
