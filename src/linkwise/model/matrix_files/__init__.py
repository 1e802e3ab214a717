"""Files of matrices. Each format is one module, imported when a file with its suffix is used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from linkwise.errors import StructureError
from linkwise.model.matrix_files.file_matrix import FileMatrix
from linkwise.model.matrix_files.isolated import read_isolated
from linkwise.registry import Registry


@dataclass(frozen=True)
class MatrixFormat:
    """A format of matrices: the full name of its module, and the library of the extra [nastran] that it needs.

    The module has a `read_matrices(path)` that gives every `FileMatrix` by name. Reading is `isolated` in a process of its own
    where a library might crash on a damaged file.
    """

    module: str
    library: str | None = None
    isolated: bool = False


FORMATS: Registry[MatrixFormat] = Registry(
    "suffix",
    {
        ".mat": MatrixFormat("linkwise.model.matrix_files.mat", isolated=True),
        ".npz": MatrixFormat("linkwise.model.matrix_files.npz"),
        ".mtx": MatrixFormat("linkwise.model.matrix_files.mtx"),
        ".pch": MatrixFormat("linkwise.model.matrix_files.dmig", library="pyyeti", isolated=True),
        ".dmig": MatrixFormat("linkwise.model.matrix_files.dmig", library="pyyeti", isolated=True),
        ".bdf": MatrixFormat("linkwise.model.matrix_files.dmig", library="pyyeti", isolated=True),
        ".op4": MatrixFormat("linkwise.model.matrix_files.op4", library="pyyeti", isolated=True),
    },
)
"""The formats by the suffix of their files."""


def read_matrices(path: Path) -> Mapping[str, FileMatrix]:
    """Every matrix of a file by its name.

    Raises StructureError for a file that is not there, has another format or cannot be read.
    """
    if not path.is_file():
        raise StructureError("there is no such file", str(path))
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        *most, last = FORMATS
        raise StructureError(f"matrices are read from {', '.join(most)} and {last} files", str(path))
    matrix_format = FORMATS[suffix]
    if matrix_format.library is not None and find_spec(matrix_format.library) is None:
        raise StructureError(
            f"reading matrices from {suffix} files needs the library {matrix_format.library}: install linkwise[nastran]",
            str(path),
        )
    if matrix_format.isolated:
        return read_isolated(matrix_format.module, path)
    try:
        matrices: Mapping[str, FileMatrix] = import_module(matrix_format.module).read_matrices(path)
    except StructureError:
        raise
    except Exception as error:  # format libraries raise all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"cannot be read as a {suffix} file: {reason[:200]}", str(path)) from None
    return matrices
