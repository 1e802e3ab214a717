"""Maximum-likelihood fit of a structure to records: segments, start, annealing, model error.

It refuses gains of channels that the records do not tell, as of all that they show together: one factor leaves the laws alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from functools import cached_property, partial
from itertools import pairwise
from math import inf, isinf
from typing import TypeVar

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import RandomForceEstimate
from linkwise.estimates.link_estimate import LinkMotion, extremes, forces_with_memory
from linkwise.likelihood.marginal import marginal_fit
from linkwise.likelihood.noise import residual_levels, with_noise_of_residuals
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.problem import SAMPLES, Problem, shooting_problem
from linkwise.likelihood.random_forces import force_estimates
from linkwise.likelihood.search import ExplainedFit, Optimum, explained_fit, searched
from linkwise.likelihood.shooting.minimise import Annealer, AnnealingFit, AnnealingStatus, AnnealingStep
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.terms import Delay, Found, Gain, OfMotion, Term, Unknown
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread, processors
from linkwise.signals.base_frame import framed_records
from linkwise.signals.gaps import is_sparse
from linkwise.weak.displacements import read_displacements
from linkwise.weak.equations import weak_equations, weak_residual

_LARGEST = 0.5  # relative standard error from which a gain is not told
_COLLINEAR = 1e5
"""Variance of a gain over that with all other unknowns known; the sensitivities, in single precision, resolve some 1e7."""


def _undetermined_gains(found: Sequence[Found], covariance: Floats, parameters: int) -> tuple[str, ...]:
    """The channels of gains of which nothing is known, and that others of all unknowns stand for.

    `covariance` (P, P) has the `parameters` first, and zero in rows of those at a bound.
    """
    variance, alone = covariance.diagonal(), inflation_beside_others(covariance)
    firsts = parameters + np.cumsum([0, *(one.unknown.count for one in found)])
    return tuple(
        one.term.channel
        for row, one in zip(firsts, found, strict=False)
        if isinstance(one.term, Gain)
        and isinf(one.term.deviation)
        and not (0.0 < alone[row] < _COLLINEAR and np.sqrt(variance[row]) < _LARGEST * abs(one.sizes[0]))
    )


def inflation_beside_others(covariance: Floats) -> Floats:
    """(P,) the variance of each unknown over what it has where the others are known; infinite where it has none."""
    variances = covariance.diagonal()
    inflation = np.full(len(variances), np.inf)
    usable = np.flatnonzero(np.isfinite(variances) & (variances > 0.0))
    deviations = np.sqrt(variances[usable])
    correlation = covariance[np.ix_(usable, usable)] / np.outer(deviations, deviations)
    with suppress(np.linalg.LinAlgError):
        inflation[usable] = np.linalg.inv(correlation).diagonal()
    return inflation


def require_told(fit: LikelihoodFit) -> None:
    """Raise IdentificationError where the records do not tell gains of which nothing is known beforehand.

    A search that was interrupted, or ended far from the records or without standard errors, does not say what they tell.
    """
    explained = fit.has_errors and not fit.chi_square_off and not fit.interrupted
    gains = fit.undetermined_gains
    if gains and (fit.converged or explained):
        raise IdentificationError(
            f"the records do not tell the gain of {', '.join(gains)}: another scale of forces, masses or motion explains "
            f"them as well. Leave {'it' if len(gains) == 1 else 'one of them'} out, or state how well it is "
            "known, by a calibration",
            arguments=("calibration",),
        )


_MOST_WORKERS = 8
T = TypeVar("T")


class CostShape(Enum):
    """What is known of the cost around an optimum.

    That it is QUADRATIC in random directions, or REGULAR: that it also rises in those that the record determines least.
    """

    UNKNOWN = auto()
    QUADRATIC = auto()
    REGULAR = auto()


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """A maximum of the likelihood.

    Attributes
    ----------
    covariance, free : array of shape (p, p) and (p,)
        The covariance of the estimates, and False for those at a bound.
    found : tuple of Found
        What was found of the errors of sensors and inputs, in the order of the unknowns.
    noise : dict of str to float
        The standard deviations of the noise in the first record, by channel.
    chi_square, chi_square_off : float, bool
        Chi-square per degree of freedom with the noise stated or estimated beforehand, and whether it is far from 1.
    noise_from_misfit : bool
        Whether the noise is what the laws leave: beside that which was stated or found no search ended.
    model_error : float
        The relaxation q of the flow where the laws leave residuals that are not noise, else 0.
    force_error : array of shape (n,)
        The standard deviation of the force on each mass, in N, that `model_error` stands for.
    error_ratios : array of shape (p,) or None
        With a model error, the factor on the standard errors in `covariance` over those of a model error that is white noise,
        from the scatter between blocks of the records; None where the records are too short for blocks.
    samples, status, path
        Number of samples, how the search ended, and its steps.
    optimum
        The segments with the residuals and defects at the maximum, and what a later search starts from.
    others : tuple of array of shape (p,)
        Values at other maxima that are as likely.
    random_forces : tuple of RandomForceEstimate
        Random forces on masses, stated or found.
    prior_conflicts : array of shape (P,)
        The reduction of -2 log likelihood without the prior of each parameter, offset or gain.
    shape : CostShape
        What is known of the cost around the optimum.
    undetermined_gains : tuple of str
        Channels whose gains, of which nothing is known beforehand, the records do not tell.
    options : LikelihoodOptions
        What it was asked for with.
    """

    covariance: Floats
    free: Bools
    found: tuple[Found, ...]
    noise: dict[str, float]
    chi_square: float
    chi_square_off: bool
    model_error: float
    force_error: Floats
    error_ratios: Floats | None
    samples: int
    status: AnnealingStatus
    path: tuple[AnnealingStep, ...]
    optimum: Optimum
    prior_conflicts: Floats
    others: tuple[Floats, ...] = ()
    random_forces: tuple[RandomForceEstimate, ...] = ()
    shape: CostShape = CostShape.UNKNOWN
    undetermined_gains: tuple[str, ...] = ()
    noise_from_misfit: bool = False
    options: LikelihoodOptions = field(default_factory=LikelihoodOptions)

    @cached_property
    def values(self) -> Floats:
        """(p,) the estimates."""
        return self.optimum.point.theta

    @property
    def names(self) -> Sequence[Name]:
        """Those of the parameters."""
        return self.segments.system.parameters.names

    @property
    def by_name(self) -> dict[str, float]:
        """The estimates by the names of the parameters."""
        return dict(zip(self.names, self.values.tolist(), strict=True))

    @cached_property
    def segments(self) -> Segments:
        """The records in segments."""
        return self.optimum.segments

    @property
    def terms(self) -> list[Term]:
        """The errors of which something was found."""
        return [*dict.fromkeys(found.term for found in self.found)]

    def size_of(self, term: Term) -> tuple[float, float]:
        """The first size that was found of a term with its standard error, of several the mean by precision."""
        of_term = [one for one in self.found if one.term == term]
        sizes, deviations = np.array([(one.sizes[0], one.deviations[0]) for one in of_term]).T
        if len(of_term) == 1:
            return float(sizes[0]), float(deviations[0])
        weights = 1.0 / np.maximum(deviations, np.finfo(float).tiny) ** 2
        if not weights.any():
            return float(sizes.mean()), inf
        return float(sizes @ weights / weights.sum()), float(weights.sum() ** -0.5)

    @property
    def delays(self) -> dict[str, float]:
        """Those in s that are left in the records, by channel."""
        of_delays = (one for one in self.found if isinstance(one.term, Delay))
        return {one.term.channel: float(one.sizes[0]) for one in of_delays}

    @cached_property
    def misfit(self) -> Misfit:
        """The residuals and defects at the maximum."""
        return self.optimum.misfit

    def at(self, optimum: Optimum, found: AnnealingFit, covariance: Floats) -> LikelihoodFit:
        """The fit moved to where another search ended, from `optimum`, with the `covariance` (P, P) there."""
        p = len(self.values)
        return replace(
            self,
            covariance=covariance[:p, :p],
            free=~found.at_bound[:p],
            optimum=replace(optimum, misfit=found.misfit, q=found.q),
        )

    @property
    def converged(self) -> bool:
        """Whether the search found an optimum."""
        return self.status is AnnealingStatus.CONVERGED

    @property
    def interrupted(self) -> bool:
        """Whether the user ended the search."""
        return self.status is AnnealingStatus.INTERRUPTED

    @property
    def leaves_noise(self) -> bool:
        """Whether exact laws leave no more than noise."""
        return not self.chi_square_off and self.model_error == 0.0

    @property
    def has_errors(self) -> bool:
        """Whether the free unknowns have variances: finite, and not negative as those of singular equations by rounding."""
        variances = self.covariance.diagonal()[self.free]
        return bool((np.isfinite(variances) & (variances >= 0.0)).all())


@np.errstate(over="ignore", invalid="ignore")  # a trial may run to infinity; what it gives is checked
def likelihood_fit(
    records: Sequence[Record],
    structure: Structure,
    theta: Floats,
    *,
    spread: Floats | None = None,
    options: LikelihoodOptions | None = None,
) -> LikelihoodFit:
    """Most likely parameters of a structure.

    Parameters
    ----------
    records : sequence of Record
        The records.
    structure : Structure
        The structure.
    theta : array of shape (p,)
        Starting values of the parameters.
    spread : array of shape (p,), optional
        Standard deviations of the starting values; the search starts closer to the laws with them.
    options : LikelihoodOptions, optional
        The options.

    Returns
    -------
    LikelihoodFit
        The parameters, converged or not.

    Raises
    ------
    IdentificationError
        If records lack channels or differ in them, or the motion from the start is not finite.
    """
    options = options or LikelihoodOptions()
    problem, nodes = Problem.of(options, records, structure), options.nodes
    records = problem.records
    sparse = is_sparse(records) if nodes is None else nodes.shape[-1] == sum(map(len, records))
    if options.random or not sparse:
        return _fit(problem, theta, spread, options)
    # exact laws, or where they leave more a model error, in segments of several samples: one of every single sample could
    # hardly be told from noise
    if options.relaxation is None:
        exact = _fit(replace(problem, sparse=True), theta, spread, replace(options, model_error=False))
        if not options.model_error or exact.interrupted or (exact.converged and not exact.chi_square_off):
            return exact
        if exact.converged:
            theta, nodes = exact.values, exact.optimum.point.nodes
    if nodes is not None:
        ends = np.cumsum([0, *map(len, records)])
        firsts = [np.arange(first, last, SAMPLES) for first, last in pairwise(ends)]
        nodes = nodes[..., np.concatenate(firsts)]
    return _fit(problem, theta, spread, replace(options, nodes=nodes))


def with_denoised(fit: LikelihoodFit, records: Sequence[Record], errors: Sequence[Term]) -> tuple[Term, ...]:
    """The errors with what their channels show of the motion of a fit in each record, without the noise of the samples."""
    return tuple(
        replace(one, shown=_denoised(fit, records, one)) if isinstance(one, OfMotion) else one
        for one in errors
    )


def _denoised(fit: LikelihoodFit, records: Sequence[Record], term: OfMotion) -> list[Floats]:
    """What an error, with its size in the first record, leaves of the motion in each record (N,)."""
    segments, number = fit.segments, records[0].responses.index(term.channel)
    size = next(float(one.sizes[0]) for one in fit.found if one.term == term)
    taken = fit.misfit.residuals[:, number] * segments.deviations(fit.optimum.scales)[number]
    for channel, added in segments.errors.added(fit.optimum.point.offsets):
        taken = taken + added * (channel == number)
    series = []
    for record, own in zip(records, segments.in_records(taken, records), strict=True):
        samples = record.channel(term.channel)
        series.append(term.left(samples - own, samples, record.step, size))
    return series


def _fit(problem: Problem, theta: Floats, spread: Floats | None, options: LikelihoodOptions) -> LikelihoodFit:
    """The fit of records in the coordinates of the equations, in the segments of a problem."""
    # products run on threads of our own
    with one_blas_thread(), ThreadPoolExecutor(min(processors(), _MOST_WORKERS)) as executor:
        annealer = Annealer(executor, options.progress)
        start, fit = searched(shooting_problem(problem, theta, spread), spread, options, annealer)
        if fit.misfit.segments.random is not None:
            fit = marginal_fit(fit, problem.stated, annealer)
        else:
            fit = with_noise_of_residuals(fit, annealer, problem.lowest)
        explained = explained_fit(start, fit, annealer, lowest=problem.lowest, options=options)
    fit, segments, ratios = explained.fit, explained.fit.misfit.segments, explained.error_ratios
    p = segments.system.parameters.size
    point = fit.point
    segments = replace(segments, inputs=segments.inputs.at(point.gains, point.delays))
    random = segments.random
    of_forces = np.zeros(0) if random is None else random.present * random.deviation.max(axis=1)
    deviations = np.sqrt(np.maximum(explained.covariance.diagonal()[p:], 0.0))
    found = _found(problem.unknowns, point.border[p:], deviations)
    of_white = None if explained.coloured is None else fit.covariance[:p, :p]
    misfit = replace(fit.misfit, segments=segments)
    return LikelihoodFit(
        covariance=explained.covariance[:p, :p],
        free=~fit.at_bound[:p],
        found=found,
        noise=_found_noise(fit, tuple(problem.frames[0].names)),
        chi_square=explained.chi_square,
        chi_square_off=explained.chi_square_off,
        noise_from_misfit=explained.noise_from_misfit,
        model_error=explained.model_error,
        force_error=_force_error(fit),
        error_ratios=None if ratios is None else ratios[:p],
        samples=fit.samples,
        status=fit.status,
        path=fit.path,
        optimum=Optimum(misfit, fit.q, explained.noise, explained.coloured, of_white),
        prior_conflicts=_prior_conflicts(explained),
        undetermined_gains=_undetermined_gains(found, explained.covariance, p),
        random_forces=force_estimates(problem.random, of_forces, problem.records[0].rate),
        options=options,
    )


def _found(unknowns: Sequence[Unknown], sizes: Floats, deviations: Floats) -> tuple[Found, ...]:
    """What was found of unknowns, from the sizes of all of them and their standard deviations; without their shapes."""
    ends = np.cumsum([unknown.count for unknown in unknowns])[:-1]
    bare = (Unknown(one.term, one.channel, one.known, one.record) for one in unknowns)
    parts = (np.split(values, ends) for values in (sizes, deviations))
    return tuple(map(Found, bare, *parts)) if unknowns else ()


def _prior_conflicts(explained: ExplainedFit) -> Floats:
    border, prior = explained.fit.point.border, explained.fit.misfit.segments.prior
    if prior is None:
        return np.zeros(len(border))
    variances = explained.noise**2 * explained.fit.covariance.diagonal()
    if explained.coloured is not None:
        variances = explained.covariance.diagonal()
    return prior.conflicts(border, variances)


def _found_noise(fit: AnnealingFit, channels: Sequence[str]) -> dict[str, float]:
    if fit.misfit.segments.random is not None:  # whose most likely values take a part of the noise
        return dict(zip(channels, map(float, fit.scales.sigma), strict=True))
    return dict(zip(channels, (fit.scales.sigma * residual_levels(fit.misfit)).tolist(), strict=True))


def _force_error(fit: AnnealingFit) -> Floats:
    """(n,) root mean square in N of the force that the velocity defects stand for."""
    segments = fit.misfit.segments
    n, duration = len(segments.system.incidence), np.mean(segments.step) * segments.steps
    jumps = np.sqrt(np.mean(fit.misfit.defects[n : 2 * n] ** 2, axis=1)) * fit.scales.state[n : 2 * n]
    return np.asarray(fit.misfit.mechanics.masses * jumps / duration)


def motion_of_links(
    fit: LikelihoodFit, identified: Structure, records: Sequence[Record], *, judged: Floats | None = None
) -> LinkMotion:
    """The links along the fitted orbit, at the samples of all records, and residuals of the weak form.

    The residuals (M, C, K) of channels are those of the fit, or those `judged` in its place.
    """
    records = framed_records(records, identified, integrated=True)
    segments = fit.segments

    def at_samples(values: Floats) -> Floats:
        """(N, ...) values (M, ..., K) in segments at the samples of all records."""
        return np.concatenate(segments.in_records(values, records))

    states = fit.misfit.trajectories.states[segments.at_samples]
    x, v = at_samples(states[:, 0]), at_samples(states[:, 1] / segments.step)
    base = rate = None
    if "x:base" in records[0].channels:
        base = np.concatenate([record.channel("x:base") for record in records])
        rate = np.concatenate([np.gradient(record.channel("x:base"), record.step) for record in records])
    d, rates = identified.elongations(x, base), identified.elongations(v, rate)
    inside = at_samples(fit.misfit.trajectories.memory[segments.at_samples]).T
    count = len(segments.system.states)
    of_links = zip(segments.system.states, inside[:count], strict=True)
    signals = dict(zip(segments.inputs.signals, inside[count:], strict=True))
    left = fit.misfit.residuals if judged is None else judged
    remains = at_samples(np.where(segments.observed, left, np.nan))
    return LinkMotion(
        structure=identified,
        time=np.concatenate([record.time for record in records]),
        d=d,
        v=rates,
        d_range=extremes(d),
        compute_residual=partial(_residual, identified, records),
        identified_force=forces_with_memory(identified, (d, rates), of_links, signals),
        residuals=dict(zip(fit.noise, remains.T, strict=True)),
    )


def _residual(identified: Structure, records: Sequence[Record]) -> Floats | None:
    """(N, n) of the weak equations at the samples, where the records have the displacements that they need.

    None for links with states or signals and for hosts, which the weak form does not take.
    """
    if identified.hosts or not all(link.law.is_plain for link in identified.links):
        return None
    columns = []
    for record in records:
        try:
            equations = weak_equations(record, identified, read_displacements(record, identified))
        except IdentificationError:
            return None
        windows = weak_residual(equations, np.zeros(0))
        columns.append(
            np.stack([np.interp(record.time, equations.time, column) for column in windows.T], axis=1)
        )
    return np.concatenate(columns)
