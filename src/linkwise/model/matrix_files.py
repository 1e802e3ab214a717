"""Matrices in files, each with the degrees of freedom that its rows stand for where the file says them.

MAT files of MATLAB; NPZ files, of one sparse matrix of SciPy or arrays by name; matrices of Nastran as DMIG entries in punch
and bulk data files, or in OUTPUT4 files, text or binary; and MTX files, those of MatrixMarket and those that Abaqus writes
with *MATRIX OUTPUT: an entry to a line, as row and column, or as node and direction of each, and of a symmetric matrix one
triangle. A matrix is named "FILE:NAME", or "FILE" where the file holds one; those of one model come with their rows in
one order.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats
from linkwise.display import near_miss
from linkwise.errors import StructureError
from linkwise.model.mat_file import load_mat, sound_sparse
from linkwise.model.reduction import HostMatrices, real_square
from linkwise.registry import lazy_module

nastran = lazy_module("pyyeti.nastran")  # of an extra
_DIRECTIONS = {0: "", 1: "x", 2: "y", 3: "z", 4: "rx", 5: "ry", 6: "rz"}
_OF_COORDINATES, _OF_NODES = 3, 5  # numbers to a line of Abaqus
_MIRRORED = {"general": 0, "symmetric": 1, "hermitian": 1, "skew-symmetric": -1}
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
    problem = "a node or a direction is not a whole number"
    nodes, directions = _whole(np.concatenate([rows, columns]), problem).T
    if directions.min() < 0 or directions.max() >= _CODE:
        raise ValueError(problem)
    present, numbers = np.unique(nodes * _CODE + directions, return_inverse=True)
    row, column = np.split(numbers, 2)
    names = tuple(degree_of_freedom(*divmod(int(code), _CODE)) for code in present)
    return FileMatrix(both_triangles(row, column, values, len(names)), names)


def both_triangles(
    rows: NDArray[np.int64], columns: NDArray[np.int64], values: Floats, size: int
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
    return scipy.sparse.csc_array(_with_mirrors(rows, columns, values, single), shape=(size, size))


def _with_mirrors(
    rows: NDArray[np.int64], columns: NDArray[np.int64], values: Floats, some: Bools, sign: int = 1
) -> tuple[Floats, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Entries and their rows and columns, with the mirror images of some, of this sign."""
    places = np.concatenate([rows, columns[some]]), np.concatenate([columns, rows[some]])
    return np.concatenate([values, sign * values[some]]), places


def read_matrices(path: Path) -> Mapping[str, FileMatrix]:
    """Every matrix of a file by its name.

    Raises StructureError for a file that is not there, has another format or cannot be read.
    """
    if not path.is_file():
        raise StructureError("there is no such file", str(path))
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        *most, last = _READERS
        raise StructureError(f"matrices are read from {', '.join(most)} and {last} files", str(path))
    read = _READERS[suffix]
    if read in _OF_NASTRAN and find_spec("pyyeti") is None:
        message = f"reading matrices from {suffix} files needs the library pyyeti: install linkwise[nastran]"
        raise StructureError(message, str(path))
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            np.printoptions(),
        ):  # which a library changes as it is loaded
            return read(path)
    except StructureError:
        raise
    except Exception as error:  # format libraries raise all kinds of errors on a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise StructureError(f"cannot be read as a {suffix} file: {reason[:200]}", str(path)) from None


def read_dmig(path: Path) -> dict[str, FileMatrix]:
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
            names = tuple(degree_of_freedom(node, direction) for node, direction in rows)
            matrices[name.upper()] = FileMatrix(np.asarray(frame), names)
    return matrices


def read_mat(path: Path) -> dict[str, FileMatrix]:
    """Every matrix of numbers by the name of its variable."""
    matrices = {}
    for name, value in load_mat(path).items():
        if scipy.sparse.issparse(value):
            matrices[name] = FileMatrix(sound_sparse(value))
        elif isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "fiuc":
            matrices[name] = FileMatrix(value)
    return matrices


def read_mtx(path: Path) -> dict[str, FileMatrix]:
    """The matrix under the name of the file."""
    first = _first_line(path)
    if first.startswith("%%MatrixMarket"):
        return {path.stem: FileMatrix(_matrix_market(path))}
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
    problem = "a row or a column is not a whole number from 1"
    places = _whole(table[:, :2], problem)
    if places.min() < 1:
        raise ValueError(problem)
    row, column = (places - 1).T
    return {path.stem: FileMatrix(both_triangles(row, column, table[:, 2], int(places.max())))}


