"""Records cut into segments with free states: residuals, defects, and their normal equations.

Segment k starts at its node, carries the samples j = 0 .. M - 1 from there, and ends where segment k + 1 starts
(if the two are linked). Several records are chains of segments that are not linked to each other. A missing sample
has weight zero; so has the padding behind the last sample of a record.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.bordered_system import BorderedSystem, Damping
from linkwise.likelihood.flow import CandidateForces, Inputs, Trajectories, flow, tangents
from linkwise.likelihood.loss import Loss
from linkwise.likelihood.system import System

X, V, A = 0, 1, 2

#: Numbers in one tangent array (2, n, P, k) of a chunk, so that a dozen of them fit a core's cache.
CHUNK = 120_000


@dataclass(frozen=True)
class Sensors:
    """kind (C,) X, V or A; mass (C,); offset, gain (C,): index of the channel's unknown offset or gain, -1 for none.

    A sensor shows gain * motion + offset.
    """

    kind: Indices
    mass: Indices
    offset: Indices
    gain: Indices = field(default_factory=lambda: np.empty(0, dtype=int))

    @property
    def offsets(self) -> int:
        return int(self.offset.max(initial=-1)) + 1

    @property
    def gains(self) -> int:
        return int(self.gain.max(initial=-1)) + 1


@dataclass(frozen=True, eq=False)
class Segments:
    """M samples a segment, `refine` (1 or even) steps of the flow a sample.

    samples (M, C, K) with 0 where missing; seen (M, C, K) bool; step (K,) s; linked (K - 1,) bool; loudness (C, K) the
    noise of a channel there over `Scales.sigma`, None where it is the same in all records.
    """

    system: System
    sensors: Sensors
    samples: Floats
    observed: Bools
    step: Floats
    linked: Bools
    inputs: Inputs
    refine: int = 1
    relative_noise: Floats | None = None

    @property
    def count(self) -> int:
        return int(self.samples.shape[-1])

    @property
    def steps(self) -> int:
        return len(self.samples) * self.refine

    @property
    def parameters(self) -> int:
        return int(self.system.parameters.size + self.sensors.offsets + self.sensors.gains)

    @cached_property
    def unconstrained(self) -> Bools:
        """(K,) segments of which nothing is known: neither a sample nor a link."""
        before, after = np.append(False, self.linked), np.append(self.linked, False)
        return np.asarray(~(before | after | self.observed.any(axis=(0, 1))))

    @property
    def chains(self) -> int:
        """Runs of linked segments, each with one free state at its head."""
        return 1 + int((~self.linked).sum()) - int(self.unconstrained.sum())


@dataclass(frozen=True, eq=False)
class Iterate:
    """The unknowns: nodes (2, n, K) in m and m/s, theta (p,), offsets (o,) and gains (g,) of sensors."""

    nodes: Floats
    theta: Floats
    offsets: Floats
    gains: Floats = field(default_factory=lambda: np.ones(0))

    @property
    def border(self) -> Floats:
        """(p + o + g,) all that the nodes share."""
        return np.concatenate([self.theta, self.offsets, self.gains])


@dataclass(frozen=True, eq=False)
class Scales:
    """Units of the unknowns: sigma (C,) noise of the channels; state (2n,): a defect's natural size; theta (p + o + g,)."""

    sigma: Floats
    state: Floats
    theta: Floats


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a point leaves: orbit, residuals / sigma (M, C, K) (0 where missing), defects / state scale (2, n, K - 1)."""

    point: Iterate
    trajectories: Trajectories
    residuals: Floats
    defects: Floats
    data: float
    continuity: float

    def cost(self, q: float) -> float:
        return self.data + self.continuity / q**2


def evaluate(segments: Segments, point: Iterate, scales: Scales, loss: Loss) -> Misfit:
    mechanics = segments.system.at(point.theta)
    with np.errstate(over="ignore", invalid="ignore"):
        orbit = flow(mechanics, point.nodes, segments.step, segments.steps, segments.inputs)
    sensors, rate = segments.sensors, 1.0 / segments.step
    every = slice(None, segments.steps, segments.refine)
    residuals = np.empty_like(segments.samples)
    for kind, motion in (
        (X, orbit.states[every, 0]),
        (V, orbit.states[every, 1] * rate),
        (A, orbit.accelerations[every]),
    ):
        chosen = np.flatnonzero(sensors.kind == kind)
        residuals[:, chosen] = segments.samples[:, chosen] - motion[:, sensors.mass[chosen]]
    for channel in np.flatnonzero(sensors.gain >= 0):
        residuals[:, channel] -= (point.gains[sensors.gain[channel]] - 1.0) * (
            segments.samples[:, channel] - residuals[:, channel]
        )
    for channel in np.flatnonzero(sensors.offset >= 0):
        residuals[:, channel] -= point.offsets[sensors.offset[channel]]
    residuals *= segments.observed
    residuals /= scales.sigma[:, None]
    if segments.relative_noise is not None:
        residuals /= segments.relative_noise
    ends = orbit.states[-1].copy()
    ends[1] *= rate
    defects = (point.nodes[..., 1:] - ends[..., :-1]) / scales.state.reshape(2, -1, 1)
    defects *= segments.linked
    return Misfit(point, orbit, residuals, defects, loss.total(residuals), float(np.vdot(defects, defects)))


@dataclass(frozen=True, eq=False)
class NormalBlocks:
    """One quadratic form over scaled unknowns: state (K, m, m), right (p + 1, K, m) border and gradient, corner."""

    state: Floats
    right: Floats
    corner: Floats
    corner_gradient: Floats

    @classmethod
    def empty(cls, K: int, m: int, p: int) -> NormalBlocks:
        return cls(np.empty((K, m, m)), np.empty((p + 1, K, m)), np.zeros((p, p)), np.zeros(p))

    def put(self, part: slice, product: Floats) -> tuple[Floats, Floats]:
        """Store [J r]'[J r] (k, P + 1, P + 1) of a chunk; returns its share of the corner and of its gradient."""
        m = self.state.shape[1]
        self.state[part] = product[:, :m, :m]
        self.right[:, part] = product[:, m:, :m].transpose(1, 0, 2)
        total = product[:, m:, m:].sum(axis=0, dtype=float)
        return total[:-1, :-1], total[-1, :-1]


