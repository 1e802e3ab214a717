"""Restarts of a fit whose starting states come from inverse dynamics.

A search that fails mostly started with part of the motion on a wrong branch of a law while its parameters are nearly right;
from these the states are computed again. A start of another kind competes with the first one.

Fits from several starts, where the likelihood may have several valleys: the lowest is kept, others as good are reported.

Where the misfits of starts do not tell which is best, searches of few steps put them in order, and longer ones that end where
they crawl follow, until one comes to the noise.

Fits of structures with hosts whose links have memory: from starts that free runs bring close to the records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.noise import ColouredNoise
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import SAMPLES
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.likelihood.starts.free_runs import FreeRuns, free_run_starts
from linkwise.likelihood.starts.memory import Valley, host_memory_starts
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, rising
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records

_ATTEMPTS = 3
_RELEVANT = 4.0  # of -2 log likelihood: what one more parameter lowers it by with a probability of 5 %
_TIED = 20.0  # of -2 log likelihood: two optima that near, with odds of 2e4 at most, are not told apart

_ALIKE = 4.0  # standard errors within which two fits are one


def _none(options: LikelihoodOptions, first: LikelihoodFit) -> None:
    """No start of another kind."""


class Search(Protocol):
    """`likelihood_fit` of some records and a structure."""

    def __call__(self, theta: Floats, *, options: LikelihoodOptions) -> LikelihoodFit: ...


def fit_with_restarts(
    fitted: Search,
    theta: Floats,
    options: LikelihoodOptions,
    *,
    another: Callable[[LikelihoodOptions, LikelihoodFit], LikelihoodFit | None] = _none,
) -> LikelihoodFit:
    """Fit up to three times, each time from the parameters of the fit before, until one converges with the expected noise.

    Parameters
    ----------
    fitted : Search
        The fit.
    theta : array of shape (p,)
        Starting values of the parameters.
    options : LikelihoodOptions
        The options; a model error is allowed only in a last fit from the best values.
    another : callable, optional
        Fits with options from a start of another kind, given the first fit; None where there is none. The likelier of both
        goes on, with the values of the other where they are as likely.

    Returns
    -------
    LikelihoodFit
        The first that converges with the expected noise, else the last; an interrupt ends the search.
    """
    best, start, nodes = None, theta, None
    strict = replace(options, model_error=False)
    for attempt in range(_ATTEMPTS):
        fit = fitted(start, options=strict)
        if attempt == 0 and not _interrupted(fit) and (rival := another(strict, fit)) is not None:
            chosen = rival if _interrupted(rival) else _likelier(fit, rival)
            nodes = rival.optimum.point.nodes if chosen.values is rival.values else None
            fit = chosen
        if _ends(fit):
            return fit
        if best is not None:
            if _gain(fit, best) < _RELEVANT:
                break
            nodes = None
        best, start = fit, fit.values
    last = options if nodes is None else replace(options, nodes=nodes)
    return fitted(theta if best is None else best.values, options=last)


def _likelier(fit: LikelihoodFit, rival: LikelihoodFit) -> LikelihoodFit:
    """The fit, or a rival that converged and is likelier by a relevant amount, with the values of the other if both may be."""
    if not _converged(rival):
        return fit
    if not _converged(fit):
        return rival
    gain = _gain(rival, fit)
    if not (_ends(fit) and _ends(rival)):
        return rival if gain > _RELEVANT else fit
    likely, rejected = (rival, fit) if gain > 0.0 else (fit, rival)
    if abs(gain) < _TIED and not _has_errors(likely) and _has_errors(rejected):
        likely, rejected = rejected, likely
    errors = np.sqrt(np.maximum(likely.covariance.diagonal(), 0.0))
    apart = np.abs(likely.values - rejected.values) > _ALIKE * errors
    return replace(likely, others=(rejected.values,)) if apart.any() and abs(gain) < _TIED else likely


def _has_errors(fit: LikelihoodFit) -> bool:
    """Whether rounding leaves standard errors to a fit."""
    return bool(np.isfinite(fit.covariance).all() and (fit.covariance.diagonal() >= 0.0).all())


def _gain(fit: LikelihoodFit, before: LikelihoodFit) -> float:
    """By how much -2 log likelihood is lower than in a fit before, their noise as it is left."""
    return float(fit.samples * np.log(before.chi_square / fit.chi_square))


def _converged(fit: LikelihoodFit) -> bool:
    return fit.status is AnnealingStatus.CONVERGED


def _interrupted(fit: LikelihoodFit) -> bool:
    return fit.status is AnnealingStatus.INTERRUPTED


def _ends(fit: LikelihoodFit) -> bool:
    """Whether a fit converged with the expected noise, or was interrupted."""
    return _interrupted(fit) or (_converged(fit) and not fit.chi_square_off)


_MOST = 3  # fits
_NEAR = 3.0  # times the misfit of the best start beyond which another is not worth a fit

_GLANCE = 2  # steps of a search that puts starts in order
_ATTEMPT = 30  # steps of a search from one of them: those that come to the noise take 9 to 20
_VALLEYS = 5  # of these at most
_RESTARTED = 2  # of these are tried again from the parameters that they came to
_FINISHED = 2  # whole searches where none came to the noise
_TIGHT = 1e-3  # relaxation at which attempts that did not end are compared
_FAR, _CLOSE = 0.5, 0.1  # parts in power of the records that free runs leave
_GLANCED = 0.1  # part of the work that is done after the glances

SearchFrom: TypeAlias = Callable[[Floats], LikelihoodFit]
"""Fits from parameters (p,)."""
FitFrom: TypeAlias = Callable[[Sequence[Valley]], LikelihoodFit]
"""Fits from starts."""


@dataclass(frozen=True)
class Stages:
    """Searches of growing length from the same start.

    Attributes
    ----------
    glance : callable
        A search of few steps from parameters (p,), the number of the start, and how many there are.
    attempt : callable
        A longer one from parameters (p,), with exact laws.
    finish : callable
        A whole search from parameters (p,) and, where they are known, states (2n + S, K).
    """

    glance: Callable[[Floats, int, int], LikelihoodFit]
    attempt: SearchFrom
    finish: Callable[[Floats, Floats | None], LikelihoodFit]

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure, options: LikelihoodOptions) -> Stages:
        """The searches of `likelihood_fit` with options, whose progress they share."""
        progress = rising(options.progress)
        longer = part(progress, _GLANCED, 1.0)
        brief = replace(options, model_error=False)

        def fitted(theta: Floats, of_stage: LikelihoodOptions, named: Progress) -> LikelihoodFit:
            return likelihood_fit(records, structure, theta, options=replace(of_stage, progress=named))

        def glance(theta: Floats, number: int, count: int) -> LikelihoodFit:
            ends = _GLANCED * number / count, _GLANCED * (number + 1) / count
            named = part(_named(progress, f"start {number + 1} of {count}"), *ends)
            return fitted(theta, replace(brief, steps=_GLANCE), named)

        def finish(theta: Floats, nodes: Floats | None) -> LikelihoodFit:
            return fitted(theta, replace(options, nodes=nodes), longer)

        attempt = partial(fitted, of_stage=replace(brief, steps=_ATTEMPT), named=longer)
        return cls(glance, attempt, finish)


def _named(progress: Progress, name: str) -> Progress:
    """The same progress, its activities with a name before them."""

    def named(report: ProgressReport, /) -> None:
        progress(replace(report, activity=f"{name}: {report.activity}"))

    return named


def fit_from_valleys(search: SearchFrom, valleys: Sequence[Valley]) -> LikelihoodFit:
    """Fit from the best starts until a fit explains the records to within their noise.

    Raises IdentificationError if the motion from none of them is finite.
    """
    fits: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    for valley in _near(valleys)[:_MOST]:
        try:
            fits.append(search(valley.values))
        except IdentificationError as error:
            failures.append(error)
        if fits and (_interrupted(fits[-1]) or _explains(fits[-1])):
            break
    if not fits:
        raise failures[0]
    return _best(fits)


def fit_in_stages(stages: Stages, valleys: Sequence[Valley]) -> LikelihoodFit:
    """Fit from starts whose misfits hardly differ, in the order of what a search of few steps leaves.

    A search that does not come to the noise soon gives way to one from the next start. Where none comes there, those that left
    least are tried again from their parameters, with states that are computed again, and then searched to their end.

    Parameters
    ----------
    stages : Stages
        The searches.
    valleys : sequence of Valley
        The starts, that with the least misfit first.

    Returns
    -------
    LikelihoodFit
        The fit that explains the records, else the best of those taken up to their ends, with others as good; an interrupt
        ends the search with the best so far.

    Raises
    ------
    IdentificationError
        If the motion from none of the starts is finite.
    """
    starts, interrupted = _in_order(_near(valleys), stages)
    if interrupted is not None:
        return interrupted
    attempts: list[LikelihoodFit] = []
    failures: list[IdentificationError] = []
    for valley in starts[:_VALLEYS]:
        try:
            attempts.append(stages.attempt(valley.values))
        except IdentificationError as error:
            failures.append(error)
        if attempts and _stays(attempts[-1]):
            break
    if not attempts:
        raise failures[0]
    if not _stays(attempts[-1]):
        attempts += _restarted(attempts, stages)
    if _interrupted(attempts[-1]):
        return _best(attempts)
    ended = [attempts[-1]] if _explains(attempts[-1]) else sorted(attempts, key=_rank_of_attempt)
    fits: list[LikelihoodFit] = []
    for attempt in ended[:_FINISHED]:
        fits.append(_finished(attempt, stages))
        if _stays(fits[-1]):
            break
    return _best(fits)


def fit_from_free_runs(stages: Stages, start: Valley, nodes: Floats | None) -> LikelihoodFit | None:
    """Fit from a start whose free runs come near the records.

    Parameters
    ----------
    stages : Stages
        The searches.
    start : Valley
        The start, whose misfit is the part in power of the records that free runs leave.
    nodes : array of shape (2n + S, K) or None
        States of these runs, where they reach to the ends of the records.

    Returns
    -------
    LikelihoodFit or None
        The fit that explains the records, was interrupted, or converged where free runs come close; else None.
    """
    if not start.misfit < _FAR:
        return None
    values = start.values
    try:
        for _ in range(_RESTARTED):  # whose states are computed again
            attempt = stages.attempt(values)
            if _stays(attempt):
                return attempt if _interrupted(attempt) else _finished(attempt, stages)
            values = attempt.values
        fit = stages.finish(start.values, nodes)
    except IdentificationError:  # the motion is not finite
        return None
    return fit if _stays(fit) or (_converged(fit) and start.misfit < _CLOSE) else None


def _finished(attempt: LikelihoodFit, stages: Stages) -> LikelihoodFit:
    """A whole search from where an attempt converged, else from its parameters; none after one that leaves white noise."""
    if _explains(attempt) and ColouredNoise.of(attempt.misfit.residuals, attempt.segments.linked) is None:
        return attempt
    nodes = attempt.optimum.point.nodes if _converged(attempt) else None
    try:
        fit = stages.finish(attempt.values, nodes)
    except IdentificationError:  # the motion from states of the records is not finite
        return attempt
    return attempt if _explains(attempt) and not _stays(fit) else fit


def _restarted(attempts: Sequence[LikelihoodFit], stages: Stages) -> list[LikelihoodFit]:
    """Attempts from the parameters that the best ones came to without an end: their states are computed again."""
    fits: list[LikelihoodFit] = []
    for attempt in sorted(attempts, key=_rank_of_attempt)[:_RESTARTED]:
        if _converged(attempt):
            continue
        try:
            fits.append(stages.attempt(attempt.values))
        except IdentificationError:
            continue
        if _stays(fits[-1]):
            break
    return fits


def _near(valleys: Sequence[Valley]) -> list[Valley]:
    """Those whose misfit is not far above that of the first."""
    return [valley for valley in valleys if valley.misfit <= _NEAR * valleys[0].misfit]


def _in_order(valleys: Sequence[Valley], stages: Stages) -> tuple[list[Valley], LikelihoodFit | None]:
    """Starts in the order of the cost that a search of few steps leaves, with loose links; the search that was interrupted.

    Those from which the motion is not finite come last.
    """
    if len(valleys) == 1:
        return list(valleys), None
    costs = []
    for number, valley in enumerate(valleys):
        try:
            fit = stages.glance(valley.values, number, len(valleys))
        except IdentificationError:
            costs.append(np.inf)
            continue
        if _interrupted(fit):
            return [], fit
        cost = fit.misfit.cost(1.0)
        costs.append(cost if np.isfinite(cost) else np.inf)
    return [valleys[number] for number in np.argsort(costs, kind="stable").tolist()], None


def _best(fits: Sequence[LikelihoodFit]) -> LikelihoodFit:
    """The best of fits, with the values of others that are as good."""
    best = min(fits, key=_rank)
    others = tuple(fit.values for fit in fits if fit is not best and _converged(fit) and _as_good(fit, best))
    return replace(best, others=others)


def fit_or_another(fit: LikelihoodFit, search: Callable[[], LikelihoodFit]) -> LikelihoodFit:
    """The fit where it explains the records to within their noise, else the better of it and of another that starts."""
    if _stays(fit):
        return fit
    try:
        return min(fit, search(), key=_rank)
    except IdentificationError:
        return fit


def _stays(fit: LikelihoodFit) -> bool:
    return _interrupted(fit) or _explains(fit)


def _explains(fit: LikelihoodFit) -> bool:
    return _converged(fit) and not fit.chi_square_off and fit.model_error == 0.0


def _rank(fit: LikelihoodFit) -> tuple[bool, float]:
    """Fits that converged first, then those that leave least: the relaxation of a model error counts as misfit."""
    return not _converged(fit), fit.chi_square if fit.model_error == 0.0 else fit.misfit.cost(fit.model_error)


def _rank_of_attempt(fit: LikelihoodFit) -> tuple[bool, float]:
    """Attempts that converged first, then by the cost with links so tight that one that stopped at loose ones has more."""
    cost = fit.misfit.cost(_TIGHT)
    return not _converged(fit), cost if np.isfinite(cost) else np.inf


def _as_good(fit: LikelihoodFit, best: LikelihoodFit) -> bool:
    errors = np.sqrt(np.maximum(best.covariance.diagonal(), 0.0))
    apart = np.abs(fit.values - best.values) > _ALIKE * errors
    return bool(apart.any() and abs(fit.misfit.cost(1.0) - best.misfit.cost(1.0)) < _TIED)


_FREE_RUNS = 0.3  # part of the work
_INEXACT = (
    0.05**2
)  # part in power of the records: free runs that leave more are not of exact laws, or not near


def fit_of_memory_beside_hosts(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    options: LikelihoodOptions,
) -> LikelihoodFit:
    """The most likely parameters of a structure with hosts whose links have memory.

    Parameters
    ----------
    records : sequence of Record
        The records, with the same channels.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.
    options : LikelihoodOptions
        The options.

    Returns
    -------
    LikelihoodFit
        The fit from free runs where they come close to the records, else the best from all starts.

    Raises
    ------
    IdentificationError
        If the records do not determine the motion, or the motion from none of the starts is finite.
    """
    progress = rising(options.progress)
    framed_ones = framed_records(records, structure, integrated=True)
    with one_blas_thread():
        valleys = host_memory_starts(framed_ones, structure, given)
        near = free_run_starts(framed_ones, structure, given, valleys, part(progress, 0.0, _FREE_RUNS))
    stages = Stages.of(records, structure, replace(options, progress=part(progress, _FREE_RUNS, 1.0)))
    fit = None
    if near:
        fit = fit_from_free_runs(stages, near[0], _nodes(framed_ones, structure, near[0].values))
    if fit is None:
        return fit_in_stages(stages, valleys)
    if near[0].misfit > _INEXACT:
        return fit
    return fit_or_another(fit, lambda: fit_in_stages(stages, valleys))


def _nodes(records: Sequence[Record], structure: Structure, values: Floats) -> Floats | None:
    """(2n + S, K) states of free runs from rest at the first sample of every segment; None where these are not so long."""
    runs = FreeRuns.of(records, structure, values)
    if any(len(run) < len(record) for run, record in zip(runs.records, records, strict=True)):
        return None
    return np.concatenate([states[:, ::SAMPLES] for states in runs.states(values)], axis=1)
