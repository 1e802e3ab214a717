"""Sums of the weak equations over pieces of a record: normal equations, what noise adds to them, and its covariance.

All of them come from the terms, the windows and the weights that the whole record has.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import residual_power
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import SlopeStatistics, quadratic_noise, residual_excess, score_blocks
from linkwise.weak.stretches import InnerStretches, Stretches
from linkwise.weak.terms import LawTerms


@dataclass(frozen=True, eq=False)
class PieceSums:
    """Sums over E pieces of a record, of p parameters.

    Attributes
    ----------
    normal : array of shape (E, p, p)
        The normal equations, without the bias due to noise.
    right : array of shape (E, p)
        Their right-hand sides.
    bias : array of shape (E, p, p)
        What noise adds to them.
    linear, quadratic : array of shape (E, p, p)
        Their covariances due to noise: the part of its first order, with the noise that terms contain, and the rest.
    windows : array of shape (E,)
        Numbers of windows without a missing sample, of the masses that have most.
    excess : array of shape (E,)
        Powers of the residuals over those expected from noise.
    """

    normal: Floats
    right: Floats
    bias: Floats
    linear: Floats
    quadratic: Floats
    windows: Floats
    excess: Floats


def piece_sums(
    equations: WeakEquations, values: Floats, ranges: Sequence[tuple[int, int]], *, least: bool = False
) -> PieceSums:
    """The sums over pieces of a record.

    Parameters
    ----------
    equations : WeakEquations
        The equations of the whole record.
    values : array of shape (p,)
        Their solution.
    ranges : sequence of tuple of int
        The first window of each piece, a multiple of `WeakEquations.slope_stride`, and the one behind its last.
    least : bool, optional
        Whether covariances and excess are what they are at least: of first order a sum of squares over some of the points
        (`InnerStretches`), and 1. The other sums are the same.

    Returns
    -------
    PieceSums
        The sums.
    """
    count, p = len(ranges), len(values)
    kind = InnerStretches if least else Stretches
    stretches = kind(equations.window, equations.thinning, tuple(ranges))
    patches = [patch for patch in equations.patches if len(patch.layout.free_terms)]
    weights = [1.0 / residual_power(patch, values) for patch in patches]
    noisy = [(patch, SlopeStatistics.along(patch, equations, values, stretches)) for patch in patches]
    normal, bias, linear, quadratic = np.zeros((4, count, p, p))
    right = np.zeros((count, p))
    for patch, weight in zip(patches, weights, strict=True):
        free, chosen = patch.layout.free_terms, _selection(patch.layout.free_parameters, p)
        signs = ((patch.signs.T * weight) @ patch.signs)[free]
        for number, (products, added) in enumerate(_products(equations, patch, ranges)):
            rows = (products - added)[free] * signs
            right[number] -= (rows @ patch.fixed) @ chosen
            normal[number] += chosen.T @ rows[:, free] @ chosen
            bias[number] += chosen.T @ (added[free] * signs)[:, free] @ chosen
    for which, blocks in score_blocks(noisy, weights, equations, quadratic=False):
        chosen = _selection(which, p)
        linear += chosen.T @ blocks @ chosen
    for (patch, statistics), weight in zip(noisy, weights, strict=True):
        which, blocks = quadratic_noise(patch, statistics, weight, equations)
        chosen = _selection(which, p)
        quadratic += chosen.T @ blocks @ chosen
    valid: Floats = np.max([patch.valid for patch in patches], axis=0)
    return PieceSums(
        normal,
        right,
        bias,
        linear,
        quadratic,
        np.array([valid[first:last].sum() for first, last in ranges]),
        np.ones(count) if least else residual_excess(noisy, values, equations),
    )


def _selection(which: Indices, count: int) -> Floats:
    """(s, count) 1 at the number of each of s terms."""
    chosen = np.zeros((len(which), count))
    chosen[np.arange(len(which)), which] = 1.0
    return chosen


def _products(
    equations: WeakEquations, patch: Patch, ranges: Sequence[tuple[int, int]]
) -> Iterator[tuple[Floats, Floats]]:
    """(q, q) products of the rows of a patch in each piece, and what noise adds to them."""
    window = equations.window
    evaluated, slope = equations.context.evaluated(patch.layout)
    for first, last in ranges:
        rows = patch.rows[:, first:last]
        samples = slice(first * window.stride, (last - 1) * window.stride + window.length)
        own, valid = [_within(terms, samples) for terms in evaluated], patch.valid[first:last]
        yield rows @ rows.T, equations.context.bias(patch.layout, own, slope, valid)


def _within(terms: LawTerms, samples: slice) -> LawTerms:
    """The terms at some samples."""
    parts = (part if isinstance(part, float) else part[:, samples] for part in terms.derivatives)
    by_rate = None if terms.rate_slope is None else terms.rate_slope[:, samples]
    return replace(terms, derivatives=tuple(parts), rate_slope=by_rate)
