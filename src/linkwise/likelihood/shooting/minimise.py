"""Annealed multiple shooting: Levenberg-Marquardt iterations while the continuity of the segments is tightened.

    minimise  sum loss((y - h(flow)) / sigma)  +  sum |defect / S|^2 / q^2 ,   q from 1 towards 0

METHODS section 5.

A step solves the linearised equations, and the curvature of the flow leaves defects of second order behind it. Where links are
tight these cost more than the step gains, so that full steps are refused beside the optimum (Maratos' effect). The equations
are then solved again with the defects that the curvature left, by the same factor, which costs no sensitivities.

References
----------
H. G. Bock, in Modelling of Chemical Reaction Systems (1981), for multiple shooting.
J. Ye et al., Phys. Rev. E 92, 052901 (2015), for annealing.
J. Nocedal and S. J. Wright, Numerical Optimization (2006), section 18.3, second-order corrections.
D. G. Anderson, J. ACM 12, 547 (1965), for the extrapolation of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from math import log10

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, border_step, excess
from linkwise.likelihood.shooting.delay_polynomials import LARGEST
from linkwise.likelihood.shooting.linear_model import LocalRows, Neighbourhood, groups_at, local_linearization
from linkwise.likelihood.shooting.normal_equations import Linearization, covariance, firm_factor, linearise
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.system import MANY
from linkwise.progress import Progress, ProgressReport, silent

SLIGHT = 1e-3  # damping that changes no step


@dataclass(frozen=True, eq=False)
class DampedEquations:
    """Normal equations at a relaxation `q` with a `damping`, and their factor; steps of any length follow from them.

    Attributes
    ----------
    linear : Linearization
        The linearised problem.
    factor : BorderedFactor or None
        The factor, damped; None where the equations are not positive definite.
    q : float
        Relaxation.
    damping : float
        Levenberg-Marquardt parameter.
    """

    linear: Linearization
    factor: BorderedFactor | None
    q: float
    damping: float

    @classmethod
    def of(cls, linear: Linearization, q: float, damping: float) -> DampedEquations:
        """Those of a linearization."""
        return cls(linear, linear.equations(q).factor(linear.damping(damping)), q, damping)


def damped_step(damped: DampedEquations, misfit: Misfit, length: float) -> tuple[Iterate, float] | None:
    """A damped Gauss-Newton step; parameters that it would take out of their bounds go to them, the others with them.

    Parameters
    ----------
    damped : DampedEquations
        The equations at the present point.
    misfit : Misfit
        Misfit there.
    length : float
        Fraction of the step to take.

    Returns
    -------
    tuple of (Iterate, float) or None
        The new point and the predicted reduction of the cost; None where the equations are not positive definite.
    """
    factor = damped.factor
    if factor is None:
        return None
    by_nodes, by_border = factor.gradient
    bounded = _within_bounds(factor, misfit, length)
    if bounded is None:
        return None
    free, fixed, border = bounded
    solved = factor.solve(free, fixed)
    if solved is None:
        return None
    nodes, change = length * solved[0], length * solved[1]
    point = misfit.point.moved(misfit.point.nodes + (nodes * misfit.scales.state).T, border)
    left = excess(factor.schur, factor.reduced, solved[1], free)
    drop = float(np.vdot(by_nodes, nodes) + by_border @ change)
    predicted = (2.0 - length) * drop - length**2 * left
    return point, predicted


def _within_bounds(
    equations: BorderedFactor, misfit: Misfit, length: float
) -> tuple[Bools, Floats, Floats] | None:
    """The part `length` of the step that equations of the border ask for, with unknowns that would pass a bound held there:
    which of them were free (P,), where the others were fixed (P,), in scaled unknowns, and the border (P,) that this leads to.
    """
    lower, upper = bounds(misfit.segments)
    old, unit = misfit.point.border, misfit.scales.theta
    free, ends = np.ones(len(old), bool), old.copy()
    while True:
        fixed = (ends - old) / unit
        step = border_step(equations.schur, equations.reduced, free, fixed)
        if step is None:
            return None
        new = old + length * step * unit
        outside = free & ((new < lower) | (new > upper))
        if not outside.any():
            break
        ends = np.where(outside, np.clip(new, lower, upper), ends)
        free &= ~outside
    if length == 1.0:
        new = np.where(free, new, ends)  # to the last digit
    return free, fixed, np.clip(new, lower, upper)


def bounds(segments: Segments) -> tuple[Floats, Floats]:
    """Bounds of parameters, offsets, gains and delays.

    Parameters
    ----------
    segments : Segments
        The records in segments.

    Returns
    -------
    lower, upper : array of shape (P,)
        The bounds; infinite for offsets and gains.
    """
    sensors, parameters = segments.sensors, segments.system.parameters
    open_ = np.full(sensors.offsets + sensors.gains, np.inf)
    late = np.full(sensors.delays, LARGEST * float(np.min(segments.step)) * segments.refine)
    return np.concatenate([parameters.lower, -open_, -late]), np.concatenate([parameters.upper, open_, late])


def freedom(segments: Segments) -> float:
    """Degrees of freedom: each chain of segments has one free state, all share the parameters, a prior is one more residual.

    Parameters
    ----------
    segments : Segments
        The records in segments.

    Returns
    -------
    float
        Their number.
    """
    known = 0 if segments.prior is None else segments.prior.count
    states = segments.chains * int(segments.continuous.sum())  # a random force is known as a residual is
    return float(int(segments.observed.sum()) + known - states - segments.parameters)


def pull_of_defects(linear: Linearization, defects: Floats) -> tuple[Floats, Floats]:
    """What defects add to the gradient of the cost, which normal equations have on their right-hand side.

    Parameters
    ----------
    linear : Linearization
        The linearised problem.
    defects : array of shape (K - 1, m)
        Defects for q = 1.

    Returns
    -------
    nodes, border : array of shape (K, m) and (p,)
        The gradient, sign reversed, in scaled unknowns.
    """
    nodes = np.zeros((len(defects) + 1, defects.shape[1]))
    nodes[:-1] = (defects[:, None] @ linear.state_ends)[:, 0]
    nodes[1:] -= linear.joined * defects
    return nodes, np.asarray(np.tensordot(defects, linear.right_ends[..., :-1], 2))


_LOWEST_GAIN = -10.0  # gain ratio below which the parabola through a step is meaningless

_MARGIN = 10.0  # times the reduction of the cost that is estimated to be left, which is not exact

_ROUNDING = 1e-7  # of the cost: error of reductions predicted by sensitivities in single precision

_ROUNDING_OF_MANY = 3e-7  # the same by those along parts of a structure of many masses

_OF_PART = 2.0  # times what a part of a step gains: what a full one leaves is less


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

    def exceeded(self, step: AnnealingStep, unclear: float) -> bool:
        """Whether the lowest cost at the q of a step is surely above the sufficient one; `unclear` is what may be left."""
        left = max(_MARGIN * step.remaining, _OF_PART * unclear)
        return step.cost - step.reduction - left > self.sufficient_cost

    def is_little(self, step: AnnealingStep, unclear: float, segments: Segments) -> tuple[bool, float]:
        """Whether a step, of which so much is `unclear`, may end the search, and what may be left of the cost then."""
        rounding = _ROUNDING if len(segments.system.incidence) < MANY else _ROUNDING_OF_MANY
        left = self.tolerance + rounding * step.cost
        return step.q <= self.final_q and max(step.remaining, unclear) < left, left

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
    >>> isinstance(steps[0], lw.likelihood.AnnealingStep), steps[0].q, steps[-1].q
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


@dataclass(frozen=True)
class SearchState:
    """State of the search: relaxation q, the last q with sufficient convergence, damping and its growth, step length, and the
    damping below which there is none.

    With `gains` that are open, the latter falls where a step without damping fails after a damped one that did not: along the
    scale which all channels share, where the cost hardly changes, the damping between them is the one that leads on.
    """

    q: float
    settled: float
    damping: float = 0.0
    growth: float = 2.0
    stride: float = 1.0
    gains: bool = False
    slight: float = SLIGHT
    eased: bool = False

    def ends_in_valley(self, step: AnnealingStep) -> bool:
        """Whether a step along a valley that bends failed, where longer ones did: what a full one promises is rounding."""
        return self.slight < SLIGHT and step.reduction <= 0.0

    def after(self, step: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> SearchState:
        """The state after a step."""
        if step.reduction > 0.0:
            return self._onward(step, schedule, samples)
        if self.stride == 1.0 and step.gain_ratio > _LOWEST_GAIN:
            return replace(self, stride=step.best_length)
        overshot = step.gain_ratio < _LOWEST_GAIN and self.growth == 2.0  # for the first time since a gain
        if self.q < self.settled and not overshot:
            back = float(np.sqrt(self.q * self.settled)) if self.q < 0.9 * self.settled else self.settled
            return replace(self, q=back, growth=2.0, stride=1.0)
        slight = 0.1 * self.slight if self.eased else self.slight
        firmer = replace(self, damping=max(self.growth * self.damping, 10.0 * slight), slight=slight)
        return replace(firmer, growth=2.0 * self.growth, stride=1.0, eased=False)

    def _onward(self, step: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> SearchState:
        """The state after a step that lowered the cost: less damping (Nielsen 1999), and a lower q on convergence."""
        damping = self.damping * max(1 / 3, 1 - (2 * min(step.gain_ratio, 1.5) - 1) ** 3)
        stride = step.best_length if self.stride == 1.0 and step.gain_ratio < 0.5 else 1.0
        q, settled = self.q, self.settled
        if step.remaining < schedule.trust_per_sample * samples:
            settled, q = q, max(schedule.final_q, q * schedule.factor(step.remaining / samples))
        elif step.reduction < 0.01 * step.cost:
            q = max(schedule.final_q, q * schedule.largest_factor)
        damping = damping if damping >= self.slight else 0.0
        eased = self.gains and damping < self.damping and damping == 0.0
        return SearchState(q, settled, damping, 2.0, stride, self.gains, self.slight, eased)


_ENOUGH = 0.5  # of the predicted reduction, from which a step is not corrected

_EXPLAINED = 1.3  # of the noise, in power: with more left than this the laws are wrong, or the states far off

_CORRECTIONS = 6  # at most; a trial costs a tenth of a linearisation of many masses, and a third of it of few

_SLOW = 0.5  # of the cost: a correction that leaves more, and no reduction, is the last


def curved_step(damped: DampedEquations, misfit: Misfit, length: float) -> tuple[Misfit, float, float] | None:
    """A damped step, corrected for the curvature of the flow where it gains much less than was predicted.

    That is done where noise explains the residuals. A search that cannot hold the motion to wrong laws had better not end: the
    model error that it needs is looked for then. From the second correction on, the defects are extrapolated from those of
    the last two, as the same one is mostly left.

    Parameters
    ----------
    damped, misfit, length
        As of `damped_step`.

    Returns
    -------
    tuple of (Misfit, float, float) or None
        The misfit behind the step, the predicted reduction of the cost, and what of it may be left: all after a correction,
        which meets the prediction along a bend where the gradient turns. None where the equations are not positive definite.
    """
    attempt = damped_step(damped, misfit, length)
    if attempt is None:
        return None
    q, predicted, before = damped.q, attempt[1], misfit.cost(damped.q)
    best, unclear = misfit.at(attempt[0]), 0.0
    counted, behind = np.zeros(1), None
    for _ in range(_CORRECTIONS if is_explained(misfit) else 0):
        cost = best.cost(q)
        if before - cost > _ENOUGH * predicted or not np.isfinite(cost):
            break
        added = _added_defects(damped.linear, misfit, best)
        last = added, added - counted
        counted = added if behind is None else _extrapolated(last, behind)
        behind = last
        attempt = damped_step(_with_defects(damped, counted, length), misfit, length)
        if attempt is None:
            break
        best.orbit.release()
        trial = misfit.at(attempt[0])
        if not trial.cost(q) < cost:
            break
        best, unclear = trial, predicted
        reduces = before - _ENOUGH * predicted < trial.cost(q) < before
        if trial.cost(q) > _SLOW * cost and not reduces:
            break
    return best, predicted, unclear


def _extrapolated(last: tuple[Floats, Floats], before: tuple[Floats, Floats]) -> Floats:
    """The added defects from which nothing would differ, from those of two corrections and how they differed from counted."""
    (added, wrong), (earlier, earlier_wrong) = last, before
    turn = earlier_wrong - wrong
    length = float(np.vdot(turn, turn))
    return added - (float(np.vdot(turn, wrong)) / length if length else 0.0) * (earlier - added)


def is_settled(damped: DampedEquations, misfit: Misfit, little: float) -> bool:
    """Whether a full step would gain as little as the last, damped one: always where the laws leave more than noise.

    Parameters
    ----------
    damped, misfit
        As of `damped_step`.
    little : float
        A reduction of the cost that ends the search.

    Returns
    -------
    bool
        Whether the search may end.
    """
    if damped.damping < SLIGHT or not is_explained(misfit):
        return True
    attempt = damped_step(DampedEquations.of(damped.linear, damped.q, 0.0), misfit, 1.0)
    return attempt is not None and attempt[1] < little


def is_explained(misfit: Misfit) -> bool:
    """Whether the residuals of a misfit are hardly more than noise."""
    return bool(misfit.data < _EXPLAINED * misfit.loss.expected * int(misfit.segments.observed.sum()))


def _added_defects(linear: Linearization, misfit: Misfit, moved: Misfit) -> Floats:
    """(K - 1, m) defects that the curvature of the flow adds to the linearised ones on the way to `moved`."""
    scales = misfit.scales
    nodes = ((moved.point.nodes - misfit.point.nodes) / scales.state[:, None]).T
    border = (moved.point.border - misfit.point.border) / scales.theta
    added = (moved.defects - misfit.defects).reshape(nodes.shape[1], -1).T
    change = linear.joined * nodes[1:] - (linear.state_ends @ nodes[:-1, :, None])[..., 0]
    return np.asarray(added - (change - linear.right_ends[..., :-1] @ border))


def _with_defects(damped: DampedEquations, added: Floats, length: float) -> DampedEquations:
    """The equations with defects (K - 1, m) beside the linearised ones at the end of a step of this length."""
    assert damped.factor is not None
    nodes, border = pull_of_defects(damped.linear, added / (length * damped.q**2))
    return replace(damped, factor=damped.factor.moved(nodes, border))


_MAX_DAMPING = 1e8  # at which steps are too short to matter

_NEAR = 0.1  # of its size: a change of a coefficient by which influences reach as far as before


class AnnealingStatus(Enum):
    """How annealing ended; the value is text for messages."""

    CONVERGED = "converged"
    EXHAUSTED = "not converged: the number of steps ran out"
    STUCK = "not converged: no step lowers the cost"
    INTERRUPTED = "not converged: interrupted"
    COSTLY = "ended: the cost is higher than was asked"


@dataclass(frozen=True, eq=False)
class AnnealingFit:
    """Result of annealing.

    Attributes
    ----------
    misfit : Misfit
        Residuals and defects at the end.
    q : float
        Last relaxation.
    covariance : array of shape (p + o + g, p + o + g)
        Covariance of parameters, offsets and gains; zero at bounds.
    at_bound : array of bool, shape (p + o + g,)
        True at a bound.
    chi_square : float
        Cost per degree of freedom, 1 for laws and noise that fit.
    status : AnnealingStatus
        How the search ended.
    path : tuple of AnnealingStep
        Its steps.
    """

    misfit: Misfit
    q: float
    covariance: Floats
    at_bound: Bools
    chi_square: float
    status: AnnealingStatus
    path: tuple[AnnealingStep, ...]

    @property
    def point(self) -> Iterate:
        """The unknowns."""
        return self.misfit.point

    @property
    def scales(self) -> Scales:
        """Their units."""
        return self.misfit.scales

    @cached_property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.misfit.segments.observed.sum())


@dataclass(frozen=True)
class Annealer:
    """The search for an optimum, with its threads and progress.

    Parameters
    ----------
    executor : Executor, optional
        Threads for the normal equations.
    progress : Progress, optional
        Called at every step.
    """

    executor: Executor | None = None
    progress: Progress = silent

    def __call__(self, misfit: Misfit, schedule: AnnealingSchedule) -> AnnealingFit:
        """Fit nodes, parameters, offsets and gains to segments.

        Parameters
        ----------
        misfit : Misfit
            That at the start.
        schedule : AnnealingSchedule
            How the relaxation is lowered.

        Returns
        -------
        AnnealingFit
            The result; an interrupt from the keyboard ends the search with the best so far.

        Raises
        ------
        IdentificationError
            If the motion from the start is not finite.
        """
        _require_finite(misfit, schedule.initial_q)
        path, segments, scales = list[AnnealingStep](), misfit.segments, misfit.scales
        control = SearchState(schedule.initial_q, schedule.initial_q, gains=segments.sensors.gains > 0)
        status = AnnealingStatus.EXHAUSTED
        samples = int(segments.observed.sum())
        linear: Linearization | None = None
        damped: DampedEquations | None = None
        theta, groups = misfit.point.theta, groups_at(misfit)
        try:
            while len(path) < schedule.max_steps:
                if np.any(np.abs(misfit.point.theta - theta) > _NEAR * scales.theta[: len(theta)]):
                    theta, groups = misfit.point.theta, groups_at(misfit)
                linear = linear or self._linear(misfit, groups)
                misfit.orbit.release()
                if control.damping > _MAX_DAMPING:
                    status = AnnealingStatus.STUCK
                    break
                if damped is None or (damped.q, damped.damping) != (control.q, control.damping):
                    damped = None  # whose memory the next ones take
                    damped = DampedEquations.of(linear, control.q, control.damping)
                attempt = curved_step(damped, misfit, control.stride)
                if attempt is None:
                    control = replace(control, damping=max(10.0 * control.damping, 1e-6))
                    continue
                trial, predicted, unclear = attempt
                unclear = max(unclear, predicted if control.stride < 1.0 else 0.0)  # by the shorter step
                q, costs = control.q, (misfit.cost(control.q), trial.cost(control.q))
                gained, left_over = costs[0] - costs[1], trial.data / samples
                step = AnnealingStep(len(path), q, costs[0], predicted, gained, left_over, control.damping)
                path.append(step)
                self.progress(step.report)
                if step.reduction > 0.0:
                    misfit = trial
                    if misfit.cost(step.q) - step.remaining > schedule.cost_ceiling * samples:
                        schedule = replace(schedule, final_q=max(schedule.final_q, step.q))
                    if schedule.exceeded(step, unclear):
                        status = AnnealingStatus.COSTLY
                        break
                small, left = schedule.is_little(step, unclear, segments)
                if small and (control.ends_in_valley(step) or is_settled(damped, misfit, left)):
                    status = AnnealingStatus.CONVERGED
                    break
                del attempt, trial  # a refused one would stand beside the next
                control = control.after(step, schedule, samples)
                linear, damped = (None, None) if step.reduction > 0.0 else (linear, damped)
        except KeyboardInterrupt:
            status = AnnealingStatus.INTERRUPTED
        known = damped is not None and (damped.q, damped.damping) == (control.q, 0.0)
        factor = damped.factor if damped is not None and known else None
        linear, damped = linear or self._linear(misfit, groups), None
        return self._ended(misfit, firm_factor(linear, control.q, factor), control.q, status, path)

    def _ended(
        self,
        misfit: Misfit,
        factor: BorderedFactor | None,
        q: float,
        status: AnnealingStatus,
        path: Sequence[AnnealingStep],
    ) -> AnnealingFit:
        """The fit where a search ended."""
        border, (lower, upper) = misfit.point.border, bounds(misfit.segments)
        free = (border > lower) & (border < upper)
        found = covariance(factor, misfit.scales, free)
        chi_square = misfit.cost_of_samples(q) / (freedom(misfit.segments) * misfit.loss.expected)
        return AnnealingFit(misfit, q, found, ~free, chi_square, status, tuple(path))

    def _linear(self, misfit: Misfit, groups: Sequence[Neighbourhood]) -> Linearization:
        """The Gauss-Newton model at a point, by `groups` of columns where there are any."""
        if groups:
            return local_linearization(LocalRows(misfit, groups), self.executor)
        return linearise(misfit, self.executor)


def _require_finite(misfit: Misfit, q: float) -> None:
    """Raise IdentificationError where the motion from a start is not finite."""
    if not np.isfinite(misfit.cost(q)):
        raise IdentificationError(
            "the motion that starts from the states in the record runs to infinity within a few samples: the time may be "
            "in another unit than s (write time[ms]), a channel in another than its header says, a law is not finite over "
            "the motion of its link, or a force acts that no channel shows (identify takes it as ambient)"
        )
