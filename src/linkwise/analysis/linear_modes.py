"""Linear modes of a structure about an equilibrium.

The laws are replaced by their tangents at rest: M q'' + C q' + K q = 0 with K = B diag(df/dd) B', C = B diag(df/dv) B'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Floats
from linkwise.errors import StructureError, expect
from linkwise.expression import Program, differentiate
from linkwise.model.link import Link, require_rest_at_zero
from linkwise.model.structure import Structure, refuse_rig
from linkwise.records.channel_units import unit_in

_ZERO = 1e-14  # times the number of masses, at least ten: squared frequencies below this fraction of the largest count as 0
_EQUAL = 1e-10  # squared frequencies that differ by less than this fraction of the largest are repeated
_AT_REST = 1e-9  # net force over the largest stiffness times the largest displacement
_DIAGONAL = 1e-12  # damping that couples the modes less than this is modal


@dataclass(frozen=True, eq=False)
class Modes:
    """The n linear modes of a structure, by ascending squared frequency.

    Attributes
    ----------
    at : array of shape (n,)
        Displacements in m about which the structure is linearised.
    frequencies : array of shape (n,)
        Undamped natural frequencies in Hz; 0 for a rigid-body motion, NaN where the stiffness is negative.
    damping : array of shape (n,)
        Damping ratios; NaN where the frequency is not positive.
    shapes : array of shape (n, n)
        Mass-normalised mode shapes in 1/sqrt(kg), one column per mode; the largest entry of each is positive.
    eigenvalues : complex array of shape (2n,)
        Eigenvalues of the state matrix in 1/s, by ascending modulus.
    note : str
        What is not an ordinary vibration about an equilibrium; empty if nothing.

    Examples
    --------
    >>> import linkwise as lw
    >>> linear = lw.analysis.modes(lw.bnes_chain(2))
    >>> linear.frequencies.round(2).tolist()
    [22.29, 27.83]
    >>> linear.shapes.shape, linear.note
    ((2, 2), '')
    """

    at: Floats
    frequencies: Floats
    damping: Floats
    shapes: Floats
    eigenvalues: NDArray[np.complex128]
    note: str


def modes(structure: Structure, at: ArrayLike | None = None) -> Modes:
    """Linear modes of a structure about an equilibrium.

    Parameters
    ----------
    structure : Structure
        A structure whose coefficients have values. States of links with memory are held at 0, as the voltage of a piezo in a
        short circuit.
    at : array of shape (n,), optional
        Displacements in m; by default the stable equilibrium of least energy.

    Returns
    -------
    Modes
        Natural frequencies, damping ratios and mode shapes.

    Raises
    ------
    StructureError
        If there is no stable equilibrium, `at` has the wrong shape, or a coefficient has no value.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.analysis.modes(lw.bnes_chain(2)).frequencies.round(2).tolist()
    [22.29, 27.83]
    """
    expect("modes(structure): structure", structure, Structure)
    refuse_rig(structure, "equilibria and modes")
    require_rest_at_zero(structure.links, "equilibria and modes")
    x = _rest(structure) if at is None else np.asarray(at, dtype=float)
    if x.shape != (structure.size,) or not np.isfinite(x).all():
        raise StructureError(f"`at` must have {structure.size} finite displacements in m, one for each mass")
    stiffness, damping, residual = _tangent(structure, x)
    squares, shapes = eigh(stiffness, np.diag(structure.mass_values))
    shapes = _uncoupled(squares, shapes, damping)
    squares = _without_rounding(squares)
    shapes *= np.sign(shapes[np.argmax(np.abs(shapes), axis=0), np.arange(structure.size)])
    with np.errstate(over="ignore", invalid="ignore"):
        modal = shapes.T @ damping @ shapes
    _check_finite("damping", modal)
    eigenvalues, pairs = _eigenvalues(squares, modal)
    omega = _angular(squares)
    ratios = np.full(structure.size, np.nan)
    moving = omega > 0.0
    product = np.sqrt(np.abs(pairs[moving].prod(axis=1)))
    ratios[moving] = -pairs[moving].sum(axis=1).real / (2.0 * product)
    order = np.argsort(np.abs(eigenvalues), kind="stable")
    note = _note(structure, squares, residual)
    return Modes(x, omega / (2.0 * np.pi), ratios, shapes, eigenvalues[order], note)


def natural_frequencies(structure: Structure) -> Floats:
    """(n,) natural frequencies in Hz about the stable equilibrium of least energy, as `modes` gives them; NaN where negative
    stiffness has none. Raises StructureError as `modes` does.

    States of links with memory follow the elongation, as they do in fast motion, and add to the stiffness.
    """
    rest = _rest(structure)
    stiffness, _, _ = _tangent(structure, rest)
    by_states = np.array(list(map(stiffness_of_states, structure.links, structure.elongations(rest, 0.0))))
    stiffness = stiffness + ((structure.incidence * by_states) @ structure.incidence.T).toarray()
    squares, _ = eigh(stiffness, np.diag(structure.mass_values))
    return _angular(_without_rounding(squares)) / (2.0 * np.pi)


def stiffness_of_states(link: Link, d: float) -> float:
    """Stiffness in N/m that states of 0 add to a link that moves too fast for them to relax."""
    law = link.law
    if not law.states:
        return 0.0
    slopes = [differentiate(law.expression, name) for name, _ in law.named_rates]
    slopes += [differentiate(rate, "v") for _, rate in law.named_rates]
    program = Program(slopes, (*law.variables, *law.coefficients))
    values = [d, 0.0, *link.zero_states.values(), *(link.values[name] for name in law.coefficients)]
    forces, rates = np.array([float(slope) for slope in program(*values)]).reshape(2, -1)
    return float(forces @ rates)


def _without_rounding(squares: Floats) -> Floats:
    """Squares (n,) of angular frequencies, zero where they are nothing but rounding."""
    rounding = _ZERO * max(len(squares), 10) * np.abs(squares).max(initial=0.0)
    return np.where(np.abs(squares) <= rounding, 0.0, squares)


def _angular(squares: Floats) -> Floats:
    with np.errstate(invalid="ignore"):  # negative stiffness has no frequency: NaN
        return np.asarray(np.sqrt(squares))


def _uncoupled(squares: Floats, shapes: Floats, damping: Floats) -> Floats:
    """`shapes` with those of a repeated frequency combined so that damping does not couple them."""
    shapes = shapes.copy()
    borders = np.flatnonzero(np.diff(squares) > _EQUAL * np.abs(squares).max(initial=0.0)) + 1
    for group in np.split(np.arange(len(squares)), borders):
        if len(group) > 1:
            shapes[:, group] @= np.linalg.eigh(shapes[:, group].T @ damping @ shapes[:, group])[1]
    return shapes


def _rest(structure: Structure) -> Floats:
    points = equilibria(structure)
    if not points.stable:
        why = f": {points.note}" if points.note else ""
        raise StructureError(f"no stable equilibrium was found{why}; give `at`")
    return points.stable[0].x


def _tangent(structure: Structure, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Stiffness (n, n), damping (n, n) and net forces (n,) of the links at rest at `x`; the base is at zero."""
    at = list(zip(structure.links, structure.elongations(x, 0.0), strict=True))
    slopes = np.array([link.tangent(d) for link, d in at])
    forces = np.array([float(link.force(d, states=link.zero_states)) for link, d in at])
    incidence = structure.incidence
    stiffness = (incidence * slopes[None, :, 0]) @ incidence.T
    damping = (incidence * slopes[None, :, 1]) @ incidence.T
    _check_finite("stiffness", stiffness.data)
    _check_finite("damping", damping.data)
    net = incidence @ forces
    rounding = _AT_REST * np.abs(slopes[:, 0]).max(initial=0.0) * np.abs(x).max(initial=0.0)
    at_rest = np.abs(net) <= rounding
    return stiffness.toarray(), damping.toarray(), np.where(at_rest, 0.0, net)


