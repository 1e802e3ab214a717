"""Whether the answer of the weak form can be trusted: what noise explains, and what in the record follows the motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, source_names
from linkwise.weak.equations import WeakEquations, weak_residual
from linkwise.weak.fit import SIGNIFICANT, WeakFit
from linkwise.weak.tested_terms import missing_term

LARGEST_EXCESS = 1.3  # residual power over what noise explains; right laws stay below it from 10 dB on
NOTED_EXCESS = 1.15  # right laws hardly ever leave more
_FALSE_ALARM = 1e-5  # probability that a record of few windows leaves the limits although its laws are right
_SKEWED = 0.1  # relative standard error of R or C: beyond, those that come out low look too sure, by four errors and more
_EXPLAINED = "The laws explain the record to within its noise"


def judgement(
    record: Record,
    structure: Structure,
    equations: WeakEquations,
    fit: WeakFit,
    contradicted: Sequence[str],
) -> tuple[Verdict, str]:
    """The most important that can be said of an answer, and the same in words.

    The record contradicts what is known beforehand of the parameters `contradicted`.
    """
    forbidden = _forbidden(record, structure, equations, fit)
    if forbidden is not None:
        return forbidden
    if contradicted:
        return Verdict.MEASUREMENT_ERROR, _contradiction(contradicted)
    lacking = missing_term(record, structure, equations, fit)
    if lacking is None:
        return Verdict.CONVERGED, f"{_EXPLAINED}."
    return Verdict.SYSTEMATIC_MISFIT, (
        f"{_EXPLAINED}, but what they leave follows the motion: a force like {lacking.term} in {lacking.link}, "
        f"{abs(lacking.z):.3g} standard errors in size, would explain a part of it. Intervals would count that as noise, so "
        'none is given; a term or a link is missing, or a sensor or a stated mass is wrong. Method "ml" distinguishes these.'
    )


def _forbidden(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> tuple[Verdict, str] | None:
    """What takes trust away before terms are tested."""
    if equations.motion.surplus > LARGEST_EXCESS:
        return Verdict.SYSTEMATIC_MISFIT, (
            "The sensors of a host do not move as its modes do: what they show beside these is "
            f"{np.sqrt(equations.motion.surplus):.3g} times their noise: a shape, a place or the "
            "sign of a sensor is wrong, modes that were left out move, or the noise is larger than stated."
        )
    lowest, highest = _limits(sum(len(patch.masses) * patch.windows for patch in equations.patches))
    times = f"{np.sqrt(fit.excess):.3g} times"
    if not fit.excess < highest:
        larger = ", or larger than stated" if record.noise else ""
        share = _model_error(equations, fit)
        return Verdict.NOISE_MISMATCH, (
            f"The laws explain the record to within {100.0 * share:.3g} % of its forces, which is {times} what noise "
            "would leave: a term is missing from a law, a link from the structure, a force from the "
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
            f"The residuals are only {times} what noise would leave: the noise is smaller than "
            f"{source} or not white, and the correction for its bias has biased the values. {advice}."
        )
    if _has_outliers(record, structure, equations.motion):
        return Verdict.OUTLIERS, (
            "The noise has more large errors than normal noise, for which the weak form corrects the "
            'bias. Remove the outliers, or use method "ml", with a robust loss where they are many.'
        )
    significances = zip(equations.parameters, fit.significance, strict=True)
    if hardly := [name for name, significance in significances if significance < SIGNIFICANT]:
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but the record contains hardly more information on {', '.join(hardly)} than the noise that the "
            "weak form subtracts, so that an interval would be too narrow. Give a number, record a motion that "
            'stands farther above the noise, or use method "ml", which needs no such correction.'
        )
    if skewed := _skewed(equations, fit):
        return Verdict.HARDLY_DETERMINED, (
            f"{_EXPLAINED}, but tells {', '.join(skewed)} to within more than {100.0 * _SKEWED:.0f} % only, and the rate of "
            "a state is not linear in these, so that an interval would be too narrow on one side. Give a number, "
            'record a motion that stands farther above the noise, or use method "ml".'
        )
    return None


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


def _limits(windows: float) -> tuple[float, float]:
    """Limits of the residual excess of right laws; neighbouring windows share their noise, so two count as one."""
    freedom = 0.5 * max(windows, 2.0)
    chances = [_FALSE_ALARM, 1.0 - _FALSE_ALARM]
    low, high = (scipy.special.gammaincinv(0.5 * freedom, chances) * 2.0 / freedom).tolist()
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
