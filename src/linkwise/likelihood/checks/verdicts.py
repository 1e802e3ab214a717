"""The verdict on a maximum-likelihood fit: whether it converged, whether its residuals are noise, and what they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import enumerated, format_percent
from linkwise.estimates.causes import CLOCK, EVENT, GAIN_DRIFT, NONLINEARITY, Cause
from linkwise.likelihood.checks.horizons import hidden_term
from linkwise.likelihood.checks.judgement import AS_NOISE, LARGEST_SHIFT, LARGEST_TERM, Examined, Judgement
from linkwise.likelihood.checks.jumps import event_between, moment
from linkwise.likelihood.checks.usual_terms import asymmetry, doubt, scatter_of_blocks
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.optima.hidden_wells import about_another_rest
from linkwise.likelihood.optima.other_optima import (
    is_loosened,
    is_regular,
    undetermined_far_away,
    with_faint_modes,
)
from linkwise.likelihood.random_forces import NOISIEST_INPUT
from linkwise.likelihood.search import BlockScatter
from linkwise.likelihood.shooting.minimise import AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.tests.diagnosis import hinted_errors as errors_of
from linkwise.likelihood.tests.variances import (
    BEHIND_FILTER,
    SPECTRAL_KINDS,
    UNSTEADY,
    for_noise_of_inputs,
    input_kicks,
)
from linkwise.likelihood.whiteness import is_coloured
from linkwise.likelihood.widened import dissipates
from linkwise.model.coefficient import MASS
from linkwise.signals.noise import outliers_exceed_noise
from linkwise.verdict import Verdict

_NEXT_TO_NOTHING = 0.01  # of the noise: memory over 100 samples makes residuals no larger than that
_LARGEST_ERROR = 0.1
"""Relative to the forces on a mass: the largest model error beside which the values are close to those of exact laws."""
# of the energy at the start: over 30 periods a damping ratio of 0.1 % takes off a fifth
_MANY_PERIODS, _GOES_ON = (30, 0.85)
_NEGLIGIBLE = 0.02  # of a variance, which changes a standard error by a hundredth
_STRETCH = 0.2  # of the record: half of the misfit in less points at what happened there
_MOMENT = 0.05  # of the record: half of the misfit in less, and not at its start, is no error of a law
_UNDETERMINED = 0.5  # standard error of a coefficient over its value
_RAN_AWAY = 1e6  # chi-square: gaps in the motion of 1000 times the noise, which none near the record has
_SMALL_ERRORS = (
    *("gain", GAIN_DRIFT, NONLINEARITY, "offset", "drift", "delay", CLOCK, "crosstalk"),  # of sensors
    *(MASS, "force gain", "force delay"),
)
"""Whose effect the first order describes. A filter of all sensors changes the motion that nonlinear links act by as well,
noise of inputs has no size that moves coefficients to a side, and what contradicts a stated value is no small error."""
_NAMED = 6  # coefficients
_LIKE_A_FORCE = (Verdict.NOISE_MISMATCH, Verdict.MEASUREMENT_ERROR, Verdict.UNEXPLAINED_FORCES)
_NO_ERRORS = (
    "The search converged, but standard errors are not finite: a coefficient has no effect on what "
    "was recorded, or a mode or a link moves faster than the sampling rate lets it be followed. Leave out modes far above the "
    "band of the record, or record at a higher rate."
)
_NOT_WHITE = (
    ", but the residuals are not white, as the noise is taken to be: intervals of exact laws would be too narrow. A "
    "filter or a drift of a sensor, or a term that is missing, leaves such residuals."
)
_PARTS = (
    "Intervals of exact laws would not include that: identify the parts of the record before and behind it."
)
_FILTERED = (
    ", as behind a filter that all sensors share. Such a filter also changes the recorded motion, which the residuals "
    "do not show. Remove the effect of the filter, or record without it."
)
_SHORT = (
    " The record is too short to compare separate blocks of it, so the intervals take what is left for white noise, and "
    "may be too narrow."
)


def convergence(of: Examined) -> Judgement | None:
    """Whether the search ended without an optimum."""
    status = of.fit.status
    if status is AnnealingStatus.CONVERGED:
        return None
    reason = (
        "With these values the motion runs away from the record between its samples: they are not estimates. Give other "
        "starts, or hold some coefficients at known values."
        if of.fit.chi_square > _RAN_AWAY
        else f"The values are the best so far. {_stuck(of)}"
    )
    return Judgement(Verdict.NOT_CONVERGED, f"{status.value.capitalize()}. {reason}")


def _worst_stretch(fit: LikelihoodFit) -> tuple[int, int, float]:
    """The first and last segment of the shortest stretch that holds half of the misfit beyond noise, and that half."""
    power = np.sum(fit.misfit.residuals**2, axis=(0, 1))
    power = np.maximum(power - 2.0 * np.median(power), 0.0)
    power[1:] += np.sum((fit.misfit.defects / fit.optimum.q) ** 2, axis=0)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(power))])
    last = np.searchsorted(total[1:], total[:-1] + 0.5 * total[-1])
    first = int(np.argmin(last - np.arange(len(last)) + len(last) * (last == len(last))))
    return first, min(int(last[first]), len(last) - 1), 0.5 * float(total[-1])


def _stuck(of: Examined) -> str:
    """Where a search is stuck, and what helps: a stretch that holds half of the misfit, or a coefficient not determined."""
    fit, segments = of.fit, of.fit.segments
    first, last, _ = _worst_stretch(fit)
    if last - first < _STRETCH * segments.count:
        start, end = (moment(segments, place, of.records) for place in (first, last))
        easier = f"from {end} on" if first + last < segments.count else f"up to {start}"
        return (
            f"Half of what is left of the record lies between {start} and {end}: identify the record {easier}, and look there "
            "for what the laws or the sensors lack."
        )
    errors = np.sqrt(np.maximum(fit.covariance.diagonal(), 0.0))
    relative = errors / np.maximum(np.abs(fit.values), np.finfo(float).tiny)
    worst = int(np.argmax(np.where(fit.free & np.isfinite(relative), relative, 0.0)))
    if relative[worst] > _UNDETERMINED:
        return (
            f"The record hardly determines {fit.names[worst]}: hold it at a known value, or give it bounds."
        )
    return "Identify the beginning of the record, and give its values as starts for the whole."


def standard_errors(of: Examined) -> Judgement | None:
    """Whether an unknown has no finite standard error."""
    return None if of.fit.has_errors else Judgement(Verdict.HARDLY_DETERMINED, _NO_ERRORS)


def event(of: Examined) -> Judgement | None:
    """Whether half of a misfit happens in a moment of a record, to a motion on which no input acts more than elsewhere."""
    fit, segments = of.fit, of.fit.segments
    if of.causes and of.causes[0].kind == EVENT:
        return of.found(Verdict.UNEXPLAINED_FORCES, f", but {would_explain(of.causes[0])}. {_PARTS}")
    if not (fit.chi_square_off or of.share > _LARGEST_ERROR):
        return None
    first, last, gain = _worst_stretch(fit)
    begin = int(np.max(np.flatnonzero(~segments.linked[:first]) + 1, initial=0))  # of its record
    if last - first >= _MOMENT * segments.count or first - begin < _MOMENT * segments.count:
        return None
    acting, signals = segments.inputs, segments.inputs.signals.values()
    levels = (signal - signal.mean() for signal in signals)
    changes = (np.ptp(signal, axis=(0, 1), keepdims=True) for signal in signals)
    inputs = (acting.force, acting.base, acting.frame, *levels, *changes)
    for values in (values for values in inputs if values is not None):
        power = np.sum(values**2, axis=tuple(range(values.ndim - 1)))
        if power[first : last + 1].mean() > power.mean():
            return None
    start, end = (moment(segments, place, of.records) for place in (first, last + 1))
    cause = event_between(segments, first, last + 1, of.records, gain)
    explained = f"half of what is left would be explained by {cause.description}"
    advice = f"Identify the record from {end} on, or up to {start}."
    return of.found(Verdict.UNEXPLAINED_FORCES, f": {explained}. {advice}", cause)


def level_of_noise(of: Examined) -> Judgement | None:
    """Whether chi-square is not that of the noise."""
    fit = of.fit
    if not fit.chi_square_off:
        return None
    times = f"The residuals are {np.sqrt(fit.chi_square):.3g} times the noise"
    residuals = fit.misfit.residuals.transpose(2, 0, 1).reshape(-1, fit.misfit.residuals.shape[1])
    if not of.causes and fit.chi_square > 1.0 and outliers_exceed_noise(residuals):
        message = (
            f"{times}, because of outliers alone: typical residuals match the noise found. Use a robust loss, which gives "
            "outliers little weight, or mark them as missing samples."
        )
        return Judgement(Verdict.OUTLIERS, message, of.share, of.causes)
    message = (
        f"{times}: the noise is not what was stated or found, a term is missing from a law, or a link from the structure. "
        f"The values are the best of these laws.{likeliest(of.causes)}"
    )
    return Judgement(Verdict.NOISE_MISMATCH, message, of.share, of.causes)


def noise_found_of_inputs(of: Examined) -> Judgement | None:
    """Whether inputs have more noise, as it was found, than measured inputs have."""
    found = [force for force in of.fit.random_forces if force.found and not force.ambient]
    if not found:
        return None
    rms = {name: size for name, size, _ in input_kicks(of.fit.optimum, of.identified, of.channels)}
    noisy = [force.where for force in found if force.deviation > NOISIEST_INPUT * rms[force.where]]
    if not noisy:
        return None
    return of.found(
        Verdict.UNEXPLAINED_FORCES,
        f", but the noise found of {', '.join(noisy)} exceeds {100.0 * NOISIEST_INPUT:.0f} % of it: it stands for errors of "
        f"the laws, which intervals would take for noise.{likeliest(of.causes)}",
    )


def error_of_measurement(of: Examined) -> Judgement | None:
    """Whether an error of a sensor, an input or a mass explains most of what is left, and moves coefficients."""
    if not (of.causes and of.causes[0].is_instrument) or _are_small(of):
        return None
    return of.found(Verdict.MEASUREMENT_ERROR, _of_instrument(of.causes[0]))


def _are_small(of: Examined) -> bool:
    """Whether intervals by blocks hold what any error of a sensor, an input or a mass makes of the coefficients."""
    return of.has_intervals_by_blocks and all(
        error.kind in _SMALL_ERRORS and 0.0 < error.shift <= LARGEST_SHIFT and not error.overturned
        for error in of.causes
        if error.is_instrument
    )


def unexplained_forces(of: Examined) -> Judgement | None:
    """Whether the laws leave a large part of the forces."""
    if not of.share > _LARGEST_ERROR:
        return None
    return of.found(Verdict.UNEXPLAINED_FORCES, f": a term or a link is missing.{likeliest(of.causes)}")


def systematic_misfit(of: Examined) -> Judgement | None:
    """Whether what is left follows the motion as a missing term or link does."""
    first = next((cause for cause in of.causes if not cause.is_instrument), None)
    is_small = first is not None and first.kind == "term" and first.share <= LARGEST_TERM
    if first is None or (
        is_small and (of.has_intervals_by_blocks or _scatter_of_small_terms(of) is not None)
    ):
        return None
    overturned = f", and {', '.join(first.overturned)} would have no certain sign, or another one"
    return of.found(
        Verdict.SYSTEMATIC_MISFIT,
        f", but what is left follows the motion: {would_explain(first)}{overturned if first.overturned else ''}. Intervals of "
        "exact laws would count that as noise; a term or a link is missing, or a sensor has an error.",
    )


def _scatter_of_small_terms(of: Examined) -> BlockScatter | None:
    """How far blocks disagree on stated laws that leave only noise, in which small terms alone are significant; else None."""
    fit, first = of.fit, of.causes[0]
    noise = max((cause.gain for cause in of.causes if cause.kind == "input noise"), default=0.0)
    terms = {cause.kind for cause in of.causes} <= {"term", "input noise"} and noise < AS_NOISE * first.gain
    if fit.model_error > 0.0 or of.searched or not terms or first.share > LARGEST_TERM:
        return None
    return scatter_of_blocks(fit, of.diagnosis.tested)


def spectra_of_forces(of: Examined) -> Judgement | None:
    """Whether random forces are not white, independent and steady."""
    if not of.causes or of.causes[-1].kind not in SPECTRAL_KINDS:
        return None
    return of.found(Verdict.MEASUREMENT_ERROR, _of_instrument(of.causes[-1]))


def filter_of_all_sensors(of: Examined) -> Judgement | None:
    """Whether the noise of all sensors is correlated as behind one filter."""
    return of.found(Verdict.COLOURED_RESIDUALS, _FILTERED) if of.is_filtered else None


def whiteness(of: Examined) -> Judgement | None:
    """Whether residuals of exact laws are not white, of loosened ones where they are held closer.

    Loose links take up noise at the frequencies of the motion.
    """
    fit = of.fit
    exact = fit.model_error <= AnnealingSchedule.final_q and not fit.random_forces
    counted = exact and fit.chi_square > _NEXT_TO_NOTHING and not of.coloured
    closest = of.closer.fit if counted and is_loosened(fit) and of.closer else fit
    if not (counted and is_coloured(closest.misfit.residuals)):
        return None
    return of.found(Verdict.COLOURED_RESIDUALS, _NOT_WHITE)


def values_far_away(of: Examined) -> Judgement | None:
    """Whether values far from the estimates of a link that hardly moves explain the records as well."""
    faint = undetermined_far_away(of.fit, of.identified)
    if not faint:
        return None
    return of.found(
        Verdict.SEVERAL_OPTIMA,
        f", but values of {', '.join(faint)} far from the estimates explain it as well: the elongation of the link hardly "
        "exceeds the noise. Hold them at known values, or record a motion with a larger elongation of the link.",
    )


def another_rest(of: Examined) -> Judgement | None:
    """Whether motion about another position of rest explains the records as well."""
    another = about_another_rest(of.fit)
    return of.found(Verdict.SEVERAL_OPTIMA, f", but {another}") if another else None


def regularity(of: Examined) -> Judgement | None:
    """Whether the likelihood has other optima nearby, or is not quadratic."""
    if is_regular(of.fit, with_faint_modes(of.fit, of.identified)[1]):
        return None
    return of.found(
        Verdict.SEVERAL_OPTIMA,
        ", but around the estimates the likelihood has other optima or is not quadratic, as intervals assume. Give closer "
        "starting values, a shorter part of the record, or less noise.",
    )


def model_error(of: Examined) -> Judgement:
    """Whether the laws leave more than noise, a small part of the forces that nothing else explains."""
    fit, causes = of.fit, of.causes
    scatter = _scatter_of_small_terms(of) if causes else None
    if fit.model_error > 0.0 or scatter is not None:
        short = _SHORT if scatter is None and fit.error_ratios is None else ""
        found = of.found(Verdict.MODEL_ERROR_NEEDED, f".{short}{likeliest(causes)}{moved(causes)}")
        return found if scatter is None else replace(found, added={"blocks": scatter.added(fit.covariance)})
    return of.found(Verdict.CONVERGED, "; all intervals allow for that." if of.coloured else ".")


def would_explain(cause: Cause) -> str:
    """What a cause would explain."""
    return f"{cause.description} would lower -2 log likelihood by {cause.gain:.3g}"


def likeliest(causes: Sequence[Cause]) -> str:
    """That the likeliest cause would explain most."""
    return f" Most of what is left would be explained by {causes[0].description}." if causes else ""


def moved(causes: Sequence[Cause]) -> str:
    """Which coefficient the likeliest cause would change most, where it would change by more than its interval says."""
    if not causes or causes[0].shift <= LARGEST_SHIFT:
        return ""
    return f" With it, {causes[0].shifted} would change by {causes[0].shift:.2g} of the standard errors of the laws as stated."


def _of_instrument(cause: Cause) -> str:
    """What an error in what was recorded or stated means for the answer."""
    wrong = "would be wrong by more than intervals of exact laws say"
    if cause.kind in ("input noise", "ambient"):
        ambient = cause.kind == "ambient"
        advice = f"allow for an ambient force on {cause.where}" if ambient else _against_noise(cause.where)
        advice = "allow for more of it, or let it be found" if cause.remark else advice
        means = f". It excites the structure, and coefficients, above all dampings, {wrong}: {advice}."
    elif cause.kind == UNSTEADY:
        means = (
            f". The strongest parts tell most, so intervals would be at least {np.hypot(1.0, cause.size):.2g} times too "
            "narrow: use parts of the record in which the level is about the same."
        )
    elif cause.remark.endswith(BEHIND_FILTER):
        means = (
            f". All frequencies tell the level of the forces, and dampings {wrong}: resample the accelerations at twice the "
            "frequency up to which the filter is flat, by their Fourier transform."
        )
    elif cause.kind in SPECTRAL_KINDS:
        means = (
            f". The laws take up what such forces differ by from white and independent ones, and {wrong}: record the forces, "
            "or the structure where nothing but applied forces or its own decay moves it."
        )
    else:
        means = f", more than any missing term. Coefficients {wrong}: correct it, or estimate it with the other unknowns."
    return f", but {would_explain(cause)}{means}"


def term_hidden_by_model_error(of: Examined, before: Judgement) -> Judgement | None:
    """Whether the motion held closer to the laws shows a missing term, or an error of a mass, that is hidden otherwise.

    Beside a model error, or where it would change coefficients by no more than intervals hold, it is named.
    """
    if before.verdict.forbids or before.diagnosis or of.closer is None:
        return None
    hidden = hidden_term(of.fit, of.closer)
    if hidden is None:
        return None
    cause, change, shift = hidden
    is_mass = cause.kind == MASS
    is_small = shift <= LARGEST_SHIFT and (is_mass or of.fit.random_forces)
    # a small part of the force, and a large one of what dissipates
    damps = change >= LARGEST_TERM and dissipates(cause.term)
    if is_small or (of.fit.model_error > 0.0 and not is_mass and not damps):
        named = (replace(cause, shift=shift),)
        return replace(before.saying(f"{likeliest(named)}{moved(named)}".lstrip()), diagnosis=(cause,))
    is_changed = cause.shifted and change > 0.0
    changed = f", and change {cause.shifted} by {format_percent(change)}" if is_changed else ""
    noise = " and ".join(f"noise of {force.where}" for force in of.fit.random_forces)
    where = f"with the {noise}" if noise else "where the motion departs from it a little"
    advice = ": correct it, or estimate it with the other unknowns" if is_mass else "; a term is missing"
    message = (
        f"The structure explains the record only {where}. Held closer, most of what is left follows the motion: "
        f"{would_explain(cause)}{changed}. Intervals of exact laws would not include that{advice}."
    )
    verdict = Verdict.MEASUREMENT_ERROR if is_mass else Verdict.SYSTEMATIC_MISFIT
    return before.overruled(verdict, message, cause)


def remarks_on_forces(of: Examined, before: Judgement) -> Judgement | None:
    """Whether an unrecorded force, or noise of an input, may be what is missing, and what could not be tested."""
    remark = (_of_forces(of, before.verdict) + of.diagnosis.remark).lstrip() if of.is_settled else ""
    return before.saying(remark) if remark else None


def _of_forces(of: Examined, verdict: Verdict) -> str:
    fit = of.fit
    if any(force.ambient for force in fit.random_forces):
        return (
            " Ambient forces are assumed to be white and independent, which is tested where the structure moves; errors of "
            "sensors and stated masses are not tested with them."
        )
    inputs = [name for name in of.channels if name.is_input]
    if not (fit.random_forces or inputs) and verdict in _LIKE_A_FORCE:
        return " If an unrecorded force acts, such as wind or traffic, state it as ambient."
    noisy = [cause for cause in of.causes[1:] if cause.kind == "input noise"]
    if noisy and verdict is Verdict.SYSTEMATIC_MISFIT:
        advice = _against_noise(noisy[0].where)
        return f" Also, {noisy[0].description} would explain it: {advice} before adding a term."
    if inputs and verdict is Verdict.MODEL_ERROR_NEEDED:
        return f" Noise of {inputs[0]} has the same effect: if it has some, {_against_noise(inputs[0])}."
    return ""


def _against_noise(channel: str) -> str:
    """What to do about noise of an input: that of a signal is no random force, which could be allowed for."""
    if channel.startswith("signal:"):
        return f"record {channel} with less"
    return f"allow for noise of {channel}"


def motion_that_goes_on(of: Examined, before: Judgement) -> Judgement | None:
    """Whether a motion without a recorded force does not decay, for which something must feed it, or hardly damp it."""
    fit = of.fit
    driven = fit.random_forces or fit.options.harmonics or any(name.is_input for name in of.channels)
    if driven or not of.is_settled:
        return None
    u = fit.misfit.trajectories.states[: -1 : fit.segments.refine, 1] / fit.segments.step
    masses = fit.segments.system.at(fit.optimum.point.theta).masses
    energy = np.einsum("m,jmk->kj", masses, u**2).ravel()[: len(of.records[0])]
    third = len(energy) // 3
    fastest = u[:, int(np.argmax(np.mean(u**2, axis=(0, 2)) * masses))].T.ravel()[: len(energy)]
    periods = np.count_nonzero(np.diff(np.sign(fastest))) // 2
    if periods < _MANY_PERIODS or energy[-third:].mean() < _GOES_ON * energy[:third].mean():
        return None
    return before.saying(
        f"The motion does not decay over {periods} periods, though no force was recorded: one that was not may act "
        "(--ambient, --harmonic), or the structure feeds itself, or its damping is too small to be told."
    )


def noise_of_inputs(of: Examined, before: Judgement) -> Judgement | None:
    """Whether inputs have noise, by their channels or by what residuals hint at, though it is not significant."""
    if not before.leaves_noise:
        return None
    noise = for_noise_of_inputs(of.fit, of.inputs, of.levels_of_inputs)
    if noise is None or not np.any(np.diag(noise[1]) > _NEGLIGIBLE * np.diag(of.fit.covariance)):
        return None
    return before.saying(f"The intervals allow for {noise[0]}.", {"input noise": noise[1]})


def hinted_errors(of: Examined, before: Judgement) -> Judgement | None:
    """Whether residuals hint at an error of a stated mass or a sensor, though it is not significant."""
    tested = of.diagnosis.tested
    hint = None if before.verdict.forbids or before.diagnosis or not tested else errors_of(of.fit, tested)
    return None if hint is None else _widened(before, *hint)


def hinted_event(of: Examined, before: Judgement) -> Judgement | None:
    """Whether residuals hint at motion that begins anew at one moment, though it is not significant."""
    if not before.leaves_noise or of.jump is None or "input noise" in before.added:
        return None
    return _widened(before, {"events": np.outer(of.jump.moves, of.jump.moves)}, of.jump.event.description)


def hinted_terms(of: Examined, before: Judgement) -> Judgement | None:
    """Whether residuals hint at missing terms, or parts of the records disagree, though nothing is significant.

    What hints at a term may as well be an error of a sensor that alone would be no hint.
    """
    fit, tested = of.fit, of.diagnosis.tested
    ambient = any(force.ambient for force in fit.random_forces)
    if not before.leaves_noise or fit.optimum.coloured is not None or ambient:
        return None
    hint = doubt(fit, tested, searched=of.searched)
    if hint is None or tested is None:
        return None
    terms = float(np.max(tested.tests.gains[tested.of_laws], initial=0.0)) / fit.optimum.noise**2
    errors = None if {"masses", "sensors"} & {*before.added} else errors_of(fit, tested, terms)
    widened = _widened(before, *hint)
    return widened if errors is None else _widened(widened, *errors)


def motion_that_begins_anew(of: Examined, before: Judgement) -> Judgement | None:
    """Whether a jump of all states at one moment, which nothing else explains, is more than chance gives."""
    if not before.leaves_noise or of.jump is None or not of.jump.is_significant:
        return None
    event = of.jump.event
    return of.found(Verdict.UNEXPLAINED_FORCES, f", but {would_explain(event)}. {_PARTS}", event)


def asymmetric_wells(of: Examined, before: Judgement) -> Judgement | None:
    """Whether links that move in one well, or hardly leave it, hide forces that are not symmetric and move coefficients."""
    tested = of.diagnosis.tested
    hint = asymmetry(of.fit, tested) if before.leaves_noise and tested else None
    if hint is None:
        return None
    added, terms = hint
    remark = (
        f"The motion does not tell these laws from laws with {terms}, as of asymmetric wells; the intervals allow for that. "
        "Record motion that crosses d = 0 for longer or, if they are known to be alike, state the term with 0."
    )
    return before.saying(remark, added)


def _widened(before: Judgement, added: Mapping[str, Floats], hint: str) -> Judgement:
    return before.saying(f"The residuals hint at {hint}; the intervals allow for that.", added)


def motion_that_runs_away(of: Examined, before: Judgement) -> Judgement | None:
    """Whether motion by laws beside a model error, run on from states along the record, soon runs away from it.

    Laws that explain all of a record a few samples at a time, and a period of it not at all, are those of a wrong optimum.
    """
    fit = of.fit
    if not (fit.model_error > 0.0 and before.may_be_approximate and fit.optimum.runs_away):
        return None
    free = np.array(fit.names)[fit.free].tolist()
    message = (
        "With these values the laws predict the next samples alone: the motion soon runs away from the record. "
        f"The search ended at a wrong optimum: state starts of {enumerated(free[:_NAMED])} within some 20 %, or identify the "
        "beginning of the record first."
    )
    return before.overruled(Verdict.NOT_CONVERGED, message)
