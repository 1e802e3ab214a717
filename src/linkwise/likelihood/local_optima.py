"""Search for other optima near that of a fit: a second search, and the cost a few standard errors away.

The likelihood of chaotic motion or of noisy records has many local optima. A search of many steps indicates them; one of few
steps is trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.neighbourhoods import MANY

_STRAIGHT = 10  # steps of annealing up to which there is no sign of another optimum
_DOUBLED = 5.0  # more of them for twice the masses, of which the slowest to converge decides
_DIRECTIONS = 2  # in which the cost is evaluated
_EXHAUSTED = AnnealingSchedule.max_steps  # steps after which a search was taken up again
_DISTANCE = 2.0  # standard errors
_STEPS = 60  # of annealing at most in each direction
_LOOSENED = 1e3  # times the last q: annealing starts from here once parameters were moved
_LOOSEST = 1e-2
_IRREGULAR = 4.0  # factor on the rise of the cost beyond which it is not quadratic
_IRREGULAR_UNCONVERGED = 100.0  # the same where annealing did not converge: the rise is then an upper bound
_SEED = 20261122


def went_straight(fit: LikelihoodFit) -> bool:
    """Whether there is no sign of another optimum: few steps, or a model error or a random force, which smooths the
    likelihood.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    bool
        Whether there is none.
    """
    masses = len(fit.segments.system.incidence)
    more = _DOUBLED * np.log2(masses / MANY) if masses > MANY else 0.0
    return len(fit.path) <= _STRAIGHT + more or fit.model_error > 0.0 or bool(fit.random_forces)


def lower_of_two(fit: LikelihoodFit, search: Callable[[Floats], LikelihoodFit]) -> LikelihoodFit:
    """Repeat a fit that converged only after many steps, and keep the better one.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    search : callable
        Fits again from given parameters (p,).

    Returns
    -------
    LikelihoodFit
        The fit with the lower chi-square.
    """
    if fit.status is not AnnealingStatus.CONVERGED or went_straight(fit):
        return fit
    again = search(fit.values)
    if again.status is AnnealingStatus.INTERRUPTED:
        return again
    better = again.status is AnnealingStatus.CONVERGED and again.chi_square < fit.chi_square
    if not better or again.model_error > 0.0:
        return fit
    return replace(again, path=max(fit.path, again.path, key=len))


def is_regular(fit: LikelihoodFit, faint: Sequence[str] = ()) -> bool:
    """Whether the cost around the optimum rises as the covariance predicts; tested only after many steps.

    The parameters are moved by two standard errors in random directions and held, and the orbit is fitted again.
    A search that converged only after it had run out of steps crossed a likelihood too uneven for its curvature to say much.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that stay where they are, as their intervals do not rest on the covariance.

    Returns
    -------
    bool
        Whether it does.
    """
    if went_straight(fit):
        return True
    if len(fit.path) > _EXHAUSTED:
        return False
    return is_quadratic(fit, faint)


def is_quadratic(
    fit: LikelihoodFit,
    faint: Sequence[str] = (),
    *,
    factor: float = _IRREGULAR,
    sides: Sequence[float] = (1.0,),
) -> bool:
    """Whether the cost rises as the covariance predicts where the parameters are moved by two standard errors and held.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that stay where they are.
    factor : float, optional
        By which the rise may differ from the prediction.
    sides : sequence of float, optional
        Signs of the two random directions that are taken.

    Returns
    -------
    bool
        Whether it does.
    """
    free = np.flatnonzero(fit.free & ~np.isin(fit.segments.system.parameters.names, list(faint)))
    of_white = fit.optimum.of_white  # as which the cost takes the noise
    covariance = (fit.covariance if of_white is None else of_white)[np.ix_(free, free)]
    if not len(free) or not np.isfinite(covariance).all():
        return True
    size = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    directions = np.random.default_rng(_SEED).normal(size=(_DIRECTIONS, len(free)))
    directions *= _DISTANCE / np.linalg.norm(directions, axis=1, keepdims=True)
    return all(
        _rises_as_expected(fit, free, side * (root @ direction), factor)
        for direction in directions
        for side in sides
    )


def _rises_as_expected(fit: LikelihoodFit, free: Indices, step: Floats, factor: float) -> bool:
    """Whether the cost rises quadratically, within a factor, when the free parameters are moved by `step` and held."""
    optimum = fit.optimum
    theta = optimum.point.theta.copy()
    theta[free] += step
    moved = fitted_with(optimum, theta, np.ones(len(theta), dtype=bool))
    rise = (moved.misfit.cost(optimum.q) - fit.misfit.cost(optimum.q)) / optimum.noise**2 / _DISTANCE**2
    if moved.status is AnnealingStatus.CONVERGED:
        return bool(1.0 / factor < rise < factor)
    return bool(rise < _IRREGULAR_UNCONVERGED)


def fitted_with(optimum: Optimum, theta: Floats, held: Bools) -> AnnealingFit:
    """The orbit fitted again from parameters `theta` (p,), those that are `held` (p,) kept."""
    system = optimum.segments.system
    lower = np.where(held, theta, system.parameters.lower)
    upper = np.where(held, theta, system.parameters.upper)
    constrained = replace(system, parameters=replace(system.parameters, lower=lower, upper=upper))
    return anneal(
        replace(optimum.segments, system=constrained),
        replace(optimum.point, theta=np.clip(theta, lower, upper)),
        optimum.scales,
        AnnealingSchedule(
            initial_q=max(optimum.q, min(_LOOSENED * optimum.q, _LOOSEST)),
            final_q=optimum.q,
            max_steps=_STEPS,
        ),
        loss=optimum.loss,
    )
