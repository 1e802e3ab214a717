"""Annealed multiple shooting: Levenberg-Marquardt iterations while the continuity of the segments is tightened.

    minimise  sum loss((y - h(flow)) / sigma)  +  sum |defect / S|^2 / q^2 ,   q from 1 towards 0

METHODS section 5.

References
----------
H. G. Bock, in Modelling of Chemical Reaction Systems (1981), for multiple shooting.
J. Ye et al., Phys. Rev. E 92, 052901 (2015), for annealing.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from enum import Enum

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.bordered_system import BorderedFactor
from linkwise.likelihood.shooting.linear_model import covariance, firm_factor, groups_at
from linkwise.likelihood.shooting.local_equations import local_linearization
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import LocalRows, Neighbourhood
from linkwise.likelihood.shooting.normal_equations import Linearization, linearise
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.steps import AnnealingSchedule as AnnealingSchedule
from linkwise.likelihood.shooting.steps import (
    AnnealingStep,
    DampedEquations,
    SearchState,
    bounds,
    curved_step,
    freedom,
    is_settled,
)
from linkwise.progress import Progress, silent

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

    misfit: Misfit
    q: float
    scales: Scales
    covariance: Floats
    at_bound: Bools
    chi_square: float
    samples: int
    status: AnnealingStatus
    path: tuple[AnnealingStep, ...]

    @property
    def point(self) -> Iterate:
        """The unknowns."""
        return self.misfit.point


def _started(segments: Segments, start: Iterate | Misfit, scales: Scales, loss: Loss, q: float) -> Misfit:
    """The misfit at the start, which must be finite."""
    misfit = start if isinstance(start, Misfit) else evaluate(segments, start, scales, loss)
    if not np.isfinite(misfit.cost(q)):
        raise IdentificationError(
            "the motion that starts from the states in the record runs to infinity within a few samples: the time may be in "
            "another unit than s (write time[ms]), a channel in another than its header says, a law is not finite over the "
            "motion of its link, or a force acts that no channel shows (identify takes it as ambient)"
        )
    return misfit


def _ended(
    segments: Segments,
    factor: BorderedFactor | None,
    misfit: Misfit,
    scales: Scales,
    loss: Loss,
    q: float,
    status: AnnealingStatus,
    path: list[AnnealingStep],
) -> AnnealingFit:
    """The fit where a search ended."""
    border, (lower, upper) = misfit.point.border, bounds(segments)
    free = (border > lower) & (border < upper)
    return AnnealingFit(
        misfit,
        q,
        scales,
        covariance(factor, scales, free),
        ~free,
        misfit.cost_of_samples(q) / (freedom(segments) * loss.expected),
        int(segments.observed.sum()),
        status,
        tuple(path),
    )


@dataclass(frozen=True)
class Annealer:
    """The search for an optimum, with its loss, threads and progress.

    Parameters
    ----------
    loss : Loss
        Loss of a residual.
    executor : Executor, optional
        Threads for the normal equations.
    progress : Progress, optional
        Called at every step.
    """

    loss: Loss
    executor: Executor | None = None
    progress: Progress = silent

    def __call__(
        self, segments: Segments, start: Iterate | Misfit, scales: Scales, schedule: AnnealingSchedule
    ) -> AnnealingFit:
        """Fit nodes, parameters, offsets and gains to segments.

        Parameters
        ----------
        segments : Segments
            The records in segments.
        start : Iterate or Misfit
            Starting values, or the misfit there.
        scales : Scales
            Units of the unknowns.
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
        loss, path = self.loss, list[AnnealingStep]()
        control = SearchState(schedule.initial_q, schedule.initial_q, gains=segments.sensors.gains > 0)
        status = AnnealingStatus.EXHAUSTED
        samples = int(segments.observed.sum())
        misfit = _started(segments, start, scales, loss, schedule.initial_q)
        linear: Linearization | None = None
        damped: DampedEquations | None = None
        theta, groups = misfit.point.theta, groups_at(segments, misfit, scales)
        try:
            while len(path) < schedule.max_steps:
                if np.any(np.abs(misfit.point.theta - theta) > _NEAR * scales.theta[: len(theta)]):
                    theta, groups = misfit.point.theta, groups_at(segments, misfit, scales)
                linear = linear or self._linear(segments, misfit, scales, groups)
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
                unclear = max(unclear, predicted if control.stride < 1.0 else 0.0)  # by the shorter step
                step = control.evaluated_step(len(path), misfit, trial, predicted, samples)
                path.append(step)
                self.progress(step.report)
                if step.reduction > 0.0:
                    misfit = trial
                    schedule = schedule.with_ceiling(step, misfit, samples)
                    if schedule.exceeded(step, unclear):
                        status = AnnealingStatus.COSTLY
                        break
                small, left = schedule.is_little(step, unclear, segments)
                settled = small and (
                    control.ends_in_valley(step)
                    or is_settled(segments, linear, damped, misfit, scales, loss, left)
                )
                if settled:
                    status = AnnealingStatus.CONVERGED
                    break
                control = control.after(step, schedule, samples)
                linear, damped = (None, None) if step.reduction > 0.0 else (linear, damped)
        except KeyboardInterrupt:
            status = AnnealingStatus.INTERRUPTED
        factor = None if damped is None else damped.undamped_factor(control.q)
        linear, damped = linear or self._linear(segments, misfit, scales, groups), None
        firm = firm_factor(linear, control.q, factor)
        return _ended(segments, firm, misfit, scales, loss, control.q, status, path)

    def _linear(
        self, segments: Segments, misfit: Misfit, scales: Scales, groups: Sequence[Neighbourhood]
    ) -> Linearization:
        """The Gauss-Newton model at a point, by `groups` of columns where there are any."""
        if groups:
            return local_linearization(LocalRows(segments, misfit, scales, self.loss, groups), self.executor)
        return linearise(segments, misfit, scales, self.loss, self.executor)
