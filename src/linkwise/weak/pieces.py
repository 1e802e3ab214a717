"""Whether pieces of a record agree on the coefficients: a term that the laws lack acts otherwise where the motion is smaller.

Friction beside a damper looks like more damping the smaller the motion is, and quadratic damping like less. Where the motion
decays no score of such terms is needed, which would take a smoothed rate: the laws as they are stated are fitted to halves of
the record, of its first half and of its first quarter, since a motion that decays is soon hidden by noise, and to quarters.
The squares of what the pieces differ by, over their variances, follow chi-square where the laws are right (Cochran 1954).

Variances that are sums over some points of the record bound these squares from above, for a fraction of the cost; the whole
sums are formed only where the bound leaves room for a difference.

The terms and the windows of the whole record are those of its pieces (`piecewise`), but for the second half, where a motion
that decays is slower than in the first and needs wider windows.

References
----------
W. G. Cochran, Biometrics 10, 101 (1954), for the combination of estimates from different experiments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from scipy.linalg.lapack import dpotrf, dpotri

from linkwise.arrays import Bools, Floats
from linkwise.errors import LinkwiseError
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.weak.equations import MIN_WINDOWS, WeakEquations, weak_equations
from linkwise.weak.fit import SIGNIFICANT, SINGULAR, WeakFit, significance
from linkwise.weak.piecewise import PieceSums, piece_sums

_CUTS = ((0.0, 0.125, 0.25), (0.0, 0.25, 0.5), (0.0, 0.5, 1.0), (0.0, 0.25, 0.5, 0.75, 1.0))
_HALF = 0.5
_TWICE = 2.0  # the significance that a whole record needs: below, errors of some pieces were a third of what they should be
_LEAST = 0.1  # of the part of a variance that is a sum of squares: a smaller one is the difference of large, inexact parts
_SURELY = 1e3  # of the smallest eigenvalue that is not singular: no eigenvalue is below the reciprocal of the inverse's trace
_LARGEST = 48  # masses of a structure whose pieces are compared
_FALSE_ALARM = 1e-4  # probability that pieces differ so much by chance, over all coefficients and cuts


@dataclass(frozen=True)
class Disagreement:
    """A coefficient of which pieces of the record give different values, between `lowest` and `highest`."""

    name: str
    lowest: float
    highest: float


def disagreement(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> Disagreement | None:
    """The coefficient on which pieces of a record agree least.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.

    Returns
    -------
    Disagreement or None
        The coefficient; None where chance explains all differences, or the structure has too many masses, or an unknown one,
        which is hardly distinguished from zero in some pieces.
    """
    if structure.size > _LARGEST or not all(mass.mass.known for mass in structure.masses):
        return None
    of_second = _second_half(record, structure, equations, fit)
    bounds = _differences_of_all(equations, of_second, fit, least=True)
    if (
        bounds is not None
        and min((chance for chance, _ in bounds), default=1.0) * max(len(bounds), 1) >= _FALSE_ALARM
    ):
        return None
    differences = _differences_of_all(equations, of_second, fit)
    if not differences:
        return None
    chance, worst = min(differences, key=lambda pair: pair[0])
    return worst if chance * len(differences) < _FALSE_ALARM else None


def _differences_of_all(
    equations: WeakEquations, of_second: WeakEquations | None, fit: WeakFit, *, least: bool = False
) -> list[tuple[float, Disagreement]] | None:
    """For each cut and parameter the probability of what its pieces differ by; no less than it with the `least` variances.

    None where a piece has none of these.
    """
    pieces = sorted({ends for cut in _CUTS for ends in pairwise(cut)})
    first = [ends for ends in pieces if ends[1] <= _HALF]
    second = [((low - _HALF) / _HALF, (high - _HALF) / _HALF) for low, high in pieces if low >= _HALF]
    fits = dict(zip(first, _fits(equations, fit, first, least=least), strict=True))
    later = [None] * len(second) if of_second is None else _fits(of_second, fit, second, least=least)
    fits |= dict(zip((ends for ends in pieces if ends[0] >= _HALF), later, strict=True))
    if least and not all(piece is None or piece.complete for piece in fits.values()):
        return None
    differences: list[tuple[float, Disagreement]] = []
    for cut in _CUTS:
        fitted = [fit_of_piece for ends in pairwise(cut) if (fit_of_piece := fits[ends]) is not None]
        if len(fitted) > 1:
            values, weights = (
                np.stack(part) for part in zip(*((p.values, p.weights) for p in fitted), strict=True)
            )
            differences += _differences(equations.parameters, values, weights)
    return differences


def _second_half(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> WeakEquations | None:
    """The equations of the second half of a record; None where it is too short."""
    given = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    half = record[round(_HALF * len(record)) :]
    try:
        motion = equations.motion.of_piece(half, structure)
        return weak_equations(half, structure, motion, values=given)
    except LinkwiseError:
        return None


@dataclass(frozen=True, eq=False)
class _PieceFit:
    """Values and weights (p,) of the parameters in a piece; weight 0 for what it hardly determines, or is at a bound.

    It is `complete` where all others have a variance.
    """

    values: Floats
    weights: Floats
    complete: bool


def _fits(
    equations: WeakEquations, fit: WeakFit, pieces: Sequence[tuple[float, float]], *, least: bool
) -> list[_PieceFit | None]:
    """The fit of each piece, perhaps with variances that are what they are at `least`.

    None for a piece that is too short, or has no motion left.
    """
    window, stride = equations.window, equations.slope_stride
    samples = equations.motion.displacements.shape[1]
    ranges = []
    for low, high in pieces:
        first = -(-round(low * samples) // window.stride)
        last = (round(high * samples) - window.length) // window.stride + 1
        ranges.append((-(-first // stride) * stride, min(last, equations.windows)))
    long = [number for number, (first, last) in enumerate(ranges) if last - first >= MIN_WINDOWS]
    fits: list[_PieceFit | None] = [None] * len(pieces)
    if not long or not fit.free.any():
        return fits
    sums = piece_sums(equations, fit.values, [ranges[number] for number in long], least=least)
    for place, number in enumerate(long):
        fits[number] = _fitted(sums, place, fit)
    return fits


def _fitted(sums: PieceSums, piece: int, fit: WeakFit) -> _PieceFit | None:
    """The fit of a piece, as of `_fits`.

    What it hardly determines it has from the whole: with another value, which may be anything, the others would scatter by
    more than their variance says.
    """
    normal, right, windows = sums.normal[piece], sums.right[piece], int(sums.windows[piece])
    if windows < MIN_WINDOWS or not np.isfinite(normal).all():
        return None
    free = fit.free & (normal.diagonal() > 0.0)
    solved = _Solved.of(normal, sums.bias[piece], windows, free)
    if solved is None:
        return None
    clear = solved.significance > _TWICE * SIGNIFICANT
    if not clear.all():
        free[free] = clear
        solved = _Solved.of(normal, sums.bias[piece], windows, free)
        if solved is None:
            return None
    values, weights = fit.values.copy(), np.zeros(len(free))
    values[free] = solved.inverse @ (right - normal[:, ~free] @ values[~free])[free]
    linear, whole = (
        (solved.inverse @ scatter[np.ix_(free, free)] @ solved.inverse).diagonal()
        for scatter in (sums.linear[piece], sums.linear[piece] + sums.quadratic[piece])
    )
    variance = np.maximum(whole, _LEAST * linear)
    determined = variance > 0.0
    variance = np.where(determined, variance * max(float(sums.excess[piece]), 1.0) ** 2, 1.0)
    weights[free] = np.where(determined, 1.0 / variance, 0.0)
    return _PieceFit(values, weights, bool(determined.all()))


@dataclass(frozen=True, eq=False)
class _Solved:
    """The `inverse` (f, f) of normal equations of f free parameters, and the `significance` (f,) of each beside the others."""

    inverse: Floats
    significance: Floats

    @classmethod
    def of(cls, normal: Floats, bias: Floats, windows: int, free: Bools) -> _Solved | None:
        """None where no parameter is free, or the equations are not positive definite."""
        if not free.any():
            return None
        chosen, scale = np.ix_(free, free), 1.0 / np.sqrt(normal.diagonal()[free])
        unit = np.outer(scale, scale)
        inverse = _inverse(normal[chosen] * unit)
        if inverse is None:
            return None
        directions = inverse / inverse.diagonal()
        added = np.einsum("ip,ip->p", directions, (bias[chosen] * unit) @ directions)
        return cls(inverse * unit, significance(1.0 / inverse.diagonal(), added, windows))


def _inverse(scaled: Floats) -> Floats | None:
    """The inverse of a matrix with a diagonal of 1; None where it is not positive definite."""
    factor, failed = dpotrf(scaled, lower=1)
    inverse = None if failed else dpotri(factor, lower=1)[0]
    if inverse is not None and np.trace(inverse) < 1.0 / (_SURELY * SINGULAR):
        return np.asarray(np.tril(inverse) + np.tril(inverse, -1).T)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    return np.asarray((vectors / eigenvalues) @ vectors.T) if eigenvalues[0] >= SINGULAR else None


def _differences(
    names: tuple[str, ...], values: Floats, weights: Floats
) -> Iterator[tuple[float, Disagreement]]:
    """For each parameter that two of the pieces (b, p) determine, the probability of their differences."""
    count = np.count_nonzero(weights, axis=0)
    total = np.maximum(weights.sum(axis=0), np.finfo(float).tiny)
    squares = np.sum(weights * (values - np.sum(weights * values, axis=0) / total) ** 2, axis=0)
    chances = scipy.special.gammaincc(0.5 * np.maximum(count - 1, 1), 0.5 * squares)
    for number in np.flatnonzero(count > 1).tolist():
        own = values[weights[:, number] > 0.0, number]
        yield float(chances[number]), Disagreement(names[number], float(own.min()), float(own.max()))
