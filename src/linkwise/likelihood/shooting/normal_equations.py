"""Gauss-Newton normal equations of multiple shooting, block by block and chunk by chunk of segments."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.acting_forces import ActingForces
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem, Damping
from linkwise.likelihood.shooting.flow import Inputs
from linkwise.likelihood.shooting.local_rows import as_slice
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.normal_blocks import ChannelErrors, NormalBlocks, put_columns
from linkwise.likelihood.shooting.prior import Prior
from linkwise.likelihood.shooting.random_states import RandomStates
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, F, Iterate, S, Scales, Segments, V, X
from linkwise.likelihood.shooting.sensor_columns import (
    add_delays,
    add_offsets,
    add_shown_forces,
    calibrate_gains,
    changes_of_forces,
    columns_of_forces,
    tangents_of_channels,
)
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.shooting.shown_tangents import shown_tangents
from linkwise.likelihood.shooting.slider_starts import add_starts
from linkwise.likelihood.shooting.tangent_forces import CandidateForces, Single
from linkwise.likelihood.shooting.tangents import tangents
from linkwise.likelihood.shooting.transitions import carried

#: Numbers in one tangent array (2, n, P, k) of a chunk, so that a dozen of them fit a core's cache.
CHUNK = 120_000
_AT_ONCE = 32  # nodes whose equations are assembled together
NEGLIGIBLE = (1e-13, 1e-12, 1e-11)  # of the diagonal: single precision has 6e-8


def chunks(segments: Segments, parameters: int | None = None) -> list[slice]:
    """The segments in parts whose sensitivities to states and `parameters` stay in a core's cache."""
    m, K = segments.system.dimension, segments.count
    p = segments.parameters if parameters is None else parameters
    if segments.by_transitions:  # with two arrays of them in place of a dozen
        return [slice(*pair) for pair in pairwise(block_ends(K, -(-K * m * (m + p) // (2 * CHUNK))))]
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
    `blocks` of segments; products with errors are not told apart by these.
    """
    m, K = segments.system.dimension, segments.count
    p = segments.parameters + _extra_columns(candidates, errors)
    columns = np.delete(np.arange(p + 1), _columns_of(errors, segments, candidates))
    parts, ends_of_blocks = chunks(segments, len(columns) - 1), block_ends(K, blocks)
    data, defects = NormalBlocks.empty(K, m, p, blocks), NormalBlocks.empty(K, m, p, blocks)
    joined, defects_by_node = np.zeros((2, K, m))
    joined[:-1], defects_by_node[:-1] = segments.link_weights.T, misfit.defects.reshape(m, -1).T
    state_ends, right_ends = np.empty((K, m, m)), np.zeros((K, m, p + 1))

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(part: slice) -> tuple[Floats, Floats, Floats | None]:
        pieces = [piece for _, piece in blocks_of(part, ends_of_blocks)]
        rows, ends = whitened_jacobian(segments, misfit, scales, loss, part, candidates)
        corners, of_errors = data.put(part, rows, pieces, columns), None
        if errors is not None:
            added = _whitened_errors(errors, segments, misfit, scales, loss, part, candidates)
            of_errors = data.put_errors(part, rows, added, columns)
        ends *= joined[part, :, None]
        ends = np.concatenate([ends, defects_by_node[part, :, None]], axis=2)
        state_ends[part] = ends[:, :, :m]
        put_columns(right_ends[part], columns, ends[:, :, m:])
        return corners, defects.put(part, ends, pieces, columns), of_errors

    by_part = map(work, parts) if executor is None or len(parts) == 1 else executor.map(work, parts)
    for part, (*sums, of_errors) in zip(parts, by_part, strict=True):
        own = np.array([block for block, _ in blocks_of(part, ends_of_blocks)])
        for form, corners in zip((data, defects), sums, strict=True):
            form.add_corners(own, columns, corners)
        if of_errors is not None:
            data.add_corners(own[:1], np.arange(p + 1), of_errors[None])
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
    put = _put_carried if segments.by_transitions else _put_marched
    ends = put(jacobian, segments, misfit, scales, part, whiten, candidates, columns)
    if segments.random is not None and segments.random.shown is not None:
        add_shown_forces(jacobian, segments.random, scales, whiten)
    if errors is not None:
        for number, channel in enumerate(errors.channel):
            jacobian[:, :, channel, moving + number] = (whiten[:, channel] * errors.values[:, number, part]).T
    add_offsets(jacobian[..., width:], segments, scales, whiten, part)
    calibrate_gains(jacobian, segments, misfit, scales, root, part)
    add_delays(jacobian, segments, misfit, scales, whiten, part)
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
    units, of_links = (scales.state, scales.theta[:p]), bool(np.any(sensors.kind == F))
    steps = tangents(mechanics, orbit, step, *units, forces, inputs=inputs, of_links=of_links)
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


def _put_carried(
    jacobian: NDArray[Any],
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    part: slice,
    whiten: Single,
    candidates: CandidateForces | None,
    columns: tuple[int, list[int]],
) -> Floats:
    """As `_put_marched`, by transitions over half steps; all that sensors show are displacements of masses."""
    stride = segments.flow_steps_per_tangent
    step = segments.step[part] * stride
    mechanics, sensors = segments.system.at(misfit.point.theta), segments.sensors
    n, p = segments.system.incidence.shape[0], segments.system.parameters.size
    rate, moving = (1.0 / step)[:, None, None].astype(np.float32), columns[0]
    orbit = misfit.trajectories.part(part)
    unit, inputs = scales.theta[:p], segments.inputs.part(part)
    orbit = orbit.thinned(stride // 2)
    acting = ActingForces.along(
        mechanics, orbit, step, unit, candidates and candidates.part(part), inputs=inputs
    )
    shown, factors = as_slice(sensors.mass), whiten.transpose(0, 2, 1)[..., None]
    for number, motion in enumerate(carried(mechanics, step, scales.state, acting, moving)):
        sample, between = divmod(number, segments.tangent_refine)
        if sample < len(factors) and not between:
            np.multiply(motion[:, shown], factors[sample], out=jacobian[:, sample, :, :moving])
    ends = np.zeros((len(jacobian), 2 * n, jacobian.shape[-1] - 1))
    ends[:, :n, :moving], ends[:, n:, :moving] = motion[:, :n], motion[:, n:] * rate
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
    whiten = (root / scales.sigma[:, None]).astype(np.float32)
    if segments.relative_noise is not None:
        whiten /= segments.relative_noise[:, part].astype(np.float32)
    return root, whiten


def _columns_of(
    errors: SensorErrors | None, segments: Segments, candidates: CandidateForces | None
) -> Indices:
    """The columns of `errors` in the border, which follow those of the parameters and of `candidates`."""
    first = segments.system.parameters.size + _extra_columns(candidates, None)
    return first + np.arange(_extra_columns(None, errors))


def _whitened_errors(
    errors: SensorErrors,
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    part: slice,
    candidates: CandidateForces | None,
) -> list[ChannelErrors]:
    """What errors add to the rows of their channels in some segments."""
    _, whiten = _weights(segments, misfit, scales, loss, part)
    columns = _columns_of(errors, segments, candidates)
    factors = segments.sensors.factors(misfit.point.gains)
    by_channel = []
    for channel in np.unique(errors.channel).tolist():
        own = np.flatnonzero(errors.channel == channel)
        added = whiten[:, channel, None] * errors.values[:, own, part]
        values = added.transpose(2, 0, 1).astype(np.float32)
        if channel in segments.sensors.scaled:
            values *= np.float32(factors[channel])
        by_channel.append(ChannelErrors(channel, columns[own], values))
    return by_channel


def _extra_columns(candidates: CandidateForces | None, errors: SensorErrors | None) -> int:
    """Number of columns behind those of the parameters."""
    of_candidates = 0 if candidates is None else len(candidates.first)
    return of_candidates + (0 if errors is None else len(errors.channel))
