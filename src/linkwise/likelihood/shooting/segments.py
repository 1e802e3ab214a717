"""Records cut into segments with free states: the samples, the sensors that show them, and the unknowns.

Segment k starts at its node, carries the samples j = 0 .. M - 1 from there, and ends where segment k + 1 starts
(if the two are linked). Several records are chains of segments that are not linked to each other. A missing sample
has weight zero; so has the padding behind the last sample of a record.

`Sensors` have unknown gains and delays; what they add in known shapes of unknown size, offsets too, are `SensorErrors`. Over
a long gap chaotic motion has many continuations, and a search cannot choose among them from poor starting values: the state
behind it is free at first (`split_at_gaps`), and the two sides are joined once the laws are known.

What else the cost counts: priors of the unknowns, random forces on masses (states that are constant in a segment of one
sample, and independent of those around), and readings of overloaded sensors, as bounds.

With u the distance in standard deviations by which the motion is beyond the end of the range, a clipped reading has the
probability Phi(u), the normal distribution. Its score h = phi(u) / Phi(u) and curvature h (h + u) are those of an observation
1 / (h + u) beyond the motion with this curvature as weight. Samples that noise alone held inside are exact: were they left
out and the others not, noise would have chosen which samples count.

References
----------
J. Tobin, Econometrica 26, 24 (1958).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.delay_polynomials import LARGEST, value_and_slope
from linkwise.likelihood.shooting.flow import Inputs, OverSegments, Trajectories, flow
from linkwise.likelihood.shooting.system import NumericSystem, System
from linkwise.records.record import Record

_OWN = 1e-3  # of a prior's variance: what the records must take off it to say anything against it


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal distributions of the unknowns that all segments share.

    Attributes
    ----------
    mean : array of shape (P,)
        Most likely values of parameters, offsets and gains.
    deviation : array of shape (P,)
        Their standard deviations; infinite where nothing is known.
    """

    mean: Floats
    deviation: Floats

    @property
    def count(self) -> int:
        """Number of unknowns with a prior; each is one more residual."""
        return int(np.isfinite(self.deviation).sum())

    def cost(self, border: Floats) -> float:
        """-2 log of the density at `border` (P,), without its constant."""
        return float(np.sum(self._standardised(border) ** 2))

    def curvature(self, unit: Floats) -> Floats:
        """(P,) diagonal that the prior adds to normal equations in units of `unit` (P,)."""
        return np.asarray((unit / self.deviation) ** 2)

    def gradient(self, border: Floats, unit: Floats) -> Floats:
        """(P,) that the prior adds to the right-hand side of normal equations in units of `unit` (P,)."""
        return np.asarray(self._standardised(border) * unit / self.deviation)

    def conflicts(self, border: Floats, variance: Floats) -> Floats:
        """(P,) what leaving out each prior would take off the cost, to first order: chi-square with one degree of freedom.

        `border` and `variance` (P,) are the unknowns and their variances with all priors; zero where there is no prior, or
        where it alone says what the unknown is.
        """
        left = 1.0 - np.minimum(variance / self.deviation**2, 1.0)
        determined = np.isfinite(self.deviation) & (left > _OWN)
        return np.where(determined, self._standardised(border) ** 2 / np.where(determined, left, 1.0), 0.0)

    def _standardised(self, border: Floats) -> Floats:
        return np.asarray((self.mean - border) / self.deviation)


