"""Whether the answer of the weak form can be trusted: what noise explains, and what in the record follows the motion.

The latter is a score test of weak equations: terms that links lack most often, each of size zero, one at a time. The score of
a term is the sum over windows of the term times what the laws leave, without the bias due to noise and beside the coefficients
of the laws (Rao 1948); its variance is that of the normal equations due to noise (`scatter`). The equations of each patch of
masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import Link, with_term
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.noise import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, source_names
from linkwise.weak.equations import WeakEquations, weak_equations, weak_residual
from linkwise.weak.fit import SIGNIFICANT, WeakFit, dense_blocks, normal_blocks, residual_power, significance
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import NoisyPatch, score_blocks

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
    lacking = _missing_force(record, structure, equations, fit)
    if not lacking:
        return Verdict.CONVERGED, f"{_EXPLAINED}."
    return Verdict.SYSTEMATIC_MISFIT, (
        f"{_EXPLAINED}, but what they leave follows the motion: a force like {lacking}, would explain a part of it. "
        "Intervals would count that as noise, so none is given; a term or a link is missing, or a sensor or a stated mass is "
        'wrong. Method "ml" distinguishes these.'
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


_TERMS = ("d**2", "d**3", "v*abs(v)", "sign(v)")
_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_CANCELLED = 0.1  # of what white noise would give: a smaller variance is the difference of large ones that are not exact
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits


def _missing_force(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> str:
    """The most significant term that a link lacks, in words; empty where chance explains all scores."""
    wide, added = _with_terms(structure)
    known = equations.by_name(fit.values)
    uncertain = _NOISE_POWER + (abs(fit.excess - 1.0) if record.noise else 0.0)
    try:
        system = weak_equations(record, wide, equations.motion, window=equations.window, values=known)
        values = np.array([known.get(name, 0.0) for name in system.parameters])
        tested = np.array([name not in known for name in system.parameters])
        scores = np.zeros(len(values))
        for patch in system.patches:
            numbers, z = _scores(patch, system, values, tested, max(fit.excess, 1.0), uncertain)
            scores[numbers] = np.where(np.abs(z) > np.abs(scores[numbers]), z, scores[numbers])
    except (IdentificationError, np.linalg.LinAlgError):  # a term may not be finite along the motion
        return ""
    largest = int(np.argmax(np.abs(scores)))
    if not scores[largest] ** 2 > _CHANCE + 2.0 * float(np.log(max(np.sum(tested), 1))):
        return ""
    name = wide.parameters[largest].name
    return f"{added[name.key]} in {name.owner}, {abs(scores[largest]):.3g} standard errors in size"


def _scores(
    patch: Patch, system: WeakEquations, values: Floats, tested: Bools, excess: float, uncertain: float
) -> tuple[Indices, Floats]:
    """Numbers (s,) of the tested terms of a patch, and their scores: 0 for those that the laws have or noise hides."""
    numbers = np.unique(patch.layout.free_parameters)
    numbers = numbers[np.argsort(tested[numbers], kind="stable")]
    p, weights = int(np.count_nonzero(~tested[numbers])), [1.0 / residual_power(patch, values)]

    def sums(bias: float) -> tuple[Floats, Floats]:
        blocks, right = normal_blocks([patch], weights, len(values), bias=bias)
        moments = dense_blocks(blocks, numbers)
        return moments, right[numbers] - moments @ values[numbers]

    (moments, slope), (biased, biased_slope) = sums(0.0), sums(1.0)
    scatter = dense_blocks(score_blocks([NoisyPatch.of(patch, system, values)], weights), numbers)
    scale = 1.0 / np.sqrt(np.maximum(biased.diagonal(), np.finfo(float).tiny))
    moments, biased, scatter = (matrix * np.outer(scale, scale) for matrix in (moments, biased, scatter))
    beside = np.linalg.lstsq(moments[:p, :p], moments[:p, p:], rcond=_COLLINEAR**2)[0]
    across = np.concatenate([-beside, np.eye(len(numbers) - p)])
    matrices = (moments, biased - moments, scatter)
    left, bias, variance = (np.einsum("ij,ij->j", across, matrix @ across) for matrix in matrices)
    own, noise = moments.diagonal()[p:], scatter.diagonal()[p:]
    stands = (left > _COLLINEAR) & (own > 0.0) & (noise > 0.0)
    white = np.where(stands, left * noise, 0.0) / np.where(stands, own, 1.0)
    stands &= (variance > _CANCELLED * white) & (significance(left, bias, system.windows) > SIGNIFICANT)
    added = uncertain * (across.T @ (scale * (biased_slope - slope)))
    variance = excess * np.maximum(variance, white) + added**2
    scores = np.where(stands, across.T @ (scale * slope), 0.0)
    return numbers[p:], scores / np.sqrt(np.where(stands, variance, 1.0))


@lru_cache(maxsize=32)
def _with_terms(structure: Structure) -> tuple[Structure, dict[str, str]]:
    """The structure with an unknown coefficient for each term that a law has none for, and the terms by their names."""
    prefix = "added"
    while any(name.startswith(prefix) for link in structure.links for name in link.coefficients):
        prefix += "_"
    added = {f"{prefix}{number}": term for number, term in enumerate(_TERMS)}
    links = tuple(_with_link_terms(link, added) for link in structure.links)
    return replace(structure, links=links), added


def _with_link_terms(link: Link, added: dict[str, str]) -> Link:
    free = (name for name in link.law.linear if link.coefficients[name].value is None)
    unknown = {to_text(link.law.basis[name]).replace(" ", "") for name in free}
    new = {name: term for name, term in added.items() if term not in unknown}
    form = " + ".join(f"{{{number}}}*({term})" for number, term in enumerate(new.values()))
    return with_term(link, form, dict.fromkeys(new, Coefficient.unknown())) if new else link
