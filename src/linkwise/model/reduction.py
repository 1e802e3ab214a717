"""Hosts from matrices of a finite-element model: the lowest modes, and the flexibility of the others at the points.

Modes that are left out still give way under a force at a point: by K^-1 less the sum of phi phi'/w^2 over those kept. The
residual attachment modes have this flexibility: what is left of the static response to a unit force at each point, made
modes by the eigenvalues of the matrices in their span. Without them a link would be felt too stiff by a point that is too
stiff (R. H. MacNeal, Comput. Struct. 1, 581 (1971); S. Rubin, AIAA J. 13, 995 (1975)).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeAlias

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.host import DIRECTIONS, Host, HostMode, Pair
from linkwise.model.link import ANGLE, LENGTH


@dataclass(frozen=True, eq=False)
class HostReduction:
    """A host from matrices, and what the reduction leaves out.

    Attributes
    ----------
    host : Host
        The kept modes and the residual attachment modes.
    kept : int
        The number of modes that are natural modes of the matrices.
    band : float
        Frequency in Hz at which `error` is computed: half that of the first mode that was left out, or up to a tenth less
        where a kept mode is in resonance.
    error : float
        Relative error of the receptances between the points there, by their Frobenius norm; less at lower frequencies, but
        for antiresonances.
    damping_coupling : float
        Largest motion of one mode, as a part of that of another at resonance, that a damping matrix causes which is not
        diagonal in the modes [1]_; infinite between modes of one frequency. Pairs of modes with more than 0.1 % are in the
        `damping` of the host.
    total_mass : float or None
        Mass in kg of the model, where its degrees of freedom are named.
    massless : int
        Degrees of freedom without mass, which follow the others statically.

    References
    ----------
    .. [1] T. K. Hasselman, AIAA J. 14, 1627 (1976).

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from scipy.sparse import csc_array
    >>> stiffness = csc_array(1e4 * (2.0 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)))
    >>> reduced = lw.modal.HostMatrices(csc_array(0.1 * np.eye(9)), stiffness).reduce("rod", {"mid": 5}, keep=2)
    >>> round(reduced.band, 1)
    22.8
    """

    host: Host
    kept: int
    band: float
    error: float
    damping_coupling: float = 0.0
    total_mass: float | None = None
    massless: int = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before the host is used: what was left out, and what may be wrong with the matrices."""
        notes = [
            f"{self.kept} modes and {len(self.host.modes) - self.kept} residual ones; at {self.band:.4g} Hz the receptances "
            f"at the points are off by {100.0 * self.error:.2g} %"
        ]
        pairs = sum(first != second for first, second in self.host.damping)
        if pairs:
            notes.append(
                f"the damping matrix couples {pairs} {'pair' if pairs == 1 else 'pairs'} of modes, one of which moves by "
                f"up to {100.0 * self.damping_coupling:.3g} % of the other at resonance"
            )
        free = sum(mode.frequency.value == 0.0 for mode in self.host.modes)
        if free:
            notes.append(
                f"{free} {'mode is' if free == 1 else 'modes are'} at 0 Hz: the model is free to move; if the structure is "
                "not, take matrices with its boundary conditions"
            )
        if self.massless:
            notes.append(
                f"{self.massless} degrees of freedom have no mass and follow the others statically; if they should have mass, "
                "the mass matrix is not complete"
            )
        if self.total_mass is not None:
            notes.append(f"the model weighs {self.total_mass:.4g} kg, its matrices being taken in SI units")
        return tuple(notes)


_DENSE = 400  # degrees of freedom up to which all eigenvalues are computed
# of the largest stiffness over mass: a square of a frequency below is 0
_ROUNDING = 100.0 * float(np.finfo(float).eps)
# of the first elastic square of a frequency: makes the static response of a free structure finite
_SOFT = 1e-3
_SHIFT = 1e-8  # of the mean stiffness over mass: makes the stiffness of a free structure regular
# 1/s^2, the largest stiffness over mass of a degree of freedom: any real structure moves faster
_SLOWEST = 1e-2
_ROUNDED = 1e-9  # of the largest modal damping: none
_COUPLED = 1e-3  # of the motion of one mode at resonance: of another that damping between both gives, below which it is none
_RESIDUAL = 1e-10  # of the largest: residual flexibility that is none
_NEAR = 0.01  # of a frequency: a mode so close to that of the error is in resonance there
_BELOW = np.linspace(0.99, 0.9, 10)  # frequencies that are tried then

