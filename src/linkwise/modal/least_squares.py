"""Levenberg-Marquardt steps on the normal equations of a few unknowns: what both searches for modes take.

References
----------
J. J. Moré, Lecture Notes in Mathematics 630, 105 (1978).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from linkwise.arrays import Floats

_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-9, 1e12  # of steps, as a part of the curvature


class LinearProblem(NamedTuple):
    """A sum of squares about a point: its `cost`, and half its slope downwards (p,) and its curvature (p, p)."""

    cost: float
    slope: Floats
    curvature: Floats


class SearchEnd(NamedTuple):
    """Where a search ended, and whether it converged there."""

    point: Floats
    converged: bool


def least_squares(
    start: Floats,
    equations: Callable[[Floats], LinearProblem],
    cost: Callable[[Floats], float],
    within: Callable[[Floats], Floats],
    *,
    steps: int,
    least_gain: float,
) -> SearchEnd:
    """The point of the least sum of squares near `start` (p,), where no step lowers the cost or one lowers it by less than
    a part `least_gain`. It converged if the first step there promised no more than that. `equations` linearises the
    problem about a point, `cost` is the sum of squares there, `within` the nearest point within the bounds.
    """
    point, linear, damping = start, equations(start), _FIRST_DAMPING
    for _ in range(steps):
        promised: float | None = None
        scale = np.sqrt(np.maximum(linear.curvature.diagonal(), np.finfo(float).tiny))
        matrix = linear.curvature / np.outer(scale, scale)
        while True:
            step = np.linalg.solve(matrix + damping * np.eye(len(point)), linear.slope / scale) / scale
            trial = within(point + step)
            if promised is None:  # what points out of the bounds gains nothing
                promised = float(linear.slope @ (trial - point))
            trial_cost = cost(trial)
            if trial_cost < linear.cost:
                break
            damping *= 10.0
            if damping > _MOST_DAMPING:
                return SearchEnd(point, promised < least_gain * linear.cost)
        gained, point = linear.cost - trial_cost, trial
        if gained < least_gain * trial_cost:
            return SearchEnd(point, converged=True)
        linear, damping = equations(point), max(0.1 * damping, _LEAST_DAMPING)
    return SearchEnd(point, converged=False)
