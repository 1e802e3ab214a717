"""Search for other optima near that of a fit: a second search, and the cost a few standard errors away.

The likelihood of chaotic motion or of noisy records has many local optima. A search of many steps indicates them; one of few
steps is trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.fit import CostShape, LikelihoodFit, Optimum
from linkwise.likelihood.shooting.anneal import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.shooting.neighbourhoods import MANY

_STRAIGHT = 10  # steps of annealing up to which there is no sign of another optimum
_DOUBLED = 5.0  # more of them for twice the masses, of which the slowest to converge decides
_DIRECTIONS = 2  # in which the cost is evaluated
_EXHAUSTED = AnnealingSchedule.max_steps  # steps after which a search was taken up again
_DISTANCE = 2.0  # standard errors
_PRECISION = 0.1  # of the cost there: 2.5 % of the rise that is expected at two standard errors
_STEPS = 60  # of annealing at most in each direction
_LOOSENED = 1e3  # times the last q: annealing starts from here once parameters were moved
_LOOSEST = 1e-2
_IRREGULAR = 4.0  # factor on the rise of the cost beyond which it is not quadratic
_IRREGULAR_UNCONVERGED = 100.0  # the same where annealing did not converge: the rise is then an upper bound
_WEAKEST = 2  # directions that the record determines least
_FAR = 3.0  # standard errors that the parameters are moved in these
_TOO_LITTLE = 0.5  # of the rise expected there: the valley bends, or another one is near
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

    The parameters are moved by two standard errors in random directions, and by three in the directions that the record
    determines least, and held, and the orbit is fitted again. A narrow valley that bends leaves the latter only. A search that
    converged only after it had run out of steps crossed a likelihood too uneven for its curvature to say much.

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
    if fit.shape is CostShape.REGULAR:
        return True
    known = fit.shape is CostShape.QUADRATIC
    return (known or is_quadratic(fit, faint)) and rises_in_weak_directions(fit, faint)


def is_quadratic(
    fit: LikelihoodFit,
    faint: Sequence[str] = (),
    *,
    factor: float = _IRREGULAR,
    sides: Sequence[float] = (1.0,),
) -> bool:
    """Whether the cost rises as the covariance predicts where the parameters are moved by two standard errors and held.

    Beside a host only parameters without a prior are moved, and all others are fitted again: dampings between modes, which
    records hardly determine, shift frequencies by their squares, so that the cost is no parabola of all together.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that are not moved.
    factor : float, optional
        By which the rise may differ from the prediction.
    sides : sequence of float, optional
        Signs of the two random directions that are taken.

    Returns
    -------
    bool
        Whether it does.
    """
    tested = _tested(fit, faint)
    chosen = _unknown_beforehand(fit, tested)
    axes = _axes_of_covariance(fit, chosen)
    if axes is None:
        return True
    scale, vectors, deviations = axes
    root = scale[:, None] * (vectors * deviations)
    rise = _rise if len(chosen) == len(tested) else rise_of_profile
    directions = np.random.default_rng(_SEED).normal(size=(_DIRECTIONS, len(chosen)))
    directions *= _DISTANCE / np.linalg.norm(directions, axis=1, keepdims=True)
    return all(
        _is_expected(*rise(fit, chosen, side * (root @ direction), _DISTANCE), factor)
        for direction in directions
        for side in sides
    )


def rises_in_weak_directions(fit: LikelihoodFit, faint: Sequence[str] = ()) -> bool:
    """Whether the cost rises by enough where the parameters are moved in the directions that the record determines least.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that stay where they are.

    Returns
    -------
    bool
        Whether it does.
    """
    free = _tested(fit, faint)
    axes = _axes_of_covariance(fit, free)
    if axes is None:
        return True
    scale, vectors, deviations = axes
    return all(
        _rise(fit, free, side * _FAR * scale * weak, _FAR, enough=_TOO_LITTLE)[0] > _TOO_LITTLE
        for weak in (vectors * deviations).T[-_WEAKEST:]
        for side in (1.0, -1.0)
    )


def profiles_rise(fit: LikelihoodFit) -> bool:
    """Whether -2 log likelihood rises by enough along the profile of each parameter.

    A valley that bends, or another one that crosses it, may be seen in profiles alone, which follow it.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    bool
        Whether it does.
    """
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    for parameter in np.flatnonzero(fit.free).tolist():
        if not (np.isfinite(errors[parameter]) and errors[parameter] > 0.0):
            return False
        is_fixed = np.zeros(len(fit.values), dtype=bool)
        is_fixed[parameter] = True
        for distance in (_FAR, -_FAR):
            step = distance * fit.covariance[:, parameter] / errors[parameter]
            if not rises_by(_TOO_LITTLE, fit, fit.values + step, is_fixed, distance):
                return False
    return True


def rises_by(least: float, fit: LikelihoodFit, theta: Floats, is_fixed: Bools, distance: float) -> bool:
    """Whether -2 log likelihood is higher by enough where some parameters are moved and held.

    Parameters
    ----------
    least : float
        Of the rise that is expected.
    fit : LikelihoodFit
        The fit.
    theta : array of shape (p,)
        Parameters after the move.
    is_fixed : array of bool, shape (p,)
        Those that keep these values; the others are fitted again.
    distance : float
        Of the move in standard errors.

    Returns
    -------
    bool
        Whether it is.
    """
    moved = _fitted_with(fit.optimum, theta, is_fixed, sufficient_cost=_raised_cost(fit, distance, least))
    return _relative_rise(fit, moved, distance) > least


def rise_of_profile(fit: LikelihoodFit, moved: Indices, step: Floats, distance: float) -> tuple[float, bool]:
    """The rise of -2 log likelihood where parameters are moved and held, and all others fitted again.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    moved : array of int, shape (f,)
        The parameters that are moved.
    step : array of shape (f,)
        By how much.
    distance : float
        Of the move in standard errors.

    Returns
    -------
    tuple of (float, bool)
        The rise over that expected, the square of the distance, and whether the others were found; else an upper bound of it.
    """
    covariance = _covariance(fit)
    size = np.sqrt(np.maximum(covariance.diagonal()[moved], np.finfo(float).tiny))
    correlation = covariance[np.ix_(moved, moved)] / np.outer(size, size)
    with_others = covariance[:, moved] / size @ np.linalg.pinv(correlation, hermitian=True) @ (step / size)
    is_fixed = np.isin(np.arange(len(fit.values)), moved)
    annealed = _fitted_with(fit.optimum, fit.optimum.point.theta + with_others, is_fixed)
    return _relative_rise(fit, annealed, distance), annealed.status is AnnealingStatus.CONVERGED


def _tested(fit: LikelihoodFit, faint: Sequence[str]) -> Indices:
    """The parameters that are free and not `faint`."""
    return np.flatnonzero(fit.free & ~np.isin(fit.segments.system.parameters.names, list(faint)))


def _unknown_beforehand(fit: LikelihoodFit, parameters: Indices) -> Indices:
    """Those of some parameters that have no prior; all of them where none is without, or the structure has no host."""
    prior = fit.segments.prior
    if prior is None or not len(fit.segments.system.points):
        return parameters
    unknown = parameters[np.isinf(prior.deviation[parameters])]
    return unknown if len(unknown) else parameters


def _covariance(fit: LikelihoodFit) -> Floats:
    """(p, p) covariance of the parameters as the cost has it, which takes the noise for white."""
    of_white = fit.optimum.of_white
    return fit.covariance if of_white is None else of_white


def _axes_of_covariance(fit: LikelihoodFit, free: Indices) -> tuple[Floats, Floats, Floats] | None:
    """Standard deviations (f,) of the free parameters, as the cost has them, and principal axes of their correlations.

    The axes are (f, f) vectors in columns and deviations (f,) along them, the largest last. None where there is no covariance.
    """
    covariance = _covariance(fit)[np.ix_(free, free)]
    if not len(free) or not np.isfinite(covariance).all():
        return None
    scale = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    variances, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    vectors = vectors * np.where(vectors[-1] < 0.0, -1.0, 1.0)  # signs differ from one machine to another
    return scale, vectors, np.sqrt(np.maximum(variances, 0.0))


def _is_expected(rise: float, converged: bool, factor: float) -> bool:
    """Whether a rise of the cost over that expected is quadratic, within a factor."""
    return bool(1.0 / factor < rise < factor if converged else rise < _IRREGULAR_UNCONVERGED)


def _rise(
    fit: LikelihoodFit, free: Indices, step: Floats, distance: float, *, enough: float = np.inf
) -> tuple[float, bool]:
    """The rise of the cost over that expected at a `distance` in standard errors, and whether the orbit was found there.

    An upper bound of it where it was not; a lower one where it is surely more than `enough`.
    """
    optimum = fit.optimum
    theta = optimum.point.theta.copy()
    theta[free] += step
    moved = _motion_with(optimum, theta, sufficient_cost=_raised_cost(fit, distance, enough))
    return _relative_rise(fit, moved, distance), moved.status is AnnealingStatus.CONVERGED


def _relative_rise(fit: LikelihoodFit, moved: AnnealingFit, distance: float) -> float:
    """By how much -2 log likelihood is higher after a move of a `distance` in standard errors, over what is expected."""
    optimum = fit.optimum
    q = moved.q if moved.status is AnnealingStatus.COSTLY else optimum.q
    rise = moved.misfit.cost(q) - fit.misfit.cost(optimum.q)
    return float(rise / optimum.noise**2 / distance**2)


def _raised_cost(fit: LikelihoodFit, distance: float, relative_rise: float) -> float:
    """The cost that is higher than at the optimum by a multiple of what is expected at a `distance`."""
    optimum = fit.optimum
    return float(fit.misfit.cost(optimum.q) + relative_rise * (distance * optimum.noise) ** 2)


def _fitted_with(
    optimum: Optimum, theta: Floats, is_fixed: Bools, *, sufficient_cost: float = np.inf
) -> AnnealingFit:
    """The orbit fitted again from parameters `theta` (p,), those that `is_fixed` (p,) marks unchanged.

    The search ends early where the cost is surely above `sufficient_cost`.
    """
    system = optimum.segments.system
    lower = np.where(is_fixed, theta, system.parameters.lower)
    upper = np.where(is_fixed, theta, system.parameters.upper)
    constrained = replace(system, parameters=replace(system.parameters, lower=lower, upper=upper))
    segments = replace(optimum.segments, system=constrained)
    point = replace(optimum.point, theta=np.clip(theta, lower, upper))
    return anneal(segments, point, optimum.scales, _tightened(optimum.q, sufficient_cost), loss=optimum.loss)


def _motion_with(optimum: Optimum, theta: Floats, *, sufficient_cost: float) -> AnnealingFit:
    """As `_fitted_with` all parameters held; without them as unknowns where nothing is known of them beforehand."""
    segments, scales = optimum.segments, optimum.scales
    if segments.prior is not None or segments.system.shapes is not None:
        everything = np.ones(len(theta), dtype=bool)
        return _fitted_with(optimum, theta, everything, sufficient_cost=sufficient_cost)
    return anneal(
        replace(segments, system=segments.system.without_parameters(theta)),
        replace(optimum.point, theta=np.empty(0)),
        replace(scales, theta=scales.theta[len(theta) :]),
        _tightened(optimum.q, sufficient_cost),
        loss=optimum.loss,
    )


def _tightened(q: float, sufficient_cost: float) -> AnnealingSchedule:
    """From loosened links to a relaxation, which ends early where the cost is surely above a sufficient one."""
    return AnnealingSchedule(
        initial_q=max(q, min(_LOOSENED * q, _LOOSEST)),
        final_q=q,
        tolerance=_PRECISION,
        max_steps=_STEPS,
        sufficient_cost=sufficient_cost,
    )
