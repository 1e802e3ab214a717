"""Residuals of the samples and defects between segments at a point, their losses, and what errors of sensors would add.

`LongerSegments` joins segments where the motion is already that of the laws: short ones let a search start far from the
optimum, and the same samples in segments several times as long have the same one, with fewer nodes to eliminate.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.flow import Inputs, Trajectories, end_to_end, flow, late_motion
from linkwise.likelihood.shooting.segments import (
    A,
    ClippedMisfit,
    F,
    Iterate,
    S,
    Scales,
    Segments,
    V,
    X,
    slider_starts,
)
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.terms import Shown, integrated
from linkwise.records.record import Record

_REACH, _POINTS = 10.0, 4001  # standard deviations and points of the quadrature for an expectation


class Loss(ABC):
    """A loss: twice the negative log likelihood of residuals in standard deviations of the noise.

    See Also
    --------
    Gaussian, Huber, Student : The losses to choose from.

    Examples
    --------
    >>> import linkwise as lw
    >>> method = lw.MaximumLikelihood(loss=lw.likelihood.Huber())
    >>> isinstance(method.loss, lw.likelihood.Loss)
    True
    """

    @abstractmethod
    def costs(self, residuals: Floats) -> Floats:
        """Cost of each residual.

        Parameters
        ----------
        residuals : array
            Residuals in standard deviations.

        Returns
        -------
        array of the same shape
            Twice the negative log likelihood, up to a constant.
        """

    @abstractmethod
    def weight(self, residuals: Floats) -> Floats:
        """Weights for iteratively reweighted least squares.

        Parameters
        ----------
        residuals : array
            Residuals r in standard deviations.

        Returns
        -------
        array of the same shape
            Derivative of the cost over 2 r.
        """

    def total(self, residuals: Floats) -> float:
        """Sum of the costs.

        Parameters
        ----------
        residuals : array
            Residuals in standard deviations.

        Returns
        -------
        float
            The sum.
        """
        return float(self.costs(residuals).sum())

    @property
    def expected(self) -> float:
        """Mean cost of a standard normal residual, which normalises chi-square."""
        z, step = np.linspace(-_REACH, _REACH, _POINTS, retstep=True)
        return float(np.sum(self.costs(z) * np.exp(-0.5 * z**2)) * step / np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class Gaussian(Loss):
    """Squared residuals: maximum likelihood for normal noise.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Gaussian().weight(np.array([0.0, 10.0]))
    array([1., 1.])
    """

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray(residuals**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.ones_like(residuals)

    def total(self, residuals: Floats) -> float:
        return float(np.vdot(residuals, residuals))

    @property
    def expected(self) -> float:
        """Mean cost of a standard normal residual, 1."""
        return 1.0


def _check_positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise IdentificationError(f"{name} must be positive and finite, got {value}")


@dataclass(frozen=True)
class Huber(Loss):
    """Huber's loss, quadratic for small and linear for large residuals: robust against single outliers.

    Parameters
    ----------
    corner : float, optional
        Residual in standard deviations from which the loss is linear. 1.345 has 95 % efficiency for normal noise.

    Raises
    ------
    IdentificationError
        If the corner is not positive and finite.

    References
    ----------
    P. J. Huber, Ann. Math. Statist. 35, 73 (1964).

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Huber().weight(np.array([0.0, 10.0]))
    array([1.    , 0.1345])
    """

    corner: float = 1.345

    def __post_init__(self) -> None:
        _check_positive("corner", self.corner)

    def costs(self, residuals: Floats) -> Floats:
        size = np.abs(residuals)
        return np.where(size < self.corner, size**2, 2 * self.corner * size - self.corner**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray(self.corner / np.maximum(np.abs(residuals), self.corner))


@dataclass(frozen=True)
class Student(Loss):
    """Negative log likelihood of Student's t distribution: robust where outliers are many or large.

    Parameters
    ----------
    freedom : float, optional
        Degrees of freedom; fewer tolerate larger outliers.

    Raises
    ------
    IdentificationError
        If they are not positive and finite.

    References
    ----------
    K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881 (1989).

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Student().weight(np.array([0.0, 10.0])).round(3)
    array([1.25 , 0.048])
    """

    freedom: float = 4.0

    def __post_init__(self) -> None:
        _check_positive("freedom", self.freedom)

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) * np.log1p(residuals**2 / self.freedom))

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) / (self.freedom + residuals**2))


LOSSES = {"huber": Huber(), "student": Student()}
"""Robust losses by name, as `identify` takes them."""


def with_bounds_for(loss: Loss, records: Sequence[Record]) -> list[Record]:
    """Records with clipped readings where the likelihood of bounds is that of the loss: of a normal variable.

    Parameters
    ----------
    loss : Loss
        Loss of a residual.
    records : sequence of Record
        The records.

    Returns
    -------
    list of Record
        With a robust loss without them, so that these samples are missing everywhere.
    """
    if isinstance(loss, Gaussian):
        return list(records)
    return [replace(record, clipped={}) for record in records]


_SMALL = 200_000  # numbers in links along an orbit: one of fewer is kept, and not found again


class Orbit:
    """Trajectories that are found where they are asked for, and again where they were released since: of a long record they
    are most of what a point of a search has in memory.
    """

    def __init__(self, find: Callable[[], Trajectories]) -> None:
        self._find = find

    @cached_property
    def trajectories(self) -> Trajectories:
        """The motion."""
        return self._find()

    def release(self) -> None:
        """Let the trajectories go, if they are large."""
        if "trajectories" in vars(self) and self.trajectories.links.size > _SMALL:
            del self.trajectories

    def __reduce__(self) -> tuple[Callable[[Trajectories], Orbit], tuple[Trajectories]]:
        """Pickled with the motion: what finds it may be local to a function."""
        return Orbit.of, (self.trajectories,)

    @classmethod
    def of(cls, trajectories: Trajectories) -> Orbit:
        """The orbit of trajectories that are known."""
        return cls(lambda: trajectories)


@dataclass(frozen=True, eq=False)
class Misfit:
    """Misfit at a point of the search.

    Attributes
    ----------
    segments, scales, loss : Segments, Scales, Loss
        The records in segments, units of the unknowns, and the loss of a residual.
    point : Iterate
        The unknowns.
    orbit : Orbit
        The motion from the nodes.
    residuals : array of shape (M, C, K)
        Residuals in standard deviations of the noise; 0 where a sample is missing.
    defects : array of shape (2n + S, K - 1)
        Defects in units of the state; 0 between segments that are not linked.
    data, continuity : float
        Cost of the residuals, and of the defects for q = 1.
    prior : float
        Cost of the unknowns' distances from what is known of them beforehand, of random forces, and of sliders at the start.
    clipped : ClippedMisfit or None
        What clipped readings say, beside the samples.
    """

    segments: Segments
    scales: Scales
    loss: Loss
    point: Iterate
    orbit: Orbit
    residuals: Floats
    defects: Floats
    data: float
    continuity: float
    prior: float = 0.0
    clipped: ClippedMisfit | None = None

    @property
    def trajectories(self) -> Trajectories:
        """The motion from the nodes."""
        return self.orbit.trajectories

    @cached_property
    def pulling(self) -> Floats:
        """(M, C, K) residuals, also of the observations that stand for clipped readings."""
        return self.residuals if self.clipped is None else self.residuals + self.clipped.residuals

    def at(self, point: Iterate, louder: Floats | float = 1.0) -> Misfit:
        """That at another point, the deviations of the noise so many times as large."""
        scales = replace(self.scales, sigma=self.scales.sigma * louder)
        return evaluate(self.segments, point, scales, self.loss)

    @cached_property
    def mechanics(self) -> NumericSystem:
        """The system in numbers."""
        return self.segments.system.at(self.point.theta)

    def along_tangents(self, part: slice | Indices = slice(None)) -> tuple[Trajectories, Floats, Inputs]:
        """The orbit in some segments at the steps of its tangents, these steps (k,) in s, and what acts along it."""
        every = self.segments.flow_steps_per_tangent
        orbit = self.trajectories.part(part).thinned(every)
        return orbit, self.segments.step[part] * every, self.segments.inputs.part(part)

    def part(self, which: slice, segments: Segments) -> Misfit:
        """The misfit of some segments that follow each other, without clipped readings and whole costs, which are NaN."""
        orbit = self.orbit
        return Misfit(
            segments,
            self.scales,
            self.loss,
            replace(self.point, nodes=self.point.nodes[..., which]),
            Orbit(lambda: orbit.trajectories.part(which)),
            self.residuals[..., which],
            self.defects[..., which.start : which.stop - 1],
            *(np.nan, np.nan),
        )

    def weights(self, part: slice) -> tuple[Floats, NDArray[np.float32]]:
        """(M, C, k) square roots of the weights of the residuals that pull, in some segments, 0 where there is none; and what
        whitens what sensors show.
        """
        segments = self.segments
        roots = np.sqrt(self.loss.weight(self.residuals[..., part])) * segments.observed[..., part]
        if self.clipped is not None:
            roots = roots + self.clipped.roots[..., part]
        return roots, (roots / segments.deviations(self.scales, part)).astype(np.float32)

    def cost(self, q: float) -> float:
        """Total cost.

        Parameters
        ----------
        q : float
            Relaxation.

        Returns
        -------
        float
            data + prior + continuity / q^2, and the cost of clipped readings.
        """
        return self.cost_of_samples(q) + (0.0 if self.clipped is None else self.clipped.cost)

    def cost_of_samples(self, q: float) -> float:
        """The cost without that of clipped readings, which is not that of as many residuals."""
        return self.data + self.prior + self.continuity / q**2


def evaluate(segments: Segments, point: Iterate, scales: Scales, loss: Loss) -> Misfit:
    """Misfit at a point.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    point : Iterate
        The unknowns.
    scales : Scales
        Units of the unknowns.
    loss : Loss
        Loss of a residual.

    Returns
    -------
    Misfit
        Residuals and defects; not finite where the motion diverges.
    """
    mechanics = segments.system.at(point.theta)

    def motion_from_nodes() -> Trajectories:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a mass may be 0 in a trial
            inputs = segments.inputs.at(point.gains, point.delays)
            return flow(mechanics, point.nodes, segments.step, segments.steps, inputs)

    residuals, nothing = np.empty_like(segments.samples), np.empty((0, 0))
    misfit = Misfit(segments, scales, loss, point, Orbit(motion_from_nodes), residuals, nothing, 0.0, 0.0)
    orbit = misfit.trajectories
    ends = orbit.ends(segments.step)[: len(point.nodes)]
    sensors = segments.sensors.at(mechanics)
    shown_orbit, factors = sensors.orbit_with_points(orbit), sensors.factors(point.gains)
    unit, starts = segments.deviations(scales), slider_starts(segments, point.nodes, scales)[2]
    for kind, channels, places in sensors.by_kind:
        motion = _at_samples(segments, mechanics, shown_orbit, kind)
        residuals[:, channels] = segments.samples[:, channels] - motion[:, places]
    if segments.random is not None and segments.random.shown is not None:
        residuals[0] -= segments.random.shown @ point.nodes[segments.random.rows]
    for channel in {*sensors.late.tolist(), *segments.moved_apart, *sensors.scaled.tolist()}:
        residuals[:, channel] = segments.samples[:, channel] - factors[channel] * _shown(misfit, channel)[0]
        if segments.carried is not None:
            residuals[:, channel] += segments.carried[0][:, channel]
    for channel, added in segments.errors.added(point.offsets):
        residuals[:, channel] -= added
    residuals /= unit
    clipped = None
    if segments.clipped is not None and isinstance(loss, Gaussian):
        clipped = segments.clipped.misfit(residuals, unit)
    residuals *= segments.observed
    defects = (point.nodes[..., 1:] - ends[..., :-1]) / scales.state[:, None]
    defects *= segments.link_weights
    prior = 0.0 if segments.prior is None else segments.prior.cost(point.border)
    prior += float(np.sum(starts**2))
    if segments.random is not None:
        prior += segments.random.cost(point.nodes, point.border)
    data, continuity = loss.total(residuals), float(np.vdot(defects, defects))
    found = residuals, defects, data, continuity, prior, clipped
    return Misfit(segments, scales, loss, point, misfit.orbit, *found)


def _at_samples(
    segments: Segments, mechanics: NumericSystem, orbit: Trajectories, kind: int, part: slice = slice(None)
) -> Floats:
    """(M, places, k) what a kind of sensors may show at the samples of an orbit with points, in some segments."""
    every = segments.at_samples
    if kind == F:
        links, memory = orbit.links[every], orbit.memory[every]
        forces = np.empty_like(links[:, 0])
        mechanics.force(links[:, 0], links[:, 1], memory, forces, np.empty_like(memory))
        return forces
    if kind == V:
        return np.asarray(orbit.states[every, 1] * (1.0 / segments.step[part]))
    return {X: orbit.states[:, 0], A: orbit.accelerations, S: orbit.memory}[kind][every]


def shown_motion(misfit: Misfit) -> list[Shown]:
    """What each channel shows (M, K)."""
    segments = misfit.segments
    ramp, elapsed = _ramp(segments), _elapsed(segments)

    def along(value: Floats, rate: Floats) -> Shown:
        return Shown(value, ramp, elapsed, lambda: rate, lambda: _integrated(segments, value))

    return [along(*_shown(misfit, channel)) for channel in range(len(segments.sensors.kind))]


def filtered_motion(misfit: Misfit) -> list[Floats]:
    """What a filter that all sensors share does to each channel (M, K) beside a delay: the second derivative of what it shows.

    A low pass of first order with the time constant T takes exp(i w t) to (1 - T^2 w^2 / 2) exp(i w (t - T)) at low
    frequencies, so its size here, in s^2, is T^2 / 2.
    """
    segments = misfit.segments
    sensors, step = segments.sensors, segments.step * segments.refine
    return [
        motion_of(misfit, V, int(mass))[1]
        if kind == X and segments.carried is None
        else _rate(_shown(misfit, channel)[1], step)
        for channel, (kind, mass) in enumerate(zip(sensors.kind, sensors.mass, strict=True))
    ]


def estimated_errors(misfit: Misfit, part: slice) -> Iterator[tuple[int, int, Floats]]:
    """What each error of a sensor that is among the unknowns adds in some segments, if its size is 1: the number of a
    channel, that of the unknown, and values (M, k).
    """
    segments = misfit.segments
    sensors, point = segments.sensors, misfit.point
    for number, channel in enumerate(segments.errors.channel.tolist()):
        yield channel, number, segments.errors.values[number][:, part]
    factors = sensors.factors(point.gains)
    for channel in np.union1d(sensors.scaled, sensors.late).tolist():
        shown, rate = _shown(misfit, channel, part)
        for number in np.flatnonzero(sensors.gain[channel]).tolist():
            yield channel, sensors.offsets + number, shown
        if channel in sensors.late:
            delay = int(sensors.delay[channel])
            yield channel, sensors.offsets + sensors.gains + delay, -factors[channel] * rate
    uncertain = segments.inputs.uncertain
    if uncertain is None or uncertain.base is None:
        return
    gain, delay = int(uncertain.gains[uncertain.base]), int(uncertain.delays[uncertain.base])
    for channel in segments.moved_apart:  # by a gain and a delay of the record of moving coordinates
        carried = carried_by(segments, point, channel, part)
        if carried is not None and gain >= 0:
            yield channel, sensors.offsets + gain, -factors[channel] * carried[0] / point.gains[gain]
        if carried is not None and delay >= 0:
            yield channel, sensors.offsets + sensors.gains + delay, factors[channel] * carried[1]


def _shown(misfit: Misfit, channel: int, part: slice = slice(None)) -> tuple[Floats, Floats]:
    """(M, k) what a sensor shows of a mass and of moving coordinates in some segments, and its rate."""
    segments, point = misfit.segments, misfit.point
    sensors, random = segments.sensors, segments.random
    kind, mass = int(sensors.kind[channel]), int(sensors.mass[channel])
    if channel in sensors.late:
        orbit = sensors.at(misfit.mechanics).orbit_with_points(misfit.trajectories.part(part))
        step, delay = segments.step[part] * segments.refine, float(point.delays[sensors.delay[channel]])
        value, rate = late_motion(orbit, step, segments.refine, mass=mass, kind=kind, delay=delay)
    else:
        value, rate = motion_of(misfit, kind, mass, part)
    if random is not None and random.shown is not None:
        value = value + random.shown[channel] @ point.nodes[random.rows][:, part]
    carried = carried_by(segments, point, channel, part)
    return (value, rate) if carried is None else (value + carried[0], rate + carried[1])


def carried_by(
    segments: Segments, point: Iterate, channel: int, part: slice = slice(None)
) -> tuple[Floats, Floats] | None:
    """(M, k) what a sensor shows of moving coordinates, by the gains and delays of both, and its rate; None without any."""
    if segments.carried is None:
        return None
    uncertain = segments.inputs.uncertain
    gain, early = (1.0, 0.0) if uncertain is None else uncertain.of_base(point.gains, point.delays)
    if segments.late_base is None or channel not in segments.late_base.channels:
        value, rate = (own[:, channel, part] for own in segments.carried)
    else:
        late = float(np.append(point.delays, 0.0)[segments.sensors.delay[channel]])
        value, rate = segments.late_base.at(channel, late - early, part)
    return value / gain, rate / gain


def motion_of(misfit: Misfit, kind: int, mass: int, part: slice = slice(None)) -> tuple[Floats, Floats]:
    """(M, k) what a sensor of this kind shows of a mass in some segments, and its rate."""
    segments, step, mechanics = misfit.segments, misfit.segments.step[part], misfit.mechanics
    orbit = segments.sensors.at(mechanics).orbit_with_points(misfit.trajectories.part(part))
    value = _at_samples(segments, mechanics, orbit, kind, part)[:, mass]
    if kind in (X, V):
        return value, _at_samples(segments, mechanics, orbit, kind + 1, part)[:, mass]
    return value, _rate(value, step * segments.refine)


def _rate(shown: Floats, step: Floats) -> Floats:
    """(M, k) the rate of a signal (M, k) with samples in steps (k,) in s."""
    return np.asarray(np.gradient(shown.T.ravel()).reshape(shown.T.shape).T / step)


def _ramp(segments: Segments) -> Floats:
    """(M, K) from 0 at the start of each chain of segments to 1 at its end."""
    M, K = len(segments.samples), segments.count
    ramp = np.empty((K, M))
    for first, last in _chains(segments):
        ramp[first:last] = np.linspace(0.0, 1.0, (last - first) * M).reshape(-1, M)
    return ramp.T


def _elapsed(segments: Segments) -> Floats:
    """(K,) how long the chain of each segment takes, in s."""
    duration = segments.step * segments.steps
    chains = np.cumsum(np.append(0, ~segments.linked))
    return np.asarray(np.bincount(chains, duration)[chains])


def _integrated(segments: Segments, shown: Floats) -> Floats:
    """(M, K) the integral of what is shown (M, K) beside its mean in each chain of segments."""
    integral = np.empty(shown.T.shape)
    steps = segments.step * segments.refine
    for first, last in _chains(segments):
        series = integrated(shown.T[first:last].ravel(), float(steps[first]))
        integral[first:last] = (series - series.mean()).reshape(last - first, -1)
    return integral.T


def _chains(segments: Segments) -> Iterator[tuple[int, int]]:
    """The first segment of each chain, and that after its last."""
    yield from pairwise([0, *(np.flatnonzero(~segments.linked) + 1).tolist(), segments.count])


_JOINED = 2  # short segments in a longer one: in more of them the influence of a mass reaches too far

_JOINED_OF_FEW = 4  # the same where it reaches most of the structure anyway

_FEW = 24  # masses


@dataclass(frozen=True, eq=False)
class LongerSegments:
    """`segments` of several shorter ones each, whose numbers are `parts` (K', f); the last of a chain may be repeated."""

    segments: Segments
    parts: Indices

    @classmethod
    def of(cls, shorter: Segments) -> LongerSegments | None:
        """The segments of each chain joined, a few to one.

        None with random forces, which are constant in a segment, and late bases.
        """
        if shorter.random is not None or shorter.late_base is not None:
            return None
        parts = _parts(shorter)
        joined = shorter.linked[parts[:-1, -1]]
        together = shorter.mapped(partial(end_to_end, parts=parts), parts[:, 0])
        once = _once(parts, len(shorter.samples))
        clipped = together.clipped and together.clipped.mapped(lambda values: values * once)
        observed = together.observed & once
        return cls(replace(together, observed=observed, linked=joined, clipped=clipped), parts)

    def point(self, point: Iterate) -> Iterate:
        """A point with the nodes of the longer segments."""
        return replace(point, nodes=point.nodes[:, self.parts[:, 0]])

    def misfit(self, shorter: Misfit) -> Misfit:
        """The misfit of the shorter segments as one of the longer ones: the same motion, whose defects inside them count for
        nothing.
        """
        parts, orbit, once = self.parts, shorter.orbit, _once(self.parts, len(shorter.residuals))

        def joined(values: Floats) -> Floats:
            return np.asarray(once * end_to_end(values, parts))

        defects = shorter.defects[:, parts[:-1, -1]]
        return replace(
            shorter,
            segments=self.segments,
            point=self.point(shorter.point),
            orbit=Orbit(lambda: orbit.trajectories.mapped(partial(end_to_end, parts=parts, shared=1))),
            residuals=joined(shorter.residuals),
            clipped=shorter.clipped and shorter.clipped.mapped(joined),
            defects=defects,
            continuity=float(np.vdot(defects, defects)),
        )


def _parts(segments: Segments) -> Indices:
    """(K', f) the short segments in each longer one, which no end of a chain interrupts."""
    joined = _JOINED_OF_FEW if len(segments.system.incidence) <= _FEW else _JOINED
    rows = [
        np.minimum(np.arange(first, last, joined)[:, None] + np.arange(joined), last - 1)
        for first, last in _chains(segments)
    ]
    return np.concatenate(rows)


def _once(parts: Indices, samples: int) -> Bools:
    """(f M, 1, K') at which of M samples of each of the `parts` (K', f) these are not repeated."""
    which = np.diff(parts, axis=1, prepend=-1) != 0
    return np.repeat(which.T, samples, axis=0)[:, None]