def _matrix_market(path: Path) -> scipy.sparse.coo_array:
    """The matrix of a file of MatrixMarket. SciPy's reader crashes on some of those that are damaged.

    Raises ValueError for one of other than real numbers, or of more or fewer than it states.
    """
    with path.open(encoding="utf-8") as file:
        _, _, layout, field, symmetry = file.readline().lower().split()
        sizes = next(line for line in file if line.strip() and not line.startswith("%")).split()
        with warnings.catch_warnings(action="error"):  # for what is no number
            numbers = np.fromstring(file.read(), sep=" ")
    if field not in ("real", "double", "integer"):
        raise ValueError(f"its entries are {field}, not real numbers")
    if symmetry not in _MIRRORED:
        raise ValueError(f"its symmetry is {symmetry!r}")
    (size, width), mirrored = map(int, sizes[:2]), _MIRRORED[symmetry]
    triangle = size * (size + 1) // 2 - size * (mirrored < 0)
    stated = 3 * int(sizes[2]) if layout == "coordinate" else triangle if mirrored else size * width
    if len(numbers) != stated:
        raise ValueError(f"it states {stated} numbers and holds {len(numbers)}")
    if layout == "coordinate":
        entries = numbers.reshape(-1, 3)
        rows, columns = _whole(entries[:, :2], "a row or a column is not a whole number").T - 1
        values = entries[:, 2]
    else:  # column by column
        values = numbers
        of_triangle = np.triu_indices(size, k=int(mirrored < 0))
        columns, rows = of_triangle if mirrored else np.indices((width, size)).reshape(2, -1)
    off = (rows != columns) & (mirrored != 0)
    return scipy.sparse.coo_array(_with_mirrors(rows, columns, values, off, mirrored), shape=(size, width))


def _whole(places: Floats, problem: str) -> NDArray[np.int64]:
    """The numbers as integers; ValueError with the problem unless they are."""
    if not (places == np.round(places)).all():
        raise ValueError(problem)
    return places.astype(np.int64)


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


def read_npz(path: Path) -> dict[str, FileMatrix]:
    """The sparse matrix under the name of the file, or every array of two dimensions."""
    with np.load(path, allow_pickle=False) as arrays:
        if {"format", "data", "indices", "indptr", "shape"} <= set(arrays.files):
            return {path.stem: FileMatrix(scipy.sparse.load_npz(path))}
        return {name: FileMatrix(arrays[name]) for name in arrays.files if arrays[name].ndim == 2}


def read_op4(path: Path) -> dict[str, FileMatrix]:
    """Every matrix by its name in capitals, such as "KAA"."""
    matrices = nastran.op4.read(str(path), sparse=None)
    return {name.upper(): FileMatrix(matrix) for name, matrix in matrices.items()}


_OF_NASTRAN = (read_dmig, read_op4)
_READERS: dict[str, Callable[[Path], dict[str, FileMatrix]]] = {
    ".mat": read_mat,
    ".npz": read_npz,
    ".mtx": read_mtx,
    **dict.fromkeys((".pch", ".dmig", ".bdf"), read_dmig),
    ".op4": read_op4,
}
"""What gives every matrix of a file by its name, by the suffix of the file."""


# in MAT and NPZ files, and those of Nastran; not KGG, which no boundary condition constrains
_USUAL = {"mass": ("M", "mass", "MAAX", "MAA"), "stiffness": ("K", "stiffness", "KAAX", "KAA")}
_CONSTRAINED = 1e36  # stiffness that Abaqus adds where a boundary condition holds a degree of freedom