@dataclass(frozen=True, eq=False)
class RandomStates(OverSegments):
    """Random forces among the states: normal, of mean zero, and without continuity between segments.

    Attributes
    ----------
    rows : array of int, shape (r,)
        Their numbers among the 2n + S states.
    deviation : array of shape (r, K)
        Standard deviations in N.
    is_estimated : array of bool, shape (r,)
        Whether the deviations are to be found.
    absent : array of bool, shape (r,)
        Those that were looked for and not found: their deviations stand for zero.
    varying : array of bool, shape (r,)
        Those that vary within a segment as white noise does, of which the states are the means.
    slope : array of shape (P,) or None
        Gradient of the log determinant of the equations by the unknowns that all nodes share: its part of -2 log of the
        marginal likelihood, which is linear around the optimum.
    origin : array of shape (P,) or None
        Where that part is counted as zero.
    shown : array of shape (C, r) or None
        What the sensors show of them directly, besides the motion that follows; None for nothing.
    weights : array of shape (2n + S, K) or None
        What defects at the ends of the segments weigh, where these forces leave some in displacements. None for 1.
    """

    of_each = ("deviation", "weights")

    rows: Indices
    deviation: Floats
    is_estimated: Bools
    absent: Bools
    varying: Bools
    slope: Floats | None = None
    origin: Floats | None = None
    shown: Floats | None = None
    weights: Floats | None = None

    def cost(self, nodes: Floats, border: Floats) -> float:
        """What the forces among `nodes` (2n + S, K) and the slope along `border` (P,) add to the cost."""
        tilt = 0.0
        if self.slope is not None and self.origin is not None:
            tilt = float(self.slope @ (border - self.origin))
        return float(np.sum((nodes[self.rows] / self.deviation) ** 2)) + tilt

    def curvature(self, scale: Floats) -> Floats:
        """(r, K) half the second derivatives of the cost by the forces, in units `scale` (2n + S,) of the states."""
        return np.asarray((scale[self.rows, None] / self.deviation) ** 2)

    @property
    def present(self) -> Bools:
        """(r,) those that are not absent."""
        return ~self.absent

    def scaled(self, factors: Floats) -> Self:
        """The same with deviations multiplied by `factors` (r,)."""
        return replace(self, deviation=self.deviation * factors[:, None])


_FARTHEST = 1e5  # standard deviations inside the range, from which a bound is an observation to rounding


@dataclass(frozen=True, eq=False)
class ClippedMisfit(OverSegments):
    """What clipped readings say of a motion.

    Attributes
    ----------
    residuals, roots : array of shape (M, C, K)
        Residuals of the observations that stand for them, in standard deviations, and the roots of their weights; else 0.
    shown : array of shape (M, C, K)
        What the sensors would show there, in standard deviations; else 0.
    cost : float
        Twice the negative log likelihood, up to a constant.
    """

    along = ("residuals", "roots", "shown")

    residuals: Floats
    roots: Floats
    shown: Floats
    cost: float


@dataclass(frozen=True, eq=False)
class ClippedReadings(OverSegments):
    """Clipped readings in segments.

    Attributes
    ----------
    present : array of bool, shape (M, C, K)
        Where one is.
    readings, sides : array of shape (M, C, K)
        As of `ClippedSamples`; 0 where there is none.
    """

    along = ("present", "readings", "sides")

    present: Bools
    readings: Floats
    sides: Floats

    @classmethod
    def of(
        cls, records: Sequence[Record], channels: Sequence[str], cut: Callable[[list[Floats]], Floats]
    ) -> ClippedReadings | None:
        """Those of the `channels` of records, `cut` into segments; None without any."""
        series = []
        for record in records:
            both = np.full((len(record), 2, len(channels)), np.nan)
            for number, name in enumerate(channels):
                own = record.clipped.get(name)
                if own is not None and (own := own.of(record.channel(name))) is not None:
                    both[:, 0, number], both[:, 1, number] = own.readings, own.sides
            series.append(both)
        readings, sides = cut(series).transpose(1, 0, 2, 3)
        present = np.isfinite(readings)
        if not present.any():
            return None
        return cls(present, np.where(present, readings, 0.0), np.where(present, sides, 0.0))

    def misfit(self, residuals: Floats, unit: Floats) -> ClippedMisfit:
        """What they say of a motion.

        Parameters
        ----------
        residuals : array of shape (M, C, K)
            Of samples, which are 0 here, in standard deviations of the noise.
        unit : array to broadcast against those
            The standard deviations, in the units of the channels.

        Returns
        -------
        ClippedMisfit
            Residuals and cost; not finite where the motion diverges.
        """
        shown = np.where(self.present, -residuals, 0.0)
        left = np.where(self.present, self.readings / unit - shown, 0.0)
        bounded = self.sides != 0.0
        beyond = np.maximum(-self.sides[bounded] * left[bounded], -_FARTHEST)
        score, curvature = _score_and_curvature(beyond)
        roots = self.present.astype(float)
        roots[bounded] = np.sqrt(curvature)
        cost = float(np.vdot(left[~bounded], left[~bounded]) - 2.0 * np.sum(scipy.special.log_ndtr(beyond)))
        left[bounded] = self.sides[bounded] / (score + beyond)
        return ClippedMisfit(left, roots, shown, cost)


