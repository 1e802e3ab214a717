"""Approximate answers: the estimates of laws that leave more than noise, over horizons from loose to tight.

Where laws are wrong by more than the noise, the likeliest relaxation is that of the best one-step predictor, over which a slow
motion tells hardly anything and what is missing goes into the coefficients. So the motion is held to the laws over longer and
longer horizons. The answer is that of the loosest horizon from which on the coefficients hardly move: the values of this form
of the laws that come closest over motion like that of the records (White, Econometrica 50, 1982). Its standard errors are
those of the scores of separate blocks of the records at the common optimum, and hold the change to the tighter horizons and
that from the one before, as where the first of several is flat is partly luck. They may be less than white noise would give:
a force that does no work over a period leaves a damping alone.

What a model error or noise of an input hides: a missing term that explains most of what is left without it, or a change.

A model error lets the motion forget, and with it what a small term does over many periods: a score test beside the model error
is silent on friction that would change a damping by ten standard errors. Held ten times closer, the laws leave more than that.
Where one term would explain most of that, they lack it, and where a change of one coefficient would, it changes; an error
that is random leaves what neither explains. Noise of an input lets the motion forget likewise, and is found where there is
none; the motion is held closer with a tenth of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import format_both
from linkwise.estimates.causes import Cause
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.marginal import is_long, relaxation
from linkwise.likelihood.noise import evidence
from linkwise.likelihood.search import BLOCKS, FEWEST, BlockScores, Optimum, blocks_of_scatter
from linkwise.likelihood.shooting.minimise import AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.segments import Prior
from linkwise.likelihood.tests.diagnosis import Diagnosis, diagnose
from linkwise.model.coefficient import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel

_REACH = {10.0: 1, 3.0: 1, 1.0: 1, 0.3: 2, 0.1: 4, 0.03: 7, 0.01: 27}
"""How many segments the error of a state reaches at each relaxation, as measured with an oscillator of 10 Hz."""

_INDEPENDENT = 2  # times that reach: the shortest block whose neighbours do not share its errors
_FLAT = 0.5  # of its standard error: what a coefficient moves by to the next horizon where the path is flat
_LARGEST = 2.0  # of its standard error: what it moves by where no interval can hold what tighter horizons would change
_LOOSE = 1.0  # the loosest relaxation of laws that were fitted as exact: near it scatter is least, and blocks are independent
_STEPS = 60  # of a search, which starts at the optimum of the looser horizon


def over_horizons(fit: LikelihoodFit) -> LikelihoodFit | str:
    """The approximate answer of laws that leave more than noise.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that converged.

    Returns
    -------
    LikelihoodFit or str
        With the values, the motion and the covariance of the loosest horizon from which on the path is flat, or of that which
        the next one moves least; of the likeliest one where beside longer ones blocks are too short. A sentence on why there
        is none where the path is flat nowhere or the records are too short for blocks; an empty one beside random forces,
        which let the motion forget as a relaxation does.
    """
    if fit.optimum.segments.random is not None:
        return ""
    if blocks_of_scatter(fit.optimum.segments) == 1:
        longer = np.ceil(10.0 * FEWEST * BLOCKS[0] / fit.optimum.segments.count) / 10.0
        return (
            f"The record is too short to compare parts of it: take {longer:g} times as much of such motion, of several "
            "records together where one ends before."
        )
    path = _path(fit)
    moves = [_largest_move(before, after) for before, after in pairwise(path)]
    alone = path and not fit.noise_from_misfit and path[0].fit.optimum.q < _with_blocks(fit.optimum)[-1]
    if not (moves or alone):
        return (
            "No search over longer horizons ends: take a shorter part of the record, or state what is left."
        )
    if min(moves, default=0.0) > _LARGEST:
        return _turning(fit, path)
    least = int(np.argmin(moves)) if moves else 0
    chosen = next((number for number, move in enumerate(moves) if move <= _FLAT), least)
    answer = path[chosen].fit
    moved = [other.fit.values - answer.values for other in path[max(chosen - 1, 0) :]]
    return replace(answer, covariance=answer.covariance + np.diag(np.max(np.square(moved), axis=0)))


def _turning(fit: LikelihoodFit, path: Sequence[_Horizon]) -> str:
    """What the horizon changes most, of which no interval can be given."""
    deviations = np.maximum(path[0].deviations, 1e-150)
    loose, tight = path[0].fit.values, path[-1].fit.values
    most = int(np.argmax(np.abs(tight - loose) / deviations * fit.free))
    first, last = (format_both(values[most], deviations[most])[0] for values in (loose, tight))
    name = fit.names[most]
    return (
        f"{name} is {first} over short horizons and {last} over long ones, which no interval holds: hold it at a known value, "
        "or take a part of the record over which it is the same."
    )


@dataclass(frozen=True, eq=False)
class _Horizon:
    """The fit at one horizon, and the standard errors (p,) by blocks, or by white noise where these are larger.

    Below the latter a coefficient moves from one horizon to the next by chance.
    """

    fit: LikelihoodFit
    deviations: Floats


def _largest_move(before: _Horizon, after: _Horizon) -> float:
    """How far the parameter moves most from a horizon to the next, in its standard errors; those at bounds have none."""
    moved = after.fit.values - before.fit.values
    free = before.deviations > 0.0
    return float(np.max(np.abs(moved[free]) / before.deviations[free], initial=0.0))


def _path(fit: LikelihoodFit) -> list[_Horizon]:
    """The optima at tighter and tighter relaxations, from the likeliest one on, as long as they are found and have blocks.

    Those of a fit of exact laws beside the noise that they leave are sought from there, at looser and looser ones: over short
    horizons a record may not tell what it does over long ones, as the motion of many modes by few sensors.
    """
    relaxations = _with_blocks(fit.optimum)
    if fit.noise_from_misfit:
        exact = _Horizon(fit, np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0)))
        return [exact, *_followed(fit, [q for q in reversed(relaxations) if q <= _LOOSE])][::-1]
    loosest = _LOOSE if fit.optimum.q <= AnnealingSchedule.final_q else fit.optimum.q
    return _followed(fit, [loosest, *(q for q in relaxations if q < loosest)])


def _followed(fit: LikelihoodFit, relaxations: Iterable[float]) -> list[_Horizon]:
    """The fits at relaxations, each searched from the one before, as long as they are found."""
    path, optimum = list[_Horizon](), fit.optimum
    for q in relaxations:
        found = optimum.searched(q, _STEPS)
        there = _by_blocks(fit, found) if found.status is AnnealingStatus.CONVERGED else None
        if there is None:
            break
        path.append(there)
        optimum = there.fit.optimum
    return path


def _with_blocks(optimum: Optimum) -> list[float]:
    """The relaxations, loose ones first, beside whose reach blocks are long."""
    longest = optimum.segments.count / (_INDEPENDENT * BLOCKS[0])
    return [q for q, reach in _REACH.items() if reach <= longest]


@np.errstate(over="ignore", invalid="ignore")  # what is not finite is no horizon
def _by_blocks(fit: LikelihoodFit, found: AnnealingFit) -> _Horizon | None:
    """The fit where a search ended, with its covariance by blocks; None where that is not finite.

    Of what hardly more than one block tells, blocks do not say that it is known better than by white noise; nor of anything
    where some of it is known beforehand, which the rest follows.
    """
    optimum = replace(fit.optimum, misfit=found.misfit, q=found.q, coloured=None, of_white=None)
    if blocks_of_scatter(optimum.segments) == 1:
        return None
    noise, _ = evidence(found)
    scores = optimum.block_scores(BLOCKS[0])
    if scores is None:
        return None
    try:
        ratios = scores.ratios(~found.at_bound, noise, BlockScores.by_scores)
        told = scores.told(~found.at_bound)
        white = _with_noise(found, noise, optimum.segments.prior)
    except np.linalg.LinAlgError:
        return None
    if (prior := optimum.segments.prior) is not None:
        told &= np.isinf(prior.deviation).all()
    ratios = np.where(told, ratios, np.maximum(ratios, 1.0))
    covariance = white * np.outer(ratios, ratios)
    if not np.isfinite(covariance).all():
        return None
    there = fit.at(replace(optimum, noise=noise), found, covariance)
    larger = np.sqrt(np.maximum(np.maximum(covariance, white).diagonal(), 0.0))
    return _Horizon(there, larger[: len(there.values)])


def _with_noise(found: AnnealingFit, noise: float, prior: Prior | None) -> Floats:
    """(p, p) covariance by the noise that was found, which makes what is known of parameters beforehand no better or worse."""
    covariance = noise**2 * found.covariance
    if prior is None:
        return covariance
    deviations = np.sqrt(covariance.diagonal())
    free = np.flatnonzero(deviations > 0.0)
    scale, known = np.outer(deviations[free], deviations[free]), deviations[free] / prior.deviation[free]
    precision = np.linalg.inv(covariance[np.ix_(free, free)] / scale)
    precision[np.diag_indices(len(free))] += (1.0 - noise**-2) * known**2
    covariance[np.ix_(free, free)] = np.linalg.inv(precision) * scale
    return covariance


_CLOSER = (0.1, 0.3)  # times the relaxation that stands for the model error, or the noise of inputs
# the same of long records, which were not held more closely because no search leads straight there
_CLOSER_IF_LONG = (0.3,)
_STEPS_CLOSER = 40
_MOST = 0.5  # of what is left there


@dataclass(frozen=True, eq=False)
class CloserFit:
    """A `fit` whose motion is held closer to the laws than another: by how much more it leaves in -2 log likelihood, `left`,
    and the `diagnosis` of that.
    """

    fit: LikelihoodFit
    left: float
    diagnosis: Diagnosis

    def explains_most(self, gain: float) -> bool:
        """Whether what lowers -2 log likelihood by a `gain` explains most of what is left."""
        return gain > _MOST * self.left


def held_closer(fit: LikelihoodFit, identified: Structure, channels: Sequence[Channel]) -> CloserFit | None:
    """The fit with its motion held closer to the laws, and what explains what they leave there.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit with a model error, with noise of inputs, or whose links between segments were loosened.
    identified : Structure
        The structure with the values of the fit.
    channels : sequence of str
        The channels of the record.

    Returns
    -------
    CloserFit or None
        The closer fit; None where the motion cannot be held closer.
    """
    optimum = fit.optimum
    exact = not fit.random_forces and optimum.q <= AnnealingSchedule.final_q
    if exact or optimum.coloured is not None or any(force.ambient for force in fit.random_forces):
        return None
    for factor in _CLOSER_IF_LONG if is_long(optimum.segments) else _CLOSER:
        tight = _tightened(optimum, factor)
        closer = tight.searched(tight.q, _STEPS_CLOSER)
        if closer.status in (AnnealingStatus.INTERRUPTED, AnnealingStatus.CONVERGED):
            break
    left = (closer.misfit.cost(closer.q) - fit.misfit.cost(optimum.q)) / optimum.noise**2
    if closer.status is not AnnealingStatus.CONVERGED or not np.isfinite(left):
        return None
    closest = fit.at(tight, closer, optimum.noise**2 * closer.covariance)
    there = identified.with_values(closest.by_name)
    return CloserFit(closest, left, diagnose(closest, there, channels, terms=True))


def _tightened(optimum: Optimum, factor: float) -> Optimum:
    """From where the motion is to be held closer: with the relaxation, or the noise of inputs, times a factor."""
    segments, random = optimum.segments, optimum.segments.random
    if random is None:
        return replace(optimum, q=max(factor * optimum.q, AnnealingSchedule.final_q))
    quieter = replace(random.scaled(np.full(len(random.rows), factor)), slope=None, origin=None)
    misfit = replace(optimum.misfit, segments=replace(segments, random=quieter))
    return replace(optimum, misfit=misfit, q=relaxation(misfit))


def hidden_term(fit: LikelihoodFit, closer: CloserFit) -> tuple[Cause, float, float] | None:
    """The missing term, or error of a mass, that explains most of what the laws leave in a fit held `closer` than `fit`.

    With that by how much of its value it would change the coefficient that it changes most, and in standard errors of `fit`.
    """
    causes = closer.diagnosis.causes
    if not causes or causes[0].kind not in ("term", MASS) or not closer.explains_most(causes[0].gain):
        return None
    change, shift = 0.0, 0.0
    if causes[0].shifted:
        number = fit.names.index(causes[0].shifted)
        error = float(np.sqrt(closer.fit.covariance[number, number]))
        changed, tiny = causes[0].shift * error, np.finfo(float).tiny
        change = changed / max(abs(float(fit.values[number])), tiny)
        shift = changed / max(float(np.sqrt(fit.covariance[number, number])), tiny)
    return causes[0], change, shift
