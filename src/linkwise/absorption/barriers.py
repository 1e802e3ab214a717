"""The barriers and the lowest wells of a link's potential, for one set of coefficients or for thousands.

A crossing is a passage over the top of the barrier between two wells. Stored energy is counted from the lowest well, so that
it is never negative. For laws that are polynomials in d, rest points are eigenvalues of companion matrices, for all sets at
once.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from linkwise.analysis.wells import RestPoint, rest_points
from linkwise.arrays import Bools, Floats
from linkwise.errors import StructureError
from linkwise.expression import Number, Program, polynomial
from linkwise.model.law import Law

_HIGHEST_ORDER = 12  # of a polynomial law whose rest points are found by companion matrices
_REAL = 1e-7  # of the largest root: a smaller imaginary part is the rounding error of a double root


class Barriers(NamedTuple):
    """The barriers of one link for R sets of coefficients.

    `tops` (R, K) m are the elongations, each between two wells, at which the potential is largest; NaN if there are fewer than
    K. `floor` (R,) J is the potential in the lowest well relative to d = 0; 0 if there is no well.
    """

    tops: Floats
    floor: Floats


def barriers(law: Law, values: Mapping[str, Floats], runs: int) -> Barriers:
    """The barriers of a law for `runs` (R) sets of coefficients, each of `values` (R,).

    A law with too many rest points to count, such as a periodic one, has no barriers here, and its energy is counted from
    d = 0.
    """
    columns = [np.asarray(values[name], dtype=float) for name in law.coefficients]
    table = np.stack(columns, axis=1) if columns else np.zeros((runs, 0))
    rows, inverse = np.unique(table, axis=0, return_inverse=True)
    polynomial_points = _rest_points_of_polynomial(law, rows)
    points, wells = _rest_points_of_any_law(law, rows) if polynomial_points is None else polynomial_points
    distinct = _between_wells(law, rows, points, wells)
    inverse = inverse.reshape(-1)
    return Barriers(distinct.tops[inverse], distinct.floor[inverse])


def _between_wells(law: Law, rows: Floats, points: Floats, wells: Bools) -> Barriers:
    """The highest rest point between each two wells.

    From rest points `points` (R, K) m, ascending with NaN at the end, and which of them are `wells` (R, K).
    """
    runs = len(rows)
    present = np.isfinite(points)
    named = {name: rows[:, k, None] for k, name in enumerate(law.coefficients)}
    energy = np.where(present, law.potential(np.where(present, points, 0.0), named), -np.inf)
    passed_well = np.zeros(runs, dtype=bool)
    highest, position = np.full(runs, -np.inf), np.full(runs, np.nan)
    tops = []
    for k in range(points.shape[1]):
        well = wells[:, k]
        tops.append(np.where(well & passed_well, position, np.nan))
        higher = ~well & present[:, k] & (energy[:, k] > highest)
        position = np.where(higher, points[:, k], position)
        highest = np.where(well, -np.inf, np.where(higher, energy[:, k], highest))
        passed_well |= well
    table = np.sort(np.stack(tops, axis=1), axis=1) if tops else np.zeros((runs, 0))
    floor = np.where(wells, energy, np.inf).min(axis=1, initial=np.inf)
    most = int(np.isfinite(table).sum(axis=1).max(initial=0))
    return Barriers(table[:, :most], np.where(np.isfinite(floor), floor, 0.0))


def _rest_points_of_any_law(law: Law, rows: Floats) -> tuple[Floats, Bools]:
    """Rest points (R, K) m and which of them are wells (R, K), one set of coefficients after the other."""
    sets = [_rest_points(law, dict(zip(law.coefficients, row.tolist(), strict=True))) for row in rows]
    width = max((len(some) for some in sets), default=0)
    points, wells = np.full((len(rows), width), np.nan), np.zeros((len(rows), width), dtype=bool)
    for number, some in enumerate(sets):
        points[number, : len(some)] = [point.d for point in some]
        wells[number, : len(some)] = [point.well for point in some]
    return points, wells


def _rest_points(law: Law, values: Mapping[str, float]) -> tuple[RestPoint, ...]:
    still = dict.fromkeys(law.states, 0.0)

    def force(d: Floats) -> Floats:
        return np.broadcast_to(law.force(d, 0.0, {**values, **still}), np.shape(d))

    def slope(d: Floats) -> Floats:
        return np.broadcast_to(law.partials(d, 0.0, {**values, **still}).by_d, np.shape(d))

    try:
        return rest_points(force, slope)
    except StructureError:
        return ()


def _rest_points_of_polynomial(law: Law, rows: Floats) -> tuple[Floats, Bools] | None:
    """The same for a law that is a polynomial in d; None for another law.

    A root is a well if the force changes from negative to positive there, which the middles between roots show.
    """
    terms = polynomial(law.elastic, ("d",))
    if terms is None or not terms or max(power for (power,) in terms) > _HIGHEST_ORDER:
        return None
    order = max(power for (power,) in terms)
    program = Program([terms.get((k,), Number(0.0)) for k in range(order + 1)], law.coefficients)
    columns = program(*(rows[:, k] for k in range(rows.shape[1])))
    table = np.stack([np.broadcast_to(column, len(rows)) for column in columns], axis=1)
    points = np.sort(_real_roots(table), axis=1)
    largest = np.nanmax(np.abs(np.where(np.isnan(points), 0.0, points)), axis=1, initial=0.0)
    beyond = np.where(largest > 0.0, 2.0 * largest, 1.0)[:, None]
    edges = np.concatenate([-beyond, np.where(np.isnan(points), beyond, points), beyond], axis=1)
    edges[:, 1:-1][np.isnan(points)] = np.repeat(beyond, points.shape[1], axis=1)[np.isnan(points)]
    middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
    force = np.zeros(middle.shape)
    for k in range(order, -1, -1):
        force = force * middle + table[:, k, None]
    return points, np.isfinite(points) & (force[:, :-1] < 0.0) & (force[:, 1:] > 0.0)


def _real_roots(table: Floats) -> Floats:
    """(R, K) distinct real roots of polynomials (R, K + 1), lowest power first; NaN for those that are missing."""
    runs, width = table.shape[0], table.shape[1] - 1
    roots = np.full((runs, width), np.nan)
    degree = np.where(table != 0.0, np.arange(width + 1), 0).max(axis=1)
    for order in np.unique(degree[degree > 0]):
        rows = np.flatnonzero(degree == order)
        powers = order - np.arange(order)
        monic = table[rows, :order] / table[rows, order, None]
        size = (np.abs(monic) ** (1.0 / powers)).max(axis=1)
        size[size == 0.0] = 1.0
        companion = np.zeros((len(rows), order, order))
        companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
        companion[:, :, -1] = -monic / size[:, None] ** powers
        eigenvalues = np.linalg.eigvals(companion)
        real = np.sort(np.where(np.abs(eigenvalues.imag) <= _REAL, eigenvalues.real, np.nan), axis=1)
        real[:, 1:][np.diff(real, axis=1) <= _REAL] = np.nan
        roots[rows, :order] = real * size[:, None]
    return roots
