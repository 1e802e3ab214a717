"""What a model error or noise of an input hides: a missing term that explains most of what is left without it, or a change.

A model error lets the motion forget, and with it what a small term does over many periods: a score test beside the model error
is silent on friction that would change a damping by ten standard errors. Held ten times closer, the laws leave more than that.
Where one term would explain most of that, they lack it, and where a change of one coefficient would, it changes; an error
that is random leaves what neither explains. Noise of an input lets the motion forget likewise, and is found where there is
none; the motion is held closer with a tenth of it.

Laws that leave hardly more than noise and yet are not exact: what says so, and intervals that hold it.

Chi-square sees an error of the laws only where it exceeds several percent of the noise in power. Two tests see a smaller one:
the scores of terms that laws lack most often, and the scatter of blocks of the records, as a law that lacks a term is fitted
by other values to each motion that it meets (a test of homogeneity: Cochran, Biometrics 10, 1954). For exact laws the two are
nearly independent, and their product says more than either (Fisher, "Statistical methods for research workers", 1932).
Where they doubt the laws, intervals are those beside a model error: as wide as blocks scatter, and with what usual terms
would make of the coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.expression import symbols
from linkwise.likelihood.checks.held_errors import LARGEST_TERM, MissingTerms, for_usual_terms, usual_scores
from linkwise.likelihood.fit import LikelihoodFit, Optimum
from linkwise.likelihood.marginal import held_at, is_long, relaxation
from linkwise.likelihood.search import BLOCKS, EQUAL, BlockScatter, block_scatter
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.minimise import AnnealingFit, AnnealingSchedule, AnnealingStatus, anneal
from linkwise.likelihood.tests.diagnosis import Diagnosis, TestedCauses, diagnose, in_longer_segments
from linkwise.likelihood.tests.score_test import BETWEEN_MODES, MEMORY_TERMS
from linkwise.model.host import in_words
from linkwise.model.law import Law
from linkwise.model.names import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.runtime import one_blas_thread

_CLOSER = (0.1, 0.3)  # times the relaxation that stands for the model error, or the noise of inputs
_CLOSER_IF_LONG = (
    0.3,
)  # the same of long records, which were not held more closely because no search leads straight there
_STEPS = 40
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


@dataclass(frozen=True)
class HiddenTerm:
    """The `cause`, and by how much of its value the term would change the coefficient that it changes most: `change`.

    `shift` is the same in standard errors of the fit, and `held` the fit that is held closer.
    """

    cause: Cause
    change: float
    shift: float
    closer_fit: LikelihoodFit

    @property
    def dissipates(self) -> bool:
        """Whether it depends on the rate, or on its past; an error of a mass is a force of inertia."""
        return self.cause.kind != MASS and self._depends_on_rate

    @property
    def _depends_on_rate(self) -> bool:
        return self.cause.term in MEMORY_TERMS or "v" in symbols(Law.parse(f"a*{self.cause.term}").expression)


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
        closer = _searched_closer(tight)
        if closer is None:
            continue
        if closer.status is AnnealingStatus.INTERRUPTED:
            return None
        if closer.status is AnnealingStatus.CONVERGED:
            return _diagnosed(fit, closer, tight, identified, channels)
    return None


def _tightened(optimum: Optimum, factor: float) -> Optimum:
    """From where the motion is to be held closer: with the relaxation, or the noise of inputs, times a factor."""
    segments, random = optimum.segments, optimum.segments.random
    if random is None:
        return replace(optimum, q=max(factor * optimum.q, AnnealingSchedule.final_q))
    quieter = replace(random.scaled(np.full(len(random.rows), factor)), slope=None, origin=None)
    segments = replace(segments, random=quieter)
    return replace(optimum, segments=segments, q=relaxation(segments, optimum.scales, optimum.point))


def _searched_closer(tight: Optimum) -> AnnealingFit | None:
    """The search from where the motion is to be held closer; None where one in pieces does not lead to an optimum."""
    if is_long(tight.segments):
        return held_at(tight.segments, tight.point, tight.scales, tight.loss, tight.q)
    schedule = AnnealingSchedule(initial_q=tight.q, final_q=tight.q, max_steps=_STEPS)
    return anneal(tight.segments, tight.point, tight.scales, schedule, loss=tight.loss)


def _diagnosed(
    fit: LikelihoodFit,
    closer: AnnealingFit,
    tight: Optimum,
    identified: Structure,
    channels: Sequence[Channel],
) -> CloserFit | None:
    """A search by the equations of `tight`, whose end is `closer`, with what explains what it leaves; None where that is not
    finite. The structure is `identified` with the values of the fit.
    """
    optimum, p = fit.optimum, len(fit.values)
    closer_fit = replace(
        fit,
        values=closer.point.theta,
        covariance=optimum.noise**2 * closer.covariance[:p, :p],
        free=~closer.at_bound[:p],
        misfit=closer.misfit,
        segments=tight.segments,
        optimum=replace(tight, point=closer.point, q=closer.q),
    )
    names = fit.segments.system.parameters.names
    closer_structure = identified.with_values(dict(zip(names, map(float, closer.point.theta), strict=True)))
    left = (closer.misfit.cost(closer.q) - fit.misfit.cost(optimum.q)) / optimum.noise**2
    if not np.isfinite(left):
        return None
    return CloserFit(closer_fit, left, diagnose(closer_fit, closer_structure, channels, terms=True))


def hidden_term(fit: LikelihoodFit, closer: CloserFit) -> HiddenTerm | None:
    """The missing term, or error of a mass, that explains most of what the laws leave in a fit held `closer` than `fit`."""
    causes = closer.diagnosis.causes
    if not causes or causes[0].kind not in ("term", MASS) or not closer.explains_most(causes[0].gain):
        return None
    change, shift = 0.0, 0.0
    if causes[0].shifted:
        number = fit.segments.system.parameters.names.index(causes[0].shifted)
        error = float(np.sqrt(closer.fit.covariance[number, number]))
        changed, tiny = causes[0].shift * error, np.finfo(float).tiny
        change = changed / max(abs(float(fit.values[number])), tiny)
        shift = changed / max(float(np.sqrt(fit.covariance[number, number])), tiny)
    return HiddenTerm(causes[0], change, shift, closer.fit)


_DOUBT = 0.02
"""Probability of so large scores and so much scatter by chance, below which exact laws are doubted: one record in 50 has wider
intervals for nothing."""

_AS_NOISE = 0.25
"""Of what the likeliest term explains: noise of an input that explains less is that term, seen as noise. Of 166 records with
such noise alone, five had a term before it in the diagnosis, which explained 1.1 to 2.1 times as much."""


@dataclass(frozen=True, eq=False)
class Doubt:
    """What exact laws may lack: `missing` terms, and the standard errors by blocks over those of noise, `ratios` (p,).

    The latter are None where blocks do not disagree.
    """

    missing: MissingTerms | None
    ratios: Floats | None = None

    def for_blocks(self, covariance: Floats) -> Floats | None:
        """(p, p) what the scatter of blocks adds to a covariance of white noise."""
        return None if self.ratios is None else covariance * (np.outer(self.ratios, self.ratios) - 1.0)

    @property
    def hint(self) -> str:
        """What the residuals show of it."""
        if self.missing is None:
            return "a difference between parts of the records"
        first = self.missing.counted[0]
        if first.kind == BETWEEN_MODES:
            return f"damping {in_words(first.where)}"
        return f"a force like {first.term} in {first.where}"


def with_small_model_error(
    fit: LikelihoodFit, causes: Sequence[Cause], tested: TestedCauses | None = None
) -> LikelihoodFit:
    """A fit of laws that lack a small term, with intervals as beside a model error, from blocks of the records.

    Parameters
    ----------
    fit : LikelihoodFit
        Any fit.
    causes : sequence of Cause
        What is significant in its residuals, the likeliest first.
    tested : TestedCauses, optional
        What was tested.

    Returns
    -------
    LikelihoodFit
        With the least model error that a fit may have, where it has none and nothing but missing terms is significant, or
        noise of an input that explains much less, the likeliest term small enough to be trusted; the same fit otherwise, as
        where the records are too short for blocks.
    """
    if fit.model_error > 0.0 or fit.chi_square_off or not causes:
        return fit
    if causes[0].kind != "term" or causes[0].share > LARGEST_TERM:
        return fit
    if not all(cause.kind == "term" or _is_term_seen_as_noise(cause, causes[0]) for cause in causes):
        return fit
    scatter = _scatter(fit, tested)
    if scatter is None:
        return fit
    ratios = scatter.ratios[: len(fit.values)]
    return replace(
        fit,
        model_error=fit.optimum.q,
        error_ratios=ratios,
        covariance=fit.covariance * np.outer(ratios, ratios),
    )


def _is_term_seen_as_noise(cause: Cause, term: Cause) -> bool:
    return cause.kind == "input noise" and cause.gain < _AS_NOISE * term.gain


def share_of_term(identified: Structure, cause: Cause, forces: Floats) -> float:
    """The force of a missing term over the `forces` (n,) on the masses, of that with the largest ratio."""
    ends = next(link.between for link in identified.links if link.name == cause.where)
    own = [forces[number] for number, name in enumerate(identified.mass_names) if name in ends]
    return abs(cause.size) / max(min(own), np.finfo(float).tiny) if own else cause.share


def doubt(
    fit: LikelihoodFit, identified: Structure, tested: TestedCauses | None, *, searched: bool
) -> Doubt | None:
    """What intervals of exact laws hold where residuals hint at missing terms, none of them significant.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that leaves only white noise.
    identified : Structure
        The structure with the values of the fit.
    tested : TestedCauses or None
        What was tested, usual terms among it; None where nothing was.
    searched : bool
        Whether the laws were searched in these records. The search weighs each term by its standard error, so that blocks
        do not widen it.

    Returns
    -------
    Doubt or None
        None where nothing says that the laws are not exact.
    """
    if tested is None:
        return None
    scores = usual_scores(fit, identified, tested)
    scores = scores[scores > 0.0]
    scatter = None if searched else _scatter(fit, tested)
    if scatter is not None:
        beyond = float(scipy.special.ndtr(-np.max(scores, initial=0.0)))
        product = scatter.chance * min(1.0, 2.0 * max(len(scores), 1) * beyond)
        if product * (1.0 - np.log(max(product, np.finfo(float).tiny))) < _DOUBT:
            missing = for_usual_terms(fit, identified, tested, doubted=True)
            return Doubt(missing, scatter.ratios[: len(fit.values)])
    hinted = for_usual_terms(fit, identified, tested, doubted=False)
    return None if hinted is None else Doubt(hinted)


@np.errstate(over="ignore", invalid="ignore")  # a trial beyond what is finite gives no scatter
def _scatter(fit: LikelihoodFit, tested: TestedCauses | None) -> BlockScatter | None:
    """The scatter of blocks of the records.

    None where they are too short for blocks, or where a robust loss, what is known beforehand, coloured noise or a random
    force weighs the samples otherwise than the scores say.
    """
    optimum, segments = fit.optimum, fit.segments
    weighed = segments.prior is not None or segments.random is not None or optimum.coloured is not None
    if weighed or not isinstance(optimum.loss, Gaussian):
        return None
    free = np.ones(len(optimum.point.border), dtype=bool)
    free[: len(fit.values)] = fit.free
    longer, misfit = optimum, fit.misfit
    with one_blas_thread():
        scores = tested.block_scores if tested else None
        if scores is None:
            longer, misfit = in_longer_segments(fit)
            if longer.segments.count < EQUAL * BLOCKS[0]:  # short ones make more equal blocks
                longer, misfit = optimum, fit.misfit
        scatter = block_scatter(
            longer.segments,
            misfit,
            optimum.scales,
            optimum.loss,
            q=optimum.q,
            noise=optimum.noise,
            free=free,
            scores=scores,
        )
    return None if scatter is None or not np.isfinite(scatter.ratios).all() else scatter
