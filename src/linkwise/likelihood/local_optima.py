"""Whether the optimum of a fit is the only one near: a second search, and a look at the cost some standard errors away.

Where motion is chaotic or noise is large, the likelihood has many valleys. A search that needed many steps is the sign of it;
one that went straight to its end is believed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.anneal import AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.fit import LikelihoodFit

_STRAIGHT = 10  # steps of annealing after which a search went straight to its end
_LOOKS = 2  # directions in which the cost is looked at
_DISTANCE = 2.0  # standard errors
_STEPS = 60  # that following a look may take
_LOOSENED = 1e3  # times the last q: from here annealing follows coefficients that were moved
_LOOSEST = 1e-2
_IRREGULAR = 4.0  # factor on the rise of the cost beyond which it is no parabola
_LOST = 100.0  # the same where the orbit could not be followed to the end, so that the rise is an upper bound
_SEED = 20261122


def went_straight(fit: LikelihoodFit) -> bool:
    """Whether there is no sign of another optimum: few steps, or a model error, which smooths the likelihood."""
    return len(fit.path) <= _STRAIGHT or fit.model_error > 0.0


def lower_of_two(fit: LikelihoodFit, search: Callable[[Floats], LikelihoodFit]) -> LikelihoodFit:
    """`fit`, or where it converged only after many steps, the better one of it and of a `search` from its values."""
    if fit.status is not AnnealingStatus.CONVERGED or went_straight(fit):
        return fit
    again = search(fit.values)
    if again.status is AnnealingStatus.INTERRUPTED:
        return again
    better = again.status is AnnealingStatus.CONVERGED and again.chi_square < fit.chi_square
    return again if better and again.model_error == 0.0 else fit


def is_regular(fit: LikelihoodFit) -> bool:
    """Whether the cost rises around the optimum as the covariance says, where many steps make that doubtful.

    The coefficients are moved by two standard errors in random directions and the orbit is fitted to them anew.
    """
    if went_straight(fit):
        return True
    free = np.flatnonzero(fit.free)
    covariance = fit.covariance[np.ix_(free, free)]
    if not len(free) or not np.isfinite(covariance).all():
        return True
    size = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    directions = np.random.default_rng(_SEED).normal(size=(_LOOKS, len(free)))
    directions *= _DISTANCE / np.linalg.norm(directions, axis=1, keepdims=True)
    return all(_rises_as_expected(fit, free, root @ direction) for direction in directions)


def _rises_as_expected(fit: LikelihoodFit, free: Indices, step: Floats) -> bool:
    """Whether the cost rises like a parabola when the free coefficients are moved by `step` and held."""
    optimum = fit.optimum
    theta = optimum.point.theta.copy()
    theta[free] += step
    system = optimum.segments.system
    held = replace(system, parameters=replace(system.parameters, lower=theta, upper=theta))
    moved = anneal(
        replace(optimum.segments, system=held),
        replace(optimum.point, theta=theta),
        optimum.scales,
        AnnealingSchedule(
            initial_q=max(optimum.q, min(_LOOSENED * optimum.q, _LOOSEST)),
            final_q=optimum.q,
            max_steps=_STEPS,
        ),
        loss=optimum.loss,
    )
    rise = (moved.misfit.cost(optimum.q) - fit.misfit.cost(optimum.q)) / optimum.noise**2 / _DISTANCE**2
    if moved.status is AnnealingStatus.CONVERGED:
        return bool(1.0 / _IRREGULAR < rise < _IRREGULAR)
    return bool(rise < _LOST)
