"""The verdict on a maximum-likelihood fit: whether it converged, and whether its residuals are noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import Cause
from linkwise.likelihood.checks.held_errors import (
    LARGEST_SHIFT,
    LARGEST_TERM,
    CountedCauses,
    MissingTerms,
    counted_causes,
    decisive,
    for_missing_terms,
    held_errors,
    intervals_by_blocks,
    likeliest,
    moved,
    not_held,
    of_error_beside_terms,
    of_held_errors,
    of_instrument,
    of_systematic_misfit,
    would_explain,
)
from linkwise.likelihood.checks.model_error import (
    CloserFit,
    Doubt,
    HiddenTerm,
    doubt,
    held_closer,
    hidden_term,
    share_of_term,
    with_small_model_error,
)
from linkwise.likelihood.checks.unstated_forces import unstated_forces
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.noise import is_coloured, lag_one_autocorrelation
from linkwise.likelihood.optima.hidden_wells import about_another_rest
from linkwise.likelihood.optima.other_optima import is_regular, undetermined_far_away, with_faint_modes
from linkwise.likelihood.shooting.minimise import AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.tests.diagnosis import (
    HintedMasses,
    TestedCauses,
    diagnose,
    hinted_masses,
    likeliest_first,
)
from linkwise.likelihood.tests.variances import (
    SPECTRAL_KINDS,
    InputNoise,
    for_noise_of_inputs,
    noise_of_inputs,
)
from linkwise.model.names import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE, Channel
from linkwise.signals.noise import outliers_exceed_noise
from linkwise.verdict import Grade, Verdict

_NEXT_TO_NOTHING = 0.01  # of the noise: memory over 100 samples makes residuals no larger than that
_LARGEST_ERROR = 0.1
"""Relative to the forces on a mass: the largest model error that is trusted. Intervals include the error to first order; the
neglected second order is 1 % of the forces at this limit, a tenth of what they include."""
_STATED = frozenset({MASS, "sign", "unit", "swapped", "gain", "force gain", "high pass", "clipped"})
"""Causes by which the records contradict a stated mass, sign, unit, calibration or range of a sensor."""
_NOISIEST_INPUT = 0.15  # of it: noise of 20 dB is 0.1, which a record of some seconds shows to within a third
_LIKE_A_FORCE = (Verdict.NOISE_MISMATCH, Verdict.MEASUREMENT_ERROR, Verdict.UNEXPLAINED_FORCES)
_NOT_WHITE = (
    ", but the residuals are not white, as the noise is taken to be: intervals of exact laws would be too narrow. A "
    "filter or a drift of a sensor, or a term that is missing, leaves such residuals."
)
_FILTERED = (
    ", as behind a filter that all sensors share. Such a filter also changes the recorded motion, which the residuals "
    "do not show. Remove the effect of the filter, or record without it."
)
_RAN_AWAY = 1e6  # chi-square: gaps in the motion of 1000 times the noise, which none near the record has
_CHANCE = 3.0  # standard deviations of chi-square within which missing terms of many links are not looked for
_FEW_LINKS = 4  # whose missing terms cost little to look for: then wherever chi-square is above 1
_NO_ERRORS = (
    "The search converged, but standard errors are not finite: a coefficient has no effect on what "
    "was recorded, or a mode or a link moves faster than the sampling rate lets it be followed. Leave out modes far above the "
    "band of the record, or record at a higher rate."
)


@dataclass(frozen=True)
class Judgement:
    """The `verdict` on a fit with its explanation; `model_error`, the part of the forces that the laws leave unexplained, and
    the `diagnosis` of it, the largest gain in likelihood first.

    To be added to the covariance (p, p) of the fit are `for_missing_terms`, where a model error is trusted that terms explain
    a part of or residuals hint at terms or errors of masses, `for_blocks`, where blocks doubt laws that leave hardly more than
    noise, `for_input_noise`, where the residuals hint at noise of an input, and `for_skewed_profiles`, where standard errors
    do not reach as far as the likelihood. `tested` is what was tested, and `closer_fit` a fit whose motion was held closer.
    """

    verdict: Verdict
    message: str
    model_error: float = 0.0
    diagnosis: tuple[Cause, ...] = ()
    for_missing_terms: Floats | None = None
    for_blocks: Floats | None = None
    for_input_noise: Floats | None = None
    for_skewed_profiles: Floats | None = None
    tested: TestedCauses | None = None
    closer_fit: CloserFit | None = None

    @property
    def trusted_tests(self) -> TestedCauses | None:
        """What was tested, where the verdict lets the answer be trusted."""
        return None if self.verdict.forbids else self.tested

    @property
    def widens_for_laws(self) -> bool:
        """Whether intervals hold what laws or inputs may lack."""
        laws = (self.for_missing_terms, self.for_blocks, self.for_input_noise)
        return any(part is not None for part in laws)

    @property
    def additions(self) -> list[Floats]:
        """All that is to be added to the covariance."""
        laws = (self.for_missing_terms, self.for_blocks, self.for_input_noise, self.for_skewed_profiles)
        return [part for part in laws if part is not None]

    @property
    def may_be_approximate(self) -> bool:
        """Whether the scatter between parts of the records gives intervals: not where what was stated is contradicted."""
        stated = self.verdict is Verdict.MEASUREMENT_ERROR and self.diagnosis[:1]
        contradicted = any(cause.kind in _STATED for cause in stated or ())
        return self.verdict.grade is Grade.APPROXIMATE and not contradicted

    @property
    def leaves_noise(self) -> bool:
        """Whether the laws leave only noise, in which nothing is significant."""
        return self.verdict is Verdict.CONVERGED and not self.diagnosis


def assess(
    fit: LikelihoodFit, identified: Structure, channels: Sequence[Channel], *, searched: bool = False
) -> Judgement:
    """Assess a fit to a record of these `channels`, whose laws were `searched` in it or stated.

    Intervals of stated laws may hold a small term that they lack; a search goes on.
    """
    failed = _failed(fit)
    if failed is not None:
        return failed
    coloured = fit.optimum.coloured
    diagnosis = diagnose(fit, identified, channels, terms=_may_lack_any_term(fit, identified))
    inputs = noise_of_inputs(fit, identified, channels)
    noisy = (input_noise.cause for input_noise in inputs if input_noise.cause is not None)
    every = (*diagnosis.causes, *noisy, *unstated_forces(fit, identified, channels))
    causes = tuple(sorted(every, key=lambda cause: (cause.kind in SPECTRAL_KINDS, likeliest_first(cause))))
    given, fit = fit, fit if searched else with_small_model_error(fit, causes, diagnosis.tested)
    share = _share(fit, identified, causes) if fit.model_error > 0.0 else 0.0
    responses = [name for name in channels if not name.is_input]
    remembering = [] if coloured is None else [responses[number] for number in coloured.channels]
    inexact = fit.model_error > 0.0
    counted = counted_causes(fit, identified, causes, diagnosis.tested) if inexact else CountedCauses()
    verdict, message = _verdict(
        fit,
        identified,
        share,
        causes,
        counted,
        coloured=remembering,
        filtered=1 < len(responses) == len(remembering) and lag_one_autocorrelation(fit.misfit) > 0.0,
    )
    missing, noise, masses = counted.missing, None, None
    by_blocks = None if fit is given else fit.covariance - given.covariance
    closer: CloserFit | None = None
    if not verdict.forbids and not causes:
        closer = held_closer(fit, identified, channels)
        hidden = None if closer is None else hidden_term(fit, closer)
        if hidden is not None:
            verdict, message = _with_hidden_term(fit, verdict, message, hidden)
            causes = (hidden.cause,)
            inexact = verdict is Verdict.MODEL_ERROR_NEEDED
            missing = for_missing_terms(hidden.closer_fit, identified) if inexact else None
    message += _of_forces(fit, verdict, causes, channels) + diagnosis.remark
    doubted = None
    if verdict is Verdict.CONVERGED and not causes:
        noise = for_noise_of_inputs(fit, inputs)
        white = coloured is None and not fit.random_forces
        doubted = doubt(fit, identified, diagnosis.tested, searched=searched) if white else None
        if doubted is not None:
            missing, by_blocks = doubted.missing, doubted.for_blocks(fit.covariance)
    if diagnosis.tested and not (verdict.forbids or causes):
        masses = hinted_masses(fit, diagnosis.tested)
    message += _of_hints(doubted, noise, masses)
    return Judgement(
        verdict,
        message,
        share,
        causes,
        for_missing_terms=None if verdict.forbids else _sum_of_covariances(missing, masses),
        for_blocks=None if verdict.forbids else by_blocks,
        for_input_noise=None if noise is None else noise[1],
        tested=diagnosis.tested,
        closer_fit=closer,
    )


def _may_lack_any_term(fit: LikelihoodFit, identified: Structure) -> bool:
    """Whether the laws leave enough for all terms to be tested, not only the usual ones."""
    chance = 0.0 if len(identified.links) - len(identified.modes) <= _FEW_LINKS else _CHANCE
    return (
        bool(fit.random_forces)
        or fit.optimum.coloured is not None
        or max(fit.model_error, fit.optimum.q) > AnnealingSchedule.final_q  # laws lacking much fit then too
        or fit.chi_square > 1.0 + chance * np.sqrt(2.0 / fit.samples)
    )


def _failed(fit: LikelihoodFit) -> Judgement | None:
    """The judgement of a fit that did not converge, or has no standard errors."""
    if fit.status is not AnnealingStatus.CONVERGED:
        reason = f"{fit.status.value.capitalize()}. The values are the best so far; give better starts, or a longer record."
        if fit.chi_square > _RAN_AWAY:
            reason = (
                f"{fit.status.value.capitalize()}. With these values the motion runs away from the record between its "
                "samples: they are not estimates. Give other starts, or hold some coefficients at known values."
            )
        return Judgement(Verdict.NOT_CONVERGED, reason)
    if not fit.has_errors:
        return Judgement(Verdict.HARDLY_DETERMINED, _NO_ERRORS)
    return None


def _sum_of_covariances(*parts: MissingTerms | HintedMasses | None) -> Floats | None:
    """What parts that are there add to the covariance of the coefficients."""
    added = [part.covariance for part in parts if part is not None]
    return np.sum(added, axis=0) if added else None


def _of_hints(
    doubted: Doubt | None, noise: tuple[InputNoise, Floats] | None, masses: HintedMasses | None
) -> str:
    """What the residuals of exact laws hint at, and intervals hold."""
    hints = [noise[0].description] if noise else []
    if masses:
        hints.append(masses.hint)
    if doubted:
        hints.append(doubted.hint)
    return f" The residuals hint at {' and '.join(hints)}; the intervals allow for that." if hints else ""


def _with_hidden_term(
    fit: LikelihoodFit, verdict: Verdict, message: str, hidden: HiddenTerm
) -> tuple[Verdict, str]:
    """The verdict where a model error, or noise of inputs, hides a missing term, so that the diagnosis beside it is silent.

    An error of a mass forbids trust as well where it would change a coefficient by more than its interval says.

    A damper or friction is a small part of the force in its link, and a large one of what dissipates: it forbids trust where
    it would change a coefficient by more than can be neglected. Beside noise of inputs every term does that would change one
    by more than its interval says.
    """
    is_mass = hidden.cause.kind == MASS
    if is_mass and hidden.shift <= LARGEST_SHIFT:
        return verdict, message + likeliest((hidden.cause,))
    if fit.model_error > 0.0 and not is_mass and (not hidden.dissipates or hidden.change < LARGEST_TERM):
        return verdict, f"{message}{likeliest((hidden.cause,))}{moved((hidden.cause,))}"
    if fit.random_forces and hidden.shift <= LARGEST_SHIFT:
        return verdict, message + likeliest((hidden.cause,))
    named = bool(hidden.cause.shifted) and hidden.change > 0.0
    change = f", and change {hidden.cause.shifted} by {100.0 * hidden.change:.2g} %" if named else ""
    noise = " and ".join(f"noise of {force.where}" for force in fit.random_forces)
    where = f"with the {noise}" if noise else "where the motion departs from it a little"
    misfit = Verdict.MEASUREMENT_ERROR if is_mass else Verdict.SYSTEMATIC_MISFIT
    advice = ": correct it, or estimate it with the other unknowns" if is_mass else "; a term is missing"
    return misfit, (
        f"The structure explains the record only {where}. Held closer, most of what is left follows the motion: "
        f"{would_explain(hidden.cause)}{change}. Intervals of exact laws would not include that{advice}."
    )


def _verdict(
    fit: LikelihoodFit,
    identified: Structure,
    share: float,
    causes: Sequence[Cause],
    counted: CountedCauses,
    *,
    coloured: Sequence[str],
    filtered: bool,
) -> tuple[Verdict, str]:
    """The first of all verdicts that holds.

    Intervals hold what is `counted` where blocks tell it; `coloured` channels have noise that remembers, all of them if
    `filtered` as a low-pass filter gives it.
    """
    explained = _explained(fit, share, coloured)
    allowed = held_errors(fit, causes)
    others = [cause for cause in causes if cause not in allowed]
    noisy = _noisy_inputs(fit, identified.mass_names)
    if fit.chi_square_off:
        return _mismatch(fit, causes)
    if noisy:
        return Verdict.UNEXPLAINED_FORCES, (
            f"{explained}, but the noise found of {', '.join(noisy)} exceeds {100.0 * _NOISIEST_INPUT:.0f} % of it: "
            f"it stands for errors of the laws, which intervals would take for noise.{likeliest(causes)}"
        )
    if causes and causes[0].is_instrument and not allowed:
        return Verdict.MEASUREMENT_ERROR, explained + of_instrument(causes[0])
    if share > _LARGEST_ERROR:
        return Verdict.UNEXPLAINED_FORCES, (f"{explained}: a term or a link is missing.{likeliest(causes)}")
    by_blocks = intervals_by_blocks(fit)
    largest = decisive(not_held(fit, others, counted.missing) if by_blocks else others, by_blocks=by_blocks)
    if largest is not None:
        return Verdict.SYSTEMATIC_MISFIT, explained + of_systematic_misfit(largest)
    if counted.too_far is not None:
        return Verdict.MEASUREMENT_ERROR, explained + of_error_beside_terms(counted.too_far)
    if causes and causes[-1].kind in SPECTRAL_KINDS:
        return Verdict.MEASUREMENT_ERROR, explained + of_instrument(causes[-1])
    if filtered:
        return Verdict.COLOURED_RESIDUALS, explained + _FILTERED
    exact = fit.model_error <= AnnealingSchedule.final_q and not fit.random_forces
    if exact and fit.chi_square > _NEXT_TO_NOTHING and not coloured and is_coloured(fit.misfit.residuals):
        return Verdict.COLOURED_RESIDUALS, explained + _NOT_WHITE
    faint = undetermined_far_away(fit, identified)
    if faint:
        return Verdict.SEVERAL_OPTIMA, (
            f"{explained}, but values of {', '.join(faint)} far from the estimates explain it as well: the elongation "
            f"of the link hardly exceeds the noise. Hold them at known values, or record "
            f"a motion with a larger elongation of the link."
        )
    if another_rest := about_another_rest(fit):
        return Verdict.SEVERAL_OPTIMA, f"{explained}, but {another_rest}"
    if not is_regular(fit, with_faint_modes(fit, identified)[1]):
        return Verdict.SEVERAL_OPTIMA, (
            f"{explained}, but around the estimates the likelihood has other optima or is not quadratic, as intervals assume. "
            "Give closer starting values, a shorter part of the record, or less noise."
        )
    if fit.model_error > 0.0:
        return Verdict.MODEL_ERROR_NEEDED, (
            f"{explained}.{_of_short_records(fit)}{of_held_errors(causes, allowed)}"
            f"{likeliest(others, 'of what is left' if others[:1] == list(causes[:1]) else 'of the rest')}{moved(others)}"
        )
    return Verdict.CONVERGED, f"{explained}{'; all intervals allow for that' if coloured else ''}."


def _mismatch(fit: LikelihoodFit, causes: Sequence[Cause]) -> tuple[Verdict, str]:
    """The verdict where chi-square is not that of the noise."""
    times = f"The residuals are {np.sqrt(fit.chi_square):.3g} times the noise"
    residuals = fit.misfit.residuals.transpose(2, 0, 1).reshape(-1, fit.misfit.residuals.shape[1])
    if not causes and fit.chi_square > 1.0 and outliers_exceed_noise(residuals):
        return Verdict.OUTLIERS, (
            f"{times}, because of outliers alone: typical residuals match the noise found. "
            f"Use a robust loss, which gives outliers little weight, or mark them as missing samples."
        )
    return Verdict.NOISE_MISMATCH, (
        f"{times}: the noise is not what was stated or found, a term is missing from a law, or a "
        f"link from the structure. The values are the best of these laws.{likeliest(causes)}"
    )


def _explained(fit: LikelihoodFit, share: float, coloured: Sequence[str]) -> str:
    """How far the laws explain the record."""
    if fit.model_error > 0.0:
        return f"The structure explains the record to within {100.0 * share:.2g} % of its forces"
    laws = "The laws and the random forces explain" if fit.random_forces else "The laws explain"
    noise = f", which is correlated from sample to sample in {', '.join(coloured)}" if coloured else ""
    return f"{laws} the record to within its noise{noise}"


def _noisy_inputs(fit: LikelihoodFit, masses: Sequence[str]) -> list[str]:
    """Channels of inputs with more noise, as it was found, than measured inputs have."""
    inputs, rms = fit.segments.inputs, {}
    if inputs.force is not None:
        powers = np.mean(inputs.force[:, 0] ** 2, axis=(0, 2))
        rms = {f"force:{name}": float(np.sqrt(power)) for name, power in zip(masses, powers, strict=True)}
    if inputs.frame is not None:
        rms[f"a:{BASE}"] = float(np.sqrt(np.mean(inputs.frame[:, 0] ** 2)))
    if inputs.base is not None:
        rms[f"x:{BASE}"] = float(np.sqrt(np.mean(inputs.base[:, 0, 0] ** 2)))
    return [
        force.where
        for force in fit.random_forces
        if force.found and not force.ambient and force.deviation > _NOISIEST_INPUT * rms[force.where]
    ]


def _of_forces(
    fit: LikelihoodFit, verdict: Verdict, causes: Sequence[Cause], channels: Sequence[Channel]
) -> str:
    """What random forces leave open, or that they may be what is missing."""
    if any(force.ambient for force in fit.random_forces):
        return (
            " Ambient forces are assumed to be white and independent, which is tested where the structure moves; errors of "
            "sensors and stated masses are not tested with them."
        )
    inputs = [name for name in channels if name.is_input]
    if not (fit.random_forces or inputs) and verdict in _LIKE_A_FORCE:
        return " If an unrecorded force acts, such as wind or traffic, state it as ambient."
    noisy = [cause for cause in causes[1:] if cause.kind == "input noise"]
    if noisy and verdict is Verdict.SYSTEMATIC_MISFIT:
        return f" Also, {noisy[0].description} would explain it: allow for noise of {noisy[0].where} before adding a term."
    if inputs and verdict is Verdict.MODEL_ERROR_NEEDED:
        return f" Noise of {inputs[0]} has the same effect: if it has some, allow for noise of {inputs[0]}."
    return ""


def _of_short_records(fit: LikelihoodFit) -> str:
    """What records without blocks leave open."""
    if fit.error_ratios is not None:
        return ""
    return (
        " The record is too short to compare separate blocks of it, so the intervals take what is left for white noise, and "
        "may be too narrow."
    )


def _share(fit: LikelihoodFit, identified: Structure, causes: Sequence[Cause]) -> float:
    """Root mean square of the force error over that of the forces, of the mass with the largest ratio.

    In a fit with the least model error that of the likeliest missing term counts, which its motion follows.
    """
    n = identified.size
    acceleration = fit.misfit.trajectories.accelerations.reshape(-1, n, fit.segments.count)
    forces = identified.mass_values * np.sqrt(np.mean(acceleration**2, axis=(0, 2)))
    share = float(np.max(fit.force_error / np.maximum(forces, np.finfo(float).tiny)))
    follows = fit.model_error <= AnnealingSchedule.final_q and causes and causes[0].kind == "term"
    return max(share, share_of_term(identified, causes[0], forces)) if follows else share
