"""The search for an optimum: annealing from a start, through gaps of the records, and in longer segments near its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.explained_fit import did_not_converge
from linkwise.likelihood.held_laws import states_by_held_laws, within_reach
from linkwise.likelihood.long_records import is_long, search_in_pieces
from linkwise.likelihood.marginal import relaxation
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import ShootingProblem
from linkwise.likelihood.shooting.anneal import (
    Annealer,
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
)
from linkwise.likelihood.shooting.damped_step import freedom
from linkwise.likelihood.shooting.gaps import carry_through_gaps, split_at_gaps
from linkwise.likelihood.shooting.longer_segments import LongerSegments
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.likelihood.shooting.residuals import evaluate
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments

_NEAR = AnnealingSchedule(
    initial_q=0.1, smallest_factor=0.01, trust_per_sample=10.0
)  # from a start with known deviations: the weak fit's
_FAR_OF_MANY = AnnealingSchedule(
    smallest_factor=0.1, trust_per_sample=1.0
)  # of many masses: the mean of all hides that the quadratic model is wrong for one
_NEAR_OF_MANY = replace(_FAR_OF_MANY, initial_q=0.1)
_WARM = AnnealingSchedule(
    initial_q=0.01, smallest_factor=0.003, trust_per_sample=10.0
)  # from the states of a fit to nearly the same laws
_CHI_SQUARE = 0.08  # what the estimate of the noise may leave chi-square off by
_SIGMAS = 5.0  # and its own scatter
_NEARLY = 2.0  # times the noise, in power: a search that ended there without converging was on its way
_TIGHTER = 9.0  # factor below a known model error from which it is looked for again: two points of its grid
_JOINING = 30  # steps that linking the sides of a gap may take
# steps of a search in longer segments, which takes six where the laws are right and motion is regular
_STRAIGHT = 20
# relaxation from which longer segments may take over: defects are a few percent of the noise
_CONTINUOUS = 0.02
_CONTINUOUS_FOR_LONG = 0.002  # the same of segments of more than two, along which the motion bends more
_IN_LONGER = 2e-4  # first relaxation in longer segments


def searched(
    problem: ShootingProblem, spread: Floats | None, options: LikelihoodOptions, annealer: Annealer
) -> tuple[Segments, Iterate, AnnealingFit, float]:
    """The optimum of a problem.

    Long gaps break the chain of segments at first; its parts are linked where the laws and the samples allow it.

    Parameters
    ----------
    problem : ShootingProblem
        The problem.
    spread : array of shape (p,) or None
        Standard deviations of the starting values, where known.
    options : LikelihoodOptions
        The options of the fit.
    annealer : Annealer
        How annealing runs.

    Returns
    -------
    tuple of (Segments, Iterate, AnnealingFit, float)
        The segments, the start and the result of annealing, and by how much its chi-square may differ from 1 by chance.
    """
    segments = split_at_gaps(problem.segments)
    if options.nodes is None:
        start = carry_through_gaps(segments, problem.start)
        start = within_reach(segments, start, problem.scales, annealer.loss)
        fit = _of_long_record(problem, segments, start, options, annealer)
        if fit is not None:
            return segments, start, fit, _limit(segments)
        schedule = _FAR_OF_MANY if _many(segments) else AnnealingSchedule()
        if spread is not None:
            start = states_by_held_laws(segments, start, problem.scales, annealer)
            schedule = _NEAR_OF_MANY if _many(segments) else _NEAR
    else:
        start, schedule = replace(problem.start, nodes=options.nodes), _WARM
    if options.relaxation is not None:
        tight = max(options.relaxation / _TIGHTER, AnnealingSchedule.final_q)
        schedule = AnnealingSchedule(initial_q=options.relaxation, final_q=tight)
    schedule = replace(
        schedule,
        cost_ceiling=options.ceiling,
        max_steps=min(schedule.max_steps, options.steps),
        final_q=max(schedule.final_q, options.tightest),
    )
    if segments.random is not None:
        tight = relaxation(segments, problem.scales, start)
        schedule = replace(schedule, initial_q=max(schedule.initial_q, tight), final_q=tight)
    limit = _limit(segments)
    fit = _annealed(segments, start, problem.scales, schedule, annealer, limit)
    limited = options.steps < AnnealingSchedule.max_steps
    if not limited and did_not_converge(fit) and fit.misfit.data < _NEARLY * fit.samples:
        fit = _resumed(segments, fit, schedule, annealer)
    if problem.segments.chains < segments.chains:
        joined = _joined(problem.segments, fit, limit, annealer)
        if joined is not None:
            return problem.segments, start, joined, limit
    return segments, start, fit, limit


def _of_long_record(
    problem: ShootingProblem,
    segments: Segments,
    start: Iterate,
    options: LikelihoodOptions,
    annealer: Annealer,
) -> AnnealingFit | None:
    """The fit to a long record without long gaps in pieces; None where it is not searched so, or leads to no optimum."""
    limited = options.steps < AnnealingSchedule.max_steps or options.tightest > AnnealingSchedule.final_q
    if limited or options.relaxation is not None or options.ceiling < np.inf:
        return None
    if problem.segments.chains < segments.chains or not is_long(segments):
        return None
    return search_in_pieces(segments, start, problem.scales, annealer, _limit(segments))


def _limit(segments: Segments) -> float:
    """By how much chi-square may differ from 1 by chance."""
    return _CHI_SQUARE + _SIGMAS * float(np.sqrt(2.0 / int(segments.observed.sum())))


def _annealed(
    segments: Segments,
    start: Iterate,
    scales: Scales,
    schedule: AnnealingSchedule,
    annealer: Annealer,
    limit: float,
) -> AnnealingFit:
    """Annealing, of many masses in longer segments as soon as the motion is nearly continuous.

    Short ones go on where the longer ones do not lead to the noise, to within the `limit` of chi-square.
    """
    longer = LongerSegments.of(segments) if _many(segments) else None
    limited = schedule.max_steps < AnnealingSchedule.max_steps or schedule.final_q > AnnealingSchedule.final_q
    if longer is None or limited:
        return annealer(segments, start, scales, schedule)
    trusted = schedule.trust_per_sample * int(segments.observed.sum())
    continuous = _CONTINUOUS if longer.parts.shape[1] <= 2 else _CONTINUOUS_FOR_LONG
    near = annealer(segments, start, scales, replace(schedule, final_q=continuous, tolerance=trusted))
    if near.status is not AnnealingStatus.CONVERGED:
        return near
    sufficient = (1.0 + limit) * near.samples
    if near.q <= continuous and near.misfit.cost(near.q) - near.path[-1].remaining < sufficient:
        further = replace(
            schedule,
            initial_q=max(schedule.final_q, _IN_LONGER),
            max_steps=_STRAIGHT,
            sufficient_cost=sufficient,
        )
        fit = _in_longer_segments(longer, segments, near, further, annealer)
        if fit is not None and (fit.status is AnnealingStatus.INTERRUPTED or _is_good(fit, sufficient)):
            return fit
    rest = annealer(segments, near.point, scales, replace(schedule, initial_q=near.q))
    return replace(rest, path=(*near.path, *rest.path))


def _many(segments: Segments) -> bool:
    return len(segments.system.incidence) >= MANY


def _resumed(
    segments: Segments, fit: AnnealingFit, schedule: AnnealingSchedule, annealer: Annealer
) -> AnnealingFit:
    """A search that ended before it converged, taken up again from its values and states with looser links.

    Close to its end it may creep along a bend of the likelihood, which looser links straighten. Where the second search does
    not converge either, the one with the lower cost at the tighter of their links is returned.
    """
    looser = replace(
        _WARM,
        initial_q=max(_WARM.initial_q, schedule.final_q),
        final_q=schedule.final_q,
        cost_ceiling=schedule.cost_ceiling,
        max_steps=schedule.max_steps,
    )
    again = annealer(segments, fit.point, fit.scales, looser)
    path = (*fit.path, *again.path)
    tight = min(fit.q, again.q)
    if again.status is AnnealingStatus.CONVERGED or again.misfit.cost(tight) <= fit.misfit.cost(tight):
        return replace(again, path=path)
    interrupted = again.status is AnnealingStatus.INTERRUPTED
    return replace(fit, status=again.status if interrupted else fit.status, path=path)


def _joined(whole: Segments, fit: AnnealingFit, limit: float, annealer: Annealer) -> AnnealingFit | None:
    """The fit with both sides of every long gap linked, None if laws and samples do not determine how."""
    if fit.status is not AnnealingStatus.CONVERGED:
        return None
    joined = annealer(
        whole, carry_through_gaps(whole, fit.point), fit.scales, AnnealingSchedule(max_steps=_JOINING)
    )
    return (
        joined
        if joined.status is AnnealingStatus.CONVERGED and joined.chi_square < fit.chi_square + limit
        else None
    )


def _in_longer_segments(
    longer: LongerSegments,
    segments: Segments,
    near: AnnealingFit,
    schedule: AnnealingSchedule,
    annealer: Annealer,
) -> AnnealingFit | None:
    """A search taken up again in longer segments, its result in the shorter ones; None where the motion runs away in them."""
    start = longer.point(near.point)
    if not np.isfinite(evaluate(longer.segments, start, near.scales, annealer.loss).cost(near.q)):
        return None
    fit = annealer(longer.segments, start, near.scales, schedule)
    point = replace(fit.point, nodes=longer.short_nodes(fit.misfit.trajectories))
    misfit = evaluate(segments, point, near.scales, annealer.loss)
    return replace(
        fit,
        point=point,
        misfit=misfit,
        chi_square=misfit.cost_of_samples(fit.q) / (freedom(segments) * annealer.loss.expected),
        path=(*near.path, *fit.path),
    )


def _is_good(fit: AnnealingFit, sufficient: float) -> bool:
    """Whether a search converged at the last relaxation, with no more than the noise."""
    converged = fit.status is AnnealingStatus.CONVERGED and fit.q <= AnnealingSchedule.final_q
    return converged and fit.misfit.data < sufficient
