"""Coefficients that are not the same in all of a record: a mount that slips, a magnet that shifts, a joint that loosens.

Blocks of the record pull each coefficient by scores that sum to zero at the optimum. A change at one moment makes all scores
before it pull to one side and all behind it to the other: their sum up to there is the score of that change, with the
information that all coefficients, fitted anew, leave of it (the supremum of such tests over the moment: Andrews, Econometrica
61, 1993). Laws that lack a term pull by turns as the motion does. How much so, the differences of neighbouring blocks say,
which a single change hardly touches (von Neumann, Annals of Mathematical Statistics 12, 1941).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.checks.judgement import LIKELIER, Examined, Judgement
from linkwise.likelihood.checks.jumps import moment
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.marginal import is_long
from linkwise.likelihood.search import BLOCKS, BlockScores, blocks_of_scatter
from linkwise.likelihood.shooting.normal_equations import add_prior_curvature, block_ends
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.shooting.segments import Segments
from linkwise.likelihood.tests.diagnosis import TestedCauses
from linkwise.records.record import Record
from linkwise.verdict import Verdict

_JUDGED = (
    Verdict.CONVERGED,
    Verdict.MODEL_ERROR_NEEDED,
    Verdict.SYSTEMATIC_MISFIT,
    Verdict.MEASUREMENT_ERROR,
    Verdict.UNEXPLAINED_FORCES,
    Verdict.NOISE_MISMATCH,
)
"""Verdicts on laws that fit: others have a reason of their own, which a change is not the cause of."""
_LARGEST = 4.0  # chi-square of laws for which a change is a small error
_ALIKE = 0.5  # of what a change gains: those of other coefficients look like it
# with twice the logarithm of the number of coefficients and moments: normal scores give one in 2000 fits
_CHANCE = 12.0
_LEFT = 1e-6  # of the information before a moment: what the coefficients, fitted anew, leave of it at least


def changed_coefficients(of: Examined, before: Judgement) -> Judgement | None:
    """Whether a change of one coefficient explains much more than all other causes.

    It is not tested in records too short for blocks or so long that they are fitted in pieces, and with random forces or a
    robust loss, whose weights the scores do not have.
    """
    if before.verdict not in _JUDGED:
        return None
    jump = of.jump  # which another moment may hold as well
    others = [cause for cause in before.diagnosis if jump is None or cause is not jump.event]
    change, beside = likeliest_change(of.fit, of.records, of.diagnosis.tested, others), ""
    if change is not None and jump is not None and len(others) < len(before.diagnosis):
        change = change if change.gain > jump.of_one else None
    if change is None and not of.causes and (closer := of.closer) is not None:
        diagnosis, beside = closer.diagnosis, "Held closer to the laws"
        change = likeliest_change(closer.fit, of.records, diagnosis.tested, diagnosis.causes)
        change = change if change is not None and closer.explains_most(change.gain) else None
    if change is None:
        return None
    # beside what laws lack, in words, if that shows it
    explained = f"{beside}, one value" if beside else "One value"
    message = (
        f"{explained} of {change.where} does not explain all of the record: {change.description} would lower -2 log "
        f"likelihood by {change.gain:.3g}, more than any missing term or error of a sensor. An interval would include "
        "neither value: identify the parts of the record before and after it by themselves."
    )
    return before.overruled(Verdict.COEFFICIENT_CHANGES, message, change)


def likeliest_change(
    fit: LikelihoodFit, records: Sequence[Record], tested: TestedCauses | None, causes: Sequence[Cause]
) -> Cause | None:
    """The change of a coefficient that explains much more than all `causes`; None where none is significant, or tested.

    None of more than the coefficient itself, which is no small one.
    """
    large = is_long(fit.segments) or fit.chi_square > _LARGEST
    if large or fit.random_forces or not isinstance(fit.optimum.loss, Gaussian):
        return None
    segments, scores = _scores(fit, tested)
    if scores is None:
        return None
    parameters, noise = fit.segments.system.parameters, fit.optimum.noise
    free = np.flatnonzero(fit.free)
    some = np.concatenate([free, np.arange(len(fit.values), scores.scores.shape[1])])
    known = np.zeros(scores.information.shape[1:])
    if segments.prior is not None:
        add_prior_curvature(known, segments.prior, fit.optimum.scales, parameters.size)
    within = np.ix_(some, some)
    of_some = scores.within(some)
    try:
        pull, left, scatter = _changes(of_some, known[within], len(free))
    except np.linalg.LinAlgError:
        return None
    scales = fit.optimum.scales.theta[free]
    gains, sizes = pull**2 / left / noise**2, -pull / left * scales
    if not gains.size:
        return None
    significant = gains > (_CHANCE + 2.0 * np.log(gains.size)) * np.maximum(scatter / noise**2, 1.0)
    gains = np.where(significant & (np.abs(sizes) < np.abs(fit.values[free])), gains, 0.0)
    block, number = np.unravel_index(int(np.argmax(gains)), gains.shape)
    if gains[block, number] < LIKELIER + max((cause.gain for cause in causes), default=0.0):
        return None
    alike = np.flatnonzero(gains.max(axis=0) > _ALIKE * gains[block, number])
    others = [parameters.names[place] for place in free[alike].tolist() if place != free[number]]
    return Cause(
        kind="change",
        where=parameters.names[free[number]],
        size=float(sizes[block, number]),
        unit=parameters.units[free[number]],
        gain=float(gains[block, number]),
        standard_error=float(scales[number] * noise / np.sqrt(left[block, number])),
        source=moment(segments, int(block_ends(segments.count, BLOCKS[0])[int(block) + 1]), records),
        remark=f"or of {' or '.join(others)}" if others else "",
    )


def _changes(scores: BlockScores, known: Floats, parameters: int) -> tuple[Floats, Floats, Floats]:
    """Slopes and information (m, p) of changes of the first `parameters` of u unknowns behind each of m blocks, all scaled.

    So much information (u, u) is `known` beforehand. Last the variance (p,) of neighbouring blocks over that of noise. Raises
    numpy.linalg.LinAlgError where the equations are singular.
    """
    before, pull = (np.cumsum(of, axis=0)[:-1] for of in (scores.information, scores.scores))
    inverse = np.linalg.inv(scores.information.sum(axis=0) + known)
    own = np.einsum("bii->bi", before)
    left = own - np.einsum("bij,jk,bki->bi", before, inverse, before)
    left = np.where(left > _LEFT * own, left, np.inf)[:, :parameters]
    beside = inverse[:, :parameters] / inverse.diagonal()[:parameters]
    steps = np.diff(scores.scores @ beside, axis=0)
    expected = np.einsum("up,buv,vp->bp", beside, scores.information, beside)
    scatter = np.sum(steps**2, axis=0) / np.sum(expected[1:] + expected[:-1], axis=0)
    return pull[:, :parameters], left, scatter


def _scores(fit: LikelihoodFit, tested: TestedCauses | None) -> tuple[Segments, BlockScores | None]:
    """Scores of the blocks of a fit, as they were tested or by themselves, and the segments that they consist of."""
    if tested is not None and tested.block_scores is not None:
        return tested.longer.segments, tested.block_scores
    if blocks_of_scatter(fit.segments) == 1:
        return fit.segments, None
    return fit.segments, fit.optimum.scores
