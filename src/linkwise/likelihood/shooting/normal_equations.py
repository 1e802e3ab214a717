"""Gauss-Newton normal equations of multiple shooting, chunk by chunk of segments, with dense blocks.

`linearise` sums the products of their rows, of the states by segments and of the border by blocks of segments. The equations
are block tridiagonal with a border (`bordered_system`):

    | H  E | |s|   |g|      H: an (m, m) block per node and one per neighbouring pair of nodes
    | E' C | |t| = |c|      E: (K m, p) border, C: (p, p) corner

A coefficient that sets where a mass rests moves it in every segment, by many times what the continuity of the segments
allows. The equations then hold numbers whose difference alone is information, and where it is less than their rounding a
covariance means nothing. In coordinates of the nodes relative to a shift by each unknown of the border, the same in all
segments, they are small from the start, and nothing else changes (`with_common_shift`).

With H of the states, border E and corner C of all segments, F = H^-1 E says how the states follow the unknowns. The segments
of a block contribute H_b, E_b and C_b, and their information is C_b - E_b' F + F' (H_b F - E_b). The last difference is zero
but at the first and the last node of the block, where it is what the link with the neighbouring segment transmits: the
product E_b' F remains (`block_information`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem, Damping, Nodes
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import (
    Iterate,
    Prior,
    RandomStates,
    Scales,
    Segments,
    SensorErrors,
    as_slice,
    slider_starts,
)
from linkwise.likelihood.shooting.tangents import (
    CandidateForces,
    errors_by_channel,
    extra_columns,
    whitened_jacobian,
)


@dataclass(frozen=True, eq=False)
class Corners:
    """The border of a quadratic form, by blocks of segments: `matrices` (B, p, p) and `gradients` (B, p)."""

    matrices: Floats
    gradients: Floats

    def within(self, border: Indices) -> Corners:
        """Those of these unknowns of the border alone, in arrays of their own."""
        return Corners(self.matrices[:, border[:, None], border], self.gradients[:, border])

    @property
    def matrix(self) -> Floats:
        """(p, p) of all segments."""
        return np.asarray(self.matrices.sum(axis=0))

    @property
    def gradient(self) -> Floats:
        """(p,) of all segments."""
        return np.asarray(self.gradients.sum(axis=0))


Sums = tuple[Floats, tuple[Any, ...], Floats]
"""An array by blocks of segments, the places in some of its blocks, and what is added there."""


#: Numbers in one tangent array (2, n, P, k) of a chunk, so that a dozen of them fit a core's cache.
CHUNK = 120_000
_FEWEST = 16  # segments in a chunk, beside which the overhead of its operations is small
_TOGETHER = 8  # segments whose products are summed in the precision of the rows
NEGLIGIBLE = (1e-13, 1e-12, 1e-11)  # of the diagonal: single precision has 6e-8


def chunks(segments: Segments, parameters: int) -> list[slice]:
    """The segments in parts whose sensitivities to states and `parameters` stay in a core's cache."""
    m, K = segments.system.dimension, segments.count
    count = min(round(K * m * (m + parameters) / CHUNK), K // _FEWEST)
    return [slice(*ends) for ends in pairwise(block_ends(K, max(1, count)))]


def block_ends(K: int, blocks: int) -> list[int]:
    """The first of K segments in each of as many consecutive blocks of about equal length, and, last, K."""
    return [block * K // blocks for block in range(blocks + 1)]


def blocks_of(part: slice, ends: Sequence[int]) -> list[tuple[int, slice]]:
    """The blocks that `ends` of all segments cut a part of them into: of each its number, and its place in the part."""
    within = np.clip(np.asarray(ends) - part.start, 0, part.stop - part.start).tolist()
    return [(block, slice(a, b)) for block, (a, b) in enumerate(pairwise(within)) if b > a]


@dataclass(frozen=True, eq=False)
class Linearization:
    """Gauss-Newton model of a misfit: products of the samples' rows, and the ends of the segments.

    Attributes
    ----------
    state, right : array of shape (K, m, m) and (K, m, p + 1)
        Products of the columns of each node with these, and with the border and, last, the residuals.
    of_data, of_defects : Corners
        Products of the border, of samples and of the defects for q = 1.
    state_ends, right_ends : array of shape (K - 1, m, m) and (K - 1, m, p + 1)
        The end of a segment by its node, and by the border; last the defect, sign reversed.
    joined : array of shape (K - 1, m)
        What defects weigh, as in both ends: 1, or 0 of what is not continuous.
    shift : array of shape (m, p), optional
        Shifts by the border, relative to which the nodes are.
    """

    state: NDArray[Any]
    right: NDArray[Any]
    of_data: Corners
    of_defects: Corners
    state_ends: NDArray[Any]
    right_ends: NDArray[Any]
    joined: Floats
    shift: Floats | None = None

    def within(self, border: Indices) -> Linearization:
        """That of these unknowns of the border alone, in arrays of its own."""
        columns = np.append(border, -1)
        return replace(
            self,
            right=self.right[..., columns],
            of_data=self.of_data.within(border),
            of_defects=self.of_defects.within(border),
            right_ends=self.right_ends[..., columns],
            shift=self.shift if self.shift is None else self.shift[:, border],
        )

    def equations(self, q: float) -> BorderedSystem:
        """Normal equations with squared defects weighted by 1 / q^2."""
        weight, (K, m, c) = 1.0 / q**2, self.right.shape

        def put(some: slice, room: Nodes) -> None:
            diagonal, coupling, right = room
            diagonal[:], right[:] = self.state[some], self.right[some]
            before, inner = (
                slice(max(some.start - 1, 0), some.stop - 1),
                slice(some.start, min(some.stop, K - 1)),
            )
            joined, count = weight * self.joined, inner.stop - inner.start
            later = slice(before.start + 1 - some.start, None)
            diagonal[later, range(m), range(m)] += joined[before] * self.joined[before]
            ends, by_border = (
                own[inner].astype(float, copy=False) for own in (self.state_ends, self.right_ends)
            )
            weighted = weight * ends.transpose(0, 2, 1)
            diagonal[:count] += weighted @ ends
            right[:count] += weighted @ by_border
            right[later] -= joined[before, :, None] * self.right_ends[before]
            np.multiply(ends, -joined[inner, :, None], out=coupling)

        return BorderedSystem(
            (K, m, c),
            put,
            self.of_data.matrix + weight * self.of_defects.matrix,
            self.of_data.gradient + weight * self.of_defects.gradient,
            self.shift,
        )

    def factor(self, q: float, kept: Indices | None = None) -> BorderedFactor | None:
        """Factor of `equations`; of nodes that the samples hardly determine, such as a fast mode, with the least that makes
        it one.

        What is added is below the rounding of single precision, in which the sensitivities are.
        """
        equations, nothing = self.equations(q), np.zeros(self.right.shape[2] - 1)
        for strength in (0.0, *NEGLIGIBLE):
            damping = (strength * self._diagonal(1.0 / q**2), nothing) if strength else None
            factor = equations.factor(damping, kept)
            if factor is not None:
                return factor
        return None

    def damping(self, strength: float) -> Damping | None:
        """`strength` times the diagonal at q = 1, so that a trust region means the same at every q."""
        if strength == 0.0:
            return None
        border = strength * np.diag(self.of_data.matrix + self.of_defects.matrix)
        return strength * self._diagonal(1.0), border

    def _diagonal(self, weight: float) -> Floats:
        """(K, m) that of the nodes, squared defects weighted so."""
        nodes = np.einsum("kii->ki", self.state).astype(float)
        nodes[:-1] += weight * np.einsum("kij,kij->kj", self.state_ends, self.state_ends)
        nodes[1:] += weight * self.joined**2
        return np.asarray(nodes)


def empty_model(misfit: Misfit, p: int, blocks: int, precision: type[np.floating[Any]]) -> Linearization:
    """A model of zeros for a border of p unknowns, but for the defects, with K ends, of which the last will be left out."""
    segments = misfit.segments
    m, K = segments.system.dimension, segments.count
    joined = np.zeros((K, m))
    joined[:-1] = segments.link_weights.T
    right_ends = np.zeros((K, m, p + 1), precision)
    right_ends[:-1, :, p] = misfit.defects.reshape(m, -1).T
    state, state_ends = np.zeros((2, K, m, m), precision)
    of_data, of_defects = (Corners(np.zeros((blocks, p, p)), np.zeros((blocks, p))) for _ in range(2))
    right = np.zeros((K, m, p + 1), precision)
    return Linearization(state, right, of_data, of_defects, state_ends, right_ends, joined)


def filled(
    model: Linearization,
    parts: Sequence[slice],
    work: Callable[[slice, list[slice]], list[Sums]],
    executor: Executor | None,
    misfit: Misfit,
) -> Linearization:
    """An empty model with the products of all parts of the segments, and what is known beforehand.

    `work` puts those of a part into the model, and gives what they add to its border in the pieces of blocks that it has.
    """
    segments, scales = misfit.segments, misfit.scales
    ends_of_blocks = block_ends(segments.count, len(model.of_data.gradients))

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def own(part: slice) -> list[Sums]:
        return work(part, [piece for _, piece in blocks_of(part, ends_of_blocks)])

    by_part = map(own, parts) if executor is None or len(parts) == 1 else executor.map(own, parts)
    for part, sums in zip(parts, by_part, strict=True):
        met = [block for block, _ in blocks_of(part, ends_of_blocks)]
        for array, places, added in sums:
            array[met[0] : met[-1] + 1][places] += added
    model.state[segments.unconstrained] = np.eye(segments.system.dimension)  # these nodes do not move
    rows, firsts, sizes, unit = slider_starts(segments, misfit.point.nodes, scales)
    model.state[firsts[:, None], rows, rows] += unit**-2.0
    model.right[firsts[:, None], rows, -1] -= sizes.T / unit
    add_prior(model.of_data.matrices[0], model.of_data.gradients[0], misfit)
    if segments.random is not None:
        _add_random_forces(model, segments.random, misfit.point, scales)
    return replace(
        model, state_ends=model.state_ends[:-1], right_ends=model.right_ends[:-1], joined=model.joined[:-1]
    )


def linearise(
    misfit: Misfit,
    executor: Executor | None = None,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> Linearization:
    """Gauss-Newton model at a point, chunk by chunk: a chunk's tangents stay in the processor's cache.

    The amplitudes of `candidates` and the sizes of `errors` follow theta in the border, whose corner is summed by consecutive
    `blocks` of segments, but for the errors: these are multiplied in their channel alone, and asked for in no blocks. Rows
    of few segments are multiplied in single precision, and the products summed in double precision, in which the ends are.
    """
    segments = misfit.segments
    forces, sizes = extra_columns(candidates, errors)
    m, p = segments.system.dimension, segments.parameters + forces + sizes
    model = empty_model(misfit, p, blocks, np.float64)
    last = p - segments.sensors.unknowns
    first = last - sizes
    others = np.r_[:first, last:p]  # than the errors
    own = as_slice(others)
    corner = (..., own, own) if isinstance(own, slice) else (..., others[:, None], others)

    def work(part: slice, pieces: list[slice]) -> list[Sums]:
        rows, ends = whitened_jacobian(misfit, part, candidates)
        by_border = rows[..., m:]
        product = rows[..., :m].transpose(0, 2, 1) @ rows
        right, right_ends = model.right[part], model.right_ends[part]
        model.state[part], right[..., own] = product[..., :m], product[..., m:-1]
        right[..., p] = product[..., -1]
        ends *= model.joined[part, :, None]
        model.state_ends[part], right_ends[..., own] = ends[..., :m], ends[..., m:]
        ends = np.concatenate([ends[..., m:], right_ends[..., p:]], axis=2)
        borders = (ends[piece].reshape(-1, ends.shape[2]) for piece in pieces)
        of_data = np.stack([summed(by_border[piece], by_border[piece]) for piece in pieces])
        of_defects = np.stack([border.T @ border for border in borders])
        sums = list[Sums]()
        for corners, products in ((model.of_data, of_data), (model.of_defects, of_defects)):
            sums.append((corners.matrices, corner, products[:, :-1, :-1]))
            sums.append((corners.gradients, (..., own), products[:, -1, :-1]))
        if errors is not None:
            shown = rows.reshape(len(rows), *segments.samples.shape[:2], -1)
            count, width = last - first, rows.shape[2] - m
            beside, squares = np.zeros((count, width)), np.zeros((count, count))
            for channel, numbers, columns in errors_by_channel(misfit, part, errors):
                by_channel = shown[:, :, channel]
                right[..., first + numbers] = by_channel[..., :m].transpose(0, 2, 1) @ columns
                beside[numbers] = summed(columns, by_channel[..., m:])
                squares[numbers[:, None], numbers] = summed(columns, columns)
            block, at = slice(0, 1), slice(first, last)
            sums.append((model.of_data.matrices, (block, at, own), beside[:, :-1]))
            sums.append((model.of_data.matrices, (block, own, at), beside[:, :-1].T))
            sums.append((model.of_data.matrices, (block, at, at), squares))
            sums.append((model.of_data.gradients, (block, at), beside[:, -1]))
        return sums

    parts = chunks(segments, segments.parameters + forces)
    return filled(model, parts, work, executor, misfit)


def summed(first: NDArray[Any], second: NDArray[Any]) -> Floats:
    """(q, q') sum over segments of the products of rows (k, r, q) and (k, r, q').

    Few segments are multiplied together, so that sums of single precision remain short.
    """
    k, r = first.shape[:2]
    together = k // -(-k // _TOGETHER)
    whole = k - k % together
    total = np.zeros((first.shape[2], second.shape[2]))
    for some, size in ((slice(whole), together), (slice(whole, k), 1)):
        count = (some.stop - (some.start or 0)) // size
        left, right = (rows[some].reshape(count, size * r, rows.shape[2]) for rows in (first, second))
        total += (left.transpose(0, 2, 1) @ right).sum(axis=0, dtype=float)
    return total


def add_prior(corner: Floats, gradient: Floats, misfit: Misfit) -> None:
    """Add the priors of unknowns, if any, to the border of a quadratic form, whose gradient is `gradient` (p,)."""
    prior, scales, point = misfit.segments.prior, misfit.scales, misfit.point
    if prior is not None:
        columns = add_prior_curvature(corner, prior, scales, len(point.theta))
        gradient[columns] += prior.gradient(point.border, scales.theta)


def add_prior_curvature(matrix: Floats, prior: Prior, scales: Scales, parameters: int) -> Indices:
    """Add the priors to a square matrix: parameters come first in it, offsets, gains and delays last; gives their columns."""
    columns = np.arange(len(scales.theta))
    columns[parameters:] += len(matrix) - len(columns)
    matrix[columns, columns] += prior.curvature(scales.theta)
    return columns


def _add_random_forces(model: Linearization, random: RandomStates, point: Iterate, scales: Scales) -> None:
    """Add the cost of random forces to their states, and its slope to the border, whose columns are as in `add_prior`."""
    curvature = random.curvature(scales.state)
    model.state[:, random.rows, random.rows] += curvature.T
    model.right[:, random.rows, -1] -= (
        curvature * point.nodes[random.rows] / scales.state[random.rows, None]
    ).T
    if random.slope is not None:
        columns = np.arange(len(random.slope))
        columns[len(point.theta) :] += model.right.shape[2] - 1 - len(random.slope)
        model.of_data.gradients[0, columns] -= 0.5 * random.slope * scales.theta


_INDEPENDENT = (
    1e-12  # relative square of what a shift does to the ends of segments, below which it is nothing
)


def with_common_shift(linear: Linearization) -> Linearization:
    """The same linearised problem, its nodes relative to shifts by the border that leave the ends of segments least to fit.

    Parameters
    ----------
    linear : Linearization
        The linearised problem.

    Returns
    -------
    Linearization
        That in the other coordinates: the equations of its border alone, and so the covariance, are the same but for rounding.
        The same one where the motion overflows.
    """
    (_, m, p), ends = linear.right.shape, linear.right_ends.astype(float)
    p -= 1
    if not (np.isfinite(linear.state_ends).all() and np.isfinite(ends).all()):
        return linear
    apart = linear.state_ends.astype(float)
    apart[:, range(m), range(m)] -= linear.joined
    shift = _least_left(apart, ends[:, :, :p])
    ends[:, :, :p] += apart @ shift
    blocks = [slice(*pair) for pair in pairwise(block_ends(len(linear.right), len(linear.of_data.gradients)))]
    rows = (ends[block].reshape(-1, p + 1) for block in blocks)
    products = np.stack([own.T @ own for own in rows])
    right, of_data = _moved_along(linear, shift, blocks)
    return replace(
        linear,
        right=right,
        of_data=of_data,
        of_defects=Corners(products[:, :p, :p], products[:, p, :p]),
        right_ends=ends,
        shift=shift,
    )


def _least_left(apart: Floats, by_border: Floats) -> Floats:
    """(m, p) the shift that, times `apart` (K - 1, m, m), leaves least of what the border does, (K - 1, m, p)."""
    rows = apart.reshape(-1, apart.shape[2])
    squares, products = rows.T @ rows, rows.T @ by_border.reshape(len(rows), -1)
    size = np.sqrt(np.maximum(squares.diagonal(), np.finfo(float).tiny))[:, None]
    solved = np.linalg.lstsq(squares / size / size.T, products / size, rcond=_INDEPENDENT)[0]
    return np.asarray(-solved / size)


def _moved_along(linear: Linearization, shift: Floats, blocks: Sequence[slice]) -> tuple[Floats, Corners]:
    """What samples say of nodes with the border, and of this by blocks of nodes, where it moves nodes by `shift` (m, p)."""
    p = shift.shape[1]
    right = linear.right.astype(float)
    right[:, :, :p] += linear.state @ shift
    matrices, gradients = linear.of_data.matrices.copy(), linear.of_data.gradients.copy()
    for number, block in enumerate(blocks):
        own = linear.right[block].sum(axis=0, dtype=float)
        across = own[:, :p].T @ shift
        state = linear.state[block].sum(axis=0, dtype=float)
        matrices[number] += across + across.T + shift.T @ state @ shift
        gradients[number] += shift.T @ own[:, p]
    return right, Corners(matrices, gradients)


_LOOSER = (3.0, 10.0, 30.0, 100.0)  # times the relaxation, for a covariance
_ROUNDED = 1e-13  # of the diagonal of the border: information of which rounding hides more than a hundredth


def precise_model(
    linear: Linearization,
    q: float,
    factor: BorderedFactor | None = None,
    own: int | None = None,
    kept: Indices | None = None,
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
    kept : array of int, optional
        Unknowns of the border that the nodes shall follow, by default all.

    Returns
    -------
    tuple
        The same problem, in coordinates of the nodes relative to a common shift where rounding makes that necessary, and its
        factor; None where its equations are not positive definite.
    """
    factor = factor or linear.factor(q, kept)
    if is_rounded(linear, factor, q, own):
        linear = with_common_shift(linear)
        factor = linear.factor(q, kept)
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


def is_rounded(linear: Linearization, factor: BorderedFactor | None, q: float, own: int | None) -> bool:
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
