"""Two libraries of columns over states: monomials, of all or of a mass and its neighbours (the paper's Eq. 3), and per link
(its physics-informed basis, Eq. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.errors import IdentificationError, RecordError
from linkwise.expression import differentiate, symbols
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.runtime import available_memory
from linkwise.signals.states import States
from linkwise.sindy.monomials import Monomials, tags
from linkwise.sindy.regression.linear_system import DenseSystem, Rows, StreamedSystem, fit_bytes

_MOST_BYTES = 2 * 2**30  # of stored link columns


def monomial_equations(
    states: States,
    order: int,
    *,
    mixing: int | None = None,
    columns_of: Sequence[str] | None = None,
    equations_of: Sequence[str] | None = None,
) -> StreamedSystem:
    """First-order equations of masses, x' = v and v' = a, in the monomials of states up to `order`.

    The variables are x1, v1, x2, v2, ... for masses m1, m2, ... (x_NAME, v_NAME where masses bear other names); the
    targets x1', x1'', x2', x2'', ...; applied forces (f1, ...) and the base motion (xb, vb), where they were recorded,
    take part linearly. `mixing` limits how many different states a monomial may mix, `columns_of` names the masses
    whose states and forces make up the columns and `equations_of` those whose equations are wanted, all by default.

    No matrix is stored. Raises IdentificationError for a library whose fit would not fit into memory, saying how large it is
    and what would, and for masses that have no states.
    """
    tagged = dict(zip(states.masses, tags(states.masses), strict=True))
    inner, outer = _chosen(states, columns_of), _chosen(states, equations_of)
    library = Monomials(tuple(f"{kind}{tagged[mass]}" for mass in inner for kind in "xv"), order, mixing)
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


def local_equations(
    states: States, structure: Structure, order: int, *, mixing: int | None = None
) -> dict[str, StreamedSystem]:
    """For each mass of `structure` its equations in monomials of its own states and of those of the masses that it is linked
    with: libraries that do not grow with the structure. Arguments and errors as in `monomial_equations`; RecordError for a
    mass of the structure without states.
    """
    _order(states, structure)
    found = {}
    for mass in structure.mass_names:
        linked = {end for link in structure.links if mass in link.between for end in link.between}
        inner = [one for one in states.masses if one in linked | {mass}]
        found[mass] = monomial_equations(states, order, mixing=mixing, columns_of=inner, equations_of=(mass,))
    return found


def link_columns(states: States, structure: Structure) -> DenseSystem:
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
    return DenseSystem(
        matrix.reshape(count * samples, len(parameters)),
        target.reshape(count * samples),
        tuple(one.name for one in parameters),
        weights=weights,
        units=tuple(one.unit for one in parameters),
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
        raise IdentificationError(
            f"there are no states of {absent[0] if absent else 'no mass'} to make equations of; there are states of "
            f"{', '.join(states.masses)}"
        )
    return tuple(mass for mass in states.masses if mass in masses)


def _require_room(library: Monomials, masses: int) -> None:
    """Raise IdentificationError, saying what would fit, for a library whose fit would not."""
    needed, free = fit_bytes(len(library)), available_memory()
    if needed <= free:
        return
    smaller = {
        f"{what} ({len(one)} columns, {_gigabytes(fit_bytes(len(one)))})": fit_bytes(len(one))
        for what, one in (
            ("mixing=2", replace(library, mixing=2)),
            ("mixing=1", replace(library, mixing=1)),
            ("order=2", replace(library, order=2)),
        )
        if len(one) < len(library)
    }
    fitting = [what for what, size in smaller.items() if size <= free]
    raise IdentificationError(
        f"the monomials up to order {library.order} in the {len(library.variables)} states of {masses} masses are "
        f"{len(library)} columns; their Gram matrix alone takes {_gigabytes(8 * len(library) ** 2)}, a fit "
        f"{_gigabytes(needed)}, and {_gigabytes(free)} are free. Smaller are "
        f"{', '.join([*fitting, 'columns_of=... (a mass and its neighbours)'])}, "
        "and the columns of the links (link_columns)"
    )


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.{0 if size > 1e10 else 2}f} GB"


def _order(states: States, structure: Structure) -> Indices:
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


def _evaluate(link: Link, d: Floats, v: Floats) -> tuple[Floats, dict[str, Floats]]:
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
