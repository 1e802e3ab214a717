"""Hosts from matrices of a finite-element model: the lowest modes, and the flexibility of the others at the points.

Modes that are left out still give way under a force at a point: by K^-1 less the sum of phi phi'/w^2 over those kept. The
residual attachment modes have this flexibility: what is left of the static response to a unit force at each point, made modes
by the eigenvalues of the matrices in their span. Without them a link would be felt too stiff by a point that is too stiff.

References
----------
R. H. MacNeal, Comput. Struct. 1, 581 (1971); S. Rubin, AIAA J. 13, 995 (1975).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.host import Host
from linkwise.model.host_mode import HostMode

_DENSE = 400  # degrees of freedom up to which all eigenvalues are computed
_ROUNDING = 100.0 * float(
    np.finfo(float).eps
)  # of the largest stiffness over mass: a square of a frequency below is 0
_SOFT = (
    1e-3  # of the first elastic square of a frequency: makes the static response of a free structure finite
)
_SHIFT = 1e-8  # of the mean stiffness over mass: makes the stiffness of a free structure regular
_SLOWEST = (
    1e-2  # 1/s^2, the largest stiffness over mass of a degree of freedom: any real structure moves faster
)
_RESIDUAL = 1e-10  # of the largest: residual flexibility that is none


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
        Frequency in Hz at which `error` is computed: half that of the first mode that was left out.
    error : float
        Relative error of the receptances between the points there, by their Frobenius norm; less at lower frequencies, but
        for antiresonances.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from scipy.sparse import csc_array
    >>> stiffness = csc_array(1e4 * (2.0 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)))
    >>> reduced = lw.reduce_host("rod", csc_array(0.1 * np.eye(9)), stiffness, {"mid": 5}, keep=2)
    >>> round(reduced.band, 1)
    22.8
    """

    host: Host
    kept: int
    band: float
    error: float


@checked
def reduce_host(
    name: str,
    mass: scipy.sparse.sparray | scipy.sparse.spmatrix,
    stiffness: scipy.sparse.sparray | scipy.sparse.spmatrix,
    points: Mapping[str, int],
    *,
    keep: int = 10,
    modal_damping: float = 0.0,
    rayleigh: tuple[float, float] | None = None,
    residual: bool = True,
) -> HostReduction:
    """Reduce the matrices of a finite-element model to a host.

    Parameters
    ----------
    name : str
        Name of the host.
    mass, stiffness : sparse array or sparse matrix of shape (n, n)
        The matrices in SI units, in any sparse format, constrained as the structure is; symmetric, the mass positive
        definite.
    points : mapping of str to int
        Row of the matrices for each point, counted from 1.
    keep : int, optional
        Number of the lowest modes that are kept, at most.
    modal_damping : float, optional
        Damping of every mode as a part of the critical one.
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
        If a matrix is not square or holds other than finite real numbers, a point is no row, the matrices differ in size or
        are not symmetric, or there are not so many modes.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from scipy.sparse import csc_array, diags_array
    >>> stiffness = csc_array(1e4 * diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(30, 30)))
    >>> reduced = lw.reduce_host("rod", csc_array(0.1 * np.eye(30)), stiffness, {"mid": 15}, keep=4)
    >>> reduced.kept, len(reduced.host.modes), reduced.error < 0.01
    (4, 5, True)
    """
    mass, stiffness = _real_square("mass", mass), _real_square("stiffness", stiffness)
    rows = _checked(mass, stiffness, points, keep)
    keep = min(keep, mass.shape[0] - 1)
    squares, shapes = _lowest(mass, stiffness, keep)
    at_points = np.zeros((mass.shape[0], len(rows)))
    at_points[rows, range(len(rows))] = 1.0
    following = float(squares[keep]) if len(squares) > keep else 4.0 * float(squares[-1])
    squares, shapes = squares[:keep], shapes[:, :keep]
    retained = len(squares)
    if residual:
        more, attached = _residual_modes(mass, stiffness, squares, shapes, at_points, following)
        squares, shapes = np.append(squares, more), np.concatenate([shapes, attached], axis=1)
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    if rayleigh is not None and modal_damping:
        raise StructureError("give modal damping or Rayleigh damping, not both")
    zeta = _damping_ratios(frequencies, modal_damping, rayleigh)
    local = shapes[rows]
    modes = tuple(
        HostMode(
            float(frequency),
            float(ratio),
            {point: float(value) for point, value in zip(points, column, strict=True)},
        )
        for frequency, ratio, column in zip(frequencies, zeta, local.T, strict=True)
    )
    square = 0.25 * following  # half of that frequency
    exact = at_points.T @ _factor(stiffness - square * mass).solve(at_points)
    approximate = (local / (squares - square)) @ local.T
    error = float(np.linalg.norm(approximate - exact) / np.linalg.norm(exact))
    return HostReduction(Host(name, modes), retained, float(np.sqrt(square) / (2.0 * np.pi)), error)


def _real_square(
    quantity: str, matrix: scipy.sparse.sparray | scipy.sparse.spmatrix
) -> scipy.sparse.csc_array:
    """The matrix in double precision, by columns; StructureError unless it is square, of finite real numbers."""
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise StructureError(f"the {quantity} matrix must be square, got the shape {matrix.shape}")
    if matrix.dtype.kind not in "fiu":
        raise StructureError(
            f"the {quantity} matrix holds {matrix.dtype} values, not real numbers; damping is given by modal_damping or "
            "rayleigh"
        )
    by_columns = scipy.sparse.csc_array(matrix, dtype=float)
    if not np.isfinite(by_columns.data).all():
        raise StructureError(f"the {quantity} matrix holds values that are not finite")
    return by_columns


