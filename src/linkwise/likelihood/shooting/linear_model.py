"""The linearised problem at a point, and what it tells of the unknowns.

With H of the states, border E and corner C of all segments, F = H^-1 E says how the states follow the unknowns. The segments
of a block contribute H_b, E_b and C_b, and their information is C_b - E_b' F + F' (H_b F - E_b). The last difference is zero
but at the first and the last node of the block, where it is what the link with the neighbouring segment transmits: the
product E_b' F remains. `eliminated_rows` has the rows themselves with the states eliminated: sums over them are what samples
and links between segments say of the unknowns.

Long records are tested in pieces (`tested_in_pieces`): a piece is a run of segments from one node to another, which it shares
with the next. Eliminated piece by piece, in memory that does not grow with the record, all but the last node leave equations
of that and of the unknowns of all, which join those of the next piece: the factor is that of the equations of all nodes.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.normal_equations import (
    BorderedFactor,
    BorderedSystem,
    Linearization,
    add_prior,
    block_ends,
    chunks,
    linearise,
    with_common_shift,
)
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors
from linkwise.likelihood.shooting.segments import Scales, Segments
from linkwise.likelihood.shooting.tangents import CandidateForces, whitened_jacobian
from linkwise.runtime import processors

_LOOSER = (3.0, 10.0, 30.0, 100.0)  # times the relaxation, for a covariance
_ROUNDED = 1e-13  # of the diagonal of the border: information of which rounding hides more than a hundredth


def precise_model(
    linear: Linearization, q: float, factor: BorderedFactor | None = None, own: int | None = None
) -> tuple[Linearization, BorderedFactor | None]:
    """A linearised problem with its factor, whose rounding hides nothing that the equations tell of the border.

    Parameters
    ----------
    linear : Linearization
        The linearised problem.
    q : float
        Relaxation.
    factor : BorderedFactor, optional
        Its factor at the relaxation.
    own : int, optional
        How many of the border, the first, rounding must not hide; candidates behind them may well be as good as singular. By
        default all.

    Returns
    -------
    tuple
        The same problem, in coordinates of the nodes relative to a common shift where rounding makes that necessary, and its
        factor; None where its equations are not positive definite.
    """
    factor = factor or linear.factor(q)
    if _is_rounded(linear, factor, q, own):
        linear = with_common_shift(linear)
        factor = linear.factor(q)
    return linear, factor


def firm_factor(
    linear: Linearization, q: float, factor: BorderedFactor | None = None
) -> BorderedFactor | None:
    """The factor at a relaxation, or at the least larger one at which nothing has to be added to the nodes.

    That at the relaxation is the given one, if there is one. What is added makes a factor, and would count as information; a
    larger relaxation can only widen the covariance. Where nothing helps it is that with the addition.
    """
    linear, factor = precise_model(linear, q, factor)
    for looser in _LOOSER if factor is not None and factor.damped else ():
        again = linear.factor(looser * q)
        if again is not None and not again.damped:
            return again
    return factor


def _is_rounded(linear: Linearization, factor: BorderedFactor | None, q: float, own: int | None) -> bool:
    """Whether rounding hides what equations tell of some direction in the first `own` columns of the border."""
    if factor is None or not len(factor.schur[:own]):
        return False
    diagonal = (linear.of_data.matrix + linear.of_defects.matrix / q**2).diagonal()[:own]
    size = np.sqrt(np.maximum(diagonal, np.finfo(float).tiny))
    relative = factor.schur[:own, :own] / np.outer(size, size)
    return bool(np.isfinite(relative).all() and np.linalg.eigvalsh(relative)[0] < _ROUNDED)


def covariance(factor: BorderedFactor | None, scales: Scales, free: Bools) -> Floats:
    """Of theta, offsets and gains in their own units, zero where not free; infinite where rounding leaves the equations no
    positive definite matrix, since the variances of another would be its errors alone.
    """
    size = len(scales.theta)
    unknown = np.full((size, size), np.inf)
    if factor is None:
        return unknown
    chosen = np.ix_(free, free)
    try:
        root = np.linalg.cholesky(factor.schur[chosen])
    except np.linalg.LinAlgError:
        return unknown
    out = np.zeros((size, size))
    half = solve_triangular(root, np.diag(scales.theta[free]), lower=True, check_finite=False)
    out[chosen] = half.T @ half
    return out


@dataclass(frozen=True, eq=False)
class FactoredModel:
    """Gauss-Newton blocks at a point, and the `factor` of their equations at a relaxation, without damping."""

    linear: Linearization
    factor: BorderedFactor

    @property
    def in_blocks(self) -> bool:
        """Whether the corner of `linear` is that of several blocks."""
        return len(self.linear.of_data.gradients) > 1


def block_information(model: FactoredModel, q: float) -> tuple[Floats, Floats]:
    """Scores (B, p) and information (B, p, p) of as many blocks as the corner of the model has, at its relaxation."""
    linear, weight, follow = model.linear, 1.0 / q**2, followed_states(model.factor)
    K, _, p = follow.shape
    gradient = linear.of_data.gradients + weight * linear.of_defects.gradients
    corner = linear.of_data.matrices + weight * linear.of_defects.matrices
    ends = block_ends(K, len(corner))
    for block, (first, last) in enumerate(pairwise(ends)):
        inner = slice(first, min(last, K - 1))  # segments that another follows
        later = linear.joined[inner, :, None] * follow[first + 1 : inner.stop + 1]
        moved = linear.state_ends[inner] @ follow[inner] - later
        along = _product(linear.right[first:last], follow[first:last])
        along += weight * _product(linear.right_ends[inner], moved)
        corner[block] -= along[:p]
        gradient[block] -= along[p]
        if last < K:
            link = linear.right_ends[last - 1, :, :p] - moved[-1]
            passed = weight * later[-1].T @ link
            corner[block] += passed
            corner[block + 1] -= passed
    return gradient, 0.5 * (corner + corner.transpose(0, 2, 1))


def followed_states(factor: BorderedFactor) -> Floats:
    """(K, m, p): by how much the scaled states fall where an unknown grows by one unit and the states follow."""
    return factor.root.backward(factor.forward[..., :-1].copy())


def _product(rows: NDArray[Any], others: Floats) -> Floats:
    """(q, c) sum over segments and rows of (k, r, q) times (k, r, c)."""
    count = rows.shape[0] * rows.shape[1]  # no -1, which columns that there are none of leave open
    return np.asarray(rows.reshape(count, rows.shape[2]).T @ others.reshape(count, others.shape[2]))


@dataclass(frozen=True, eq=False)
class EliminatedRows:
    """Of the k segments `part`: `data` (k, M C, p), `residuals` (k, M C), `defects` (k, 2n + S, p) and `missed` (k, 2n + S).

    Rows and residuals are whitened, in scaled unknowns (theta, amplitudes of candidates, sizes of errors, offsets, gains).
    """

    part: slice
    data: Floats
    residuals: Floats
    defects: Floats
    missed: Floats


def eliminated_rows(
    misfit: Misfit,
    q: float,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
) -> Iterator[EliminatedRows] | None:
    """The rows of all segments, chunk by chunk; None where the equations are singular."""
    segments = misfit.segments
    linear = linearise(misfit, candidates=candidates, errors=errors)
    factor = linear.equations(q).factor()
    if factor is None:
        return None
    follow = followed_states(factor)
    _, m, p = follow.shape
    following = np.concatenate([follow[1:], np.zeros((1, m, p))])
    weights, missed = np.zeros((2, segments.count, m))
    weights[:-1], missed[:-1] = segments.link_weights.T, misfit.defects.reshape(m, -1).T

    def chunk(part: slice) -> EliminatedRows:
        rows, ends = whitened_jacobian(misfit, part, candidates, errors)
        node = follow[part]
        defects = ends[..., m:] - ends[..., :m] @ node + following[part]
        defects *= weights[part, :, None] / q
        data = rows[..., m:-1] - rows[..., :m] @ node
        return EliminatedRows(part, data, rows[..., -1], defects, missed[part] / q)

    return map(chunk, chunks(segments, p))


_PIECE = (
    4000  # segments in a piece: in shorter ones threads wait for each other, longer ones leave the caches
)


def piece_ends(linked: Bools) -> Indices:
    """The nodes at which pieces of segments end, the first and the last node among them.

    None ends at the first node of another record, which would have neither samples nor a link in that piece.

    Parameters
    ----------
    linked : array of bool, shape (K - 1,)
        Which neighbouring segments are continuous.

    Returns
    -------
    array of int, shape (P + 1,)
        The nodes.
    """
    count = len(linked) + 1
    number = max(1, round(count / _PIECE))
    ends = np.linspace(0, count - 1, number + 1).round().astype(int)
    ends[1:-1] -= ~linked[ends[1:-1] - 1]
    return ends


def piece_between(segments: Segments, first: int, last: int) -> Segments:
    """The segments between two nodes, without what is known of the unknowns beforehand.

    Parameters
    ----------
    segments : Segments
        All segments.
    first, last : int
        The nodes.

    Returns
    -------
    Segments
        The piece; the samples behind its last node belong to the next, unless there is none.
    """
    piece = replace(segments.chosen(np.arange(first, last + 1)), prior=None)
    if last < segments.count - 1:
        observed = piece.observed.copy()
        observed[..., -1] = False
        piece = replace(piece, observed=observed)
    return piece


def but_the_last(equations: BorderedSystem, before: BorderedFactor | None) -> BorderedSystem:
    """The equations of a piece with its last node in the border, before the other unknowns there.

    Of the piece `before`, whose last node is the first of this one, that node and the border are left.
    """
    m, p = equations.diagonal.shape[1], len(equations.corner)
    diagonal, right = equations.diagonal, equations.right
    corner, gradient = np.zeros((m + p, m + p)), np.append(right[-1, :, p], equations.corner_gradient)
    corner[:m, :m], corner[:m, m:], corner[m:, m:] = diagonal[-1], right[-1, :, :p], equations.corner
    if before is not None:
        diagonal[0] += before.schur[:m, :m]
        right[0] += np.column_stack([before.schur[:m, m:], before.reduced[:m]])
        corner[m:, m:] += before.schur[m:, m:]
        gradient[m:] += before.reduced[m:]
    corner[m:, :m] = corner[:m, m:].T
    inner = np.concatenate([np.zeros((len(right) - 1, m, m)), right[:-1]], axis=2)
    inner[-1, :, :m] = equations.coupling[-1].T
    return BorderedSystem(diagonal[:-1], equations.coupling[:-1], inner, corner, gradient)


def tested_in_pieces(
    misfit: Misfit, q: float, candidates: CandidateForces, errors: SensorErrors | None
) -> BorderedFactor | None:
    """The equations of parameters and of sizes of what is tested, all nodes eliminated.

    Parameters
    ----------
    misfit, candidates, errors
        As of `linearise`.
    q : float
        Relaxation.

    Returns
    -------
    BorderedFactor or None
        The factor, of which `schur` and `reduced` are these equations; None where they are not positive definite.
    """
    segments = misfit.segments
    left: BorderedFactor | None = None
    with ThreadPoolExecutor(processors()) as executor:
        for first, last in pairwise(piece_ends(segments.linked).tolist()):
            part = slice(first, last + 1)
            some = None if errors is None else replace(errors, values=errors.values[..., part])
            piece = misfit.part(part, piece_between(segments, first, last))
            linear = linearise(piece, executor, candidates.part(part), some)
            left = but_the_last(linear.equations(q), left).factor()
            if left is None:
                return None
    assert left is not None  # there is a piece at least
    m = len(misfit.point.nodes)
    corner, gradient = left.schur[m:, m:].copy(), left.reduced[m:].copy()
    add_prior(corner, gradient, misfit)
    right = np.column_stack([left.schur[:m, m:], left.reduced[:m]])
    return BorderedSystem(
        left.schur[None, :m, :m], np.empty((0, m, m)), right[None], corner, gradient
    ).factor()