def _score_and_curvature(beyond: Floats) -> tuple[Floats, Floats]:
    """Slope of the log likelihood of bounds that the motion is `beyond`, in standard deviations, and its curvature."""
    score = np.sqrt(2.0 / np.pi) / scipy.special.erfcx(-beyond / np.sqrt(2.0))
    return score, score * (score + beyond)


@dataclass(frozen=True, eq=False)
class SensorErrors(OverSegments):
    """c errors of unit size: `channel` (c,), and c `values` (M, K), what each adds to its samples."""

    along = ("values",)

    channel: Indices = field(default_factory=lambda: np.empty(0, dtype=int))
    values: Sequence[Floats] = ()

    def added(self, sizes: Floats) -> Iterator[tuple[int, Floats]]:
        """The channel of each error of these `sizes` (c,), and what it adds to that, (M, K)."""
        for channel, size, values in zip(self.channel.tolist(), sizes, self.values, strict=True):
            yield channel, size * values


@dataclass(frozen=True, eq=False)
class LateBase(OverSegments):
    """Polynomials in the delay of what `channels` show of moving coordinates.

    `coefficients` (P, M, L, K) of powers of the delay over its largest, constant first; `step` (K,) of the samples in s.
    """

    of_each = ("coefficients", "step")

    channels: tuple[int, ...]
    coefficients: Floats
    step: Floats

    def at(self, channel: int, delay: float, part: slice = slice(None)) -> tuple[Floats, Floats]:
        """(M, k) what a channel shows that is `delay` s late, and its rate; straight on beyond the largest delay."""
        unit = LARGEST * self.step[part]
        value, slope = value_and_slope(
            self.coefficients[:, :, self.channels.index(channel), part], delay / unit
        )
        return value, -slope / unit


X, V, A, F, S = 0, 1, 2, 3, 4
"""Kinds of sensors: displacement, velocity and acceleration of a mass, force in a link, state of a link."""


def as_slice(numbers: Indices) -> Indices | slice:
    """The same places as a slice, where they follow each other, so that no copy is made."""
    if len(numbers) and numbers[-1] - numbers[0] == len(numbers) - 1 and (np.diff(numbers) == 1).all():
        return slice(int(numbers[0]), int(numbers[-1]) + 1)
    return numbers


