"""Levenberg-Marquardt steps of multiple shooting within the bounds of the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.likelihood.shooting.bordered_system import BorderedSystem, border_step
from linkwise.likelihood.shooting.late_sensors import LARGEST
from linkwise.likelihood.shooting.linear_model import Border, Factor, GaussNewtonModel
from linkwise.likelihood.shooting.local_equations import LocalLinearization, LocalSystem
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

SLIGHT = 1e-3  # damping that changes no step


@dataclass(frozen=True, eq=False)
class DampedEquations:
    """Normal equations at a relaxation `q` with a `damping`, and their factor; steps of any length follow from them.

    Attributes
    ----------
    equations : BorderedSystem or LocalSystem
        The equations.
    factor : BorderedFactor, LocalFactor or None
        Their factor, damped; None where they are not positive definite.
    q : float
        Relaxation.
    damping : float
        Levenberg-Marquardt parameter.
    """

    equations: BorderedSystem | LocalSystem
    factor: Factor | None
    q: float
    damping: float

    @classmethod
    def of(cls, linear: GaussNewtonModel, q: float, damping: float) -> DampedEquations:
        """Those of a linearization."""
        equations = linear.equations(q)
        return cls(equations, equations.factor(linear.damping(damping)), q, damping)

    def undamped_factor(self, q: float) -> Factor | None:
        """The factor where it is that without damping at a relaxation, else None."""
        return self.factor if (self.q, self.damping) == (q, 0.0) else None


def damped_step(
    segments: Segments, damped: DampedEquations, misfit: Misfit, scales: Scales, length: float
) -> tuple[Iterate, float] | None:
    """A damped Gauss-Newton step; parameters that it would take out of their bounds go to them, the others with them.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    damped : DampedEquations
        The equations at the present point.
    misfit : Misfit
        Misfit there.
    scales : Scales
        Units of the unknowns.
    length : float
        Fraction of the step to take.

    Returns
    -------
    tuple of (Iterate, float) or None
        The new point and the predicted reduction of the cost; None where the equations are not positive definite.
    """
    equations, factor = damped.equations, damped.factor
    if factor is None:
        return None
    bounded = _within_bounds(segments, factor, misfit, scales, length)
    solved = None if bounded is None else factor.solve(bounded.free, bounded.fixed)
    if bounded is None or solved is None:
        return None
    nodes, border = length * solved[0], length * solved[1]
    moved = (nodes * scales.state).T
    point = misfit.point.moved(misfit.point.nodes + moved, bounded.border)
    excess = factor.excess(solved[1], bounded.free)
    predicted = (2.0 - length) * equations.drop(nodes, border) - length**2 * excess
    return point, predicted


@dataclass(frozen=True, eq=False)
class _BorderStep:
    """A step of the unknowns of the border: which were `free` (P,) of their bounds, where the others were `fixed` (P,), in
    scaled unknowns, the whole `step` (P,) in these, and the `border` (P,) to which the part asked for leads.
    """

    free: Bools
    fixed: Floats
    step: Floats
    border: Floats


def _within_bounds(
    segments: Segments, equations: Border, misfit: Misfit, scales: Scales, length: float
) -> _BorderStep | None:
    """The part `length` of the step that equations of the border ask for, with unknowns that would pass a bound held there."""
    lower, upper = bounds(segments)
    old = misfit.point.border
    free, ends = np.ones(segments.parameters, bool), old.copy()
    while True:
        fixed = (ends - old) / scales.theta
        step = border_step(equations.schur, equations.reduced, free, fixed)
        if step is None:
            return None
        new = old + length * step * scales.theta
        outside = free & ((new < lower) | (new > upper))
        if not outside.any():
            break
        ends = np.where(outside, np.clip(new, lower, upper), ends)
        free &= ~outside
    if length == 1.0:
        new = np.where(free, new, ends)  # to the last digit
    return _BorderStep(free, fixed, step, np.clip(new, lower, upper))


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


def full_reduction(
    segments: Segments, linear: GaussNewtonModel, misfit: Misfit, scales: Scales, damped: DampedEquations
) -> float:
    """What a full step is predicted to take off the cost, where a damped one, which is short, takes off little anywhere.

    Parameters
    ----------
    segments, misfit, scales
        As of `damped_step`.
    linear : GaussNewtonModel
        The linearised problem.
    damped : DampedEquations
        The equations of the last step.

    Returns
    -------
    float
        The predicted reduction; 0 where the last step was a full one, infinite where the equations are not positive definite.
    """
    if damped.damping < SLIGHT:
        return 0.0
    if isinstance(linear, LocalLinearization):  # a second factor would take as much room as the first one
        border = linear.equations(damped.q).border()
        bounded = None if border is None else _within_bounds(segments, border, misfit, scales, 1.0)
        return float("inf") if border is None or bounded is None else border.reduction(bounded.step)
    attempt = damped_step(segments, DampedEquations.of(linear, damped.q, 0.0), misfit, scales, 1.0)
    return float("inf") if attempt is None else attempt[1]