def read_host_matrices(
    mass: str, stiffness: str, damping: str | None = None, *, folder: str | Path = "."
) -> HostMatrices:
    """Read the matrices of a finite-element model, with their rows in one order.

    Parameters
    ----------
    mass, stiffness : str
        ``"FILE:NAME"``, or ``"FILE"`` where the file holds one matrix: MAT, NPZ, MatrixMarket and Abaqus files (MTX), or
        Nastran's DMIG entries (PCH, BDF) and OUTPUT4 files (OP4), for which linkwise[nastran] is installed. Of a file that
        holds several, ``"FILE"`` is the one with a usual name: M, mass, MAAX or MAA, and K, stiffness, KAAX or KAA.
    damping : str, optional
        The matrix of viscous damping.
    folder : str or Path, optional
        The folder from which relative names count.

    Returns
    -------
    HostMatrices
        The matrices. Where the files name nodes and directions, a degree of freedom that one of them lacks is 0 there; those
        that Abaqus holds fixed, by a stiffness of 1e36, are left out.

    Raises
    ------
    StructureError
        If a file cannot be read or holds no such matrix, or the matrices belong to different models.

    Examples
    --------
    >>> import linkwise as lw
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "mass.mtx").write_text("7,1, 7,1, 0.5\\n7,2, 7,2, 0.5\\n")
    ...     _ = (Path(folder) / "stiff.mtx").write_text("7,1, 7,1, 1e36\\n7,2, 7,2, 200.0\\n")
    ...     lw.modal.read_host_matrices("mass.mtx", "stiff.mtx", folder=folder).names
    ('7y',)
    """
    sources = {"mass": mass, "stiffness": stiffness} | ({"damping": damping} if damping is not None else {})
    read = {quantity: _read(source, folder, _USUAL.get(quantity, ())) for quantity, source in sources.items()}
    places = [(_file_and_name(source)[0], read[quantity][0]) for quantity, source in sources.items()]
    if places[0] == places[1]:
        raise StructureError(
            f"{places[0][1]} is taken for the mass and for the stiffness; name both matrices, or a file for each, the "
            "mass first",
            mass,
        )
    in_files = {quantity: matrix for quantity, (_, matrix) in read.items()}
    named = [quantity for quantity, matrix in in_files.items() if matrix.names]
    if named and len(named) < len(in_files):
        unnamed = next(quantity for quantity in in_files if quantity not in named)
        raise StructureError(
            f"{sources[named[0]]} names nodes and directions and {sources[unnamed]} does not; take all matrices from files "
            "of one kind"
        )
    if named:
        names = list({name: None for matrix in in_files.values() for name in matrix.names})
        matrices = {quantity: _spread(matrix, names) for quantity, matrix in in_files.items()}
    else:
        matrices = {quantity: matrix.matrix for quantity, matrix in in_files.items()}
        names = [str(row) for row in range(1, matrices["stiffness"].shape[0] + 1)]
        for quantity, matrix in matrices.items():
            if matrix.shape != matrices["stiffness"].shape:
                raise StructureError(
                    f"the {quantity} matrix has {matrix.shape[0]} rows and the stiffness matrix {len(names)}; they belong to "
                    "different models",
                    " and ".join(dict.fromkeys([sources[quantity], sources["stiffness"]])),
                )
    free = np.flatnonzero(matrices["stiffness"].diagonal() < _CONSTRAINED)
    if len(free) == 0:
        raise StructureError("every degree of freedom is held fixed", sources["stiffness"])
    if len(free) < len(names):
        matrices = {name: scipy.sparse.csc_array(matrix[free][:, free]) for name, matrix in matrices.items()}
    own = matrices["mass"], matrices["stiffness"], matrices.get("damping")
    return HostMatrices(*own, tuple(names[row] for row in free))


def read_matrix(named: str, folder: str | Path = ".") -> scipy.sparse.csc_array:
    """Read a matrix of a finite-element model.

    Parameters
    ----------
    named : str
        ``"FILE:NAME"``, or ``"FILE"`` where the file holds one matrix; of the kinds of files of `read_host_matrices`.
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

    See Also
    --------
    read_host_matrices : Matrices of one model, with the names of their rows.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     np.savez(Path(folder) / "beam.npz", M=np.eye(3))
    ...     lw.modal.read_matrix("beam.npz:M", folder).shape
    (3, 3)
    """
    return _read(named, folder)[1].matrix


def _read(named: str, folder: str | Path, usual: Sequence[str] = ()) -> tuple[str, FileMatrix]:
    """Name and matrix, as `read_matrix` gives it, with the names of its rows; without a name, a `usual` one."""
    file, name = _file_and_name(named)
    path = Path(folder) / file
    source = str(path)
    matrices = read_matrices(path)
    if not matrices:
        raise StructureError("holds no matrices", source)
    if name is None:
        name = next((usual_name for usual_name in usual if usual_name in matrices), None)
    if name is None and len(matrices) == 1:
        name = next(iter(matrices))
    if name not in matrices:
        problem = f"holds no matrix {name!r}{near_miss(name, matrices)}" if name else "holds several matrices"
        raise StructureError(f"{problem}; choose from {', '.join(matrices)}, as in {file}:NAME", source)
    chosen = matrices[str(name)]
    return str(name), FileMatrix(real_square(chosen.matrix, str(name), source), chosen.names)


def _file_and_name(named: str) -> tuple[str, str | None]:
    """The file and the name in it; a colon in second place is that of a drive."""
    file, colon, name = named.rpartition(":")
    return (file, name) if colon and len(file) > 1 else (named, None)


def _spread(chosen: FileMatrix, names: list[str]) -> scipy.sparse.csc_array:
    """The matrix (n, n) with rows in the order of `names`; 0 for those that it lacks."""
    numbers = {name: number for number, name in enumerate(names)}
    places = np.array([numbers[name] for name in chosen.names])
    entries = scipy.sparse.coo_array(chosen.matrix)
    rows, columns = entries.coords
    spread = (entries.data, (places[rows], places[columns]))
    return scipy.sparse.csc_array(spread, shape=(len(names), len(names)))
