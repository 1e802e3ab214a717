"""Tops and lowest wells of a link's potential, for one set of coefficients or for thousands of them.

A crossing is a passage over a top between two wells; stored energy is counted from the lowest well, so that none of it is
negative. Laws that are polynomials in d are done by the eigenvalues of companion matrices, all sets at once.
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

_HIGHEST = 12  # order of a polynomial law that is done by its roots
_REAL = 1e-7  # of the largest root: an imaginary part below this is rounding of a double root


class Barriers(NamedTuple):
    """`tops` (R, K) m: elongations between two wells at which the potential is largest, NaN where there are fewer than K.
    `floor` (R,) J: the potential in the lowest well, seen from d = 0; 0 where there is no well.
    """

    tops: Floats
    floor: Floats


def barriers(law: Law, values: Mapping[str, Floats], runs: int) -> Barriers:
    """Of a law, for `runs` (R) sets of coefficients, each of `values` (R,).

    A law with more tops than anybody can count (a periodic one) has none here, and its energies are counted from d = 0.
    """
    columns = [np.asarray(values[name], dtype=float) for name in law.coefficients]
    table = np.stack(columns, axis=1) if columns else np.zeros((runs, 0))
    rows, back = np.unique(table, axis=0, return_inverse=True)
    found = _of_polynomial(law, rows)
    places, wells = _one_by_one(law, rows) if found is None else found
    result = _between(law, rows, places, wells)
    back = back.reshape(-1)
    return Barriers(result.tops[back], result.floor[back])


def _between(law: Law, rows: Floats, places: Floats, wells: Bools) -> Barriers:
    """From rest points (R, K), ascending with NaN at the end, and which of them are wells: the highest between two wells."""
    runs = len(rows)
    there = np.isfinite(places)
    named = {name: rows[:, k, None] for k, name in enumerate(law.coefficients)}
    energy = np.where(there, law.potential(np.where(there, places, 0.0), named), -np.inf)
    started = np.zeros(runs, dtype=bool)
    highest, where = np.full(runs, -np.inf), np.full(runs, np.nan)
    tops = []
    for k in range(places.shape[1]):
        well = wells[:, k]
        tops.append(np.where(well & started, where, np.nan))
        higher = ~well & there[:, k] & (energy[:, k] > highest)
        where = np.where(higher, places[:, k], where)
        highest = np.where(well, -np.inf, np.where(higher, energy[:, k], highest))
        started |= well
    table = np.sort(np.stack(tops, axis=1), axis=1) if tops else np.zeros((runs, 0))
    floor = np.where(wells, energy, np.inf).min(axis=1, initial=np.inf)
    most = int(np.isfinite(table).sum(axis=1).max(initial=0))
    return Barriers(table[:, :most], np.where(np.isfinite(floor), floor, 0.0))


def _one_by_one(law: Law, rows: Floats) -> tuple[Floats, Bools]:
    """Rest points of any law."""
    found = [_rest_points(law, dict(zip(law.coefficients, row.tolist(), strict=True))) for row in rows]
    width = max((len(each) for each in found), default=0)
    places, wells = np.full((len(rows), width), np.nan), np.zeros((len(rows), width), dtype=bool)
    for number, each in enumerate(found):
        places[number, : len(each)] = [point.d for point in each]
        wells[number, : len(each)] = [point.well for point in each]
    return places, wells


def _rest_points(law: Law, values: Mapping[str, float]) -> tuple[RestPoint, ...]:
    def force(d: Floats) -> Floats:
        return np.broadcast_to(law.force(d, 0.0, values), np.shape(d))

    def slope(d: Floats) -> Floats:
        return np.broadcast_to(law.partials(d, 0.0, values).by_d, np.shape(d))

    try:
        return rest_points(force, slope)
    except StructureError:
        return ()


def _of_polynomial(law: Law, rows: Floats) -> tuple[Floats, Bools] | None:
    """Rest points of a law that is a polynomial in d; None for another one."""
    terms = polynomial(law.elastic, ("d",))
    if terms is None or not terms or max(power for (power,) in terms) > _HIGHEST:
        return None
    highest = max(power for (power,) in terms)
    program = Program([terms.get((k,), Number(0.0)) for k in range(highest + 1)], law.coefficients)
    columns = program(*(rows[:, k] for k in range(rows.shape[1])))
    table = np.stack([np.broadcast_to(column, len(rows)) for column in columns], axis=1)
    places = np.sort(_real_roots(table), axis=1)
    largest = np.nanmax(np.abs(np.where(np.isnan(places), 0.0, places)), axis=1, initial=0.0)
    beyond = np.where(largest > 0.0, 2.0 * largest, 1.0)[:, None]
    ends = np.concatenate([-beyond, np.where(np.isnan(places), beyond, places), beyond], axis=1)
    ends[:, 1:-1][np.isnan(places)] = np.repeat(beyond, places.shape[1], axis=1)[np.isnan(places)]
    middle = 0.5 * (ends[:, 1:] + ends[:, :-1])
    force = np.zeros(middle.shape)
    for k in range(highest, -1, -1):
        force = force * middle + table[:, k, None]
    return places, np.isfinite(places) & (force[:, :-1] < 0.0) & (force[:, 1:] > 0.0)


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
        found = np.linalg.eigvals(companion)
        real = np.sort(np.where(np.abs(found.imag) <= _REAL, found.real, np.nan), axis=1)
        real[:, 1:][np.diff(real, axis=1) <= _REAL] = np.nan
        roots[rows, :order] = real * size[:, None]
    return roots