def _check_finite(quantity: str, values: Floats) -> None:
    """Raise StructureError if coefficients are so large that the numbers made of them are not finite."""
    if not np.isfinite(values).all():
        message = f"the {quantity} of its links is too large for its masses: its modes are not finite"
        raise StructureError(message)


def _eigenvalues(squares: Floats, modal: Floats) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """All 2n eigenvalues of the state matrix, and the two (n, 2) of each undamped mode.

    In modal coordinates the state matrix is [[0, 1], [-squares, -modal]]. Eigenvectors are assigned to modes, two to each, by
    the largest sum of their shares in the motion of the modes.
    """
    n = len(squares)
    off = modal - np.diag(np.diag(modal))
    if np.abs(off).max(initial=0.0) <= _DIAGONAL * np.abs(modal).max(initial=0.0):
        half = 0.5 * np.asarray(np.diag(modal), dtype=np.complex128)
        root = np.sqrt(half**2 - squares)
        pairs = np.stack([-half + root, -half - root], axis=1)
        return pairs.reshape(-1), pairs
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(squares), -modal]])
    values, vectors = np.linalg.eig(state.astype(complex))
    shares = np.abs(vectors[:n]) ** 2
    shares /= shares.sum(axis=0)
    rows, columns = scipy.optimize.linear_sum_assignment(np.repeat(shares, 2, axis=0), maximize=True)
    return values, values[columns[np.argsort(rows)]].reshape(n, 2)


def _note(structure: Structure, squares: Floats, residual: Floats) -> str:
    notes = []
    if np.any(residual):
        worst = int(np.argmax(np.abs(residual)))
        name = structure.mass_names[worst]
        force = f"{-residual[worst]:.3g} {unit_in(structure, f'force:{name}')}"
        notes.append(f'this is not an equilibrium: the links exert {force} on mass "{name}"')
    if rigid := int(np.sum(squares == 0.0)):
        notes.append(f"{rigid} of {len(squares)} modes at 0 Hz, without elastic resistance")
    if unstable := int(np.sum(squares < 0.0)):
        modes_so = f"{unstable} of {len(squares)} modes of negative stiffness"
        notes.append(f"{modes_so}, unstable and without a frequency")
    return "; ".join(notes)
