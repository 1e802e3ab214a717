"""Reading in a process of its own, since the libraries of binary formats may crash on a damaged file."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import scipy

from linkwise.errors import StructureError
from linkwise.model.matrix_files.file_matrix import FileMatrix

_SECONDS = 600.0  # that a file may take
_CHILD = "import sys; sys.path[:] = {path!r}; from linkwise.model.matrix_files.isolated import main; main()"
_NAMES = "names.json"


def read_isolated(module: str, path: Path) -> dict[str, FileMatrix]:
    """What `read_matrices` of the module with this full name finds in the file.

    Raises StructureError for a file that cannot be read, or where reading crashes or does not end.
    """
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-c", _CHILD.format(path=sys.path), module, str(path), folder]
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
            raise StructureError(f"cannot be read as a {path.suffix} file: {last[:200]}", str(path))
        names = json.loads((Path(folder) / _NAMES).read_text(encoding="utf-8"))
        return {
            name: FileMatrix(scipy.sparse.load_npz(Path(folder) / f"{number}.npz"), tuple(rows))
            for number, (name, rows) in enumerate(names)
        }


def main() -> None:
    """Write every matrix that the module finds in the file into the folder, all three named by the command."""
    module, path, folder = sys.argv[1:]
    matrices: dict[str, FileMatrix] = import_module(module).read_matrices(Path(path))
    for number, matrix in enumerate(matrices.values()):
        scipy.sparse.save_npz(Path(folder) / f"{number}.npz", scipy.sparse.csc_array(matrix.matrix))
    names = [(name, matrix.names) for name, matrix in matrices.items()]
    (Path(folder) / _NAMES).write_text(json.dumps(names), encoding="utf-8")
