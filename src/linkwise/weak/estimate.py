"""The weak form (METHODS section 4) as a method of identification: regression, search and verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, final

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.estimator import Estimator
from linkwise.estimates.link_motion import LinkMotion, extremes
from linkwise.estimates.noise_estimate import NoiseEstimate
from linkwise.model.memory_support import refuse_memory
from linkwise.model.rig_support import refuse_rig
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import FramedRecord, framed
from linkwise.signals.outliers import has_outliers
from linkwise.verdict import Verdict
from linkwise.weak.displacements import MeasuredDisplacements, read_displacements, source_names
from linkwise.weak.equations import WeakEquations, weak_equations
from linkwise.weak.fit import SIGNIFICANT, WeakFit, weak_fit
from linkwise.weak.pieces import disagreement
from linkwise.weak.priors import with_priors
from linkwise.weak.residual import weak_residual
from linkwise.weak.score_tests import significant_score
from linkwise.weak.weak_form import weak_law

_LARGEST_EXCESS = 1.3  # residual power over what noise explains; right laws stay below it from 10 dB on
_NOTED_EXCESS = 1.15  # right laws hardly ever leave more
_FALSE_ALARM = 1e-5  # probability that a record of few windows leaves the limits although its laws are right
_LINKS_AT_ONCE = 16  # whose samples are in memory at a time
_STEPS = 40  # of Gauss-Newton for coefficients that enter a law nonlinearly
_CONVERGED_STEP = 1e-3  # of a standard error


@final
@dataclass(frozen=True)
class WeakForm(Estimator):
    """The weak form, with the bias due to noise removed: the method "weak" of `identify`.

    The equations of motion are multiplied by test functions and integrated over short windows, so that no signal is
    differentiated. It needs displacements and one record, takes milliseconds, and has no options.

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
        refuse_memory(structure.links, 'method "weak"', "maximum likelihood takes it")
        given = self.only_record(records)
        frame = framed(given, structure)
        record = frame.record
        with one_blas_thread():
            motion = read_displacements(record, structure)
            equations, fit, converged = weak_search(record, structure, motion)
            fit, contradicted = with_priors(fit, structure.parameters)
        verdict, message = (
            _verdict(record, structure, equations, fit)
            if converged
            else (Verdict.NOT_CONVERGED, _NOT_CONVERGED)
        )
        if contradicted and not verdict.forbids:
            verdict, message = Verdict.MEASUREMENT_ERROR, _contradiction(contradicted)
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
    nonlinear = _nonlinear(structure)
    if not nonlinear:
        equations = weak_equations(record, structure, motion)
        return equations, weak_fit(equations, structure), True
    known = {p.name: p.start for p in structure.parameters if p.start is not None} | dict(given or {})
    starts = {name: value for name, value in known.items() if name in nonlinear}
    linear, values = structure.with_values(starts), dict(starts)
    try:
        if linear.parameters:
            equations = weak_equations(record, linear, motion)
            values.update(
                zip(equations.parameters, map(float, weak_fit(equations, linear).values), strict=True)
            )
        for _ in range(_STEPS):
            equations = weak_equations(record, structure, motion, values=values)
            fit = weak_fit(equations, structure)
            step = np.array([fit.values[i] - values[name] for i, name in enumerate(equations.parameters)])
            deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
            if np.all(np.abs(step) <= np.maximum(_CONVERGED_STEP * deviations, 1e-9 * np.abs(fit.values))):
                return equations, fit, True
            values = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    except IdentificationError as error:
        if not starts:
            raise
        last = ", ".join(f"{name} = {values[name]:.4g}" for name in starts)
        raise IdentificationError(
            f"{error}. The search was at {last}; give starts nearer to their values, or bounds"
        ) from None
    return equations, fit, False


def _contradiction(contradicted: Sequence[str]) -> str:
    return (
        f"The record contradicts what is stated of {', '.join(contradicted)} by more than four standard errors, so no "
        "interval is given: correct the value or its sigma, or look for an error of a sensor."
    )


_NOT_CONVERGED = (
    f"The search for the coefficients that enter a law nonlinearly did not converge in {_STEPS} steps; give starts nearer to "
    "their values, or bounds."
)


def _nonlinear(structure: Structure) -> set[str]:
    """The parameters that enter a law nonlinearly."""
    return {
        parameter.name
        for parameter in structure.parameters
        if any(index >= 0 and key in structure.links[index].law.nonlinear for index, key in parameter.members)
    }


def _verdict(
    record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit
) -> tuple[Verdict, str]:
    if equations.motion.surplus > _LARGEST_EXCESS:
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
    explained = "The laws explain the record to within its noise"
    hardly = [
        name
        for name, significance in zip(equations.parameters, fit.significance, strict=True)
        if significance < SIGNIFICANT
    ]
    if hardly:
        return Verdict.HARDLY_DETERMINED, (
            f"{explained}, but the record contains hardly more information on {', '.join(hardly)} than the noise that the "
            "weak form subtracts, so no interval is given: it would be too narrow. Give a number, record a motion that "
            'stands farther above the noise, or use method "ml", which needs no such correction.'
        )
    follows = _follows_the_motion(record, structure, equations, fit)
    if follows:
        return Verdict.SYSTEMATIC_MISFIT, f"{explained}, but {follows}"
    return Verdict.CONVERGED, f"{explained}."


