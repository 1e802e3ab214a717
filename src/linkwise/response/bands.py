"""Bands of amplitudes: the steady motions of draws from the posterior at the frequencies of a branch.

Each draw starts from the motion of the identified structure, moved as at the point before. Where a fold has moved, a draw
has no motion at a frequency and is left out there. Stable motion alone has bands. A draw is solved for at some points of a
branch; between them what its motion is off that of the branch is interpolated, draw by draw: a quantile turns sharply where
draws cross each other, and an amplitude at an antiresonance; motion does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from linkwise.arrays import Floats, Indices
from linkwise.estimates.uncertainty import Posterior
from linkwise.model.structure import Structure
from linkwise.response.continuation import Point, solve
from linkwise.response.options import ResponseOptions
from linkwise.response.result import Branch
from linkwise.response.search import Curve, repeats_sooner
from linkwise.response.shooting import PeriodicEquations, half_height

_DEVIATIONS = 1.96  # on either side: 95 % of normal draws
_SAMPLES = 64  # of a turn
_STATIONS, _FEWEST, _MOST = 120, 6, 40  # points of all branches at which draws are made, and of each
_FAR = 0.1  # of the size of the motion: nearer, it may be one whose period does not double yet
_JUMP = 0.5  # of the size of the motion, from where it was expected: farther off it is one of another branch
_LEAST = 0.5  # of the draws must have a motion


def banded(
    posterior: Posterior,
    curves: Sequence[Curve],
    branches: Sequence[Branch],
    rows: Floats,
    options: ResponseOptions,
) -> list[Branch]:
    """The branches of curves with bands; without where shapes of hosts are uncertain, on which the equations depend."""
    drawn = drawn_structures(posterior, options.draws, options.seed)
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
    stable = np.flatnonzero(branch.stable)
    if not len(stable):
        return branch
    peaks = stable[branch.amplitude[stable].argmax(axis=0)]
    along = np.linspace(0, len(stable) - 1, stations).round().astype(int)
    at = np.unique(np.concatenate([stable[along], peaks]))
    points = [curve.points[number][0] for number in at.tolist()]
    ways = [(b.unknowns - a.unknowns) / a.sizes for (a, _), (b, _) in pairwise(curve.points)]
    along = np.append(0.0, np.cumsum(np.linalg.norm(ways, axis=1)))
    motions = np.array([_shown_motion(curve.equations, point.unknowns, rows) for point, _ in curve.points])
    of_draws = (_motions_of_draw(curve.equations.of(one), points, rows) - motions[at] for one in drawn)
    ratios = [half_height(motions + _everywhere(off, at, along)) / branch.amplitude for off in of_draws]
    lower, upper = map(np.exp, spread(np.log(ratios)))
    lower[~branch.stable] = upper[~branch.stable] = np.nan
    return replace(branch, lower=lower * branch.amplitude, upper=upper * branch.amplitude)


def drawn_structures(posterior: Posterior, count: int, seed: int) -> list[Structure]:
    """Structures from the posterior, in pairs on either side of the identified one."""
    return [
        posterior.structure.with_values(dict(zip(posterior.names, values.tolist(), strict=True)))
        for values in posterior.mirrored_draws(count, seed)
    ]


def spread(off: Floats) -> tuple[Floats, Floats]:
    """How far below and above the curve the band reaches where draws (R, ...) are `off` it; NaN where fewer than half of them
    have a motion. On either side it is as wide as the root mean square of the draws there says of normal ones.
    """
    enough = np.isfinite(off).mean(axis=0) >= _LEAST
    ends = []
    for side in (-1.0, 1.0):
        there = side * off > 0.0
        mean_square = np.where(there, off**2, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
        ends.append(np.where(enough, side * _DEVIATIONS * np.sqrt(mean_square), np.nan))
    return ends[0], ends[1]


def _everywhere(off: Floats, at: Indices, along: Floats) -> Floats:
    """(M, S, C) what the motion of a draw is off at all points of a curve, `along` it (M,), from what it is `off` (P, S, C)
    at the points `at`; NaN near those at which the draw has no motion.
    """
    known = np.isfinite(off).all(axis=(1, 2))
    if known.sum() < 2:
        return np.full((len(along), *off.shape[1:]), np.nan)
    between = Akima1DInterpolator(along[at[known]], off[known], method="makima", extrapolate=True)
    near = np.interp(along, along[at], known) > 0.5
    return np.where(near[:, None, None], between(along), np.nan)


def _motions_of_draw(equations: PeriodicEquations, points: Sequence[Point], rows: Floats) -> Floats:
    """(P, S, C) the motions of one draw at points of a curve, NaN where it has none near."""
    values = np.full((len(points), _SAMPLES * equations.turns, len(rows)), np.nan)
    moved = np.zeros(len(points[0].unknowns) - 1)
    for number, point in enumerate(points):
        unknowns = point.unknowns.copy()
        unknowns[:-1] += moved
        solved = _on_same_side(equations, point, unknowns)
        if solved is not None:
            values[number] = _shown_motion(equations, solved, rows)
        moved = 0.0 * moved if solved is None else solved[:-1] - point.unknowns[:-1]
    return values


def _shown_motion(equations: PeriodicEquations, unknowns: Floats, rows: Floats) -> Floats:
    """(S, C) a motion over its period in channels that are `rows` (C, N) of states."""
    return equations.motion(unknowns, _SAMPLES)[:-1] @ rows.T


def _on_same_side(equations: PeriodicEquations, point: Point, unknowns: Floats) -> Floats | None:
    """The solution near unknowns, if it is on the branch and the same side of all folds as a point, and not far off with a
    shorter period.
    """
    solution = solve(equations, unknowns)
    off = np.inf if solution is None else float(np.abs((solution.unknowns - unknowns) / point.sizes).max())
    if solution is None or off > _JUMP:
        return None
    if off > _FAR and repeats_sooner(equations, solution):
        return None
    signs = [np.linalg.slogdet(solved.jacobian[:, :-1])[0] for solved in (point, solution)]
    return solution.unknowns if signs[0] == signs[1] else None