def _checked(
    mass: scipy.sparse.csc_array, stiffness: scipy.sparse.csc_array, points: Mapping[str, int], keep: int
) -> list[int]:
    """Rows of the points from 0; StructureError for what cannot be reduced."""
    size = mass.shape[0]
    if mass.shape != stiffness.shape:
        raise StructureError(
            f"the mass matrix has {size} rows and the stiffness matrix {stiffness.shape[0]}; they belong to different models"
        )
    if not points:
        raise StructureError(
            "a host needs at least one point: name a row of the matrices, such as tip = 1205"
        )
    wrong = next((point for point, row in points.items() if not 1 <= row <= size), None)
    if wrong is not None:
        raise StructureError(
            f'the point "{wrong}" is row {points[wrong]}, but the matrices have rows 1 to {size}, counted from 1'
        )
    if keep < 1:
        raise StructureError(f"the number of kept modes must be at least 1, got {keep}")
    for quantity, matrix in (("mass", mass), ("stiffness", stiffness)):
        largest = float(np.abs(matrix.data).max(initial=0.0))
        if float(np.abs((matrix - matrix.T).data).max(initial=0.0)) > 1e-6 * largest:
            raise StructureError(
                f"the {quantity} matrix is not symmetric; a host is a linear structure that conserves energy"
            )
    _require_plausible(mass, stiffness)
    return [row - 1 for row in points.values()]


def _require_plausible(mass: scipy.sparse.csc_array, stiffness: scipy.sparse.csc_array) -> None:
    """Raise StructureError for matrices that may have been taken for each other."""
    of_mass, of_stiffness = mass.diagonal(), stiffness.diagonal()
    if not (of_mass > 0.0).all():
        raise StructureError(
            "the mass matrix must be positive definite, and has a degree of freedom without mass: condense that, or check "
            "that mass and stiffness are not swapped"
        )
    fastest = float(np.max(of_stiffness / of_mass))
    if 0.0 < fastest < _SLOWEST:
        raise StructureError(
            f"with these matrices nothing moves faster than about {np.sqrt(fastest) / (2.0 * np.pi):.2g} Hz: mass and "
            "stiffness may be swapped, the mass matrix being the first of the two, or in units that are not of one system"
        )


def _lowest(
    mass: scipy.sparse.csc_array, stiffness: scipy.sparse.csc_array, keep: int
) -> tuple[Floats, Floats]:
    """Squares (k,) of the angular frequencies of the lowest modes and one more, and mass-normalised shapes (n, k)."""
    count = min(keep + 1, mass.shape[0])
    try:
        if mass.shape[0] <= _DENSE:
            squares, shapes = scipy.linalg.eigh(
                stiffness.toarray(), mass.toarray(), subset_by_index=(0, count - 1)
            )
        else:
            shift = -_SHIFT * float(stiffness.diagonal().sum() / mass.diagonal().sum())
            inverse = scipy.sparse.linalg.LinearOperator(mass.shape, _factor(stiffness - shift * mass).solve)
            start = np.ones(mass.shape[0])  # eigsh draws one at random otherwise
            squares, shapes = scipy.sparse.linalg.eigsh(
                stiffness, count, mass, sigma=shift, which="LM", v0=start, OPinv=inverse
            )
    except (np.linalg.LinAlgError, RuntimeError) as error:
        raise StructureError(
            f"the modes of the matrices cannot be computed ({error}); the mass matrix must be positive definite, and "
            "may be swapped with the stiffness"
        ) from None
    order = np.argsort(squares)
    squares, shapes = squares[order], shapes[:, order]
    rounding = _ROUNDING * float(np.max(stiffness.diagonal() / mass.diagonal()))
    squares = np.where(np.abs(squares) < rounding, 0.0, squares)
    if (squares < 0.0).any():
        raise StructureError(
            "the stiffness matrix has negative eigenvalues: the structure it describes is not stable"
        )
    return squares, shapes / np.sqrt(np.einsum("ir,ir->r", shapes, mass @ shapes))


def _factor(matrix: scipy.sparse.csc_array) -> scipy.sparse.linalg.SuperLU:
    """LU factors of a symmetric matrix, ordered and pivoted as one."""
    try:
        return scipy.sparse.linalg.splu(
            scipy.sparse.csc_array(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.1,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise StructureError(
            f"the matrices cannot be factorised ({error}); a degree of freedom is not constrained"
        ) from None


def _residual_modes(
    mass: scipy.sparse.csc_array,
    stiffness: scipy.sparse.csc_array,
    squares: Floats,
    shapes: Floats,
    at_points: Floats,
    following: float,
) -> tuple[Floats, Floats]:
    """Squares (p,) and shapes (n, p) of modes with the flexibility at the points that the kept modes lack."""
    shift = 0.0
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


def _damping_ratios(
    frequencies: Floats, modal_damping: float, rayleigh: tuple[float, float] | None
) -> Floats:
    if rayleigh is None:
        return np.full(len(frequencies), modal_damping)
    omega = 2.0 * np.pi * frequencies
    if (omega == 0.0).any() and rayleigh[0] != 0.0:
        raise StructureError(
            "Rayleigh damping of a free structure damps its rigid motion; give modal damping"
        )
    return np.asarray(0.5 * (rayleigh[0] / np.where(omega > 0.0, omega, 1.0) + rayleigh[1] * omega))
