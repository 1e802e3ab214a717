"""Two libraries of columns over states: all monomials (the paper's Eq. 3), and per link (its physics-informed basis,
Eq. 6).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from linkwise.derive import States
from linkwise.equations import Equations, StreamedEquations
from linkwise.errors import IdentificationError, RecordError
from linkwise.expression import differentiate, symbols
from linkwise.link import Link
from linkwise.monomials import Monomials, tags
from linkwise.structure import Structure

Array = NDArray[np.float64]

_MOST_COLUMNS = 20_000  # their Gram matrix takes 3.2 GB
_MOST_BYTES = 2 * 2**30  # of stored link columns


def monomial_equations(states: States, order: int) -> StreamedEquations:
    """The first-order equations of all masses, x' = v and v' = a, in all monomials of the states up to `order`.

    The variables are x1, v1, x2, v2, ... for masses m1, m2, ... (x_NAME, v_NAME where masses bear other names); the
    targets x1', x1'', x2', x2'', ...; applied forces (f1, ...) and the base motion (xb, vb), where they were recorded,
    take part linearly. No matrix is stored. Raises IdentificationError for a library too large for any Gram matrix,
    saying how large it is.
    """
    tagged = tags(states.masses)
    library = Monomials(tuple(f"{kind}{tag}" for tag in tagged for kind in "xv"), order)
    if len(library) > _MOST_COLUMNS:
        raise IdentificationError(
            f"all monomials up to order {order} in the {2 * len(tagged)} states of {len(tagged)} masses are {len(library)} "
            f"columns; their Gram matrix alone takes {8 * len(library) ** 2 / 1e9:.0f} GB. "
            "Use a lower order, fewer masses at a time, or the columns of the links"
        )
    variables = _interleaved(states.x, states.v)
    targets = _interleaved(states.v, states.a)
    names, inputs = _inputs(states, tagged)

    def compute(piece: slice) -> tuple[Array, Array]:
        columns = library.evaluate(variables[piece])
        if names:
            columns = np.asfortranarray(np.concatenate([columns, inputs[piece]], axis=1))
        return columns, targets[piece]

    primes = tuple(f"x{tag}{prime}" for tag in tagged for prime in ("'", "''"))
    columns = (*library.names, *names)
    return StreamedEquations(compute, len(states), columns, ("",) * len(columns), primes)


def link_columns(states: States, structure: Structure) -> Equations:
    """The equations of motion of all masses with one column per unknown of the structure: m_i a_i + sum_l B_il f_l = w_i.

    Rows come mass after mass, N each. Both masses of a link share its coefficients, so each unknown is one column; known
    coefficients, known masses, applied forces and base motion stand in the target. Rows are weighted by 1 / rms(m_i a_i), so
    a light mass counts as much as a heavy one. Names and units are those of `structure.parameters`.

    Raises IdentificationError for an unknown in which a law is not linear, a structure without unknowns, equations that
    are homogeneous (no scale), and sizes beyond 2 GB; RecordError for a mass without states; StructureError where a
    base is missing.
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
    for mass, one in enumerate(structure.masses):
        acceleration = states.a[:, order[mass]]
        member = (-1 - mass, "mass")
        if member in column_of:
            matrix[mass, :, column_of[member]] += acceleration
        else:
            inertia[mass] = one.mass.value or 0.0
            target[mass] -= inertia[mass] * acceleration
    if not np.any(target):
        raise IdentificationError(
            "every term of these equations has an unknown factor, so nothing sets their scale: a mass, a coefficient or an "
            "applied force must be known"
        )
    rms = np.sqrt(np.mean((inertia * states.a[:, order]) ** 2, axis=0))
    weights = np.repeat(1.0 / np.where(rms > 0, rms, 1.0), samples)
    return Equations(
        matrix.reshape(count * samples, len(parameters)),
        target.reshape(count * samples),
        tuple(one.name for one in parameters),
        weights=weights,
        units=tuple(one.unit for one in parameters),
        targets=("force",),
    )


def _interleaved(first: Array, second: Array) -> Array:
    """Columns of two (N, n) arrays in turn: (N, 2 n)."""
    return np.stack([first, second], axis=2).reshape(len(first), -1)


def _inputs(states: States, tagged: tuple[str, ...]) -> tuple[tuple[str, ...], Array]:
    """Names and columns (N, k) of what drives the structure."""
    driven = [states.masses.index(mass) for mass in states.driven]
    names = [f"f{tagged[index]}" for index in driven]
    columns = [states.forces[:, index] for index in driven]
    for name, values in (("xb", states.base), ("vb", states.base_velocity)):
        if values is not None:
            names.append(name)
            columns.append(values)
    return tuple(names), np.column_stack(columns) if columns else np.empty((len(states), 0))


def _order(states: States, structure: Structure) -> NDArray[np.intp]:
    """Where each mass of the structure stands in the states."""
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
        raise IdentificationError(
            f"every coefficient of {structure.name} is known: there is nothing to identify"
        )
    size = 8 * samples * structure.size * unknowns
    if size > _MOST_BYTES:
        raise IdentificationError(
            f"{unknowns} unknowns over {structure.size} masses and {samples} samples are {size / 1e9:.1f} GB of columns; "
            "use the weak form, which works link by link, or a shorter record"
        )


def _evaluate(link: Link, d: Array, v: Array) -> tuple[Array, dict[str, Array]]:
    """The known part of a link's force (N,), and for each unknown coefficient what it multiplies (N,)."""
    unknown = {name for name, coefficient in link.coefficients.items() if not coefficient.known}
    for name in unknown:
        held = unknown & set(symbols(differentiate(link.law.expression, name)))
        if held:
            raise IdentificationError(
                f"the law {link.law.text} of link {link.name} is not linear in its unknown {', '.join(sorted(held))}, "
                f"so no column can stand for {name}; give {sorted(held)[0]} a number, or use the method ml"
            )
    values = {name: 0.0 if name in unknown else one.value or 0.0 for name, one in link.coefficients.items()}
    partials = link.law.partials(d, v, values)
    return partials.force, {
        name: partials.by_coefficient[name] for name in link.coefficients if name in unknown
    }