Matrix: TypeAlias = scipy.sparse.sparray | scipy.sparse.spmatrix


def _off_resonance(omega: float, modes: Floats) -> float:
    """The angular frequency `omega`, or one somewhat below it that is farther from all `modes` (k,) in resonance."""
    trials = omega * np.append(1.0, _BELOW)
    distances = np.abs(trials[:, None] / modes[modes > 0.0] - 1.0).min(axis=1, initial=np.inf)
    return float(trials[0 if distances[0] > _NEAR else np.argmax(distances)])


def real_square(matrix: Matrix, what: str, where: str = "") -> scipy.sparse.csc_array:
    """The matrix in double precision, by columns; StructureError unless it is square, of finite real numbers."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise StructureError(f"{what} must be square, got the shape {matrix.shape}", where)
    if matrix.dtype.kind not in "fiu":
        raise StructureError(
            f"{what} holds {matrix.dtype} values, not real numbers; damping is given by a matrix of its own, "
            "modal_damping or rayleigh",
            where,
        )
    by_columns = scipy.sparse.csc_array(matrix, dtype=float)
    entries = scipy.sparse.coo_array(by_columns)
    for worst in np.flatnonzero(~np.isfinite(entries.data))[:1]:
        row, column = (places[worst] + 1 for places in entries.coords)
        raise StructureError(
            f"{what} holds {entries.data[worst]}, not a finite number, in row {row} and column {column}; write it again from "
            "the program that made it",
            where,
        )
    return by_columns


def _factor(matrix: scipy.sparse.csc_array) -> scipy.sparse.linalg.SuperLU:
    """LU factors of a symmetric matrix, ordered and pivoted as one."""
    how = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.1, "options": {"SymmetricMode": True}}
    try:
        return scipy.sparse.linalg.splu(scipy.sparse.csc_array(matrix), **how)
    except RuntimeError as error:
        problem = f"the matrices cannot be factorised ({error})"
        raise StructureError(f"{problem}; a degree of freedom is not constrained") from None


def _of_damping_matrix(frequencies: Floats, modal: Floats) -> tuple[Floats, float, dict[Pair, Coefficient]]:
    """Damping ratios (k,), the largest coupling, and the other entries of a damping matrix (k, k) of mass-normalised modes."""
    omega, own = 2.0 * np.pi * frequencies, modal.diagonal()
    largest = float(np.abs(modal).max(initial=0.0))
    if (own < -_ROUNDED * largest).any():
        raise StructureError("the damping matrix feeds energy into a mode: its sign may be wrong")
    forces = np.abs(modal - np.diag(own)) * omega  # of the columns' modes at resonance, on those of the rows
    apart = np.abs(np.subtract.outer(omega**2, omega**2))
    coupled = forces > _ROUNDED * largest * omega.max(initial=0.0)
    coupling = np.zeros_like(modal)
    with np.errstate(divide="ignore"):
        coupling[coupled] = forces[coupled] / apart[coupled]
    rigid = omega == 0.0
    both_rigid = np.outer(rigid, rigid) & (np.abs(modal) > _ROUNDED * largest)
    kept_pairs = (np.maximum(coupling, coupling.T) > _COUPLED) | both_rigid
    entries = {
        (row + 1, column + 1): Coefficient.number(float(modal[row, column]))
        for row, column in np.argwhere(np.triu(kept_pairs)).tolist()
    }
    ratios = np.maximum(own, 0.0) / (2.0 * np.where(rigid, np.inf, omega))
    return np.asarray(ratios), float(coupling.max(initial=0.0)), entries


_ROUNDED_DIRECTION = 1e-3  # of the length of a direction: cosines of three digits
_NUMBER = r"\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?"
_TERM = re.compile(rf"\s*([+-]?)\s*(?:({_NUMBER})\s*\*\s*)?([^\s*+-]+)\s*")


def _row_weights(text: str) -> dict[str, float]:
    """Factors of degrees of freedom by name, of a name or a sum of names with factors; the text itself with 1 where it is
    no such sum.
    """
    weights: dict[str, float] = {}
    place = 0
    while place < len(text):
        term = _TERM.match(text, place)
        if term is None or (place > 0 and not term[1]):
            return {text: 1.0}
        sign, factor, name = term.groups()
        weights[name] = weights.get(name, 0.0) + (-1.0 if sign == "-" else 1.0) * float(factor or 1.0)
        place = term.end()
    return weights or {text: 1.0}


def _turns_throughout(text: str) -> bool:
    """Whether a point is a rotation, or a sum of rotations; with translations, rotations times a lever are one."""
    return all(DIRECTIONS[ANGLE].fullmatch(name) for name in _row_weights(text))


def _require_direction(point: str, weights: Mapping[str, float]) -> None:
    """Check that a point moves, and that a direction of one node has the length 1: else StructureError, as forces and
    stiffnesses there would be wrong by the length and its square.
    """
    length = math.hypot(*weights.values())
    if length == 0.0:
        raise StructureError(f'the point "{point}" does not move: its factors cancel')
    nodes = {match[1] if (match := DIRECTIONS[LENGTH].fullmatch(name)) else "" for name in weights}
    if len(weights) > 1 and len(nodes) == 1 and "" not in nodes and abs(length - 1.0) > _ROUNDED_DIRECTION:
        cosines = " ".join(f"{weight / length:+.4f}*{name}" for name, weight in weights.items())
        raise StructureError(
            f'the factors of the point "{point}" are no direction of node {nodes.pop()}: their squares add up to '
            f'{length**2:.4g}, not 1; write "{cosines}"'
        )


@dataclass(frozen=True, eq=False)
class HostMatrices:
    """Matrices of a finite-element model, with the names of its degrees of freedom.

    Attributes
    ----------
    mass, stiffness : scipy.sparse.csc_array
        The matrices in SI units, of shape (n, n), constrained as the structure is: without the degrees of freedom that are
        held fixed. Given in any sparse format; symmetric, the mass positive semidefinite: a degree of freedom may be without
        mass.
    damping : scipy.sparse.csc_array or None
        The matrix of viscous damping, if there is one.
    names : tuple of str
        The degree of freedom of each row: node and direction, such as ``"12z"`` or ``"12rx"``, or, where the files do not say
        them and by default, the number of the row in the files, counted from 1.

    Raises
    ------
    StructureError
        If a matrix is not square or holds other than finite real numbers, or there is not one name for each row.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from scipy.sparse import csc_array, diags_array
    >>> stiffness = csc_array(1e4 * diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(30, 30)))
    >>> matrices = lw.modal.HostMatrices(csc_array(0.1 * np.eye(30)), stiffness)
    >>> reduced = matrices.reduce("rod", {"mid": 15}, keep=4)
    >>> reduced.kept, len(reduced.host.modes), reduced.error < 0.01
    (4, 5, True)
    """

    mass: scipy.sparse.csc_array
    stiffness: scipy.sparse.csc_array
    damping: scipy.sparse.csc_array | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for quantity in ("mass", "stiffness", "damping"):
            if (matrix := getattr(self, quantity)) is not None:
                object.__setattr__(self, quantity, real_square(matrix, f"the {quantity} matrix"))
        rows = range(1, self.stiffness.shape[0] + 1)
        object.__setattr__(self, "names", self.names or tuple(map(str, rows)))
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
        """Reduce the matrices to a host.

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
            If there is no such degree of freedom or it is held fixed, damping is given twice, or the matrices differ in size,
            are not symmetric or have not so many modes.

        Examples
        --------
        >>> import linkwise as lw
        >>> from scipy.sparse import eye_array
        >>> matrices = lw.modal.HostMatrices(eye_array(2).tocsc(), 100.0 * eye_array(2).tocsc(), None, ("7x", "7y"))
        >>> matrices.reduce("post", {"tip": "7y"}, keep=1).kept
        1
        """
        if rayleigh is not None and modal_damping:
            raise StructureError("give modal damping or Rayleigh damping, not both")
        if self.damping is not None and (rayleigh is not None or modal_damping):
            raise StructureError("give a damping matrix, or modal or Rayleigh damping, not both")
        if not points:
            advice = "name a row of the matrices, such as tip = 1205"
            raise StructureError(f"a host needs at least one point: {advice}")
        if keep < 1:
            raise StructureError(f"the number of kept modes must be at least 1, got {keep}")
        self._check_matrices()
        at_points = np.zeros((len(self.names), len(points)))
        for column, (point, given) in enumerate(points.items()):
            for row, weight in self._weights(point, str(given)).items():
                at_points[row, column] = weight
        massless = int(np.count_nonzero(self.mass.diagonal() == 0.0))
        keep = min(keep, max(len(self.names) - massless - 1, 1))
        squares, shapes = self._lowest_modes(keep)
        following = float(squares[keep]) if len(squares) > keep else 4.0 * float(squares[-1])
        squares, shapes = squares[:keep], shapes[:, :keep]
        kept = len(squares)
        if residual:
            more, attached = self._residual_modes(squares, shapes, at_points, following)
            squares, shapes = np.append(squares, more), np.concatenate([shapes, attached], axis=1)
        frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
        ratios, coupling, between = self._modal_damping(frequencies, shapes, modal_damping, rayleigh)
        local = at_points.T @ shapes
        modes = tuple(
            HostMode(frequency, ratio, dict(zip(points, column, strict=True)))
            for frequency, ratio, *column in np.column_stack([frequencies, ratios, local.T]).tolist()
        )
        square = _off_resonance(0.5 * np.sqrt(following), np.sqrt(np.maximum(squares, 0.0))) ** 2
        exact = at_points.T @ _factor(self.stiffness - square * self.mass).solve(at_points)
        approximate = (local / (squares - square)) @ local.T
        error = float(np.linalg.norm(approximate - exact) / np.linalg.norm(exact))
        turning = {point: ANGLE for point, given in points.items() if _turns_throughout(str(given))}
        host, band = Host(name, modes, damping=between), float(np.sqrt(square) / (2.0 * np.pi))
        others = kept, band, error, coupling, self.total_mass, massless
        return HostReduction(host.with_units(turning), *others)

    def _check_matrices(self) -> None:
        """Raise StructureError for what cannot be reduced."""
        mass, size = self.mass, self.mass.shape[0]
        others = {"stiffness": self.stiffness} | ({} if self.damping is None else {"damping": self.damping})
        for quantity, matrix in others.items():
            if mass.shape != matrix.shape:
                raise StructureError(
                    f"the mass matrix has {size} rows and the {quantity} matrix {matrix.shape[0]}; they belong to different "
                    "models"
                )
        for quantity, matrix in {"mass": mass, **others}.items():
            largest = float(np.abs(matrix.data).max(initial=0.0))
            skew = scipy.sparse.coo_array(matrix - matrix.T)
            if float(np.abs(skew.data).max(initial=0.0)) > 1e-6 * largest:
                worst = int(np.argmax(np.abs(skew.data)))
                row, column = (int(places[worst]) for places in skew.coords)
                raise StructureError(
                    f"the {quantity} matrix is not symmetric: row {row + 1} and column {column + 1} hold "
                    f"{matrix[row, column]:.6g}, row {column + 1} and column {row + 1} {matrix[column, row]:.6g}; a host is a "
                    "linear structure that conserves energy. If the file has one triangle only, add the other"
                )
        of_mass, of_stiffness = mass.diagonal(), self.stiffness.diagonal()
        if (of_mass < 0.0).any() or not of_mass.any():
            raise StructureError(
                "the mass matrix must be positive semidefinite, and has a negative mass or none: check that mass and "
                "stiffness are not swapped"
            )
        for loose in np.flatnonzero((of_mass == 0.0) & (of_stiffness <= 0.0))[:1]:
            named = f"row {self.names[loose]}" if self.names[loose].isdecimal() else self.names[loose]
            message = (
                f"{named} has neither mass nor stiffness: leave this degree of freedom out, or constrain it"
            )
            raise StructureError(message)
        if 0.0 < self._stiffest < _SLOWEST:
            raise StructureError(
                f"with these matrices nothing moves faster than about {np.sqrt(self._stiffest) / (2.0 * np.pi):.2g} Hz: mass "
                "and stiffness may be swapped, the mass matrix being the first of the two, or in units that are not of one "
                "system"
            )

    @property
    def _stiffest(self) -> float:
        """The largest stiffness over mass of a degree of freedom with mass."""
        of_mass = self.mass.diagonal()
        return float(np.max(self.stiffness.diagonal()[of_mass > 0.0] / of_mass[of_mass > 0.0]))

    def _lowest_modes(self, keep: int) -> tuple[Floats, Floats]:
        """Squares (k,) of the angular frequencies of the lowest modes and one more, and mass-normalised shapes (n, k)."""
        mass, stiffness = self.mass, self.stiffness
        size, with_mass = mass.shape[0], int(np.count_nonzero(mass.diagonal()))
        count = min(keep + 1, with_mass)
        shift = -_SHIFT * float(stiffness.diagonal().sum() / mass.diagonal().sum())
        try:
            if size <= _DENSE and with_mass == size:
                lowest = (0, count - 1)
                squares, shapes = scipy.linalg.eigh(
                    stiffness.toarray(), mass.toarray(), subset_by_index=lowest
                )
            elif size <= _DENSE:  # 1/(w^2 - shift) exists where the mass matrix is singular
                inverses, shapes = scipy.linalg.eigh(
                    mass.toarray(),
                    (stiffness - shift * mass).toarray(),
                    subset_by_index=(size - count, size - 1),
                )
                squares = 1.0 / inverses + shift
            else:
                inverse = scipy.sparse.linalg.LinearOperator(
                    mass.shape, _factor(stiffness - shift * mass).solve
                )
                start = np.ones(mass.shape[0])  # eigsh draws one at random otherwise
                how: dict[str, Any] = {"sigma": shift, "which": "LM", "v0": start, "OPinv": inverse}
                squares, shapes = scipy.sparse.linalg.eigsh(stiffness, count, mass, **how)
        except (np.linalg.LinAlgError, RuntimeError) as error:
            raise StructureError(
                f"the modes of the matrices cannot be computed ({error}); the mass matrix must be positive definite, and "
                "may be swapped with the stiffness"
            ) from None
        order = np.argsort(squares)
        squares, shapes = squares[order], shapes[:, order]
        rounding = _ROUNDING * self._stiffest
        squares = np.where(np.abs(squares) < rounding, 0.0, squares)
        if (squares < 0.0).any():
            problem = "the stiffness matrix has negative eigenvalues"
            raise StructureError(f"{problem}: the structure it describes is not stable")
        return squares, shapes / np.sqrt(np.einsum("ir,ir->r", shapes, mass @ shapes))

    def _residual_modes(
        self, squares: Floats, shapes: Floats, at_points: Floats, following: float
    ) -> tuple[Floats, Floats]:
        """Squares (p,) and shapes (n, p) of modes with the flexibility at the points that the kept modes lack."""
        mass, stiffness, shift = self.mass, self.stiffness, 0.0
        if (squares == 0.0).any():
            shift = _SOFT * float(min(squares[squares > 0.0], default=following))
        static = _factor(stiffness + shift * mass).solve(at_points)
        static -= shapes @ ((shapes.T @ at_points) / (squares + shift)[:, None])
        static -= shapes @ (shapes.T @ (mass @ static))  # rounding
        of_mass, of_stiffness = static.T @ (mass @ static), static.T @ (stiffness @ static)
        scale = np.sqrt(of_mass.diagonal())
        scale[scale == 0.0] = 1.0
        values, vectors = np.linalg.eigh(of_mass / np.outer(scale, scale))
        basis = (vectors / scale[:, None])[:, values > _RESIDUAL * values.max()]
        reduced = scipy.linalg.eigh(basis.T @ of_stiffness @ basis, basis.T @ of_mass @ basis)
        return np.asarray(reduced[0]), np.asarray(static @ basis @ reduced[1])

    def _modal_damping(
        self, frequencies: Floats, shapes: Floats, ratio: float, rayleigh: tuple[float, float] | None
    ) -> tuple[Floats, float, dict[Pair, Coefficient]]:
        """What `_of_damping_matrix` gives, of modes with these frequencies (k,) and shapes (n, k): by the damping matrix, by
        factors of a matrix a M + b K, or by the ratio of every mode.
        """
        if self.damping is not None:
            return _of_damping_matrix(frequencies, shapes.T @ (self.damping @ shapes))
        if rayleigh is None:
            return np.full(len(frequencies), ratio), 0.0, {}
        omega = 2.0 * np.pi * frequencies
        if (omega == 0.0).any() and rayleigh[0] != 0.0:
            message = "Rayleigh damping of a free structure damps its rigid motion; give modal damping, or a damping matrix"
            raise StructureError(message)
        return 0.5 * (rayleigh[0] / np.where(omega > 0.0, omega, 1.0) + rayleigh[1] * omega), 0.0, {}

    def _weights(self, point: str, given: str) -> dict[int, float]:
        """Factors of rows, counted from 0, of which a point is the sum."""
        numbers = {name: number for number, name in enumerate(self.names)}
        weights = {given: 1.0} if given in numbers else _row_weights(given)
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
        _require_direction(point, weights)
        return {numbers[name]: weight for name, weight in weights.items()}
