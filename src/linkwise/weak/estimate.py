"""The weak form (METHODS section 4) as a method of identification: regression, search and verdict.

Coefficients that enter laws linearly follow from one regression, others from Gauss-Newton steps (`weak_search`). Where a law
needs a smoothed rate, intervals hold what that may have done to the coefficients (`_with_smoothing`). `record_misfit` says how
well a structure explains a record as it stands, to compare what may have been recorded in its place: a channel of the wrong
sign, in another unit or in the place of another leaves residuals that no change of coefficients explains.

The answer can be trusted where noise explains what is left (`judgement`), and nothing of that follows the motion. The latter
is a score test of weak equations: terms that links lack most often, each of size zero, one at a time. The score of
a term is the sum over windows of the term times what the laws leave, without the bias due to noise and beside the coefficients
of the laws (Rao 1948); its variance is that of the normal equations due to noise. The equations of each patch of
masses are tested alone, so that the cost grows with the structure and not with its square.

References
----------
C. R. Rao, Math. Proc. Cambridge Philos. Soc. 44, 50 (1948), for the score test.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import compress
from math import sqrt
from typing import ClassVar, final

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import NoiseEstimate
from linkwise.estimates.estimate import Estimate, Estimator
from linkwise.estimates.link_estimate import LinkMotion, extremes, forces_with_memory
from linkwise.expression import to_text
from linkwise.model.coefficient import Coefficient
from linkwise.model.link import refuse_memory, with_term
from linkwise.model.structure import Structure, refuse_rig
from linkwise.progress import Progress
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import FramedRecord, framed
from linkwise.signals.noise import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, read_displacements, source_names
from linkwise.weak.equations import Patch, WeakEquations, weak_equations, weak_residual
from linkwise.weak.fit import (
    SIGNIFICANT,
    NoisyPatch,
    WeakFit,
    normal_equations,
    residual_power,
    score_blocks,
    significance,
    solver,
    summed_blocks,
    weak_fit,
    with_priors,
)
from linkwise.weak.layout import structure_layout
from linkwise.weak.weak_form import weak_law
from linkwise.weak.window import ORDER, Window

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
        return Verdict.MEASUREMENT_ERROR, (
            f"The record contradicts what is stated of {', '.join(contradicted)} by more than four standard errors, so no "
            "interval is given: correct the value or its sigma, or look for an error of a sensor or a term that a law lacks, "
            "such as friction."
        )
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
    lowest, highest = _limits(sum(len(patch.layout.masses) * patch.windows for patch in equations.patches))
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
        for mass, kilograms in zip(patch.layout.masses, patch.layout.inertia.at(fit.values), strict=True)
        if kilograms
    ]
    return float(max(shares) * np.sqrt(1.0 - 1.0 / fit.excess))


_ADDED = {"added2": "d**2", "added3": "d**3", "drag": "v*abs(v)", "friction": "sign(v)"}
_COLLINEAR = 1e-6  # of its own moment: what is left of a term beside those of the laws
_CANCELLED = 0.1  # of what white noise would give: a smaller variance is the difference of large ones that are not exact
_NOISE_POWER = 0.03  # relative error of the power of noise that is found; of stated noise, what its residuals say is added
_CHANCE = 8.0  # with twice the logarithm of the number of scores: normal scores give one in 300 fits


def _missing_force(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> str:
    """The most significant term that a link lacks, in words; empty where chance explains all scores."""
    wide = _with_terms(structure)
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
    return (
        f"{_ADDED[name.key.rstrip('_')]} in {name.owner}, {abs(scores[largest]):.3g} standard errors in size"
    )


def _scores(
    patch: Patch, system: WeakEquations, values: Floats, tested: Bools, excess: float, uncertain: float
) -> tuple[Indices, Floats]:
    """Numbers (s,) of the tested terms of a patch, and their scores: 0 for those that the laws have or noise hides."""
    numbers = np.unique(patch.layout.free_parameters)
    numbers = numbers[np.argsort(tested[numbers], kind="stable")]
    p, weights = int(np.count_nonzero(~tested[numbers])), [1.0 / residual_power(patch, values)]

    def sums(bias: float) -> tuple[Floats, Floats]:
        moments, right = normal_equations([patch], weights, numbers, bias=bias)
        return moments, right - moments @ values[numbers]

    (moments, slope), (biased, biased_slope) = sums(0.0), sums(1.0)
    scatter = summed_blocks(score_blocks([NoisyPatch.of(patch, system, values)], weights), numbers)
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
def _with_terms(structure: Structure) -> Structure:
    """The structure with an unknown coefficient for each term that a law has none for."""
    links = []
    for link in structure.links:
        free = (name for name in link.law.linear if link.coefficients[name].value is None)
        unknown = {to_text(link.law.basis[name]).replace(" ", "") for name in free}
        new = {name: term for name, term in _ADDED.items() if term not in unknown}
        form = " + ".join(f"{{{number}}}*({term})" for number, term in enumerate(new.values()))
        links.append(with_term(link, form, dict.fromkeys(new, Coefficient.unknown())) if new else link)
    return replace(structure, links=tuple(links))


_WIDER = 1.4  # rates are smoothed by test functions of so many times the width: twice the width flattens fast motion
_SHARED = 0.5  # neighbouring windows share their noise, so that two count as one
_STEPS = 40  # of Gauss-Newton for coefficients that enter a law nonlinearly
_CONVERGED_STEP = 1e-3  # of a standard error
_NOT_CONVERGED = (
    f"The search for the coefficients that enter a law nonlinearly did not converge in {_STEPS} steps; give starts nearer to "
    "their values, or bounds."
)


@final
@dataclass(frozen=True)
class WeakForm(Estimator):
    """The weak form, with the bias due to noise removed: the method "weak" of `identify`.

    The equations of motion are multiplied by test functions and integrated over short windows, so that no signal is
    differentiated. It needs displacements and one record, takes milliseconds, and has no options; `identify` has its answers
    judged by the likelihood for up to six masses, which takes tenths of a second. States of links with memory are measured.

    References
    ----------
    D. A. Messenger and D. M. Bortz, J. Comput. Phys. 443, 110525 (2021), for weak-form regression.

    W. A. Fuller, Measurement Error Models (1987), for the bias.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> lw.identify(record, chain.unknown("nes"), method=lw.WeakForm()).method
    'weak'
    """

    method: ClassVar[str] = "weak"

    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """Estimate the unknowns of a structure by the weak form.

        Parameters
        ----------
        records : sequence of Record
            A single record.
        structure : Structure
            The structure, with one unknown at least.
        progress : Progress
            Not called: the regression takes milliseconds.

        Returns
        -------
        Estimate
            The answer.

        Raises
        ------
        IdentificationError
            If there are several records, no displacements, or a parameter that the record does not determine.
        """
        refuse_rig(structure, 'method "weak"')
        given = self.only_record(records)
        frame = framed(given, structure)
        record = frame.record
        with one_blas_thread():
            # refuses states that are not linear, which measuring them would not change
            structure_layout(structure)
            motion = read_displacements(record, structure)
            equations, fit, converged = weak_search(record, structure, motion)
            if converged:
                fit = _with_smoothing(record, structure, equations, fit)
            fit, contradicted = with_priors(fit, structure.parameters)
            verdict, message = Verdict.NOT_CONVERGED, _NOT_CONVERGED
            if converged:
                verdict, message = judgement(record, structure, equations, fit, contradicted)
        return Estimate(
            method="weak",
            fit_verdicts=(verdict,),
            message=message,
            seconds=0.0,
            given_structure=structure,
            parameters=structure.parameters,
            values=fit.values,
            covariance=fit.covariance,
            free=fit.free,
            noise=_noise(structure, motion, frame),
            chi_square_per_sample=fit.excess,
            samples=motion.samples,
            compute_motion=partial(_link_motion, structure, equations, fit.values),
            record=given,
            remarks=tuple(_remarks(record, structure, fit.excess)),
        )


def weak_search(
    record: Record,
    structure: Structure,
    motion: MeasuredDisplacements,
    given: Mapping[str, float] | None = None,
) -> tuple[WeakEquations, WeakFit, bool]:
    """Regression on weak equations, with Gauss-Newton iterations where coefficients enter a law nonlinearly.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure.
    motion : MeasuredDisplacements
        Displacements of the record.
    given : mapping of str to float, optional
        Starts by name of the parameter; those of the structure by default.

    Returns
    -------
    equations : WeakEquations
        The equations at the last iterate.
    fit : WeakFit
        The parameters.
    converged : bool
        Whether the iterations converged.

    Raises
    ------
    IdentificationError
        As `weak_equations` and `weak_fit`.
    """
    layout = structure_layout(structure)
    nonlinear = {layout.names[number] for number in layout.nonlinear}
    if not nonlinear:
        equations = weak_equations(record, structure, motion)
        return equations, weak_fit(equations, structure), True
    known = {p.name: p.start for p in structure.parameters if p.start is not None} | dict(given or {})
    starts = {name: value for name, value in known.items() if name in nonlinear}
    linear, values = structure.with_values(starts), dict(starts)
    try:
        if linear.parameters:
            equations = weak_equations(record, linear, motion)
            values |= equations.by_name(weak_fit(equations, linear).values)
        last: dict[str, float] = {}
        for _ in range(_STEPS):
            equations = weak_equations(record, structure, motion, values=values)
            finite = all(np.isfinite(patch.moments).all() for patch in equations.patches)
            if last and not finite:  # as where a resistance, by which a law divides, reaches 0
                values = {name: 0.5 * (value + last[name]) for name, value in values.items()}
                continue
            fit = weak_fit(equations, structure)
            step = np.array([fit.values[i] - values[name] for i, name in enumerate(equations.parameters)])
            deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
            if np.all(np.abs(step) <= np.maximum(_CONVERGED_STEP * deviations, 1e-9 * np.abs(fit.values))):
                return equations, fit, True
            reached = equations.by_name(fit.values)
            last, values = reached | values, reached
    except IdentificationError as error:
        if not starts:
            raise
        where = ", ".join(f"{name} = {values[name]:.4g}" for name in starts)
        raise IdentificationError(
            f"{error}. The search was at {where}; give starts nearer to their values, or bounds"
        ) from None
    return equations, fit, False


def record_misfit(record: Record, structure: Structure) -> float:
    """-2 log likelihood of the weak equations of a structure in a record, with the coefficients that fit it best.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure, with one unknown at least.

    Returns
    -------
    float
        The misfit, up to a constant that is the same for records that differ by a factor, a shift or the order of their
        channels: the residuals are those of the accelerations, relative to what was recorded of these.

    Raises
    ------
    IdentificationError
        As `weak_search`.
    """
    refuse_memory(structure.links, "the comparison of channels", "their states have no acceleration")
    equations, fit, _ = weak_search(record, structure, read_displacements(record, structure))
    misfit = 0.0
    for patch in equations.patches:
        noisy = NoisyPatch.of(patch, equations, fit.values)
        windows = equations.points[equations.inside]
        inertia = patch.rows[patch.layout.inertial] * noisy.masses[:, None]
        recorded = np.maximum(np.mean(inertia**2, axis=1, keepdims=True), np.finfo(float).tiny)
        terms = patch.residual(fit.values)[:, windows] ** 2 / noisy.power + np.log(noisy.power / recorded)
        misfit += equations.thinning * float(np.sum(terms @ patch.valid[windows]))
    return _SHARED * misfit


def _rated_links(structure: Structure) -> list[str]:
    """The links whose laws need a smoothed rate."""
    return [
        link.name for link in structure.links if weak_law(link.law, frozenset(link.law.nonlinear)).needs_rate
    ]


def _with_smoothing(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> WeakFit:
    """The fit with a covariance that includes what the smoothing of rates may have done to it.

    A law that jumps by the rate, as friction, bends the motion within the window that smooths the rate, so that zeros of the
    rate move, by a part of the width of that window: coefficients change in proportion as rates are smoothed more. A law that
    bends is biased by a higher power of the width, for which the proportion is a bound.
    """
    if not (_rated_links(structure) and fit.free.any()):
        return fit
    try:
        bias = _change(record, structure, equations, fit) / (_WIDER - 1.0)
    except IdentificationError:  # too few windows by the wider one, or the law is not finite by it
        return fit
    return replace(fit, covariance=fit.covariance + np.outer(bias, bias))


def _change(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> Floats:
    """(p,) change of the parameters as rates are smoothed more, to first order, in windows that both smoothings leave."""
    window, numbers, free = equations.window, np.arange(len(fit.values)), fit.free
    deviation = _WIDER * equations.rate_window.half / sqrt(2 * ORDER + 3)
    wide = weak_equations(
        record,
        structure,
        equations.motion,
        window=window,
        rate_window=Window.of_deviation(deviation, window.step),
        values=equations.by_name(fit.values),
    )
    valid = {mass: patch.valid for patch in wide.patches for mass in patch.layout.masses.tolist()}
    patches = [patch for patch in equations.patches if len(patch.layout.free_terms)]
    weights = [1.0 / residual_power(patch, fit.values) for patch in patches]
    shared = []
    for patch in patches:
        masses = patch.layout.masses.tolist()
        shared.append((masses, np.min([patch.valid, *(valid[mass] for mass in masses)], axis=0)))
    left = []
    for system in (equations, wide):
        own = [system.patch(masses, windows) for masses, windows in shared]
        normal, right = normal_equations(own, weights, numbers)
        left.append(right - normal @ fit.values)
    whole, change = normal_equations(patches, weights, numbers)[0], np.zeros(len(numbers))
    solve = solver(whole[np.ix_(free, free)], compress(equations.parameters, free))
    change[free] = solve((left[1] - left[0])[free])
    return change


def _link_motion(structure: Structure, equations: WeakEquations, values: Floats) -> LinkMotion:
    links = len(structure.links)
    identified = structure.with_values(equations.by_name(values))
    d, v = equations.d[:links].T, equations.v[:links].T
    states = zip(identified.topology.states, equations.states, strict=True)
    return LinkMotion(
        structure=identified,
        time=equations.time,
        d=d,
        v=v,
        d_range=_elongation_ranges(equations.motion, equations),
        compute_residual=partial(_force_residual, equations, values),
        identified_force=forces_with_memory(identified, (d, v), states, equations.signals),
    )


def _force_residual(equations: WeakEquations, values: Floats) -> Floats:
    """(R, n) residuals of the equations of masses and modes in N."""
    return weak_residual(equations, values)[:, : equations.structure_layout.structure.size]


def _elongation_ranges(motion: MeasuredDisplacements, equations: WeakEquations) -> Floats:
    """(L, 2) ranges in m, from the samples: averages over windows would cut the peaks."""
    layout, ranges = equations.structure_layout, []
    deviation = np.sqrt(equations.floored_elongation_variance)
    for link in range(len(layout.structure.links)):
        d = layout.elongations(motion.displacements, [link])
        nodes = [node for node, _ in layout.elements[link].reading if node < layout.equations]
        d[:, motion.missing[nodes].any(axis=0)] = np.nan
        ranges.append(extremes(d.T, deviation[[link]]))
    return np.concatenate(ranges)


def _noise(
    structure: Structure, motion: MeasuredDisplacements, frame: FramedRecord
) -> dict[str, NoiseEstimate]:
    given: dict[str, str] = {plain: name for name, plain in frame.names.items()}
    names = source_names(structure)
    moving = motion.has_channel[-2] and frame.acceleration is None
    measured = np.flatnonzero([*motion.has_channel[:-2], moving]).tolist()
    return {
        (name := given.get(names[i], names[i])): NoiseEstimate.from_power(
            float(motion.source_power[i]), float(np.sqrt(motion.source_variance[i])), unit_in(structure, name)
        )
        for i in measured
    }


def _remarks(record: Record, structure: Structure, excess: float) -> Iterator[str]:
    missing = int(record.missing.sum())
    if missing:
        yield f"{missing} samples are missing; equations that need them are left out."
    if NOTED_EXCESS < excess < LARGEST_EXCESS:
        yield (
            f"The residuals are {100.0 * (np.sqrt(excess) - 1.0):.0f} % larger than the noise explains: something small is "
            "missing from the laws. All intervals are widened by as much."
        )
    if rated := _rated_links(structure):
        yield (
            f"The law of {', '.join(rated)} is nonlinear in v, which the weak form takes from smoothed displacements; where v "
            "changes fast this biases the values. Intervals include what more smoothing would change, in proportion; method "
            '"ml" avoids it.'
        )
