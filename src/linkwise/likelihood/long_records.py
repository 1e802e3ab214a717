"""The search in a long record of few masses: in pieces first, then of all together, from loose links to tight ones.

A search that tightens the links between segments quickly creeps in a long chaotic record. Somewhere in it the motion comes
close to where neighbouring motions part, and there the likelihood of exact laws has many optima: each of a hundred thousand
samples has its own such places, the damping that one of them needs holds back all others, and where the search ends is one
optimum of many. With looser links the motion forgets before that happens. The coefficients are found in some pieces with such
links first, the states of all pieces by these coefficients, one piece independent of the others, and everything by steps
together, which few links at a time are tightened for. The tightest links are taken at which the steps lead straight to an
optimum, around which the cost rises as the covariance says, and which looser links do not contradict: of two estimates, one
of which uses more of the same data, the difference has the covariance of the one less that of the other.

References
----------
J. A. Hausman, Econometrica 46, 1251 (1978), for the test of two relaxations.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.marginal import parts_of
from linkwise.likelihood.shooting.anneal import (
    Annealer,
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    anneal,
)
from linkwise.likelihood.shooting.damped_step import bounds, freedom
from linkwise.likelihood.shooting.joint_search import JointEnd, JointSearch
from linkwise.likelihood.shooting.linear_model import covariance
from linkwise.likelihood.shooting.loss import Loss
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.pieces import InCaller, piece_ends
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.shooting.settled_states import with_held_parameters
from linkwise.progress import ProgressReport, part, silent
from linkwise.runtime import one_blas_thread, processors

_LONG = 16_000  # segments: of fewer most searches lead straight to exact laws
_LOOSE = AnnealingSchedule(
    initial_q=0.1, final_q=1e-3, smallest_factor=0.01, trust_per_sample=10.0
)  # of single pieces, in which coefficients and states are found
_OVERLAP = 400  # segments by which pieces overlap while they are searched alone: what their ends do is forgotten there
_RUNGS = (1e-3, 3e-4, 1e-4, 3e-5, AnnealingSchedule.final_q)
_PASSED = (3e-4, 3e-5)  # of these: where the next one follows in any case
_TRIED = 3e-5  # from which on parts of the record are searched before the whole
_PARTS, _PART = 3, 20_000  # of these at most, which take half of the record at most, and segments in each
_ROUGHLY, _CLOSELY = 1.0, 0.1  # standard errors that the last step may change an unknown by
_STEPS = 8  # at each of them; a search that takes more does not lead straight
_EXCESS = 0.08  # of the noise, in power, that laws may leave
_CHANCE = 1e-3  # probability of a larger difference between two relaxations by chance
_DISTANCE = 2.0  # standard errors: where the rise of the cost is looked at
_FACTOR = 2.0  # by which it may differ from the prediction
# of -2 log of the marginal likelihood: more than rounding and the error of Laplace's approximation
_WORSE = 2.0
_LEAST_VARIANCE = 0.05  # that tighter links add, of that of an unknown: more than rounding
_FIRST, _SECOND = 0.1, 0.6  # of the work: done with the coefficients, and the states, of single pieces
_SEED = 20261126


def is_long(segments: Segments) -> bool:
    """Whether a record is searched in pieces: many segments, few masses, and no unknowns but coefficients and states.

    Parameters
    ----------
    segments : Segments
        The record in segments.

    Returns
    -------
    bool
        Whether it is.
    """
    system, sensors = segments.system, segments.sensors
    return (
        segments.count >= _LONG
        and len(system.incidence) < MANY
        and system.dimension == 2 * len(system.incidence)
        and system.parameters.size > 0
        and system.shapes is None
        and segments.random is None
        and segments.clipped is None
        and sensors.unknowns == 0
    )


def search_in_pieces(
    segments: Segments, start: Iterate, scales: Scales, annealer: Annealer, limit: float
) -> AnnealingFit | None:
    """The optimum of a long record at the tightest links that lead to it straight.

    Parameters
    ----------
    segments : Segments
        The record, of which `is_long` holds.
    start : Iterate
        The unknowns to start from.
    scales : Scales
        Their units.
    annealer : Annealer
        How annealing runs.
    limit : float
        By how much chi-square may exceed 1.

    Returns
    -------
    AnnealingFit or None
        The fit, whose path is that of its last relaxation; None where laws leave more than noise, an unknown is at a bound, or
        the search did not lead to an optimum, so that another one has to look for it.
    """
    some, _ = parts_of(segments)
    of_some = replace(start, nodes=start.nodes[:, some])
    early = replace(annealer, progress=part(annealer.progress, 0.0, _FIRST))
    first = early(segments.chosen(some), of_some, scales, _LOOSE)
    point = replace(start, theta=first.point.theta)
    if first.status is AnnealingStatus.INTERRUPTED:
        return _fit_at(_RUNGS[0], segments, point, scales, annealer.loss, first.covariance)
    if first.at_bound.any() or not first.chi_square < 1.0 + limit:  # of a start no more is asked
        return None
    try:
        point = _with_states(segments, point, scales, annealer)
        search = JointSearch(segments, scales, annealer.loss, annealer.executor, annealer.progress)
        rungs = _tightened(search, point, 1.0 + limit)
        if rungs and rungs[-1].end.interrupted:
            return rungs[-1].fit(annealer.loss)
        return next((rung.fit(annealer.loss) for rung in reversed(rungs) if rung.is_quadratic(search)), None)
    except KeyboardInterrupt:
        return _fit_at(_RUNGS[0], segments, point, scales, annealer.loss, first.covariance)


def held_at(segments: Segments, start: Iterate, scales: Scales, loss: Loss, q: float) -> AnnealingFit | None:
    """The optimum of a long record at a relaxation.

    Parameters
    ----------
    segments : Segments
        The record, of which `is_long` holds.
    start : Iterate
        The unknowns to start from, with states close to the motion.
    scales : Scales
        Their units.
    loss : Loss
        Loss of a residual.
    q : float
        The relaxation.

    Returns
    -------
    AnnealingFit or None
        The fit; None where the search does not lead straight to it.
    """
    with one_blas_thread(), ThreadPoolExecutor(processors()) as executor:
        search = JointSearch(segments, scales, loss, executor)
        if not _leads_on_in_parts(search, start, [q]):
            return None
        end = search.at(q, start, little=_CLOSELY, most=_STEPS)
    if end is None or not (end.straight or end.interrupted):
        return None
    return _Rung(end, segments, scales, loss.expected).fit(loss)


def _with_states(segments: Segments, point: Iterate, scales: Scales, annealer: Annealer) -> Iterate:
    """The point with the states of each piece found alone, its parameters held."""
    nodes, ends = np.empty_like(point.nodes), piece_ends(segments.linked)
    ends[-1] += 1

    @np.errstate(over="ignore", invalid="ignore")  # threads do not share the error state of the caller
    def work(number: int) -> Floats:
        first, last = max(0, ends[number] - _OVERLAP), min(segments.count, ends[number + 1] + _OVERLAP)
        of_piece = replace(point, nodes=point.nodes[:, first:last])
        known = with_held_parameters(segments.chosen(np.arange(first, last)), of_piece, scales)
        fit = anneal(*known, _LOOSE, loss=annealer.loss, executor=InCaller())
        return fit.point.nodes[:, ends[number] - first : ends[number + 1] - first]

    pieces = len(ends) - 1
    progress = part(annealer.progress, _FIRST, _SECOND)
    for number, own in enumerate(annealer.executor.map(work, range(pieces))):
        nodes[:, ends[number] : ends[number + 1]] = own
        progress(ProgressReport((number + 1) / pieces, f"states, piece {number + 1} of {pieces}"))
    return replace(point, nodes=nodes)


def _tightened(search: JointSearch, point: Iterate, most: float) -> list[_Rung]:
    """The rungs that the search reaches straight; the last one may be where the keyboard interrupted it.

    None is left where one says that the laws are not exact: by more cost than `most` for a degree of freedom, or, of the first
    two, by values that contradict each other or a likelihood that falls. That has to be told from a model error then. Of
    tighter ones the same is a sign of another optimum.
    """
    rungs: list[_Rung] = []
    for q in _RUNGS:
        if q == _TRIED and not _leads_on_in_parts(search, point, _RUNGS[_RUNGS.index(q) :]):
            break
        passed = q in _PASSED
        end = search.at(q, point, little=_ROUGHLY if passed else _CLOSELY, most=_STEPS)
        if end is None:
            break
        rung = _Rung(end, search.segments, search.scales, search.loss.expected)
        if end.interrupted:
            return [*rungs, rung]
        if not end.straight:
            break
        if not (rung.chi_square < most and rung.is_free):
            return []
        if rungs and not rung.agrees_with(rungs[-1]):
            return rungs if len(rungs) > 1 else []
        point = end.point
        if not passed:
            rungs.append(rung)
    return rungs


def _leads_on_in_parts(search: JointSearch, start: Iterate, rungs: Sequence[float]) -> bool:
    """Whether tighter links lead straight on in some parts of the record, or whether it is too short for parts."""
    count = search.segments.count
    parts = min(_PARTS, count // (2 * _PART))
    for first in np.linspace(0, count - _PART, parts).astype(int).tolist():
        some = np.arange(first, first + _PART)
        in_part = replace(search, segments=search.segments.chosen(some), progress=silent)
        point = replace(start, nodes=start.nodes[:, some])
        for q in rungs:
            end = in_part.at(q, point, little=_ROUGHLY, most=_STEPS)
            if end is None or not end.straight:
                return False
            point = end.point
    return True


@dataclass(frozen=True, eq=False)
class _Rung:
    """Where the search ended at one relaxation, in `segments` with their `scales` and the `expected` cost of a residual."""

    end: JointEnd
    segments: Segments
    scales: Scales
    expected: float

    @cached_property
    def covariance(self) -> Floats:
        """(P, P) of the unknowns that all pieces share."""
        return covariance(self.end.factor, self.scales, np.ones(len(self.scales.theta), dtype=bool))

    @property
    def is_free(self) -> bool:
        """Whether no unknown is at a bound."""
        lower, upper = bounds(self.segments)
        border = self.end.point.border
        return bool(((border > lower) & (border < upper)).all())

    @property
    def chi_square(self) -> float:
        """Cost for a degree of freedom."""
        return self.end.cost / (freedom(self.segments) * self.expected)

    @property
    def evidence(self) -> float:
        """-2 log of the marginal likelihood, with the most likely factor on the noise."""
        segments = self.segments
        defects = segments.system.dimension * int(segments.linked.sum())
        nodes = segments.system.dimension * int((~segments.unconstrained).sum())
        known = 0 if segments.prior is None else segments.prior.count
        residuals = int(segments.observed.sum()) + known + defects - nodes - segments.parameters
        of_noise = residuals * np.log(self.end.cost / (residuals * self.expected))
        return float(of_noise + 2.0 * defects * np.log(self.end.q) + self.end.log_determinant)

    def agrees_with(self, looser: _Rung) -> bool:
        """Whether tighter links are as likely as looser ones, and change values by no more than they add to what is known."""
        if self.evidence > looser.evidence + _WORSE:
            return False
        change = self.end.point.border - looser.end.point.border
        size = np.sqrt(np.maximum(looser.covariance.diagonal(), np.finfo(float).tiny))
        added = (looser.covariance - self.covariance) / np.outer(size, size)
        variances, directions = np.linalg.eigh(added)
        square = np.sum((directions.T @ (change / size)) ** 2 / np.maximum(variances, _LEAST_VARIANCE))
        return bool(scipy.special.chdtrc(len(change), square) > _CHANCE)

    def is_quadratic(self, search: JointSearch) -> bool:
        """Whether the cost rises as the covariance predicts on both sides in a random direction."""
        try:
            root = np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            return False
        direction = np.random.default_rng(_SEED).normal(size=len(root))
        step = _DISTANCE * root @ direction / np.linalg.norm(direction)
        expected = _DISTANCE**2
        return any(
            all(1.0 / _FACTOR < rise / expected < _FACTOR for rise in rises)
            for rises in search.rises_beside(self.end, [step, -step])
        )

    def fit(self, loss: Loss) -> AnnealingFit:
        """The fit there."""
        end = self.end
        fit = _fit_at(end.q, self.segments, end.point, self.scales, loss, self.covariance)
        status = AnnealingStatus.INTERRUPTED if end.interrupted else AnnealingStatus.CONVERGED
        return replace(fit, status=status, path=end.path)


def _fit_at(
    q: float, segments: Segments, point: Iterate, scales: Scales, loss: Loss, covariance: Floats
) -> AnnealingFit:
    """A fit at a point and a relaxation, which the keyboard interrupted."""
    misfit = evaluate(segments, point, scales, loss)
    return AnnealingFit(
        point,
        misfit,
        q,
        scales,
        covariance,
        np.zeros(len(scales.theta), dtype=bool),
        misfit.cost_of_samples(q) / (freedom(segments) * loss.expected),
        int(segments.observed.sum()),
        AnnealingStatus.INTERRUPTED,
        (),
    )
