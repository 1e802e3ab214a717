"""The effect of missing terms, and of small errors of sensors, on the coefficients, where a model error stands for them.

The coefficients of a law that lacks a term make up for it, as far as they can, and do so alike in all parts of a record: no
scatter of blocks shows. Here terms are added to the linearised equations one at a time, always the one that explains most of
what those before it leave, while what it gains is significant; after those the few that laws lack most often, while they are
farther from zero than their standard error: laws that are known to be wrong may well lack them, and coefficients that
resemble them make up for many times their score. With values c_D of the terms D so found the coefficients move by G c_D, and
G c_D c_D' G' is added to their covariance: the second moment of the c_D about the zero that the laws as stated give them, as
for terms that a discovery dropped (Berk et al., Ann. Statist. 41, 2013). Errors of sensors and inputs that the diagnosis
names are added with the terms, where they would move coefficients by no more than the intervals can hold.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.diagnosis import least_gain
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.hypotheses import (
    BETWEEN_MODES,
    Hypothesis,
    missing_forces,
    which_between_modes,
    which_usual,
)
from linkwise.likelihood.memory_forces import MEMORY_TERMS, PRICE_OF_REACH
from linkwise.likelihood.score_test import augmented_quadratic, candidate_forces
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.single_tests import single_tests
from linkwise.likelihood.tested_causes import TestedCauses
from linkwise.model.structure import Structure
from linkwise.runtime import one_blas_thread

_SINGULAR = 1e-12
_MOST = 6  # significant terms; of more, each makes a small part of what the first ones do
_MOST_USUAL = 24  # usual terms after them; those of more links are as many decisions
_LIKELY = 1.0
"""Standard errors from zero beyond which usual terms are counted: as for a term of a regression (Theil 1961), those that are
nearer to zero than their own error say no more of the coefficients than their absence does."""

_HINT = 2.5
"""A normal score, on either side, beyond which intervals of exact laws hold a usual term: one in 80 by chance, so that nearly
all stay as they are. To hold what terms with a smaller score may do, all would have to be several times as wide."""

_POWERS = ("d**3", "d**5")
_HINT_OF_POWER = 2.0
"""The same of a power of the elongation: one in 22 by chance. What the coefficients make up for it depends on the amplitude:
those of 10 s of random motion differ from those of an endless record by about as many standard errors as the score says, and
beside missing damping by a third of that. Of several powers each has a higher limit, as chance gives more of them."""


@dataclass(frozen=True, eq=False)
class MissingTerms:
    """The `covariance` (p, p), in SI units, that missing terms, missing links and errors add to that of the coefficients.

    `counted` are those added, the likeliest first, and `moves` (p, c) what each makes of the coefficients beside the others;
    `unexplained` are links with terms, and pairs of masses with forms, that are still significant beside them.
    """

    counted: tuple[Hypothesis, ...]
    moves: Floats
    unexplained: frozenset[tuple[str, str]]

    @property
    def covariance(self) -> Floats:
        moved = self.moves.sum(axis=1)
        return np.outer(moved, moved)


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def for_missing_terms(
    fit: LikelihoodFit,
    identified: Structure,
    tested: TestedCauses | None = None,
    errors: Collection[Cause] = (),
) -> MissingTerms | None:
    """What missing terms of links, missing links and named errors add to the covariance of the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit with a model error.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses or None
        What was tested at this fit, all terms among it; only terms and links are tested here without it.
    errors : collection of Cause
        The errors of sensors, masses and inputs among these that are added with the terms.

    Returns
    -------
    MissingTerms or None
        None where no term explains what the laws leave.
    """
    if tested is not None:
        named = {(error.kind, error.where, error.source) for error in errors}
        numbers = [
            number
            for number, hypothesis in enumerate(tested.hypotheses)
            if hypothesis.kind in ("term", "link")
            or (hypothesis.kind, hypothesis.where, hypothesis.source) in named
        ]
        among = _among(tested, numbers, len(fit.values))
        return _counted(fit, *among, _rounds(among[0], identified))
    optimum = fit.optimum
    hypotheses, forces = missing_forces(identified, optimum.segments.system.parameters.names)
    try:
        with one_blas_thread():
            misfit = evaluate(optimum.segments, optimum.point, optimum.scales, optimum.loss)
            candidates, _ = candidate_forces(optimum, misfit, forces)
            quadratic = augmented_quadratic(optimum, misfit, candidates)
    except np.linalg.LinAlgError:
        return None
    return _counted(fit, hypotheses, quadratic.curvature, quadratic.slope, _rounds(hypotheses, identified))


def usual_scores(fit: LikelihoodFit, identified: Structure, tested: TestedCauses) -> Floats:
    """(u,) normal scores of the usual terms among what was `tested`, without sign; 0 of those that cannot be told.

    They are tested one at a time, all coefficients fitted anew to first order.
    """
    return np.sqrt(_gains_of(tested, which_usual(tested.hypotheses, identified))) / fit.optimum.noise


def for_usual_terms(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses, *, doubted: bool
) -> MissingTerms | None:
    """What usual terms, none of them significant, add to the covariance of a fit that leaves only noise; None if none does.

    Damping between modes of hosts counts as one. Those at which the residuals hint; where it is `doubted` that the laws are
    exact, those of one link that are farther from zero than their standard error, of more links fewer, as chance gives more of
    them (Foster and George, Ann. Statist. 22, 1994).
    """
    usual = which_usual(tested.hypotheses, identified)
    between = which_between_modes(tested.hypotheses)
    if not (usual or between):
        return None
    links = max(len({tested.hypotheses[number].where for number in usual}), 1)
    hypotheses = [tested.hypotheses[number] for number in usual + between]
    least = _hints(hypotheses)
    if doubted:
        least = np.minimum(_LIKELY**2 + 2.0 * np.log(links), least)
    limits = least + _prices(hypotheses)
    if not np.any(_gains_of(tested, usual + between) > limits * fit.optimum.noise**2):
        return None
    among = _among(tested, usual + between, len(fit.values))
    return _counted(fit, *among, [(limits, _MOST_USUAL if doubted else _MOST)])


@np.errstate(over="ignore", invalid="ignore")  # a candidate may be infinite somewhere; it is then not taken
def _counted(
    fit: LikelihoodFit,
    hypotheses: Sequence[Hypothesis],
    curvature: Floats,
    slope: Floats,
    rounds: Sequence[tuple[Floats, int]],
) -> MissingTerms | None:
    """The terms that are added one at a time, each the likeliest beside those before it.

    In each round those that gain more than its limits (h,), up to a number.
    """
    optimum, p = fit.optimum, len(fit.values)
    scale = 1.0 / np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    curvature, slope = curvature * np.outer(scale, scale), slope * scale
    order, added = np.arange(len(slope)), 0
    for least, at_most in rounds:
        most = min(added + at_most, len(hypotheses))
        while added < most:
            beyond = _beyond(curvature, slope, order, p + added) / optimum.noise**2
            excess = np.where(beyond > least[order[p + added :] - p], beyond, 0.0)
            if not excess.any():
                break
            position, best = p + added, int(np.argmax(excess))
            order[[position, position + best]] = order[[position + best, position]]
            added += 1
    if not added:
        return None
    own, terms = order[:p], order[p : p + added]
    both = order[: p + added]
    values = np.linalg.lstsq(curvature[np.ix_(both, both)], slope[both], rcond=_SINGULAR)[0][p:]
    follow = curvature[np.ix_(own, own)], curvature[np.ix_(own, terms)]
    moves = np.linalg.lstsq(*follow, rcond=_SINGULAR)[0] * values
    moves = np.where(fit.free[:, None], moves * (scale[:p] * optimum.scales.theta[:p])[:, None], 0.0)
    significant = _beyond(curvature, slope, order, p + added) / optimum.noise**2 > rounds[0][0][0]
    beside = (hypotheses[number - p] for number in order[p + added :][significant].tolist())
    return MissingTerms(
        moves=moves,
        counted=tuple(hypotheses[number - p] for number in terms.tolist()),
        unexplained=frozenset((hypothesis.where, hypothesis.term) for hypothesis in beside),
    )


def _rounds(hypotheses: Sequence[Hypothesis], identified: Structure) -> list[tuple[Floats, int]]:
    """First significant terms, then likely usual ones."""
    significant = np.full(len(hypotheses), least_gain(len(hypotheses)))
    likely = significant.copy()
    usual = which_usual(hypotheses, identified)
    likely[usual] = _LIKELY**2 + _prices(hypotheses)[usual]
    return [(significant, _MOST), (likely, _MOST_USUAL)]


def _hints(hypotheses: Sequence[Hypothesis]) -> Floats:
    """(h,) what each gains at least where the residuals of exact laws hint at it."""
    powers = np.array([hypothesis.term in _POWERS for hypothesis in hypotheses])
    of_power = _HINT_OF_POWER**2 + 2.0 * np.log(max(int(np.count_nonzero(powers)), 1))
    return np.asarray(np.where(powers, min(of_power, _HINT**2), _HINT**2))


def _prices(hypotheses: Sequence[Hypothesis]) -> Floats:
    """(h,) what each gains by chance beside its size: a force with memory has a reach as well.

    Beside a stiff link it hardly differs from a damper, whose interval it would make many times as wide. Damping between
    modes is one of many pairs.
    """
    pairs = sum(hypothesis.kind == BETWEEN_MODES for hypothesis in hypotheses)
    of_pair = 2.0 * float(np.log(max(pairs, 1)))
    return np.array(
        [
            of_pair
            if hypothesis.kind == BETWEEN_MODES
            else PRICE_OF_REACH * (hypothesis.term in MEMORY_TERMS)
            for hypothesis in hypotheses
        ]
    )


def _gains_of(tested: TestedCauses, numbers: Sequence[int]) -> Floats:
    """What each of some hypotheses alone would take off the cost; 0 of those that cannot be told."""
    gains = tested.tests.gains[np.array(numbers, dtype=int)]
    return np.where(np.isfinite(gains), gains, 0.0)


def _beyond(curvature: Floats, slope: Floats, order: NDArray[np.intp], counted: int) -> Floats:
    """What each of the columns after those `counted` would take off the cost beside them."""
    among = np.ix_(order, order)
    gains = single_tests(curvature[among], slope[order], curvature[among], counted).gains
    return np.where(np.isfinite(gains), gains, 0.0)


def _among(
    tested: TestedCauses, numbers: Sequence[int], parameters: int
) -> tuple[list[Hypothesis], Floats, Floats]:
    """The hypotheses of these `numbers`; curvature and slope in the `parameters` and their sizes, scaled."""
    order = [*range(parameters), *(parameters + number for number in numbers)]
    hypotheses = [tested.hypotheses[number] for number in numbers]
    return hypotheses, tested.curvature[np.ix_(order, order)], tested.slope[order]