@dataclass(frozen=True, eq=False)
class Linearization:
    """Gauss-Newton model of a misfit: its data part, and its defects for q = 1 without the later node's own share."""

    data: NormalBlocks
    defects: NormalBlocks
    state_ends: Floats  # (K - 1, m, m) end of a segment by its node
    right_ends: Floats  # (p + 1, K - 1, m) end by theta and offsets; last the defect, sign reversed
    linked: Bools  # (K - 1,)

    def equations(self, q: float) -> BorderedSystem:
        """Normal equations with squared defects weighted by 1 / q^2."""
        weight = 1.0 / q**2
        m = self.data.state.shape[1]
        diagonal = self.defects.state * weight
        diagonal += self.data.state
        diagonal[1:, range(m), range(m)] += weight * self.linked[:, None]
        right = self.defects.right * weight
        right += self.data.right
        right[:, 1:] -= weight * self.right_ends
        return BorderedSystem(
            diagonal,
            self.state_ends * -weight,
            right,
            self.data.corner + weight * self.defects.corner,
            self.data.corner_gradient + weight * self.defects.corner_gradient,
        )

    def damping(self, strength: float) -> Damping | None:
        """`strength` times the diagonal at q = 1: the same trust in metres at every q."""
        if strength == 0.0:
            return None
        nodes = np.einsum("kii->ki", self.data.state + self.defects.state)
        nodes[1:] += self.linked[:, None]
        return Damping(strength * nodes, strength * np.diag(self.data.corner + self.defects.corner))


