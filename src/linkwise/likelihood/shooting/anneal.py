"""Annealed multiple shooting: Levenberg-Marquardt iterations while the continuity of the segments is tightened.

    minimise  sum loss((y - h(flow)) / sigma)  +  sum |defect / S|^2 / q^2 ,   q from 1 towards 0

METHODS section 5.

References
----------
H. G. Bock, in Modelling of Chemical Reaction Systems (1981), for multiple shooting.

J. Ye et al., Phys. Rev. E 92, 052901 (2015), for annealing.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from math import log10

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.curved_step import curved_step, is_settled
from linkwise.likelihood.shooting.damped_step import SLIGHT, DampedEquations, bounds, freedom
from linkwise.likelihood.shooting.linear_model import GaussNewtonModel, covariance, firm_factor, linear_model
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.progress import Progress, ProgressReport, silent

_MAX_DAMPING = 1e8  # at which steps are too short to matter
_LOWEST_GAIN = -10.0  # gain ratio below which the parabola through a step is meaningless
_MARGIN = 10.0  # times the reduction of the cost that is estimated to be left, which is not exact
_OF_PART = 2.0  # times what a quarter of a step gains, or more of it: what a full one leaves is less
_ROUNDING = 1e-7  # of the cost: error of reductions predicted by sensitivities in single precision


class AnnealingStatus(Enum):
    """How annealing ended; the value is text for messages."""

    CONVERGED = "converged"
    EXHAUSTED = "not converged: the number of steps ran out"
    STUCK = "not converged: no step lowers the cost"
    INTERRUPTED = "not converged: interrupted"
    COSTLY = "ended: the cost is higher than was asked"


@dataclass(frozen=True)
class AnnealingSchedule:
    """How the relaxation q is lowered.

    The error of the quadratic model of a step grows about as q^-4/3 with the next q. More than `trust_per_sample` of it per
    sample keeps q; less lowers q by a factor between the smallest and the largest.

    Parameters
    ----------
    initial_q, final_q : float, optional
        First and last relaxation.
    smallest_factor, largest_factor : float, optional
        Limits of the factor on q per step.
    trust_per_sample : float, optional
        Error of the quadratic model per sample up to which q is lowered.
    tolerance : float, optional
        Remaining reduction of the cost at which the search has converged.
    max_steps : int, optional
        Largest number of steps.
    cost_ceiling : float, optional
        Cost per sample above which the laws are wrong and q is not lowered further.
    sufficient_cost : float, optional
        Cost above which the search ends. The lowest cost at a larger q is a lower bound of that at a smaller one.
    """

    initial_q: float = 1.0
    final_q: float = 1e-5
    smallest_factor: float = 0.03
    largest_factor: float = 0.5
    trust_per_sample: float = 3.0
    tolerance: float = 0.02
    max_steps: int = 100
    cost_ceiling: float = np.inf
    sufficient_cost: float = np.inf

    def with_ceiling(self, step: AnnealingStep, misfit: Misfit, samples: int) -> AnnealingSchedule:
        """The schedule after a `step`: it ends at the present q if the cost will remain above the ceiling there."""
        if misfit.cost(step.q) - step.remaining > self.cost_ceiling * samples:
            return replace(self, final_q=max(self.final_q, step.q))
        return self

    def exceeded(self, step: AnnealingStep, unclear: float) -> bool:
        """Whether the lowest cost at the q of a step is surely above the sufficient one; `unclear` is what may be left."""
        left = max(_MARGIN * step.remaining, _OF_PART * unclear)
        return step.cost - step.reduction - left > self.sufficient_cost

    def factor(self, left: float) -> float:
        """Factor on q after a step whose quadratic model was wrong by `left` per sample."""
        return float(
            np.clip((left / self.trust_per_sample) ** 0.75, self.smallest_factor, self.largest_factor)
        )


@dataclass(frozen=True)
class AnnealingStep:
    """A step of annealed multiple shooting; `identify` reports it as the detail of its progress.

    Attributes
    ----------
    step : int
        Number of the step, from 0.
    q : float
        Relaxation of the continuity of the segments.
    cost : float
        Cost before the step.
    predicted_reduction, reduction : float
        Reduction of the cost by the Gauss-Newton model, and the actual one; a negative one means that the step was rejected.
    data_per_sample : float
        Cost of the residuals per sample after the step.
    damping : float
        Levenberg-Marquardt parameter.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> steps = []
    >>> estimate = lw.identify(
    ...     record, chain.unknown("nes1.alpha"), progress=lambda report: steps.append(report.detail)
    ... )
    >>> isinstance(steps[0], lw.AnnealingStep), steps[0].q, steps[-1].q
    (True, 0.1, 1e-05)
    """

    step: int
    q: float
    cost: float
    predicted_reduction: float
    reduction: float
    data_per_sample: float
    damping: float

    @property
    def remaining(self) -> float:
        """Estimate of the reduction of the cost that is left at this q."""
        if self.damping == 0:
            return abs(self.predicted_reduction - self.reduction)
        return max(self.predicted_reduction, self.reduction)

    @property
    def best_length(self) -> float:
        """Minimum of the parabola through the predicted and the actual reduction, as a fraction of the step."""
        return 1.0 / (2.0 - self.gain_ratio)

    @property
    def report(self) -> ProgressReport:
        """The step as a progress report; the fraction is that of the decades of q."""
        fraction = min(max(log10(self.q) / log10(AnnealingSchedule.final_q), 0.0), 1.0)
        activity = f"q {self.q:.0e}, cost {self.cost:.6g}, chi-square {self.data_per_sample:.3f}"
        return ProgressReport(fraction, activity, self)

    @property
    def gain_ratio(self) -> float:
        """Actual over predicted reduction."""
        return self.reduction / self.predicted_reduction if self.predicted_reduction > 0 else 0.0


@dataclass(frozen=True, eq=False)
class AnnealingFit:
    """Result of annealing.

    Attributes
    ----------
    point : Iterate
        The unknowns.
    misfit : Misfit
        Residuals and defects there.
    q : float
        Last relaxation.
    scales : Scales
        Units of the unknowns.
    covariance : array of shape (p + o + g, p + o + g)
        Covariance of parameters, offsets and gains; zero at bounds.
    at_bound : array of bool, shape (p + o + g,)
        True at a bound.
    chi_square : float
        Cost per degree of freedom, 1 for laws and noise that fit.
    samples : int
        Number of samples.
    status : AnnealingStatus
        How the search ended.
    path : tuple of AnnealingStep
        Its steps.
    """

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
    """State of the search: relaxation q, the last q with sufficient convergence, damping and its growth, step length."""

    q: float
    settled: float
    damping: float = 0.0
    growth: float = 2.0
    stride: float = 1.0

    def firmer(self) -> _SearchState:
        """The state after equations that were not positive definite."""
        return replace(self, damping=max(10.0 * self.damping, 1e-6))

    def evaluated_step(
        self, step: int, misfit: Misfit, trial: Misfit, predicted: float, samples: int
    ) -> AnnealingStep:
        """The step between two misfits, whose cost was predicted to fall by `predicted`."""
        cost = misfit.cost(self.q)
        gained = cost - trial.cost(self.q)
        return AnnealingStep(step, self.q, cost, predicted, gained, trial.data / samples, self.damping)

    def after(self, step: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> _SearchState:
        """The state after a step."""
        if step.reduction > 0.0:
            return self._onward(step, schedule, samples)
        if self.stride == 1.0 and step.gain_ratio > _LOWEST_GAIN:
            return replace(self, stride=step.best_length)
        overshot = step.gain_ratio < _LOWEST_GAIN and self.growth == 2.0  # for the first time since a gain
        if self.q < self.settled and not overshot:
            back = float(np.sqrt(self.q * self.settled)) if self.q < 0.9 * self.settled else self.settled
            return replace(self, q=back, growth=2.0, stride=1.0)
        return replace(
            self, damping=max(self.growth * self.damping, 0.01), growth=2.0 * self.growth, stride=1.0
        )

    def _onward(self, step: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> _SearchState:
        """The state after a step that lowered the cost: less damping (Nielsen 1999), and a lower q on convergence."""
        damping = self.damping * (
            max(1 / 3, 1 - (2 * step.gain_ratio - 1) ** 3) if step.gain_ratio < 1.5 else 1 / 3
        )
        stride = step.best_length if self.stride == 1.0 and step.gain_ratio < 0.5 else 1.0
        q, settled = self.q, self.settled
        if step.remaining < schedule.trust_per_sample * samples:
            settled, q = q, max(schedule.final_q, q * schedule.factor(step.remaining / samples))
        elif step.reduction < 0.01 * step.cost:
            q = max(schedule.final_q, q * schedule.largest_factor)
        return _SearchState(q, settled, damping if damping >= SLIGHT else 0.0, 2.0, stride)


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
    """Fit nodes, parameters, offsets and gains to segments.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    start : Iterate
        Starting values.
    scales : Scales
        Units of the unknowns.
    schedule : AnnealingSchedule
        How the relaxation is lowered.
    loss : Loss
        Loss of a residual.
    executor : Executor, optional
        Threads for the normal equations.
    progress : Progress, optional
        Called at every step.

    Returns
    -------
    AnnealingFit
        The result; an interrupt from the keyboard ends the search with the best so far.

    Raises
    ------
    IdentificationError
        If the motion from the start is not finite.
    """
    path: list[AnnealingStep] = []
    control, status = _SearchState(schedule.initial_q, schedule.initial_q), AnnealingStatus.EXHAUSTED
    samples = int(segments.observed.sum())
    misfit = evaluate(segments, start, scales, loss)
    if not np.isfinite(misfit.cost(schedule.initial_q)):
        raise IdentificationError(
            "the motion that starts from the states in the record runs to infinity within a few samples: the time may be in "
            "another unit than s (write time[ms]), a channel in another than its header says, a law is not finite over the "
            "motion of its link, or a force acts that no channel shows (identify takes it as ambient)"
        )
    linear: GaussNewtonModel | None = None
    damped: DampedEquations | None = None
    try:
        while len(path) < schedule.max_steps:
            linear = linear or linear_model(segments, misfit, scales, loss, executor)
            if control.damping > _MAX_DAMPING:
                status = AnnealingStatus.STUCK
                break
            if damped is None or (damped.q, damped.damping) != (control.q, control.damping):
                damped = None  # whose memory the next ones take
                damped = DampedEquations.of(linear, control.q, control.damping)
            attempt = curved_step(segments, linear, damped, misfit, scales, loss, control.stride)
            if attempt is None:
                control = control.firmer()
                continue
            trial, predicted, unclear = attempt
            if control.stride < 1.0:
                unclear = max(unclear, predicted)  # by the shorter step
            step = control.evaluated_step(len(path), misfit, trial, predicted, samples)
            path.append(step)
            progress(step.report)
            if step.reduction > 0.0:
                misfit = trial
                schedule = schedule.with_ceiling(step, misfit, samples)
                if schedule.exceeded(step, unclear):
                    status = AnnealingStatus.COSTLY
                    break
            left = schedule.tolerance + _ROUNDING * step.cost
            small = control.q <= schedule.final_q and max(step.remaining, unclear) < left
            if small and is_settled(segments, linear, damped, misfit, scales, loss, left):
                status = AnnealingStatus.CONVERGED
                break
            control = control.after(step, schedule, samples)
            linear, damped = (None, None) if step.reduction > 0.0 else (linear, damped)
    except KeyboardInterrupt:
        status = AnnealingStatus.INTERRUPTED
    factor = None if damped is None else damped.undamped_factor(control.q)
    linear, damped = linear or linear_model(segments, misfit, scales, loss, executor), None
    covariance_of = partial(covariance, factor or firm_factor(linear, control.q), scales)
    return _fit(segments, covariance_of, misfit, scales, loss, control.q, status, tuple(path))


def _fit(
    segments: Segments,
    covariance_of: Callable[[Bools], Floats],
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    status: AnnealingStatus,
    path: tuple[AnnealingStep, ...],
) -> AnnealingFit:
    theta, (lower, upper) = misfit.point.border, bounds(segments)
    free = (theta > lower) & (theta < upper)
    return AnnealingFit(
        misfit.point,
        misfit,
        q,
        scales,
        covariance_of(free),
        ~free,
        misfit.cost_of_samples(q) / (freedom(segments) * loss.expected),
        int(segments.observed.sum()),
        status,
        path,
    )


@dataclass(frozen=True)
class Annealer:
    """`anneal` with its threads, loss and progress.

    Parameters
    ----------
    executor : Executor
        Threads for the normal equations.
    loss : Loss
        Loss of a residual.
    progress : Progress
        Called at every step.
    """

    executor: Executor
    loss: Loss
    progress: Progress

    def __call__(
        self, segments: Segments, start: Iterate, scales: Scales, schedule: AnnealingSchedule
    ) -> AnnealingFit:
        return anneal(
            segments, start, scales, schedule, loss=self.loss, executor=self.executor, progress=self.progress
        )
