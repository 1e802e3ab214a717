"""Bands of amplitudes: the steady motions of draws from the posterior at the frequencies of a branch.

Each draw starts from the motion of the identified structure, moved as at the point before. Where a fold has moved, a draw
has no motion at a frequency and is left out there. Stable motion alone has bands, at some points of a branch, and between
them by interpolation of its parts of the amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.uncertainty import Posterior
from linkwise.model.structure import Structure
from linkwise.response.continuation import Point, solve
from linkwise.response.options import ResponseOptions
from linkwise.response.result import Branch
from linkwise.response.search import Curve, repeats_sooner
from linkwise.response.shooting import PeriodicEquations, Shooting, amplitudes

_COVERED = 0.95
_SAMPLES = 64  # of a turn
_STATIONS, _FEWEST, _MOST = 120, 6, 40  # points of all branches at which draws are made, and of each
_FAR = 0.1  # of the size of the motion: nearer, it may be one whose period does not double yet
_LEAST = 0.5  # of the draws must have a motion


def banded(
    posterior: Posterior,
    curves: Sequence[Curve],
    branches: Sequence[Branch],
    rows: Floats,
    options: ResponseOptions,
) -> list[Branch]:
    """The branches of curves with bands; without where shapes of hosts are uncertain, on which the equations depend."""
    drawn = [
        posterior.structure.with_values(dict(zip(posterior.names, values.tolist(), strict=True)))
        for values in posterior.draws(options.draws, options.seed)
    ]
    if any(structure.shape_key != posterior.structure.shape_key for structure in drawn):
        return list(branches)
    every = sum(len(curve.points) for curve in curves)
    shares = (round(_STATIONS * len(curve.points) / every) for curve in curves)
    return [
        _with_band(curve, branch, drawn, rows, min(max(share, _FEWEST), _MOST))
        for curve, branch, share in zip(curves, branches, shares, strict=True)
    ]


def _with_band(
    curve: Curve, branch: Branch, drawn: Sequence[Structure], rows: Floats, stations: int
) -> Branch:
    """The branch with the band of structures that were drawn: at some of its points, by interpolation between."""
    count, stable = len(curve.points), np.flatnonzero(branch.stable)
    if not len(stable):
        return branch
    peaks = stable[branch.amplitude[stable].argmax(axis=0)]
    at = np.unique(
        np.concatenate([stable[np.linspace(0, len(stable) - 1, stations).round().astype(int)], peaks])
    )
    points = [curve.points[number][0] for number in at.tolist()]
    values = np.array([_drawn(curve.equations.of(one), points, rows) for one in drawn])
    values /= branch.amplitude[at]
    enough = np.isfinite(values).mean(axis=0) >= _LEAST
    values[:, ~enough] = 1.0
    tail = 50.0 * (1.0 - _COVERED)
    bounds = np.nanpercentile(values, [tail, 100.0 - tail], axis=0)
    bounds[:, ~enough] = np.nan
    lower, upper = (
        np.column_stack([np.interp(np.arange(count), at, column) for column in bound.T]) for bound in bounds
    )
    lower[~branch.stable] = upper[~branch.stable] = np.nan
    return replace(branch, lower=lower * branch.amplitude, upper=upper * branch.amplitude)


def _drawn(equations: PeriodicEquations, points: Sequence[Point], rows: Floats) -> Floats:
    """(P, C) the amplitudes of one draw at points of a curve, NaN where it has no motion near."""
    values = np.full((len(points), len(rows)), np.nan)
    moved = np.zeros(len(points[0].unknowns) - 1)
    for number, point in enumerate(points):
        unknowns = point.unknowns.copy()
        unknowns[:-1] += moved
        solved = _on_same_side(equations, point, unknowns)
        if solved is not None:
            motion = equations.motion(solved, _SAMPLES)
            values[number] = amplitudes(motion, rows, equations.turns)[0]
        moved = 0.0 * moved if solved is None else solved[:-1] - point.unknowns[:-1]
    return values


def _on_same_side(equations: PeriodicEquations, point: Point, unknowns: Floats) -> Floats | None:
    """The solution near unknowns, if it is on the same side of all folds as a point and not far off with a shorter period."""
    found = solve(equations, unknowns)
    if found is None:
        return None
    far = np.abs((found.unknowns - unknowns) / point.sizes).max() > _FAR
    if far and isinstance(equations, Shooting) and repeats_sooner(equations, found):
        return None
    signs = [np.linalg.slogdet(one.jacobian[:, :-1])[0] for one in (point, found)]
    return found.unknowns if signs[0] == signs[1] else None