def linearise(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    executor: Executor | None = None,
    pushes: CandidateForces | None = None,
) -> Linearization:
    """Gauss-Newton blocks at a point, chunk by chunk: a chunk's tangents stay in the processor's cache.

    The sizes of `pushes` stand in the border behind theta.
    """
    m, K = 2 * segments.system.incidence.shape[0], segments.count
    p = segments.parameters + (0 if pushes is None else len(pushes.first))
    size = max(16, int(CHUNK / (m * (m + p))) // 16 * 16)
    parts = [slice(first, min(first + size, K)) for first in range(0, K, size)]
    data, defects = NormalBlocks.empty(K, m, p), NormalBlocks.empty(K, m, p)
    linked = np.append(segments.linked, False)
    missed = np.zeros((K, m))
    missed[:-1] = misfit.defects.reshape(m, -1).T
    state_ends, right_ends = np.empty((K, m, m)), np.empty((p + 1, K, m))

    @np.errstate(
        over="ignore", invalid="ignore"
    )  # in threads too, which do not share the state of the caller
    def work(part: slice) -> tuple[Floats, Floats, Floats, Floats]:
        rows, ends = _chunk(segments, misfit, scales, loss, part, pushes)
        corner = data.put(part, rows.transpose(0, 2, 1) @ rows)
        ends = np.concatenate([ends, missed[part, :, None]], axis=2)
        ends *= linked[part, None, None]
        state_ends[part] = ends[:, :, :m]
        right_ends[:, part] = ends[:, :, m:].transpose(2, 0, 1)
        return *corner, *defects.put(part, ends.transpose(0, 2, 1) @ ends)

    for corners in map(work, parts) if executor is None else executor.map(work, parts):
        for total, share in zip(
            (data.corner, data.corner_gradient, defects.corner, defects.corner_gradient),
            corners,
            strict=False,
        ):
            total += share
    data.state[segments.unconstrained] = np.eye(m)  # these nodes stay where they are
    return Linearization(data, defects, state_ends[:-1], right_ends[:, :-1], segments.linked)


def _chunk(
    segments: Segments,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    part: slice,
    pushes: CandidateForces | None,
) -> tuple[Floats, Floats]:
    """Whitened Jacobian and residuals (k, M C, P + 1) in single precision; ends' sensitivities (k, 2n, P)."""
    sensors, step = segments.sensors, segments.step[part] * segments.refine
    M, C, K = segments.samples[..., part].shape
    n, p = segments.system.incidence.shape[0], segments.system.parameters.size
    added = 0 if pushes is None else len(pushes.first)
    P, width = 2 * n + segments.parameters + added, 2 * n + p + added
    mechanics = segments.system.at(misfit.point.theta)
    residuals = misfit.residuals[..., part]
    root = np.sqrt(loss.weight(residuals)) * segments.observed[..., part]
    jacobian = np.zeros((K, M, C, P + 1), np.float32)
    jacobian[..., P] = (root * residuals).transpose(2, 0, 1)
    whiten = (root / scales.sigma[:, None]).astype(np.float32)
    if segments.relative_noise is not None:
        whiten /= segments.relative_noise[:, part].astype(np.float32)
    chosen = [np.flatnonzero(sensors.kind == kind) for kind in (X, V, A)]
    rates = (1.0, 1.0 / step, 1.0 / step**2)
    orbit = misfit.trajectories.part(part).thinned(segments.refine)
    for sample, (state, acceleration) in enumerate(
        tangents(mechanics, orbit, step, scales.state, scales.theta[:p], pushes and pushes.part(part))
    ):
        if acceleration is None:
            continue
        for kind, motion in ((X, state[0]), (V, state[1]), (A, acceleration)):
            if len(chosen[kind]):
                factor = (whiten[sample, chosen[kind]] * rates[kind]).astype(np.float32)
                rows = motion[sensors.mass[chosen[kind]]] * factor[:, None]
                jacobian[:, sample, chosen[kind], :width] = rows.transpose(2, 0, 1)
    for channel in np.flatnonzero(sensors.offset >= 0):
        column = width + sensors.offset[channel]
        jacobian[:, :, channel, column] = whiten[:, channel].T * scales.theta[p + sensors.offset[channel]]
    _calibrate_gains(jacobian, segments, misfit, scales, root, part)
    ends = np.zeros((K, 2 * n, P))
    ends[:, :n, :width] = state[0].transpose(2, 0, 1)
    ends[:, n:, :width] = (state[1] * rates[V]).transpose(2, 0, 1)
    ends /= scales.state[:, None]
    return jacobian.reshape(K, M * C, P + 1), ends


def _calibrate_gains(
    jacobian: Floats, segments: Segments, misfit: Misfit, scales: Scales, root: Floats, part: slice
) -> None:
    """Sensors with an unknown gain: their rows are scaled by it, and its own column is the motion, whitened as they are.

    `root` (M, C, k) is the square root of the samples' weights, 0 where one is missing.
    """
    sensors, point = segments.sensors, misfit.point
    moved = jacobian.shape[-1] - 1 - sensors.offsets - sensors.gains
    first = len(point.theta) + len(point.offsets)
    for channel in np.flatnonzero(sensors.gain >= 0):
        number = sensors.gain[channel]
        loud = 1.0 if segments.relative_noise is None else segments.relative_noise[channel, part]
        sigma = scales.sigma[channel] * loud
        shown = segments.samples[:, channel, part] / sigma - misfit.residuals[:, channel, part]
        if sensors.offset[channel] >= 0:
            shown = shown - point.offsets[sensors.offset[channel]] / sigma
        jacobian[:, :, channel, :moved] *= np.float32(point.gains[number])
        unit = scales.theta[first + number] / point.gains[number]
        column = moved + len(point.offsets) + number
        jacobian[:, :, channel, column] = (root[:, channel] * shown * unit).T


def refined(segments: Segments, refine: int, inputs: Inputs) -> Segments:
    """The same segments with other steps a sample; inputs at the new steps' points."""
    return replace(segments, refine=refine, inputs=inputs, step=segments.step * (segments.refine / refine))