@dataclass(frozen=True)
class Sensors:
    """`kind` (C,) is X, V, A, F or S, `mass` (C,) the number of a mass, or of a link or a state in the order of the system.

    From n on it is the number of a point of a host, which moves by its row in `shapes` (c, n); `points` (c,) are their
    numbers among the points of the system. `delay` (C,) are indices of its unknown delay, -1 for none; `offsets` and `delays`
    are how many unknowns there are of what sensors add, and of delays, those of inputs as well.

    A sensor reads gain * motion + what is added, the gain being 1 plus the errors of the unknown factors in its row of `gain`
    (C, g): ones where a factor acts on the channel, else zeros.
    """

    kind: Indices
    mass: Indices
    gain: Floats
    delay: Indices = field(default_factory=lambda: np.empty(0, dtype=int))
    shapes: Floats | None = None
    points: Indices = field(default_factory=lambda: np.empty(0, dtype=int))
    offsets: int = 0
    delays: int = 0

    def at(self, mechanics: NumericSystem) -> Sensors:
        """The sensors with the shapes of hosts that a system has at its parameters."""
        if mechanics.shape_change is None or self.shapes is None:
            return self
        return replace(self, shapes=mechanics.points[self.points])

    def with_points(self, motion: NDArray[Any], axis: int) -> NDArray[Any]:
        """The motion of the masses along an axis, and behind them that of the points with a sensor."""
        if self.shapes is None:
            return motion
        weights = self.shapes.astype(motion.dtype)
        points = np.moveaxis(np.tensordot(weights, motion, axes=(1, axis)), 0, axis)
        return np.concatenate([motion, points], axis=axis)

    def shown(self, motions: Sequence[NDArray[Any]], axis: int) -> list[NDArray[Any]]:
        """What sensors of each kind show, with the points behind the masses along an axis."""
        return [self.with_points(motion, axis) if kind < F else motion for kind, motion in enumerate(motions)]

    def orbit_with_points(self, orbit: Trajectories) -> Trajectories:
        """An orbit with the points behind the masses in its states and accelerations at the ends of steps."""
        if self.shapes is None:
            return orbit
        return replace(
            orbit,
            states=self.with_points(orbit.states, 2),
            half_accelerations=self.with_points(orbit.half_accelerations, 1),
        )

    @cached_property
    def of_masses(self) -> Bools:
        """(C,) whether a sensor shows the motion of a mass."""
        return np.asarray(self.kind < F)

    @cached_property
    def by_kind(self) -> list[tuple[int, Indices | slice, Indices | slice]]:
        """Each kind that there is, the channels of it, and the numbers of what they show."""
        kinds = ((kind, np.flatnonzero(self.kind == kind)) for kind in (X, V, A, F, S))
        return [(kind, as_slice(own), as_slice(self.mass[own])) for kind, own in kinds if len(own)]

    @cached_property
    def gains(self) -> int:
        return int(self.gain.shape[1])

    @cached_property
    def unknowns(self) -> int:
        """Unknown offsets, gains and delays."""
        return self.offsets + self.gains + self.delays

    @cached_property
    def late(self) -> Indices:
        """Channels with an unknown delay."""
        return np.flatnonzero(self.delay >= 0)

    @cached_property
    def scaled(self) -> Indices:
        """Channels with an unknown gain."""
        return np.flatnonzero(self.gain.any(axis=1))

    def factors(self, gains: Floats) -> Floats:
        """(C,) gains of the channels, from the unknown factors (g,)."""
        return np.asarray(1.0 + self.gain @ (gains - 1.0))


