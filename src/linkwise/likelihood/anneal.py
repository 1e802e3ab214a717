"""Annealed multiple shooting: Levenberg-Marquardt while the defects tighten from free to (nearly) none.

    minimise  sum loss((y - h(flow)) / sigma)  +  sum |defect / S|^2 / q^2 ,   q from loose to tight

METHODS section 5; Bock 1981; Abarbanel's precision annealing.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from math import log10

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.bordered_system import BorderedFactor
from linkwise.likelihood.loss import Loss
from linkwise.likelihood.normal_equations import Linearization, linearise
from linkwise.likelihood.residuals import Misfit, evaluate
from linkwise.likelihood.segments import Iterate, Scales, Segments
from linkwise.progress import Progress, ProgressReport, silent

_HOPELESS = 1e8  # damping at which no step is one
_WILD = -10.0  # gain over promise below which the parabola through a step says nothing
_ROUNDING = 1e-7  # of the cost: what single-precision tangents leave of a drop that they promise


class AnnealingStatus(Enum):
    CONVERGED = "converged"
    EXHAUSTED = "not converged: the number of steps ran out"
    STUCK = "not converged: no step lowers the cost"
    INTERRUPTED = "not converged: interrupted"


@dataclass(frozen=True)
class AnnealingSchedule:
    """q falls from loose to tight by factors between fast and slow, as far as Gauss-Newton can be trusted.

    What a step leaves of its predicted drop grows about as q^-4/3 with the next q; more than `trust_per_sample` per sample
    keeps q where it is. The end is reached when less than `tolerance` is left of the whole cost. Where the laws are so wrong
    that the cost per sample passes `cost_ceiling`, q falls no further: the end is as tight as they allow.
    """

    initial_q: float = 1.0
    final_q: float = 1e-5
    smallest_factor: float = 0.03
    largest_factor: float = 0.5
    trust_per_sample: float = 3.0
    tolerance: float = 0.02
    max_steps: int = 100
    cost_ceiling: float = np.inf

    def held(self, taken: AnnealingStep, misfit: Misfit, samples: int) -> AnnealingSchedule:
        """The schedule that ends where q is, if the cost is above the ceiling and will be when this q is used up."""
        if misfit.cost(taken.q) - taken.remaining > self.cost_ceiling * samples:
            return replace(self, final_q=max(self.final_q, taken.q))
        return self

    def factor(self, left: float) -> float:
        """On q, when the last step left `left` per sample of its predicted drop."""
        return float(
            np.clip((left / self.trust_per_sample) ** 0.75, self.smallest_factor, self.largest_factor)
        )


@dataclass(frozen=True)
class AnnealingStep:
    """A step tried at q: cost before, what Gauss-Newton promised to take off it, what came off."""

    step: int
    q: float
    cost: float
    predicted_reduction: float
    reduction: float
    data_per_sample: float
    damping: float

    @classmethod
    def of(
        cls, step: int, control: _SearchState, misfit: Misfit, trial: Misfit, predicted: float, samples: int
    ) -> AnnealingStep:
        """From the misfits before and after."""
        cost = misfit.cost(control.q)
        gained = cost - trial.cost(control.q)
        return cls(step, control.q, cost, predicted, gained, trial.data / samples, control.damping)

    @property
    def remaining(self) -> float:
        """About what the next step can still take off."""
        return (
            abs(self.predicted_reduction - self.reduction)
            if self.damping == 0
            else max(self.predicted_reduction, self.reduction)
        )

    @property
    def best_length(self) -> float:
        """Where the parabola through what a full step promised and gave has its minimum, in full steps."""
        return 1.0 / (2.0 - self.gain_ratio)

    @property
    def report(self) -> ProgressReport:
        """For whoever waits: the way of q from 1 to its last decade, and how well the laws fit."""
        fraction = min(max(log10(self.q) / log10(AnnealingSchedule.final_q), 0.0), 1.0)
        activity = f"q {self.q:.0e}, cost {self.cost:.6g}, chi-square {self.data_per_sample:.3f}"
        return ProgressReport(fraction, activity, self)

    @property
    def gain_ratio(self) -> float:
        return self.reduction / self.predicted_reduction if self.predicted_reduction > 0 else 0.0


@dataclass(frozen=True, eq=False)
class AnnealingFit:
    """Where the annealing ended. covariance (p + o, p + o) of theta and offsets, zero where a bound holds."""

    point: Iterate
    misfit: Misfit
    q: float
    scales: Scales
    covariance: Floats
    at_bound: Bools
    chi_square: float
    samples: int
    status: AnnealingStatus
    path: tuple[AnnealingStep, ...]


@dataclass(frozen=True)
class _SearchState:
    """Where the search stands: relaxation q, the last q that was `settled`, damping and its growth, length of the step."""

    q: float
    settled: float
    damping: float = 0.0
    growth: float = 2.0
    stride: float = 1.0

    def firmer(self) -> _SearchState:
        """After equations that were not positive definite."""
        return replace(self, damping=max(10.0 * self.damping, 1e-6))

    def after(self, taken: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> _SearchState:
        """What to try next, once a step has been `taken`."""
        if taken.reduction > 0.0:
            return self._onward(taken, schedule, samples)
        if self.stride == 1.0 and taken.gain_ratio > _WILD:
            return replace(self, stride=taken.best_length)
        if self.q < self.settled:
            back = float(np.sqrt(self.q * self.settled)) if self.q < 0.9 * self.settled else self.settled
            return replace(self, q=back, stride=1.0)
        return replace(
            self, damping=max(self.growth * self.damping, 0.01), growth=2.0 * self.growth, stride=1.0
        )

    def _onward(self, taken: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> _SearchState:
        """After a step that lowered the cost: less damping (Nielsen 1999), and a tighter q when this one is used up."""
        damping = self.damping * (
            max(1 / 3, 1 - (2 * taken.gain_ratio - 1) ** 3) if taken.gain_ratio < 1.5 else 1 / 3
        )
        stride = taken.best_length if self.stride == 1.0 and taken.gain_ratio < 0.5 else 1.0
        q, settled = self.q, self.settled
        if taken.remaining < schedule.trust_per_sample * samples:
            settled, q = q, max(schedule.final_q, q * schedule.factor(taken.remaining / samples))
        elif taken.reduction < 0.01 * taken.cost:
            q = max(schedule.final_q, q * schedule.largest_factor)
        return _SearchState(q, settled, damping if damping >= 1e-3 else 0.0, 2.0, stride)


def anneal(
    segments: Segments,
    start: Iterate,
    scales: Scales,
    schedule: AnnealingSchedule,
    *,
    loss: Loss,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> AnnealingFit:
    """Fit nodes, theta and offsets to the records. An interrupt from the keyboard ends it with the best so far.

    Raises IdentificationError where the flow from the start is not finite.
    """
    path: list[AnnealingStep] = []
    control, status = _SearchState(schedule.initial_q, schedule.initial_q), AnnealingStatus.EXHAUSTED
    samples = int(segments.observed.sum())
    misfit = evaluate(segments, start, scales, loss)
    if not np.isfinite(misfit.cost(schedule.initial_q)):
        raise IdentificationError(
            "from the states that the record shows the motion runs to infinity within a few samples: the time may be in "
            "another unit than s (write time[ms]), a channel in another than its header says, or a law is not finite where "
            "the link went"
        )
    linear = linearise(segments, misfit, scales, loss, executor)
    try:
        while len(path) < schedule.max_steps:
            if control.damping > _HOPELESS:
                status = AnnealingStatus.STUCK
                break
            attempt = _step(segments, linear, misfit, scales, control)
            if attempt is None:
                control = control.firmer()
                continue
            trial = evaluate(segments, attempt[0], scales, loss)
            taken = AnnealingStep.of(len(path), control, misfit, trial, attempt[1], samples)
            path.append(taken)
            progress(taken.report)
            if taken.reduction > 0.0:
                misfit = trial
                schedule = schedule.held(taken, misfit, samples)
            if (
                control.q <= schedule.final_q
                and taken.remaining < schedule.tolerance + _ROUNDING * taken.cost
            ):
                status = AnnealingStatus.CONVERGED
                break
            control = control.after(taken, schedule, samples)
            if taken.reduction > 0.0:
                linear = linearise(segments, misfit, scales, loss, executor)
    except KeyboardInterrupt:
        status = AnnealingStatus.INTERRUPTED
    return _fit(segments, linear, misfit, scales, loss, control.q, status, tuple(path))


def _fit(
    segments: Segments,
    linear: Linearization,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    status: AnnealingStatus,
    path: tuple[AnnealingStep, ...],
) -> AnnealingFit:
    theta = misfit.point.border
    lower, upper = _bounds(segments)
    free = (theta > lower) & (theta < upper)
    samples = int(segments.observed.sum())
    return AnnealingFit(
        misfit.point,
        misfit,
        q,
        scales,
        covariance(linear.equations(q).factor(), scales, free),
        ~free,
        misfit.cost(q) / (samples * _freedom(segments) * loss.expected),
        samples,
        status,
        path,
    )


def _step(
    segments: Segments, linear: Linearization, misfit: Misfit, scales: Scales, control: _SearchState
) -> tuple[Iterate, float] | None:
    """A damped Gauss-Newton step that stops at the bounds: the new point and the predicted drop of the cost."""
    equations = linear.equations(control.q)
    factor = equations.factor(linear.damping(control.damping))
    if factor is None:
        return None
    lower, upper = _bounds(segments)
    old = misfit.point.border
    free = np.ones(segments.parameters, bool)
    while True:
        solved = factor.solve(free)
        if solved is None:
            return None
        nodes, border = control.stride * solved[0], control.stride * solved[1]
        new = old + border * scales.theta
        outside = free & ((new < lower) | (new > upper))
        if not outside.any():
            break
        free &= ~outside
    new = np.clip(new, lower, upper)
    n, p = segments.system.incidence.shape[0], segments.system.parameters.size
    moved = (nodes * scales.state).T.reshape(2, n, -1)
    point = Iterate(misfit.point.nodes + moved, *np.split(new, [p, p + segments.sensors.offsets]))
    return point, (2.0 - control.stride) * equations.drop(nodes, border)


def _bounds(segments: Segments) -> tuple[Floats, Floats]:
    """Of theta, offsets and gains; the latter two have none."""
    open_ = np.full(segments.sensors.offsets + segments.sensors.gains, np.inf)
    parameters = segments.system.parameters
    return np.concatenate([parameters.lower, -open_]), np.concatenate([parameters.upper, open_])


def _freedom(segments: Segments) -> float:
    """Share of the samples that is left when each chain has one free state and all share theta."""
    samples = int(segments.observed.sum())
    return (
        1.0 - float(segments.chains * 2 * segments.system.incidence.shape[0] + segments.parameters) / samples
    )


def covariance(factor: BorderedFactor | None, scales: Scales, free: Bools) -> Floats:
    """Of theta, offsets and gains in their own units, zero where not free; infinite where the equations are singular."""
    size = len(scales.theta)
    unknown = np.full((size, size), np.inf)
    if factor is None:
        return unknown
    chosen = np.ix_(free, free)
    try:
        inverse = np.linalg.inv(factor.schur[chosen])
    except np.linalg.LinAlgError:
        return unknown
    out = np.zeros((size, size))
    out[chosen] = inverse * np.outer(scales.theta[free], scales.theta[free])
    return out


@dataclass(frozen=True)
class Annealer:
    """How annealing runs: on which threads, what a residual costs, and whom it tells."""

    executor: Executor
    loss: Loss
    progress: Progress

    def __call__(
        self, segments: Segments, start: Iterate, scales: Scales, schedule: AnnealingSchedule
    ) -> AnnealingFit:
        return anneal(
            segments, start, scales, schedule, loss=self.loss, executor=self.executor, progress=self.progress
        )