def _has_outliers(record: Record, structure: Structure, motion: MeasuredDisplacements) -> bool:
    numbers = np.flatnonzero(motion.has_channel[:-2])
    names = source_names(structure)
    samples = np.stack([record.channel(names[number]) for number in numbers.tolist()], axis=1)
    return has_outliers(samples, np.sqrt(motion.source_variance[numbers]))


def _follows_the_motion(record: Record, structure: Structure, equations: WeakEquations, fit: WeakFit) -> str:
    """What in the record follows the motion and the laws do not explain, in words; empty where there is nothing."""
    lacking = significant_score(record, structure, equations, fit.values, fit.excess)
    if lacking is not None:
        return (
            f"what they leave follows the motion: {lacking.description}, {abs(lacking.z):.3g} standard "
            "errors in size, would explain a part of it. Intervals would count that as noise, so none is given; a term or a "
            'link is missing, or a sensor or a stated mass is wrong. Method "ml" distinguishes these.'
        )
    wrong_noise = (
        bool(record.noise) and fit.excess > _NOTED_EXCESS
    )  # of which the bias differs from piece to piece
    apart = None if wrong_noise else disagreement(record, structure, equations, fit)
    if apart is not None:
        return (
            f"pieces of it do not agree on {apart.name}: they give {apart.lowest:.3g} to "
            f"{apart.highest:.3g}, which chance does not explain, so no interval is given. A term is missing that depends on "
            'how large the motion is, such as friction, or the structure changed. Method "ml" names terms.'
        )
    return ""


def _limits(windows: float) -> tuple[float, float]:
    """Limits of the residual excess of right laws; neighbouring windows share their noise, so two count as one."""
    freedom = 0.5 * max(windows, 2.0)
    low, high = (
        float(scipy.special.gammaincinv(0.5 * freedom, chance)) * 2.0 / freedom
        for chance in (_FALSE_ALARM, 1.0 - _FALSE_ALARM)
    )
    return min(low, 1.0 / _LARGEST_EXCESS), max(high, _LARGEST_EXCESS)


def _model_error(equations: WeakEquations, fit: WeakFit) -> float:
    """Root mean square of the residuals less their noise, over that of the force on the mass; of the worst mass."""
    residual = weak_residual(equations, fit.values)
    shares = [
        np.sqrt(np.nanmean(residual[:, mass] ** 2) / np.mean(equations.acceleration[mass] ** 2)) / kilograms
        for patch in equations.patches
        for mass, kilograms in zip(patch.masses, patch.layout.inertia.at(fit.values), strict=True)
    ]
    return float(max(shares) * np.sqrt(1.0 - 1.0 / fit.excess))


def _link_motion(structure: Structure, equations: WeakEquations, values: Floats) -> LinkMotion:
    return LinkMotion(
        structure=structure.with_values(dict(zip(equations.parameters, map(float, values), strict=True))),
        time=equations.time,
        d=equations.d.T,
        v=equations.v.T,
        d_range=_elongation_ranges(equations.motion, equations),
        compute_residual=partial(weak_residual, equations, values),
    )


def _elongation_ranges(motion: MeasuredDisplacements, equations: WeakEquations) -> Floats:
    """(L, 2) ranges in m, from the samples: averages over windows would cut the peaks."""
    layout, ranges = equations.structure_layout, []
    deviation = np.sqrt(equations.context.floored_elongation_variance)
    for first in range(0, len(layout.readings), _LINKS_AT_ONCE):
        links = range(first, min(first + _LINKS_AT_ONCE, len(layout.readings)))
        d = layout.elongations(motion.displacements, links)
        if motion.missing is not None:
            for row, link in zip(d, links, strict=True):
                nodes = [node for node, _ in layout.readings[link] if node < len(motion.missing)]
                row[motion.missing[nodes].any(axis=0)] = np.nan
        ranges.append(extremes(d.T, deviation[links.start : links.stop]))
    return np.concatenate(ranges)


def _noise(
    structure: Structure, motion: MeasuredDisplacements, frame: FramedRecord
) -> dict[str, NoiseEstimate]:
    given = {plain: name for name, plain in frame.names.items()}
    names = source_names(structure)
    moving = motion.base is not None and frame.acceleration is None
    measured = np.flatnonzero([*motion.has_channel[:-2], moving]).tolist()
    return {
        given.get(names[i], names[i]): NoiseEstimate.from_power(
            float(motion.source_power[i]), names[i], float(np.sqrt(motion.source_variance[i]))
        )
        for i in measured
    }


def _remarks(record: Record, structure: Structure, excess: float) -> Iterator[str]:
    missing = int(record.missing.sum())
    if missing:
        yield f"{missing} samples are missing; equations that need them are left out."
    if _NOTED_EXCESS < excess < _LARGEST_EXCESS:
        yield (
            f"The residuals are {100.0 * (np.sqrt(excess) - 1.0):.0f} % larger than the noise explains: something small is "
            "missing from the laws. All intervals are widened by as much."
        )
    rated = [
        link.name for link in structure.links if weak_law(link.law, frozenset(link.law.nonlinear)).needs_rate
    ]
    if rated:
        yield (
            f"The law of {', '.join(rated)} is nonlinear in v, which the weak form takes from smoothed displacements; where v "
            'changes fast this biases the values, and method "ml" avoids it.'
        )
