"""How annealed multiple shooting goes on: its schedule, its steps, and the relaxation and damping that follow from these."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log10

import numpy as np

from linkwise.likelihood.shooting.damped_step import SLIGHT
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Segments
from linkwise.progress import ProgressReport

_LOWEST_GAIN = -10.0  # gain ratio below which the parabola through a step is meaningless
_MARGIN = 10.0  # times the reduction of the cost that is estimated to be left, which is not exact
_ROUNDING = 1e-7  # of the cost: error of reductions predicted by sensitivities in single precision
_ROUNDING_OF_MANY = 3e-7  # the same by those along parts of a structure of many masses
_OF_PART = 2.0  # times what a quarter of a step gains, or more of it: what a full one leaves is less


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
    number of steps at the final q that lowered the cost.
    """

    q: float
    settled: float
    damping: float = 0.0
    growth: float = 2.0
    stride: float = 1.0
    tight: int = 0

    def may_try(self, schedule: AnnealingSchedule, segments: Segments) -> bool:
        """Whether chord steps may follow a step: a full one of a search that leads to more than the start of another.

        They are tried once, of many masses, behind the first step at the final q; of few masses a dozen chords cost more than
        the few steps that are left.
        """
        due = self.tight == 0 and len(segments.system.incidence) >= MANY
        return due and self.stride == 1.0 and schedule.tolerance <= AnnealingSchedule.tolerance

    def firmer(self) -> SearchState:
        """The state after equations that were not positive definite."""
        return replace(self, damping=max(10.0 * self.damping, 1e-6))

    def evaluated_step(
        self, step: int, misfit: Misfit, trial: Misfit, predicted: float, samples: int
    ) -> AnnealingStep:
        """The step between two misfits, whose cost was predicted to fall by `predicted`."""
        cost = misfit.cost(self.q)
        gained = cost - trial.cost(self.q)
        return AnnealingStep(step, self.q, cost, predicted, gained, trial.data / samples, self.damping)

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
        return replace(
            self, damping=max(self.growth * self.damping, 0.01), growth=2.0 * self.growth, stride=1.0
        )

    def _onward(self, step: AnnealingStep, schedule: AnnealingSchedule, samples: int) -> SearchState:
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
        damping = damping if damping >= SLIGHT else 0.0
        return replace(
            self,
            q=q,
            settled=settled,
            damping=damping,
            growth=2.0,
            stride=stride,
            tight=self.tight + (step.q <= schedule.final_q),
        )
