"""Whether the answer of the weak form can be trusted: what noise explains, and what in the record follows the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.estimates.causes import UnseenTerm
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, source_names
from linkwise.weak.efficient_scores import efficient_scores
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import SIGNIFICANT, WeakFit
from linkwise.weak.pieces import disagreement
from linkwise.weak.residual import weak_residual
from linkwise.weak.score_tests import SignificantScore, significant_score
from linkwise.weak.unseen_terms import undecided_damping, unseen_terms

LARGEST_EXCESS = 1.3  # residual power over what noise explains; right laws stay below it from 10 dB on
NOTED_EXCESS = 1.15  # right laws hardly ever leave more
_FALSE_ALARM = 1e-5  # probability that a record of few windows leaves the limits although its laws are right
_SKEWED = 0.1  # relative standard error of R or C: beyond, those that come out low look too sure, by four errors and more
_EXPLAINED = "The laws explain the record to within its noise"


@dataclass(frozen=True)
class WeakJudgement:
    """What can be said of an answer.

    Attributes
    ----------
    verdict : Verdict
        The most important finding.
    message : str
        The finding in words.
    unseen_terms : tuple of UnseenTerm
        What the record does not rule out beside the laws.
    """

    verdict: Verdict
    message: str
    unseen_terms: tuple[UnseenTerm, ...] = ()


def judgement(
    record: Record,
    structure: Structure,
    equations: WeakEquations,
    fit: WeakFit,
    contradicted: Sequence[str] = (),
) -> WeakJudgement:
    """What can be said of an answer.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    equations : WeakEquations
        Its equations on the record.
    fit : WeakFit
        Their solution.
    contradicted : sequence of str, optional
        The parameters of which the record contradicts what is known beforehand.

    Returns
    -------
    WeakJudgement
        The finding, and terms that remain possible.
    """
    forbidden = _forbidden(record, structure, equations, fit)
    if forbidden is not None:
        return WeakJudgement(*forbidden)
    return _of_terms(record, structure, equations, fit, contradicted)


def _forbidden(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> tuple[Verdict, str] | None:
    """What takes trust away before terms are tested at the likeliest motion."""
    if equations.motion.surplus > LARGEST_EXCESS:
        return Verdict.SYSTEMATIC_MISFIT, (
            "The sensors of a host do not move as its modes do: what they show beside these is "
            f"{np.sqrt(equations.motion.surplus):.3g} times their noise, so no interval is given: a shape, a place or the "
            "sign of a sensor is wrong, modes that were left out move, or the noise is larger than stated."
        )
    lowest, highest = _limits(sum(len(patch.masses) * patch.windows for patch in equations.patches))
    times = f"{np.sqrt(fit.excess):.3g} times"
    if not fit.excess < highest:
        larger = ", or larger than stated" if record.noise else ""
        share = _model_error(equations, fit)
        return Verdict.NOISE_MISMATCH, (
            f"The laws explain the record to within {100.0 * share:.3g} % of its forces, which is {times} what noise "
            "would leave, so no interval is given: a term is missing from a law, a link from the structure, a force from the "
            f"record, the noise is not white{larger}, or the samples are too far apart to follow the motion. The values are "
            "the best of these laws."
        )
    if fit.excess < lowest and not equations.motion.noise_free:
        source, advice = (
            ("stated", "Correct the stated noise, or leave it out")
            if record.noise
            else ("estimated", "State it, if it is known")
        )
        return Verdict.NOISE_MISMATCH, (
            f"The residuals are only {times} what noise would leave, so no interval is given: the noise is smaller than "
            f"{source} or not white, and the correction for its bias has biased the values. {advice}."
        )
    if _has_outliers(record, structure, equations.motion):
        return Verdict.OUTLIERS, (
            "The noise has more large errors than normal noise, for which the weak form corrects the bias, so no "
            'interval is given. Remove the outliers, or use method "ml", with a robust loss where they are many.'
        )
    hardly = [
        name
        for name, significance in zip(equations.parameters, fit.significance, strict=True)
        if significance < SIGNIFICANT
    ]
    if hardly:
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but the record contains hardly more information on {', '.join(hardly)} than the noise that the "
            "weak form subtracts, so no interval is given: it would be too narrow. Give a number, record a motion that "
            'stands farther above the noise, or use method "ml", which needs no such correction.'
        )
    skewed = _skewed(equations, fit)
    if skewed:
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but tells {', '.join(skewed)} to within more than {100.0 * _SKEWED:.0f} % only, and the rate of "
            "a state is not linear in these, so no interval is given: it would be too narrow on one side. Give a number, "
            'record a motion that stands farther above the noise, or use method "ml".'
        )
    follows = _follows_the_motion(record, structure, equations, fit)
    if follows:
        return Verdict.SYSTEMATIC_MISFIT, f"{_EXPLAINED}, but {follows}"
    return None


def _of_terms(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit, contradicted: Sequence[str]
) -> WeakJudgement:
    """What terms that laws may lack make of an answer that nothing else takes trust from."""
    scores = efficient_scores(record, structure, equations, fit)
    lacking = None if scores is None else scores.significant()
    if lacking is not None:
        return WeakJudgement(Verdict.SYSTEMATIC_MISFIT, f"{_EXPLAINED}, but {_left(lacking)}")
    if contradicted:
        return WeakJudgement(Verdict.MEASUREMENT_ERROR, _contradiction(contradicted))
    if scores is None:
        return WeakJudgement(Verdict.CONVERGED, f"{_EXPLAINED}.")
    values = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    subject = structure.with_values(values), equations, fit
    driven = equations.force is not None or equations.motion.base is not None
    damping = undecided_damping(scores, *subject) if driven else None  # a decay has many amplitudes
    if damping is not None:
        return WeakJudgement(
            Verdict.HARDLY_DETERMINED,
            f"{_EXPLAINED}, but the record does not rule out {damping.description}, so no interval is given: where the motion "
            "is steady, friction and quadratic damping look like a linear damper. Record a free decay, or forces of several "
            "amplitudes, for longer or with less noise; or add the term to the law.",
        )
    return WeakJudgement(Verdict.CONVERGED, f"{_EXPLAINED}.", unseen_terms(scores, *subject))


def _contradiction(contradicted: Sequence[str]) -> str:
    return (
        f"The record contradicts what is stated of {', '.join(contradicted)} by more than four standard errors, so no "
        "interval is given: correct the value or its sigma, or look for an error of a sensor or a term that a law lacks, such "
        "as friction."
    )


def _skewed(equations: WeakEquations, fit: WeakFit) -> list[str]:
    """The coefficients that enter rates of states nonlinearly, as 1/R, and are too uncertain for a symmetric interval."""
    layout, deviations = equations.structure_layout, np.sqrt(fit.covariance.diagonal())
    remembers = {element.link for element in layout.elements[len(layout.structure.links) :]}
    of_memory = {number for (link, _), number in layout.parameter_index.items() if link in remembers}
    return [
        equations.parameters[number]
        for number in sorted(of_memory.intersection(layout.nonlinear))
        if deviations[number] > _SKEWED * abs(fit.values[number])
    ]


def _has_outliers(record: Record, structure: Structure, motion: MeasuredDisplacements) -> bool:
    numbers = np.flatnonzero(motion.has_channel[:-2])
    names = source_names(structure)
    samples = np.stack([record.channel(names[number]) for number in numbers.tolist()], axis=1)
    return has_outliers(samples, np.sqrt(motion.source_variance[numbers]))


def _follows_the_motion(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> str:
    """What in the record follows the motion and the laws do not explain, in words; empty where there is nothing."""
    lacking = significant_score(record, structure, equations, fit.values, fit.excess)
    if lacking is not None:
        return _left(lacking)
    wrong_noise = (
        bool(record.noise) and fit.excess > NOTED_EXCESS
    )  # of which the bias differs from piece to piece
    apart = None if wrong_noise else disagreement(record, structure, equations, fit)
    if apart is not None:
        return (
            f"pieces of it do not agree on {apart.name}: they give {apart.lowest:.3g} to "
            f"{apart.highest:.3g}, which chance does not explain, so no interval is given. A term is missing that depends on "
            'how large the motion is, such as friction, or the structure changed. Method "ml" names terms.'
        )
    return ""


def _left(lacking: SignificantScore) -> str:
    return (
        f"what they leave follows the motion: {lacking.description}, {abs(lacking.z):.3g} standard "
        "errors in size, would explain a part of it. Intervals would count that as noise, so none is given; a term or a "
        'link is missing, or a sensor or a stated mass is wrong. Method "ml" distinguishes these.'
    )


def _limits(windows: float) -> tuple[float, float]:
    """Limits of the residual excess of right laws; neighbouring windows share their noise, so two count as one."""
    freedom = 0.5 * max(windows, 2.0)
    low, high = (
        float(scipy.special.gammaincinv(0.5 * freedom, chance)) * 2.0 / freedom
        for chance in (_FALSE_ALARM, 1.0 - _FALSE_ALARM)
    )
    return min(low, 1.0 / LARGEST_EXCESS), max(high, LARGEST_EXCESS)


def _model_error(equations: WeakEquations, fit: WeakFit) -> float:
    """Root mean square of the residuals less their noise, over that of the force on the mass; of the worst mass."""
    residual = weak_residual(equations, fit.values)
    shares = [
        np.sqrt(np.nanmean(residual[:, mass] ** 2) / np.mean(equations.acceleration[mass] ** 2)) / kilograms
        for patch in equations.patches
        for mass, kilograms in zip(patch.masses, patch.layout.inertia.at(fit.values), strict=True)
        if kilograms
    ]
    return float(max(shares) * np.sqrt(1.0 - 1.0 / fit.excess))
