"""Approximate answers: the estimates of laws that leave more than noise, over horizons from loose to tight.

Where laws are wrong by more than the noise, the likeliest relaxation is that of the best one-step predictor, over which a slow
motion tells hardly anything and what is missing goes into the coefficients. So the motion is held to the laws over longer and
longer horizons. The answer is that of the loosest horizon from which on the coefficients hardly move: the values of this form
of the laws that come closest over motion like that of the records (White, Econometrica 50, 1982). Its standard errors are
those of the scores of separate blocks of the records at the common optimum, and hold the change to the tighter horizons.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.noise import evidence
from linkwise.likelihood.search import BLOCKS, block_scores, blocks_of_scatter
from linkwise.likelihood.shooting.minimise import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.runtime import one_blas_thread

_REACH = {10.0: 1, 3.0: 1, 1.0: 1, 0.3: 2, 0.1: 4, 0.03: 7, 0.01: 27}
"""How many segments the error of a state reaches at each relaxation, as measured with an oscillator of 10 Hz."""

_INDEPENDENT = 2  # times that reach: the shortest block whose neighbours do not share its errors
_FLAT = 0.5  # of its standard error: what a coefficient moves by to the next horizon where the path is flat
_LARGEST = 2.0  # of its standard error: what it moves by where no interval can hold what tighter horizons would change
_LOOSE = 1.0  # the loosest relaxation of laws that were fitted as exact: near it scatter is least, and blocks are independent
_STEPS = 60  # of a search, which starts at the optimum of the looser horizon


@dataclass(frozen=True, eq=False)
class _Horizon:
    """The optimum at a relaxation, with the covariance (P, P) of all unknowns by blocks and the factor on the noise."""

    fit: AnnealingFit
    covariance: Floats
    noise: float

    def deviations(self, parameters: int) -> Floats:
        return np.sqrt(np.maximum(self.covariance.diagonal()[:parameters], 0.0))


def over_horizons(fit: LikelihoodFit) -> LikelihoodFit | None:
    """The approximate answer of laws that leave more than noise.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that converged.

    Returns
    -------
    LikelihoodFit or None
        With the values, the motion and the covariance of the loosest horizon from which on the path is flat, or of that which
        the next one moves least. None where the path is flat nowhere, where the records are too short for blocks, and beside
        random forces, which let the motion forget as a relaxation does.
    """
    if fit.optimum.segments.random is not None:
        return None
    p, path = len(fit.values), list(_path(fit))
    moves = [_largest_move(before, after, p) for before, after in pairwise(path)]
    if not moves or min(moves) > _LARGEST:
        return None
    chosen = next((number for number, move in enumerate(moves) if move <= _FLAT), int(np.argmin(moves)))
    later = [horizon.fit.point.theta - path[chosen].fit.point.theta for horizon in path[chosen + 1 :]]
    return _at(fit, path[chosen], np.max(np.square(later), axis=0))


def _largest_move(before: _Horizon, after: _Horizon, parameters: int) -> float:
    """How far the parameter moves most from a horizon to the next, in its standard errors; those at bounds have none."""
    deviations, moved = before.deviations(parameters), after.fit.point.theta - before.fit.point.theta
    free = deviations > 0.0
    return float(np.max(np.abs(moved[free]) / deviations[free], initial=0.0))


def _path(fit: LikelihoodFit) -> Iterator[_Horizon]:
    """The optima at tighter and tighter relaxations, from the likeliest one on, as long as they are found and have blocks."""
    optimum, point = fit.optimum, fit.optimum.point
    exact = optimum.q <= AnnealingSchedule.final_q
    loosest = _LOOSE if exact else optimum.q
    tighter = {q: reach for q, reach in _REACH.items() if q < loosest}
    for q, reach in [(loosest, 1), *tighter.items()]:
        if optimum.segments.count < _INDEPENDENT * reach * BLOCKS[0]:
            return
        found = optimum_at(replace(optimum, point=point), q, _STEPS)
        if found.status is not AnnealingStatus.CONVERGED:
            return
        horizon = _by_blocks(optimum, found)
        if horizon is None:
            return
        point = found.point
        yield horizon


def optimum_at(optimum: Optimum, q: float, steps: int) -> AnnealingFit:
    """The search at a relaxation, from an optimum at another one."""
    schedule = AnnealingSchedule(initial_q=q, final_q=q, max_steps=steps)
    return anneal(optimum.segments, optimum.point, optimum.scales, schedule, loss=optimum.loss)


@np.errstate(over="ignore", invalid="ignore")  # what is not finite is no horizon
def _by_blocks(optimum: Optimum, found: AnnealingFit) -> _Horizon | None:
    """The optimum with its covariance by blocks; None where that is not finite."""
    segments = optimum.segments
    if blocks_of_scatter(segments) == 1:
        return None
    with one_blas_thread():
        noise, _ = evidence(segments, found, found.q, optimum.loss)
        scores = block_scores(segments, found.misfit, found.scales, optimum.loss, found.q, BLOCKS[0])
    if scores is None:
        return None
    free, ratios = ~found.at_bound, np.ones(len(found.covariance))
    chosen = np.flatnonzero(free)
    try:
        inverse = np.linalg.inv(scores.information.sum(axis=0)[np.ix_(chosen, chosen)])
        by_blocks = [scores.merged(blocks).by_scores(free)[chosen] for blocks in BLOCKS]
    except np.linalg.LinAlgError:
        return None
    white = noise * np.sqrt(np.maximum(inverse.diagonal(), np.finfo(float).tiny))
    ratios[chosen] = np.maximum(np.max(by_blocks, axis=0) / white, 1.0)
    covariance = noise**2 * found.covariance * np.outer(ratios, ratios)
    return _Horizon(found, covariance, noise) if np.isfinite(covariance).all() else None


def _at(fit: LikelihoodFit, horizon: _Horizon, moved: Floats) -> LikelihoodFit:
    """The fit at a horizon; `moved` (p,) are squares of the changes of the parameters to tighter horizons."""
    found, p = horizon.fit, len(fit.values)
    return replace(
        fit,
        values=found.point.theta,
        covariance=horizon.covariance[:p, :p] + np.diag(moved),
        free=~found.at_bound[:p],
        misfit=found.misfit,
        optimum=replace(
            fit.optimum, point=found.point, q=found.q, noise=horizon.noise, coloured=None, of_white=None
        ),
    )
