"""Matrices of a finite-element model from files: mass, stiffness and damping of the same degrees of freedom.

A matrix is named "FILE:NAME", or "FILE" where the file holds one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import scipy

from linkwise.display import near_miss
from linkwise.errors import StructureError
from linkwise.model.link import ANGLE
from linkwise.model.matrix_files import FileMatrix
from linkwise.model.matrix_files import read_matrices as matrices_of_file
from linkwise.model.reduction import HostReduction, proportional_damping, real_square, reduce_matrices
from linkwise.model.rotations import require_direction, row_weights, turns_throughout, with_units

# in MAT and NPZ files, and those of Nastran; not KGG, which no boundary condition constrains
_USUAL = {"mass": ("M", "mass", "MAAX", "MAA"), "stiffness": ("K", "stiffness", "KAAX", "KAA")}
_CONSTRAINED = 1e36  # stiffness that Abaqus adds where a boundary condition holds a degree of freedom


@dataclass(frozen=True, eq=False)
class HostMatrices:
    """Matrices of a finite-element model, with the names of its degrees of freedom.

    Attributes
    ----------
    mass, stiffness : scipy.sparse.csc_array
        The matrices, of shape (n, n), without the degrees of freedom that the file holds fixed.
    damping : scipy.sparse.csc_array or None
        The matrix of viscous damping, if it was asked for.
    names : tuple of str
        The degree of freedom of each row: node and direction, such as ``"12z"`` or ``"12rx"``, or, where the files do not say
        them, the number of the row in the files, counted from 1.

    Raises
    ------
    StructureError
        If there is not one name for each row.

    See Also
    --------
    reduce_host : A host from matrices.

    Examples
    --------
    >>> import linkwise as lw
    >>> from scipy.sparse import eye_array
    >>> matrices = lw.modal.HostMatrices(eye_array(2).tocsc(), 100.0 * eye_array(2).tocsc(), None, ("7x", "7y"))
    >>> round(matrices.reduce("post", {"tip": "7y"}, keep=1).host.modes[0].frequency.value, 3)
    1.592
    """

    mass: scipy.sparse.csc_array
    stiffness: scipy.sparse.csc_array
    damping: scipy.sparse.csc_array | None
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names) or len(self.names) != self.stiffness.shape[0]:
            raise StructureError(
                f"{len(set(self.names))} different names are given for {self.stiffness.shape[0]} degrees of freedom; give "
                "each row its own"
            )

    @property
    def total_mass(self) -> float | None:
        """Mass in kg that moves when all nodes move alike, in the direction in which it is largest.

        Degrees of freedom that are held fixed have none. None where the files do not name directions.
        """
        masses = []
        for direction in ("x", "y", "z"):
            moving = np.array([re.fullmatch(rf"-?\d+{direction}", name) is not None for name in self.names])
            if moving.any():
                masses.append(float(moving @ (self.mass @ moving.astype(float))))
        return max(masses, default=None)

    def reduce(
        self,
        name: str,
        points: Mapping[str, int | str],
        *,
        keep: int = 10,
        modal_damping: float = 0.0,
        rayleigh: tuple[float, float] | None = None,
        residual: bool = True,
    ) -> HostReduction:
        """Reduce the matrices to a host, as `reduce_host` does.

        Parameters
        ----------
        name : str
            Name of the host.
        points : mapping of str to int or str
            For each point the name of its degree of freedom, the number of a row, or a sum of such with factors: a direction
            oblique to the axes is ``"0.6*12x + 0.8*12z"``, with the cosines of its angles. A sum of rotations, such as
            ``"21ry"``, is a rotation in rad.
        keep : int, optional
            Number of the lowest modes that are kept, at most.
        modal_damping : float, optional
            Damping of every mode as a part of the critical one, where there is no damping matrix.
        rayleigh : tuple of float, optional
            Factors a in 1/s and b in s of a damping matrix a M + b K, instead.
        residual : bool, optional
            Whether residual attachment modes stand for the modes that are left out.

        Returns
        -------
        HostReduction
            The host and the error of the reduction.

        Raises
        ------
        StructureError
            If there is no such degree of freedom or it is held fixed, damping is given twice, or `reduce_host` would refuse
            the matrices.

        Examples
        --------
        >>> import linkwise as lw
        >>> from scipy.sparse import eye_array
        >>> matrices = lw.modal.HostMatrices(eye_array(2).tocsc(), 100.0 * eye_array(2).tocsc(), None, ("7x", "7y"))
        >>> matrices.reduce("post", {"tip": "7y"}, keep=1).kept
        1
        """
        loose = np.flatnonzero((self.mass.diagonal() == 0.0) & (self.stiffness.diagonal() == 0.0))
        if len(loose):
            raise StructureError(
                f"{self.names[loose[0]]} has neither mass nor stiffness: leave this degree of freedom out, or constrain it"
            )
        damping = proportional_damping(modal_damping, rayleigh)
        if damping is not None and self.damping is not None:
            raise StructureError("give a damping matrix, or modal or Rayleigh damping, not both")
        reduced = reduce_matrices(
            name,
            self.mass,
            self.stiffness,
            {point: self._weights(point, str(given)) for point, given in points.items()},
            keep=keep,
            damping=damping or (0.0 if self.damping is None else self.damping),
            residual=residual,
        )
        turning = {point: ANGLE for point, given in points.items() if turns_throughout(str(given))}
        return replace(reduced, host=with_units(reduced.host, turning), total_mass=self.total_mass)

    def _weights(self, point: str, given: str) -> dict[int, float]:
        """Factors of rows, counted from 1, of which a point is the sum."""
        numbers = {name: number for number, name in enumerate(self.names, start=1)}
        weights = {given: 1.0} if given in numbers else row_weights(given)
        missing = next((name for name in weights if name not in numbers), None)
        if missing is not None:
            first, last = self.names[0], self.names[-1]
            if first.isdecimal() and last.isdecimal():
                fixed = "; rows that are held fixed are left out" if int(last) > len(self.names) else ""
                named = f"the matrices have rows {first} to {last}, counted from 1{fixed}"
            else:
                near = get_close_matches(missing, self.names, n=3) or self.names[:3]
                named = "its file names points by node and direction, and has none of this name that is not held fixed; "
                named += f"nearest are {', '.join(near)}"
            raise StructureError(f'the point "{point}" is {given}, but {named}')
        require_direction(point, weights)
        return {numbers[name]: weight for name, weight in weights.items()}


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
    matrices = matrices_of_file(path)
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
