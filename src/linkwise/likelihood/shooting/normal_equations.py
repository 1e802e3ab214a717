"""Gauss-Newton normal equations of multiple shooting, chunk by chunk of segments, with dense blocks.

`whitened_jacobian` has the rows of some segments: sensitivities to the states of their nodes, to parameters and candidate
forces, and to errors of sensors and inputs, which touch the rows of one channel each. `linearise` sums their products, of the
states by segments and of the border by blocks of segments.

A coefficient that sets where a mass rests moves it in every segment, by many times what the continuity of the segments
allows. The equations then hold numbers whose difference alone is information, and where it is less than their rounding a
covariance means nothing. In coordinates of the nodes relative to a shift by each unknown of the border, the same in all
segments, they are small from the start, and nothing else changes (`with_common_shift`).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem, Damping
from linkwise.likelihood.shooting.flow import Inputs, at_ends_and_middles
from linkwise.likelihood.shooting.loss import Loss, Prior, RandomStates
from linkwise.likelihood.shooting.neighbourhoods import as_slice
from linkwise.likelihood.shooting.residuals import Misfit, SensorErrors, estimated_errors
from linkwise.likelihood.shooting.segments import (
    A,
    F,
    Iterate,
    S,
    Scales,
    Segments,
    Sensors,
    V,
    X,
    add_starts,
)
from linkwise.likelihood.shooting.tangents import CandidateForces, Single, shown_tangents, tangents


@dataclass(frozen=True, eq=False)
class NormalBlocks:
    """One quadratic form over scaled unknowns: state (K, m, m), right (K, m, p + 1) border and gradient, and by blocks of
    segments the corner (B, p, p) and its gradient (B, p).
    """

    state: Floats
    right: Floats
    corners: Floats
    corner_gradients: Floats

    @classmethod
    def empty(cls, K: int, m: int, p: int, blocks: int = 1) -> NormalBlocks:
        return cls(
            np.empty((K, m, m)), np.zeros((K, m, p + 1)), np.zeros((blocks, p, p)), np.zeros((blocks, p))
        )

    def within(self, border: Indices) -> NormalBlocks:
        """Those of these unknowns of the border alone, in arrays of their own."""
        return replace(
            self,
            right=self.right[..., np.append(border, -1)],
            corners=self.corners[:, border[:, None], border],
            corner_gradients=self.corner_gradients[:, border],
        )

    @property
    def corner(self) -> Floats:
        """(p, p) of all segments."""
        return np.asarray(self.corners.sum(axis=0))

    @property
    def corner_gradient(self) -> Floats:
        """(p,) of all segments."""
        return np.asarray(self.corner_gradients.sum(axis=0))

    def put(self, part: slice, rows: Floats | Single, pieces: Sequence[slice]) -> Floats:
        """Store [J r]'[J r] of the Jacobian and residuals `rows` (k, r, m + p + 1) of a chunk.

        Returns corners and gradients (b, p + 1, p + 1) of its pieces. Rows in single precision are multiplied segment by
        segment and the products summed in double precision; those in double precision are multiplied at once.
        """
        m, single = self.state.shape[1], rows.dtype == np.float32
        product = (rows if single else rows[..., :m]).transpose(0, 2, 1) @ rows
        self.state[part] = product[:, :m, :m]
        self.right[part] = product[:, :m, m:]
        if single:
            return np.stack([product[piece, m:, m:].sum(axis=0, dtype=float) for piece in pieces])
        borders = (rows[piece, :, m:].reshape(-1, rows.shape[2] - m) for piece in pieces)
        return np.stack([border.T @ border for border in borders])

    def add_corners(self, blocks: Indices, corners: Floats) -> None:
        """Add corners and gradients (b, p + 1, p + 1), as of `put`, to those of b `blocks`."""
        self.corners[blocks] += corners[:, :-1, :-1]
        self.corner_gradients[blocks] += corners[:, -1, :-1]


def columns_of_forces(segments: Segments) -> Indices:
    """The columns of gains, then of delays, of uncertain forces among those of the errors of sensors."""
    uncertain, sensors = segments.inputs.uncertain, segments.sensors
    if uncertain is None:
        return np.empty(0, dtype=int)
    gains, delays = (numbers[numbers >= 0] for numbers in (uncertain.gains, uncertain.delays))
    return np.concatenate([sensors.offsets + gains, sensors.offsets + sensors.gains + delays])


def changes_of_forces(
    segments: Segments, point: Iterate, scales: Scales, part: slice
) -> CandidateForces | None:
    """The forces on masses, in some segments, per unit of each error of `columns_of_forces`; None without any."""
    if segments.inputs.uncertain is None:
        return None
    uncertain = segments.inputs.uncertain.part(part)
    force, rate = uncertain.acting(point.gains, point.delays)
    scaled, late = np.flatnonzero(uncertain.gains >= 0), np.flatnonzero(uncertain.delays >= 0)
    gains, delays = uncertain.gains[scaled], uncertain.delays[late]
    units = scales.theta[len(point.theta) + len(point.offsets) :]
    per_gain = -force[:, :, scaled] * (units[gains] / point.gains[gains])[:, None]
    per_delay = rate[:, :, late] * units[len(point.gains) + delays][:, None]
    changes = np.concatenate([per_gain, per_delay], axis=2)
    starts, middles = at_ends_and_middles(changes, segments.flow_steps_per_tangent)
    ends = uncertain.ends[np.concatenate([scaled, late])]
    return CandidateForces(np.full(len(ends), -1), ends, starts, middles)


def add_errors_of_sensors(
    jacobian: Floats, segments: Segments, misfit: Misfit, scales: Scales, root: Floats, part: slice
) -> None:
    """The columns of errors of sensors; the rows of sensors with an unknown gain are scaled by it.

    `root` (M, C, k) is the square root of the samples' weights, 0 where one is missing. The columns of uncertain forces,
    which move the masses, are in place.
    """
    sensors, point = segments.sensors, misfit.point
    first, units = jacobian.shape[-1] - 1 - sensors.unknowns, scales.theta[len(point.theta) :]
    factors, forces = sensors.factors(point.gains), first + columns_of_forces(segments)
    for channel in sensors.scaled:
        jacobian[:, :, channel, :first] *= np.float32(factors[channel])
        jacobian[:, :, channel, forces] *= np.float32(factors[channel])
    deviations = segments.deviations(scales, part)
    for channel, number, values in estimated_errors(segments, misfit, part):
        column = root[:, channel] * (values * units[number] / deviations[channel])
        jacobian[:, :, channel, first + number] = column.T


def tangents_of_channels(
    motions: Sequence[Single],
    kind: int,
    channels: Indices,
    sensors: Sensors,
    point: Iterate,
    rate: float | Floats,
) -> Single:
    """(c, P, k) tangents of what the `channels` of one `kind` show; those that are late to first order in the delay."""
    rows = motions[kind][as_slice(sensors.mass[channels])]
    late = sensors.delay[channels] >= 0 if kind < A and len(sensors.delay) else np.zeros(0, dtype=bool)
    if late.any():
        rows = rows.copy()
    for number in np.flatnonzero(late).tolist():
        delay, mass = point.delays[sensors.delay[channels[number]]], sensors.mass[channels[number]]
        rows[number] -= (delay * rate * motions[kind + 1][mass]).astype(rows.dtype)
    return rows


def add_shown_forces(jacobian: Floats, random: RandomStates, scales: Scales, whiten: Single) -> None:
    """What sensors show of random forces directly, in segments of one sample."""
    assert random.shown is not None
    for channel, number in np.argwhere(random.shown):
        row = random.rows[number]
        jacobian[:, 0, channel, row] += whiten[0, channel] * np.float32(
            random.shown[channel, number] * scales.state[row]
        )


#: Numbers in one tangent array (2, n, P, k) of a chunk, so that a dozen of them fit a core's cache.
CHUNK = 120_000
_AT_ONCE = 32  # nodes whose equations are assembled together
NEGLIGIBLE = (1e-13, 1e-12, 1e-11)  # of the diagonal: single precision has 6e-8


def chunks(segments: Segments, parameters: int | None = None) -> list[slice]:
    """The segments in parts whose sensitivities to states and `parameters` stay in a core's cache."""
    m, K = segments.system.dimension, segments.count
    p = segments.parameters if parameters is None else parameters
    size = max(16, int(CHUNK / (m * (m + p))) // 16 * 16)
    return [slice(first, min(first + size, K)) for first in range(0, K, size)]


def block_ends(K: int, blocks: int) -> list[int]:
    """The first of K segments in each of as many consecutive blocks of about equal length, and, last, K."""
    return [block * K // blocks for block in range(blocks + 1)]


def blocks_of(part: slice, ends: Sequence[int]) -> list[tuple[int, slice]]:
    """The blocks that `ends` of all segments cut a part of them into: of each its number, and its place in the part."""
    within = np.clip(np.asarray(ends) - part.start, 0, part.stop - part.start).tolist()
    return [(block, slice(a, b)) for block, (a, b) in enumerate(pairwise(within)) if b > a]


@dataclass(frozen=True, eq=False)
class Linearization:
    """Gauss-Newton model of a misfit: the data part, and the defects for q = 1 without the diagonal of the later node."""

    data: NormalBlocks
    defects: NormalBlocks
    state_ends: Floats  # (K - 1, m, m) end of a segment by its node
    right_ends: Floats  # (K - 1, m, p + 1) end by theta and offsets; last the defect, sign reversed
    joined: Floats  # (K - 1, m) what defects weigh, as in both ends: 1, or 0 of what is not continuous
    shift: Floats | None = None  # (m, p) by the border, relative to which the nodes are

    def within(self, border: Indices) -> Linearization:
        """That of these unknowns of the border alone, in arrays of its own."""
        return replace(
            self,
            data=self.data.within(border),
            defects=self.defects.within(border),
            right_ends=self.right_ends[..., np.append(border, -1)],
            shift=self.shift if self.shift is None else self.shift[:, border],
        )

    def equations(self, q: float) -> BorderedSystem:
        """Normal equations with squared defects weighted by 1 / q^2."""
        weight = 1.0 / q**2
        m = self.data.state.shape[1]
        diagonal = self.defects.state * weight
        diagonal += self.data.state
        diagonal[1:, range(m), range(m)] += weight * self.joined**2
        right = np.empty_like(self.data.right)
        for first in range(0, len(right), _AT_ONCE):
            some, own = slice(first, first + _AT_ONCE), right[first : first + _AT_ONCE]
            np.multiply(self.defects.right[some], weight, out=own)
            own += self.data.right[some]
            links = slice(max(first - 1, 0), first + _AT_ONCE - 1)
            before = weight * self.joined[links, :, None] * self.right_ends[links]
            own[len(own) - len(before) :] -= before
        return BorderedSystem(
            diagonal,
            self.state_ends * (-weight * self.joined[:, :, None]),
            right,
            self.data.corner + weight * self.defects.corner,
            self.data.corner_gradient + weight * self.defects.corner_gradient,
            self.shift,
        )

    def factor(self, q: float) -> BorderedFactor | None:
        """Factor of `equations`; of nodes that the samples hardly determine, such as a fast mode, with the least that makes
        it one.

        What is added is below the rounding of single precision, in which the sensitivities are.
        """
        equations = self.equations(q)
        nothing = np.zeros(len(equations.corner))
        nodes = np.einsum("kii->ki", equations.diagonal).copy()
        for strength in (0.0, *NEGLIGIBLE):
            damping = Damping(strength * nodes, nothing) if strength else None
            factor = equations.factor(damping, overwrite=True)
            if factor is not None:
                return factor
        return None

    def damping(self, strength: float) -> Damping | None:
        """`strength` times the diagonal at q = 1, so that a trust region means the same at every q."""
        if strength == 0.0:
            return None
        nodes = np.einsum("kii->ki", self.data.state + self.defects.state)
        nodes[1:] += self.joined**2
        return Damping(strength * nodes, strength * np.diag(self.data.corner + self.defects.corner))


def linearise(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    executor: Executor | None = None,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> Linearization:
    """Gauss-Newton blocks at a point, chunk by chunk: a chunk's tangents stay in the processor's cache.

    The amplitudes of `candidates` and the sizes of `errors` follow theta in the border, whose corner is summed by consecutive
    `blocks` of segments.
    """
    m, K = segments.system.dimension, segments.count
    p = segments.parameters + _extra_columns(candidates, errors)
    moving = segments.parameters + _extra_columns(candidates, None)
    parts, ends_of_blocks = chunks(segments, moving), block_ends(K, blocks)
    data, defects = NormalBlocks.empty(K, m, p, blocks), NormalBlocks.empty(K, m, p, blocks)
    joined, defects_by_node = np.zeros((2, K, m))
    joined[:-1], defects_by_node[:-1] = segments.link_weights.T, misfit.defects.reshape(m, -1).T
    state_ends, right_ends = np.empty((K, m, m)), np.zeros((K, m, p + 1))

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(part: slice) -> tuple[Floats, Floats]:
        pieces = [piece for _, piece in blocks_of(part, ends_of_blocks)]
        rows, ends = whitened_jacobian(segments, misfit, scales, loss, part, candidates, errors)
        corners = data.put(part, rows, pieces)
        ends *= joined[part, :, None]
        ends = np.concatenate([ends, defects_by_node[part, :, None]], axis=2)
        state_ends[part], right_ends[part] = ends[:, :, :m], ends[:, :, m:]
        return corners, defects.put(part, ends, pieces)

    by_part = map(work, parts) if executor is None or len(parts) == 1 else executor.map(work, parts)
    for part, sums in zip(parts, by_part, strict=True):
        own = np.array([block for block, _ in blocks_of(part, ends_of_blocks)])
        for form, corners in zip((data, defects), sums, strict=True):
            form.add_corners(own, corners)
    data.state[segments.unconstrained] = np.eye(m)  # these nodes do not move
    add_starts(data.state, data.right, segments, misfit.point.nodes, scales)
    if segments.prior is not None:
        add_prior(data.corners[0], data.corner_gradients[0], segments.prior, misfit.point, scales)
    if segments.random is not None:
        _add_random_forces(data, segments.random, misfit.point, scales)
    return Linearization(data, defects, state_ends[:-1], right_ends[:-1], joined[:-1])


def add_prior(corner: Floats, gradient: Floats, prior: Prior, point: Iterate, scales: Scales) -> None:
    """Add the priors of unknowns to the border of a quadratic form, whose gradient is `gradient` (p,)."""
    columns = add_prior_curvature(corner, prior, scales, len(point.theta))
    gradient[columns] += prior.gradient(point.border, scales.theta)


def add_prior_curvature(matrix: Floats, prior: Prior, scales: Scales, parameters: int) -> Indices:
    """Add the priors to a square matrix: parameters come first in it, offsets, gains and delays last; gives their columns."""
    columns = border_columns(scales, parameters, len(matrix))
    matrix[columns, columns] += prior.curvature(scales.theta)
    return columns


def border_columns(scales: Scales, parameters: int, size: int) -> Indices:
    """The columns in a border of a `size` of what `scales` are of: parameters come first in it, the others last."""
    columns = np.arange(len(scales.theta))
    columns[parameters:] += size - len(columns)
    return columns


def _add_random_forces(data: NormalBlocks, random: RandomStates, point: Iterate, scales: Scales) -> None:
    """Add the cost of random forces to their states, and its slope to the border, whose columns are as in `add_prior`."""
    curvature = random.curvature(scales.state)
    data.state[:, random.rows, random.rows] += curvature.T
    data.right[:, random.rows, -1] -= (
        curvature * point.nodes[random.rows] / scales.state[random.rows, None]
    ).T
    if random.slope is not None:
        columns = np.arange(len(random.slope))
        columns[len(point.theta) :] += data.corners.shape[1] - len(random.slope)
        data.corner_gradients[0, columns] -= 0.5 * random.slope * scales.theta


def whitened_jacobian(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    part: slice,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
) -> tuple[Floats, Floats]:
    """Whitened Jacobian and residuals (k, M C, P + 1) in single precision; ends' sensitivities (k, 2n + S, P)."""
    M, C, K = segments.samples[..., part].shape
    P = segments.system.dimension + segments.parameters + _extra_columns(candidates, errors)
    width = P - segments.sensors.unknowns
    moving = width - (0 if errors is None else len(errors.channel))
    root, whiten = _weights(segments, misfit, scales, loss, part)
    jacobian: NDArray[Any] = np.zeros((K, M, C, P + 1), np.float32)
    jacobian[..., P] = (root * misfit.pulling[..., part]).transpose(2, 0, 1)
    columns = (moving, (width + columns_of_forces(segments)).tolist())
    ends = _put_marched(jacobian, segments, misfit, scales, part, whiten, candidates, columns)
    if segments.random is not None and segments.random.shown is not None:
        add_shown_forces(jacobian, segments.random, scales, whiten)
    if errors is not None:
        for number, channel in enumerate(errors.channel):
            jacobian[:, :, channel, moving + number] = (whiten[:, channel] * errors.values[:, number, part]).T
    add_errors_of_sensors(jacobian, segments, misfit, scales, root, part)
    ends /= scales.state[:, None]
    return jacobian.reshape(K, M * C, P + 1), ends


def _put_marched(
    jacobian: NDArray[Any],
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    part: slice,
    whiten: Single,
    candidates: CandidateForces | None,
    columns: tuple[int, list[int]],
) -> Floats:
    """Put what sensors show of the sensitivities, step by step; gives those at the ends (k, 2 n + S, P)."""
    step = segments.step[part] * segments.flow_steps_per_tangent
    mechanics = segments.system.at(misfit.point.theta)
    sensors = segments.sensors.at(mechanics)
    n, p = segments.system.incidence.shape[0], segments.system.parameters.size
    rates = (1.0, 1.0 / step, 1.0 / step**2, 1.0 / step**2, 1.0)
    shown = [
        (kind, channels, as_slice(channels), (whiten[:, channels] * rates[kind]).astype(np.float32))
        for kind in (X, V, A, F, S)
        if len(channels := np.flatnonzero(sensors.kind == kind))
    ]
    orbit = misfit.trajectories.part(part).thinned(segments.flow_steps_per_tangent)
    forces, inputs = _acting(segments, misfit.point, scales, part, candidates)
    steps = tangents(mechanics, orbit, step, scales.state, scales.theta[:p], forces, inputs=inputs)
    for number, tangent in enumerate(steps):
        sample, between = divmod(number - segments.tangents_before, segments.tangent_refine)
        if tangent.acceleration is None or between:
            continue
        motions = shown_tangents(sensors, tangent, mechanics, orbit, number, (step, scales.theta))
        for kind, channels, places, factors in shown:
            rows = tangents_of_channels(motions, kind, channels, sensors, misfit.point, rates[V])
            whitened = (rows * factors[sample, :, None]).transpose(2, 0, 1)
            _put(jacobian, (slice(None), sample, places), whitened, columns)
    ends = np.zeros((len(jacobian), segments.system.dimension, jacobian.shape[-1] - 1))
    moved = (tangent.state[0], tangent.state[1] * rates[V], tangent.memory)
    for own, change in zip((slice(0, n), slice(n, 2 * n), slice(2 * n, None)), moved, strict=True):
        _put(ends, (slice(None), own), change.transpose(2, 0, 1), columns)
    return ends


def _acting(
    segments: Segments, point: Iterate, scales: Scales, part: slice, candidates: CandidateForces | None
) -> tuple[CandidateForces | None, Inputs]:
    """The candidates in some segments, behind them what the unknowns of uncertain forces change, and the inputs there."""
    forces, inputs = candidates and candidates.part(part), segments.inputs.part(part)
    changes = changes_of_forces(segments, point, scales, part)
    if changes is None:
        return forces, inputs
    return changes if forces is None else forces.joined(changes), inputs.at(point.gains, point.delays)


def _put(
    target: NDArray[Any],
    place: tuple[slice | int | Indices, ...],
    block: NDArray[Any],
    columns: tuple[int, list[int]],
) -> None:
    """Put a block, of as many columns as come first in the target, and then of single ones there, into a place of it."""
    first, single = columns
    target[(*place, slice(first))] = block[..., :first]
    for number, column in enumerate(single, start=first):
        target[(*place, column)] = block[..., number]


def _weights(
    segments: Segments, misfit: Misfit, scales: Scales, loss: Loss, part: slice
) -> tuple[Floats, Single]:
    """(M, C, k) square roots of the weights of samples, 0 where one is missing, and what whitens what sensors show."""
    root = misfit.roots(segments, loss, part)
    return root, (root / segments.deviations(scales, part)).astype(np.float32)


def _extra_columns(candidates: CandidateForces | None, errors: SensorErrors | None) -> int:
    """Number of columns behind those of the parameters."""
    of_candidates = 0 if candidates is None else len(candidates.first)
    return of_candidates + (0 if errors is None else len(errors.channel))


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
    p, m = len(linear.data.corner), linear.data.state.shape[1]
    if not (np.isfinite(linear.state_ends).all() and np.isfinite(linear.right_ends).all()):
        return linear
    apart = linear.state_ends.copy()
    apart[:, range(m), range(m)] -= linear.joined
    shift = _least_left(apart, linear.right_ends[:, :, :p])
    right_ends = linear.right_ends.copy()
    right_ends[:, :, :p] += apart @ shift
    right = np.zeros_like(linear.defects.right)
    right[:-1] = linear.state_ends.transpose(0, 2, 1) @ right_ends
    ends = [slice(*pair) for pair in pairwise(block_ends(len(right), len(linear.data.corners)))]
    rows = (right_ends[block].reshape(-1, p + 1) for block in ends)
    products = np.stack([own.T @ own for own in rows])
    defects = replace(
        linear.defects, right=right, corners=products[:, :p, :p], corner_gradients=products[:, p, :p]
    )
    return replace(
        linear,
        data=_moved_along(linear.data, shift, ends),
        defects=defects,
        right_ends=right_ends,
        shift=shift,
    )


def _least_left(apart: Floats, by_border: Floats) -> Floats:
    """(m, p) the shift that, times `apart` (K - 1, m, m), leaves least of what the border does, (K - 1, m, p)."""
    rows = apart.reshape(-1, apart.shape[2])
    squares, products = rows.T @ rows, rows.T @ by_border.reshape(len(rows), -1)
    size = np.sqrt(np.maximum(squares.diagonal(), np.finfo(float).tiny))[:, None]
    solved = np.linalg.lstsq(squares / size / size.T, products / size, rcond=_INDEPENDENT)[0]
    return np.asarray(-solved / size)


def _moved_along(data: NormalBlocks, shift: Floats, blocks: Sequence[slice]) -> NormalBlocks:
    """The quadratic form of the samples, its corners by blocks of nodes, where the border moves nodes by `shift` (m, p)."""
    p = shift.shape[1]
    right = data.right.copy()
    right[:, :, :p] += data.state @ shift
    corners, gradients = data.corners.copy(), data.corner_gradients.copy()
    for number, block in enumerate(blocks):
        own = data.right[block].sum(axis=0)
        across = own[:, :p].T @ shift
        corners[number] += across + across.T + shift.T @ data.state[block].sum(axis=0) @ shift
        gradients[number] += shift.T @ own[:, p]
    return replace(data, right=right, corners=corners, corner_gradients=gradients)