@dataclass(frozen=True, eq=False)
class Segments(OverSegments):
    """M samples a segment, `refine` (1 or even) steps of the flow a sample and `tangent_refine` steps of its tangents.

    `refine` over `tangent_refine` is 1 or even.

    `samples` (M, C, K) are 0 where missing, `observed` (M, C, K) says where they are not; `step` (K,) in s; `linked` (K - 1,)
    says which neighbouring segments are continuous; `relative_noise` (C, K) is the noise of a channel over `Scales.sigma`,
    None where it is the same in all records; `prior` holds the priors of the unknowns; `carried`, twice (M, C, K), is what the
    sensors show beside `samples`, in which it is not, and its rate: the motion of moving coordinates, None without any;
    `late_base` is the same of late sensors; `random` are random forces among the states, None without any; `errors` what
    sensors add per unit of their unknown offsets; `clipped` are readings at the ends of the ranges of sensors, missing in
    `samples`, None without any; `centred` says whether samples are in the middle of their steps, of which there are two or
    more, and not at the start.
    """

    along = ("samples", "observed", "inputs", "carried", "late_base", "random", "errors", "clipped")
    of_each = ("step", "relative_noise")

    system: System
    sensors: Sensors
    samples: Floats
    observed: Bools
    step: Floats
    linked: Bools
    inputs: Inputs
    refine: int = 1
    tangent_refine: int = 1
    relative_noise: Floats | None = None
    prior: Prior | None = None
    carried: Sequence[Floats] | None = None
    late_base: LateBase | None = None
    random: RandomStates | None = None
    errors: SensorErrors = field(default_factory=SensorErrors)
    clipped: ClippedReadings | None = None
    centred: bool = False

    @cached_property
    def at_samples(self) -> slice:
        """The steps of the flow at whose start there is a sample."""
        return slice(self.refine // 2 if self.centred else 0, self.steps, self.refine)

    @cached_property
    def tangents_before(self) -> int:
        """Steps of the tangents in a segment before its first sample."""
        return self.tangent_refine // 2 if self.centred else 0

    @cached_property
    def count(self) -> int:
        return int(self.samples.shape[-1])

    @cached_property
    def steps(self) -> int:
        return len(self.samples) * self.refine

    @cached_property
    def flow_steps_per_tangent(self) -> int:
        """Steps of the flow in one step of its tangents."""
        return self.refine // self.tangent_refine

    @cached_property
    def parameters(self) -> int:
        return int(self.system.parameters.size + self.sensors.unknowns)

    @cached_property
    def continuous(self) -> Floats:
        """(2n + S,) 1 for states that are continuous between linked segments, 0 for random forces."""
        continuous = np.ones(self.system.dimension)
        if self.random is not None:
            continuous[self.random.rows] = 0.0
        return continuous

    @cached_property
    def link_weights(self) -> Floats:
        """(2n + S, K - 1) what defects weigh: 1, or 0 of what is not continuous, and less than 1 of what forces loosen."""
        weights = self.continuous[:, None] * self.linked
        if self.random is not None and self.random.weights is not None:
            weights *= self.random.weights[:, :-1]
        return weights

    def chosen(self, which: Indices) -> Self:
        """Some of the segments; those that follow each other in the record stay linked."""
        linked = self.linked[which[:-1]] & (np.diff(which) == 1)
        return replace(self.part(which), linked=linked)

    def in_records(self, values: Floats, records: Sequence[Record]) -> list[Floats]:
        """(N, ...) of each of the records what is at the samples of segments (M, ..., K)."""
        rows = np.moveaxis(values, -1, 0).reshape(self.count * len(values), *values.shape[1:-1])
        whole = np.cumsum([-(-len(record) // len(values)) * len(values) for record in records])
        parts = np.split(rows, whole[:-1])
        return [part[: len(record)] for part, record in zip(parts, records, strict=True)]

    @cached_property
    def moved_apart(self) -> list[int]:
        """Channels that show moving coordinates by a gain or a delay that is unknown."""
        if self.carried is None:
            return []
        uncertain = self.inputs.uncertain
        if uncertain is not None and uncertain.base is not None:
            return np.flatnonzero(self.carried[0].any(axis=(0, 2))).tolist()
        return [] if self.late_base is None else list(self.late_base.channels)

    def deviations(self, scales: Scales, part: slice = slice(None)) -> Floats:
        """(C, k) standard deviations of the noise in some segments; (C, 1) where they are the same in all records."""
        sigma = scales.sigma[:, None]
        return sigma if self.relative_noise is None else sigma * self.relative_noise[:, part]

    @cached_property
    def informed(self) -> Bools:
        """(M, C, K) where there is a sample or a clipped reading."""
        return self.observed if self.clipped is None else self.observed | self.clipped.present

    @cached_property
    def unconstrained(self) -> Bools:
        """(K,) segments without data: no sample, and no neighbour that they are linked to."""
        before, after = np.append(False, self.linked), np.append(self.linked, False)
        return np.asarray(~(before | after | self.informed.any(axis=(0, 1))))

    @property
    def chains(self) -> int:
        """Runs of linked segments, each with one free state at its head."""
        return 1 + int((~self.linked).sum()) - int(self.unconstrained.sum())


@dataclass(frozen=True, eq=False)
class Iterate:
    """The unknowns: nodes (2n + S, K) in m, m/s and units of states, theta (p,), offsets (o,), gains (g,) and delays (l,) in s
    of sensors. Offsets are the sizes of all that sensors add.
    """

    nodes: Floats
    theta: Floats
    offsets: Floats
    gains: Floats = field(default_factory=lambda: np.ones(0))
    delays: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def border(self) -> Floats:
        """(P,) the unknowns that all nodes share: parameters, offsets, gains and delays."""
        return np.concatenate([self.theta, self.offsets, self.gains, self.delays])

    def moved(self, nodes: Floats, border: Floats) -> Iterate:
        """The point with other nodes and another border (P,)."""
        sizes = [len(self.theta), len(self.offsets), len(self.gains)]
        return Iterate(nodes, *np.split(border, np.cumsum(sizes)))


@dataclass(frozen=True, eq=False)
class Scales:
    """Units of the unknowns: sigma (C,) of the noise; state (2n + S,), a defect's natural size; theta (p + o + g,)."""

    sigma: Floats
    state: Floats
    theta: Floats


_SIZE = 10.0  # times the scale of a state that no channel shows: its root mean square


def slider_starts(
    segments: Segments, nodes: Floats, scales: Scales
) -> tuple[Indices, Indices, Floats, float]:
    """What is known of the states of sliders at the starts of chains of segments.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    nodes : array of shape (2n + S, K)
        The states at the nodes.
    scales : Scales
        Units of the unknowns.

    Returns
    -------
    rows, firsts : array of int
        Rows of the states, and the first segments of chains.
    sizes : array
        The states there over their standard deviations, whose squares add to the cost.
    unit : float
        These deviations, in units of the states.
    """
    rows, firsts = segments.system.slider_states, np.flatnonzero(np.append(True, ~segments.linked))
    return rows, firsts, nodes[rows][:, firsts] / (_SIZE * scales.state[rows, None]), _SIZE


_BRIDGED = 2  # segments without a sample of a mass that a rough start may bridge


def split_at_gaps(segments: Segments) -> Segments:
    """Interrupt the chain of segments at long gaps.

    No segment inside a gap of all sensors is linked to another. In a gap of the sensors of one mass, the laws continue its
    motion from the near side, and the chain is interrupted at the far side.

    Parameters
    ----------
    segments : Segments
        The segments.

    Returns
    -------
    Segments
        The same with fewer linked pairs.
    """
    linked = segments.linked.copy()
    for first, last in _gaps(segments.informed):
        linked[max(first - 1, 0) : last] = False
    sensors = segments.sensors
    for mass in np.unique(sensors.mass[sensors.of_masses]):
        for _, last in _gaps(segments.informed[:, sensors.of_masses & (sensors.mass == mass)]):
            linked[last - 1 : last] = False
    return replace(segments, linked=linked)


def _gaps(observed: Bools) -> list[tuple[int, int]]:
    """First segment of every long gap in the channels (M, C, K) and the first after it."""
    unobserved = np.concatenate([[False], ~observed.any(axis=(0, 1)), [False]])
    turns = np.flatnonzero(np.diff(unobserved)).reshape(-1, 2)
    return [(int(first), int(last)) for first, last in turns if last - first > _BRIDGED]


def carry_through_gaps(segments: Segments, point: Iterate) -> Iterate:
    """Start inside gaps by integration of the laws instead of interpolation.

    Parameters
    ----------
    segments : Segments
        The segments.
    point : Iterate
        The start.

    Returns
    -------
    Iterate
        The start with new nodes in gaps.
    """
    n, sensors = len(segments.system.incidence), segments.sensors
    unobserved = np.zeros((len(point.nodes), segments.count), dtype=bool)
    for mass in np.unique(sensors.mass[sensors.of_masses & (sensors.mass < n)]):
        shows = sensors.of_masses & (sensors.mass == mass)
        unobserved[[mass, n + mass]] = ~segments.informed[:, shows].any(axis=(0, 1))
    unobserved[:, 0] = False
    unobserved[:, 1:] &= segments.linked
    depth = np.zeros(segments.count, dtype=int)
    for k in np.flatnonzero(unobserved.any(axis=0)):
        depth[k] = depth[k - 1] + 1
    nodes, mechanics = point.nodes.copy(), segments.system.at(point.theta)
    for reached in range(1, int(depth.max(initial=0)) + 1):
        segment = np.flatnonzero(depth == reached)
        before, step = segment - 1, segments.step[segment - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            orbit = flow(mechanics, nodes[..., before], step, segments.steps, segments.inputs.part(before))
        end = orbit.ends(step)[: len(nodes)]
        replaced = unobserved[:, segment] & np.isfinite(end).all(axis=0)
        nodes[..., segment] = np.where(replaced, end, nodes[..., segment])
    return replace(point, nodes=nodes)
