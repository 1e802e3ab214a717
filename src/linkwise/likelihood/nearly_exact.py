"""Laws that leave hardly more than noise and yet are not exact: what says so, and intervals that hold it.

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
from linkwise.likelihood.block_scores import BLOCKS, EQUAL, BlockScatter, block_scatter
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.held_errors import LARGEST_TERM
from linkwise.likelihood.hypotheses import BETWEEN_MODES
from linkwise.likelihood.longer_optimum import in_longer_segments
from linkwise.likelihood.missing_terms import MissingTerms, for_usual_terms, usual_scores
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.tested_causes import TestedCauses
from linkwise.model.host import in_words
from linkwise.model.structure import Structure
from linkwise.runtime import one_blas_thread

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
