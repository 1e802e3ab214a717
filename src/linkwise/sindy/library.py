"""Libraries of columns over states: monomials of all states or of those of a mass and its neighbours (the paper's Eq. 3),
and one column per coefficient of a link (its physics-informed basis, Eq. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError, RecordError
from linkwise.expression import differentiate, symbols
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.runtime import available_memory
from linkwise.signals.states import States
from linkwise.sindy.regression.linear_system import (
    DenseSystem,
    Rows,
    StreamedSystem,
    fit_bytes,
)


@dataclass(frozen=True)
class Monomials:
    """All monomials in q variables up to an order, the constant "1" included, degree by degree. ``len`` counts them without
    forming any, as C(q + order, order). IdentificationError if `order` is negative or a name is listed twice.
    """

    variables: tuple[str, ...]
    order: int

    def __post_init__(self) -> None:
        if self.order < 0 or len(set(self.variables)) < len(self.variables):
            raise IdentificationError(
                f"monomials need an order of 0 or more and names that differ, got order {self.order} in "
                f"{', '.join(self.variables)}"
            )

    def __len__(self) -> int:
        return comb(len(self.variables) + self.order, self.order)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """(p,) names such as "1", "x1", "x1*v2", "x1**2*x2"."""
        indices = range(len(self.variables))
        degrees = (combinations_with_replacement(indices, degree) for degree in range(self.order + 1))
        return tuple(_product(self.variables, chosen) for degree in degrees for chosen in degree)

    def evaluate(self, values: Floats) -> Floats:
        """All p monomials (B, p) at values of the variables (B, q), in Fortran order, each as one product of a variable
        and a monomial of the degree below that begins with this variable or a later one.
        """
        columns = np.empty((len(self), len(values)))
        columns[0] = 1.0
        variables = np.ascontiguousarray(values.T)
        first = 1
        for degree in range(self.order):
            end = first  # of the columns of this degree, the last of which begin with later variables
            for later, variable in zip(range(len(variables), 0, -1), variables, strict=True):
                many = comb(later + degree - 1, degree)
                np.multiply(columns[end - many : end], variable, out=columns[first : first + many])
                first += many
        return columns.T


def tags(masses: tuple[str, ...]) -> tuple[str, ...]:
    """Suffixes of x and v in the names of states: the numbers of m1, m2, ... where all names have this form, else "_" and
    the whole name.
    """
    numbered = all(mass[:1] == "m" and mass[1:].isdecimal() for mass in masses)
    return tuple(mass[1:] if numbered else f"_{mass}" for mass in masses)


def _product(variables: tuple[str, ...], chosen: tuple[int, ...]) -> str:
    """The name of a monomial, its variables by rising index: (0, 0, 1) is "x1**2*v1"."""
    powers = {index: chosen.count(index) for index in chosen}
    factors = [variables[index] + (f"**{power}" if power > 1 else "") for index, power in powers.items()]
    return "*".join(factors) or "1"


_MAX_BYTES = 2 * 2**30  # of stored link columns


def monomial_equations(
    states: States,
    order: int,
    *,
    columns_of: Sequence[str] | None = None,
    equations_of: Sequence[str] | None = None,
) -> StreamedSystem:
    """First-order equations of masses, x' = v and v' = a, in the monomials of the states.

    The variables are x1, v1, x2, v2, ... for masses m1, m2, ... (x_NAME, v_NAME for other names) and the targets x1', x1'',
    x2', x2'', .... Applied forces (f1, ...) and the motion of the base (xb, vb), where recorded, enter linearly. Rows are
    evaluated block by block; the matrix is not stored.

    Parameters
    ----------
    states : States
        Motion of the masses.
    order : int
        Highest degree of a monomial.
    columns_of : sequence of str, optional
        Masses whose states and forces form the columns; all by default.
    equations_of : sequence of str, optional
        Masses whose equations are formed; all by default.

    Returns
    -------
    StreamedSystem
        N rows with two targets per mass.

    Raises
    ------
    IdentificationError
        If a fit would not fit into memory, a mass has no states, or `order` is negative.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> system = lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=2)
    >>> system.targets
    ("x1'", "x1''", "x2'", "x2''")
    >>> len(system.names)
    15
    """
    tagged = dict(zip(states.masses, tags(states.masses), strict=True))
    inner, outer = _chosen(states, columns_of), _chosen(states, equations_of)
    library = Monomials(tuple(f"{kind}{tagged[mass]}" for mass in inner for kind in "xv"), order)
    _require_room(library, len(inner))
    names, inputs = _inputs(states, {mass: tagged[mass] for mass in inner})
    columns_at, targets_at = ([states.masses.index(mass) for mass in masses] for masses in (inner, outer))
    variables = _interleaved(states.x[:, columns_at], states.v[:, columns_at])
    targets = _interleaved(states.v[:, targets_at], states.a[:, targets_at])

    def compute(piece: Rows) -> tuple[Floats, Floats]:
        columns = library.evaluate(variables[piece])
        if names:
            columns = np.asfortranarray(np.concatenate([columns, inputs[piece]], axis=1))
        return columns, targets[piece]

    primes = tuple(f"x{tagged[mass]}{prime}" for mass in outer for prime in ("'", "''"))
    columns = (*library.names, *names)
    return StreamedSystem(compute, len(states), columns, ("",) * len(columns), primes)


def link_columns(states: States, structure: Structure) -> DenseSystem:
    """Equations of motion of all masses with one column per unknown: M a + B f = w (the paper's Eq. 6).

    Both masses of a link share its coefficients, so each unknown is one column. Known coefficients, known masses, applied
    forces and the motion of the base are in the target.

    Parameters
    ----------
    states : States
        Motion of the masses.
    structure : Structure
        The structure, with one unknown at least.

    Returns
    -------
    DenseSystem
        n N rows, mass after mass, weighted by 1 / rms(m_i a_i) so that light masses count as much as heavy ones. Names and
        units of the columns are those of `structure.parameters`; the target "force" is in N before weighting.

    Raises
    ------
    IdentificationError
        If a law is not linear in an unknown, the structure has no unknowns, the equations are homogeneous so that nothing sets
        their scale, or the columns would take more than 2 GB.
    RecordError
        If a mass has no states.
    StructureError
        If a link ends at the base and the states have no motion of it.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> system = lw.sindy.link_columns(lw.sindy.differentiate(record), chain.unknown("nes1"))
    >>> system.names, system.units
    (('nes1.alpha', 'nes1.beta', 'nes1.c'), ('N/m', 'N/m^3', 'N s/m'))
    >>> {name: f"{value:.6g}" for name, value in lw.sindy.Stlsq().fit(system).terms("force").items()}
    {'nes1.alpha': '-100', 'nes1.beta': '1e+06', 'nes1.c': '0.02'}
    """
    order = _order(states, structure)
    parameters = structure.parameters
    _require_solvable(structure, len(states))
    d = structure.elongations(states.x[:, order], states.base)
    rates = structure.elongations(states.v[:, order], states.base_velocity)
    count, samples = structure.size, len(states)
    matrix = np.zeros((count, samples, len(parameters)))
    target = states.forces[:, order].T.copy()
    column_of = {member: column for column, one in enumerate(parameters) for member in one.members}
    incidence = structure.incidence.tocsc()
    for index, link in enumerate(structure.links):
        force, by_coefficient = _evaluate(link, d[:, index], rates[:, index])
        ends = slice(incidence.indptr[index], incidence.indptr[index + 1])
        for mass, sign in zip(incidence.indices[ends], incidence.data[ends], strict=True):
            target[mass] -= sign * force
            for name, values in by_coefficient.items():
                matrix[mass, :, column_of[index, name]] += sign * values
    inertia = np.ones(count)
    for mass, given in enumerate(structure.masses):
        acceleration = states.a[:, order[mass]]
        member = (-1 - mass, "mass")
        if member in column_of:
            matrix[mass, :, column_of[member]] += acceleration
        else:
            inertia[mass] = given.mass.value or 0.0
            target[mass] -= inertia[mass] * acceleration
    if not np.any(target):
        raise IdentificationError(
            "every term of these equations has an unknown factor, so nothing sets their scale: a mass, a coefficient or an "
            "applied force must be known"
        )
    rms = np.sqrt(np.mean((inertia * states.a[:, order]) ** 2, axis=0))
    weights = np.repeat(1.0 / np.where(rms > 0, rms, 1.0), samples)
    return DenseSystem(
        matrix.reshape(count * samples, len(parameters)),
        target.reshape(count * samples),
        tuple(parameter.name for parameter in parameters),
        weights=weights,
        units=tuple(parameter.unit for parameter in parameters),
        targets=("force",),
    )


def _interleaved(first: Floats, second: Floats) -> Floats:
    """Columns of two (N, n) arrays in turn: (N, 2 n)."""
    return np.stack([first, second], axis=2).reshape(len(first), -1)


def _inputs(states: States, tagged: dict[str, str]) -> tuple[tuple[str, ...], Floats]:
    """Names and columns (N, k) of what drives the masses in `tagged`, and of the base motion."""
    driven = [mass for mass in states.driven if mass in tagged]
    names = [f"f{tagged[mass]}" for mass in driven]
    columns = [states.forces[:, states.masses.index(mass)] for mass in driven]
    for name, values in (("xb", states.base), ("vb", states.base_velocity)):
        if values is not None:
            names.append(name)
            columns.append(values)
    return tuple(names), np.column_stack(columns) if columns else np.empty((len(states), 0))


def _chosen(states: States, masses: Sequence[str] | None) -> tuple[str, ...]:
    """The named masses, or all, in the order of the states."""
    if masses is None:
        return states.masses
    absent = [mass for mass in masses if mass not in states.masses]
    if absent or not masses:
        wrong = f"there are no states of {absent[0]}" if absent else "no mass was chosen"
        raise IdentificationError(f"{wrong}; there are states of {', '.join(states.masses)}")
    return tuple(mass for mass in states.masses if mass in masses)


def _require_room(library: Monomials, masses: int) -> None:
    """Raise IdentificationError for a library whose fit would not go into memory."""
    needed, free = fit_bytes(len(library)), available_memory()
    if needed <= free:
        return
    raise IdentificationError(
        f"the monomials up to order {library.order} in the {len(library.variables)} states of {masses} masses are "
        f"{len(library)} columns; their Gram matrix alone takes {_gigabytes(8 * len(library) ** 2)}, a fit "
        f"{_gigabytes(needed)}, and {_gigabytes(free)} are free. Smaller are those of a lower order, or with "
        "columns_of=... (a mass and its neighbours), and the columns of the links (link_columns)"
    )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.{0 if size > 1e10 else 2}f} GB"


def _order(states: States, structure: Structure) -> Indices:
    """Column of each mass of the structure in the states."""
    absent = [name for name in structure.mass_names if name not in states.masses]
    if absent:
        raise RecordError(
            f"mass {absent[0]} of the structure has no channel, and derivatives cannot be formed for it; there are states of "
            f"{', '.join(states.masses)}. A method that estimates hidden motion (ml) is needed"
        )
    return np.array([states.masses.index(name) for name in structure.mass_names], dtype=np.intp)


def _require_solvable(structure: Structure, samples: int) -> None:
    unknowns = len(structure.parameters)
    if not unknowns:
        message = f"every coefficient of {structure.name} is known: there is nothing to identify"
        raise IdentificationError(message)
    size = 8 * samples * structure.size * unknowns
    if size > _MAX_BYTES:
        raise IdentificationError(
            f"{unknowns} unknowns over {structure.size} masses and {samples} samples are {size / 1e9:.1f} GB of columns; "
            "use the weak form, which works link by link, or a shorter record"
        )


def _evaluate(link: Link, d: Floats, v: Floats) -> tuple[Floats, dict[str, Floats]]:
    """The known part of a link's force (N,), and for each unknown coefficient what it multiplies (N,)."""
    unknown = {name for name, coefficient in link.coefficients.items() if not coefficient.known}
    for name in unknown:
        shared = unknown & set(symbols(differentiate(link.law.expression, name)))
        if shared:
            raise IdentificationError(
                f"the law {link.law.text} of link {link.name} is not linear in its unknown {', '.join(sorted(shared))}, "
                f"so no column represents {name}; give {sorted(shared)[0]} a number, or use the method ml"
            )
    values = {name: coefficient.value or 0.0 for name, coefficient in link.coefficients.items()}
    partials = link.law.partials(d, v, values | dict.fromkeys(unknown, 0.0))
    free = (name for name in link.coefficients if name in unknown)
    return partials.force, {name: partials.by_coefficient[name] for name in free}
