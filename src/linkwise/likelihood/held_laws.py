"""Better states to start from: the motion near the record that the laws allow while their coefficients are held.

Smoothing gives poor rates of a fast motion of few samples, and states that are far from any motion of the structure lead
a search for states and coefficients together astray. With coefficients that are roughly right the states alone are found
safely.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingSchedule
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.residuals import Misfit, evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

_ROUGH = 3.0  # cost per sample at q = 1 beyond which states are no motion: their noise leaves 1 or 2
_SCHEDULE = AnnealingSchedule(initial_q=10.0, final_q=0.1, max_steps=30)
_OPPOSITE = 4.0  # times the power of the samples: residuals of a motion as large, in opposite phase
_MANY = 0.2  # share of the segments from which the flow runs away although laws and units are right
_HALVINGS = 20  # of states from which the flow runs away


def within_reach(segments: Segments, start: Iterate, scales: Scales, loss: Loss) -> Iterate:
    """Reduce the states from which the flow runs away, until it does not.

    Where it runs away from many, laws or units are wrong, and nothing is changed.

    Parameters
    ----------
    segments : Segments
        The record in segments.
    start : Iterate
        States and parameters.
    scales : Scales
        Their units, and the noise.
    loss : Loss
        The cost of a residual.

    Returns
    -------
    Iterate
        The same parameters, and states halved until the flow from them stays near the samples.
    """
    misfit = evaluate(segments, start, scales, loss)
    wild = _runs_away(segments, misfit, scales)
    if np.mean(wild) > _MANY:
        return start
    for _ in range(_HALVINGS):
        if not wild.any():
            break
        calmer = replace(misfit.point, nodes=np.where(wild, 0.5, 1.0) * misfit.point.nodes)
        misfit = evaluate(segments, calmer, scales, loss)
        wild = _runs_away(segments, misfit, scales)
    return misfit.point


def states_by_held_laws(segments: Segments, start: Iterate, scales: Scales, annealer: Annealer) -> Iterate:
    """Fit the states alone, the parameters held, where the states of a start are no motion of the laws.

    Parameters
    ----------
    segments : Segments
        The record in segments.
    start : Iterate
        States and parameters, the latter near the truth.
    scales : Scales
        Their units, and the noise.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    Iterate
        The same parameters, with the states of a motion near the record.
    """
    cost = evaluate(segments, start, scales, annealer.loss).cost(1.0)
    if not _ROUGH * int(segments.observed.sum()) < cost < np.inf:
        return start
    system, theta = segments.system, start.theta
    fixed_system = replace(system, parameters=replace(system.parameters, lower=theta, upper=theta))
    fit = annealer(replace(segments, system=fixed_system), start, scales, _SCHEDULE)
    return replace(start, nodes=fit.point.nodes)


def _runs_away(segments: Segments, misfit: Misfit, scales: Scales) -> Bools:
    """(K,) segments whose flow is farther from the samples than any motion of their size could be, or not finite.

    The flow behind the last sample of a segment is judged by where it ends, against the largest states of the record.
    """
    sigma = scales.sigma[:, None]
    if segments.relative_noise is not None:
        sigma = sigma * segments.relative_noise
    largest = np.sum((segments.samples / sigma) ** 2 + segments.observed, axis=(0, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        residuals = np.sum(misfit.residuals**2, axis=(0, 1))
        ends = np.sum(misfit.defects**2, axis=0)
    finite = np.isfinite(misfit.trajectories.states).all(axis=(0, 1, 2))
    finite &= np.isfinite(misfit.trajectories.memory).all(axis=(0, 1))
    states = misfit.point.nodes / scales.state.reshape(-1, *[1] * (misfit.point.nodes.ndim - 1))
    near = residuals <= _OPPOSITE * largest
    near[:-1] &= ends <= _OPPOSITE * np.sum(np.max(states**2, axis=-1))
    return np.asarray(~(finite & near))
