"""The answer of the weak form, judged by maximum likelihood.

The weak form is biased where its windows do not follow the motion, as at kinks and gaps, and terms that laws lack bias it more
than the power of its residuals shows. A search of the likelihood from its values takes a few linearisations. The tests of that
fit say what the laws lack, and how far its values are from those of the weak form whether these are biased: the efficient
estimate differs from another that is right by less than the standard errors of the latter (Hausman, Econometrica 46, 1251,
1978).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import UnseenTerm, unseen_remark
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.link_estimate import NORMAL_95
from linkwise.expression import differentiate, kinks, symbols
from linkwise.likelihood.checks.judgement import Examined
from linkwise.likelihood.checks.table import judge
from linkwise.likelihood.checks.usual_terms import unseen_terms
from linkwise.likelihood.fit import LikelihoodFit, likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.shooting.minimise import AnnealingStatus
from linkwise.model.link import Link
from linkwise.verdict import Verdict

_LARGEST = 6  # masses: of 6000 samples the search takes 0.9 s for so many, and the weak form 0.07 s for ten
_STEPS = 15  # of the search with exact laws, which takes five to nine where these are right
_LOOSE = 0.01  # relaxation to which laws that lack something are followed: tighter, the search creeps
_CHANCE = 12.0  # with twice the logarithm of the number of unknowns: normal errors are as large in one of 2000 answers
_DAMPING = ("v*abs(v)", "sign(v)")
_TOO_FAR = 4.0 * NORMAL_95, 0.1
"""Standard errors and part of a coefficient that damping may move it by: an interval four times as wide would not hold more,
and hardly any test determines a damper to 10 %."""
_OF_THE_LIKELIHOOD = (
    "values far away",
    "another position of rest",
    "regularity",
    "skewed profiles",
    "clipped samples and errors of channels",
)
"""Checks of other optima and of the shape of the likelihood, on which intervals of the weak form do not rest, and of causes
that cost more than they say where the power of the residuals is that of the noise."""
_JUDGED = (Verdict.CONVERGED, Verdict.SYSTEMATIC_MISFIT)
"""What the weak form says where the power of what it leaves is that of the noise."""


def judged_by_likelihood(answer: Estimate) -> Estimate:
    """The answer of the weak form with the verdict that the likelihood has on its laws and its values.

    It stays as it is where the power of its residuals says enough, of larger structures, and where the likelihood of a record
    cannot be searched from its values.
    """
    if answer.fit_verdicts[0] not in _JUDGED or answer.given_structure.size > _LARGEST:
        return answer
    fit = _fit(answer)
    if fit is None:
        return answer
    structure, record = answer.given_structure, answer.record
    examined = Examined(fit, (structure,), (record,), searched=True)
    judgement = judge(examined, without=_OF_THE_LIKELIHOOD)
    verdict, message = judgement.verdict, judgement.message
    covariance, unseen = answer.covariance, tuple[UnseenTerm, ...]()
    if verdict is Verdict.CONVERGED:
        tests, noise = examined.diagnosis.tested, judgement.leaves_noise
        beside = unseen_terms(fit, tests, covariance, terms=noise)
        verdict, message = _biased(answer, fit) or _undecided(answer, beside) or (verdict, message)
        covariance = sum(judgement.added.values(), covariance)
        unseen = unseen_terms(fit, tests, covariance, terms=noise)
    return replace(
        answer,
        fit_verdicts=(verdict,),
        message=message,
        covariance=covariance,
        diagnosis=judgement.diagnosis,
        unseen_terms=unseen,
        remarks=(*answer.remarks, *unseen_remark(unseen)),
    )


def _fit(answer: Estimate) -> LikelihoodFit | None:
    """The fit of exact laws from the values of an answer, or where these leave more than noise, one with looser links.

    None where the likelihood of the record is refused, or neither search converges.
    """
    larger = np.sqrt(answer.chi_square_per_sample or 1.0)  # as the weak form widens its intervals
    noise = {name: larger * sigma for name, sigma in answer.record.noise.items()}
    errors = np.sqrt(np.maximum(answer.covariance.diagonal(), 0.0))
    records = [replace(answer.record, noise=noise)]
    search = partial(likelihood_fit, records, answer.given_structure, answer.values, spread=errors)
    try:
        fit = search(options=LikelihoodOptions(model_error=False, steps=_STEPS))
        if fit.status is AnnealingStatus.CONVERGED and not fit.chi_square_off:
            return fit
        fit = search(options=LikelihoodOptions(model_error=False, tightest=_LOOSE))
    except (LinkwiseError, np.linalg.LinAlgError):
        return None
    return fit if fit.status is AnnealingStatus.CONVERGED else None


def _biased(answer: Estimate, fit: LikelihoodFit) -> tuple[Verdict, str] | None:
    """The verdict where the likelihood moves a coefficient farther than standard errors of the weak form allow."""
    deviations = np.sqrt(np.maximum(answer.covariance.diagonal(), np.finfo(float).tiny))
    moved = np.where(answer.free & fit.free, np.abs(fit.values - answer.values) / deviations, 0.0)
    farthest = int(np.argmax(moved))
    if moved[farthest] ** 2 <= _CHANCE + 2.0 * np.log(len(moved)):
        return None
    return Verdict.BIASED, (
        f"The laws explain the record to within its noise with {answer.parameters[farthest].name} {moved[farthest]:.2g} "
        "standard errors from here: the weak form is biased, as by gaps, kinks or samples too far apart for the motion. Use "
        'method "ml".'
    )


def _undecided(answer: Estimate, unseen: tuple[UnseenTerm, ...]) -> tuple[Verdict, str] | None:
    """The verdict where the record of a steady motion leaves damping open that would move a coefficient far."""
    if not answer.record.inputs:  # a decay has many amplitudes
        return None
    structure = answer.given_structure
    for term in unseen:
        if term.term not in _DAMPING or _is_nonlinear_in_rate(structure.link(term.link)):
            continue
        if term.standard_errors > _TOO_FAR[0] and term.relative_change > _TOO_FAR[1]:
            return Verdict.HARDLY_DETERMINED, (
                f"The laws explain the record to within its noise, but the record does not rule out {term.description}: where "
                "the motion is steady, friction and quadratic damping look like a linear damper. Record a free decay, or "
                "forces of several amplitudes, for longer or with less noise; or add the term to the law."
            )
    return None


def _is_nonlinear_in_rate(link: Link) -> bool:
    """Whether the slope of the law changes with v, or the law is not smooth by v, as sign(v), of slope 0."""
    slope = differentiate(link.law.expression, "v")
    return any("v" in symbols(expression) for expression in (slope, *kinks(link.law.expression)))
