"""Validation on a record that a structure was not identified from: scores by channel beside what noise and the errors of
the answer allow, and where in the motion the prediction fails.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isinf
from pathlib import Path
from typing import TypeAlias

import numpy as np
import scipy

from linkwise.arrays import Floats, stretches
from linkwise.errors import IdentificationError, RecordError, expect
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import KnownAnswer, Posterior, covariance_root
from linkwise.identification.prediction import (
    Prediction,
    WindowPredictor,
    one_step,
    predict,
    usable,
)
from linkwise.identification.validated_answer import (
    LEVEL,
    agreements,
    answer_in_numbers,
    estimated_again,
    refittable_names,
    sensor_noise,
    taken_as_exact,
    with_uncertain,
    without_exchanges,
    without_found_errors,
)
from linkwise.identification.validation_result import (
    ChannelPrediction,
    CoefficientAgreement,
    ErrorProfile,
    ErrorSpectrum,
    Validation,
)
from linkwise.likelihood.rigs.estimate import RigFit, minimise
from linkwise.likelihood.rigs.problem import BASE_CHANNEL, RigProblem, cell_name
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.records.channel import COMMON, SensorUncertainty
from linkwise.records.channel_units import in_units_of, unit_in
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed
from linkwise.signals.force_window import with_force_windows
from linkwise.verdict import Verdict


def with_stated_sensors(prediction: Prediction, record: Record) -> Prediction:
    """The prediction whose errors count those of the sensors of `record`, whose gain, offset or delay is known to within.

    They add to the errors of laws, which are of one kind throughout a record. What is unknown altogether adds nothing.
    """
    if not record.uncertainty:
        return prediction
    common = record.uncertainty.get(COMMON, SensorUncertainty()).gain
    variances = prediction.variances.copy()
    for column, name in enumerate(record.responses):
        known, shown = record.uncertainty.get(name, SensorUncertainty()), prediction.predicted[:, column]
        gain, shared, offset, delay = (
            0.0 if isinf(sigma) else sigma for sigma in (known.gain, common, known.offset, known.delay)
        )
        variances[:, 2, column] += (gain**2 + shared**2) * shown**2 + offset**2
        if delay:
            variances[:, 2, column] += (delay * _largest_rate(shown, record.step)) ** 2
    return replace(prediction, variances=variances)


def _largest_rate(shown: Floats, step: float) -> Floats:
    """(N,) the larger absolute slope beside each sample, of which one may be beside a gap of what is predicted."""
    slopes = np.abs(np.diff(shown)) / step
    beside: Floats = np.fmax(np.append(np.nan, slopes), np.append(slopes, np.nan))
    return beside


def unknown_sensors(record: Record) -> tuple[str, ...]:
    """A sentence on errors of sensors that are unknown, which a prediction cannot count."""
    names = []
    for name, known in record.uncertainty.items():
        names += [f"{kind} of {name}" for kind, sigma in vars(known).items() if isinf(sigma)]
    return (f"Errors taken as zero, though stated as unknown: {', '.join(names)}.",) if names else ()


_ESTIMATED_NOISE = 1.2  # over the noise that is estimated from a record: how far that may be off


def channel_scores(
    record: Record,
    structure: Structure,
    prediction: Prediction,
    steps: tuple[Floats, Floats],
    noise: dict[str, float],
) -> dict[str, ChannelPrediction]:
    """The scores by channel.

    The squared error is a sum of squares: that of the noise is chi-square distributed with as many degrees of freedom as there
    are samples; those of initial states with at least one a start; those of coefficients and laws with at least one. Each is
    allowed its quantile.
    """
    names = record.responses
    level = LEVEL / len(names)
    once = float(scipy.special.chdtri(1, level))
    often = float(scipy.special.chdtri(prediction.starts, level)) / prediction.starts
    scores: dict[str, ChannelPrediction] = {}
    for column, name in enumerate(names):
        measured = record.channel(name)
        error = measured - prediction.predicted[:, column]
        scored = np.isfinite(error)
        count, mean_square = int(scored.sum()), float(np.mean(error[scored] ** 2))
        parts = np.mean(prediction.variances[scored, :, column], axis=0).tolist()
        square = noise[name] ** 2
        allowed = square if name in record.noise else square * _ESTIMATED_NOISE**2
        allowed *= float(scipy.special.chdtri(count, level)) / count
        spread = float(np.var(measured[scored]))
        nmse = mean_square / spread if spread > 0.0 else math.inf
        ahead = measured - steps[0][:, column]
        scores[name] = ChannelPrediction(
            name=name,
            unit=unit_in(structure, name),
            samples=count,
            rmse=math.sqrt(mean_square),
            nmse_percent=100.0 * nmse,
            fit_percent=100.0 * (1.0 - math.sqrt(nmse)),
            noise=noise[name],
            expected=math.sqrt(square + sum(parts)),
            limit=math.sqrt(allowed + often * parts[0] + once * (parts[1] + parts[2])),
            one_step_rmse=float(np.sqrt(np.nanmean(ahead**2))),
            one_step_expected=math.sqrt(square + float(np.nanmean(steps[1][:, column]))),
        )
    return scores


_BINS = 24
_SEGMENTS = 8  # of a spectrum, at half overlap


def error_profiles(record: Record, structure: Structure, prediction: Prediction) -> tuple[ErrorProfile, ...]:
    """The error over time, then over d and v of every link along the predicted motion; modes of hosts are no links."""
    measured = record.select(record.responses).values
    size = np.nanstd(measured, axis=0)
    relative = (measured - prediction.predicted) / np.where(size > 0.0, size, 1.0)
    with np.errstate(invalid="ignore"):
        counted = np.isfinite(relative).sum(axis=1)
        square = np.nansum(relative**2, axis=1) / np.maximum(counted, 1)
    scored = counted > 0
    quantities = [("time", "s", record.time)]
    for number, link in enumerate(structure.links):
        if link.name in structure.modes:
            continue
        of_d, of_v = link.law.motion_units
        quantities.append((f"d of {link.name}", of_d, prediction.d[:, number]))
        quantities.append((f"v of {link.name}", of_v, prediction.v[:, number]))
    return tuple(_profile(name, unit, values[scored], square[scored]) for name, unit, values in quantities)


def _profile(quantity: str, unit: str, values: Floats, square: Floats) -> ErrorProfile:
    low, high = float(values.min()), float(values.max())
    if not high > low:
        high = low + max(abs(low), 1e-12)
    edges = np.linspace(low, high, _BINS + 1)
    samples, _ = np.histogram(values, edges)
    total, _ = np.histogram(values, edges, weights=square)
    error = np.where(samples > 0, 100.0 * np.sqrt(total / np.maximum(samples, 1)), np.nan)
    return ErrorProfile(quantity, unit, edges, error, samples)


def error_spectra(record: Record, predicted: Floats) -> dict[str, ErrorSpectrum]:
    """Spectra of the channels over their longest stretch without gaps; none where it is too short."""
    spectra: dict[str, ErrorSpectrum] = {}
    for column, name in enumerate(record.responses):
        measured = record.channel(name)
        error = measured - predicted[:, column]
        stretch = max(stretches(np.isfinite(error)), key=lambda run: run.stop - run.start)
        length = 2 * (stretch.stop - stretch.start) // (_SEGMENTS + 1)
        if length < 16:
            continue
        settings = {"fs": record.rate, "nperseg": length}
        frequency, density = scipy.signal.welch(measured[stretch], **settings)
        _, left = scipy.signal.welch(error[stretch], **settings)
        spectra[name] = ErrorSpectrum(frequency[1:], density[1:], left[1:])
    return spectra


_BURN = 0.05  # of the record
_FEWEST, _MOST = 50, 300  # samples of the burn, unless it is given
_SCORED = 20  # samples at least
_REFUTING = {
    Verdict.MEASUREMENT_ERROR,
    Verdict.UNEXPLAINED_FORCES,
    Verdict.SYSTEMATIC_MISFIT,
    Verdict.COEFFICIENT_CHANGES,
}
"""Of an estimate from the record alone: the laws of the answer leave more than noise, whatever their coefficients."""

_Predicted: TypeAlias = tuple[int, Prediction, tuple[Floats, Floats], dict[str, float]]


def validate(
    record: Record,
    answer: Structure | Estimate | Posterior | str | Path,
    *,
    burn: float | None = None,
    model_error: float | None = None,
    corrected: Mapping[str, Sequence[str]] | None = None,
    refit: bool = False,
    progress: Progress = silent,
) -> Validation:
    """Predict a record with a structure that was identified from others, and compare.

    The state at the start is estimated from the first `burn` seconds. From it the structure runs freely under the inputs of
    the record. Where the motion is chaotic, so that the error of this state would hide it, the run is restarted in windows,
    with states from the samples just before each. The prediction agrees with the record if in no channel the RMSE exceeds the
    value that noise and the errors of states, coefficients and laws together exceed with a probability of 0.001.

    Parameters
    ----------
    record : Record
        The record, or a part of one, that the structure was not identified from.
    answer : Structure, Estimate, Posterior or path-like
        The structure, every coefficient a number, or the path of its file. An estimate, a `Posterior` or the path of a result
        folder adds the covariance of the coefficients: their errors count in the comparison. Offsets, gains and delays of
        sensors that it found are taken out of the record.
    burn : float, optional
        Time in s at the start from which the state is estimated, and which is not scored. By default 5 % of the record, from
        50 to 300 samples.
    model_error : float, optional
        Part of the forces that the laws are known to leave, by root mean squares. By default that of a trusted estimate, or
        0.
    corrected : mapping of str to sequence of {"offset", "gain", "delay"}, optional
        Errors of sensors, by channel, that the record is without: you took them out, or the sensor was exchanged. What the
        answer found of these is not taken out again.
    refit : bool
        Whether the coefficients that have a covariance are also estimated again, from this record alone, and compared (Wald
        test). By default the record is predicted only, and `Validation.refittable` lists them.
    progress : Progress
        Called with a `ProgressReport` now and then.

    Returns
    -------
    Validation
        The scores, by channel and over the motion, and the verdict.

    Raises
    ------
    RecordError
        If the record has no response of the structure, a force on another mass, an input with gaps or no motion
        of a base, or is too short for the burn.
    IdentificationError
        If the motion of the base is not known well enough for a link or a channel, or what is `corrected` is no error of a
        channel.
    StructureError
        If a coefficient has no value.
    SimulationError
        If the structure diverges, or no state is found from which it follows the start of the record.
    TypeError
        If the record or the answer has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> validation = lw.validate(record, chain)
    >>> validation.trusted, validation.free_run
    (True, True)
    >>> sorted(validation.channels)
    ['x:m1', 'x:m2']
    """
    expect("validate(record, answer): record", record, Record)
    expect("validate(record, answer): answer", answer, Structure, Estimate, Posterior, str, Path)
    given = answer_in_numbers(answer)
    structure, posterior = given.structure, given.posterior
    law_error = _law_error(given.model_error if model_error is None else model_error)
    record, exchanged = without_exchanges(in_units_of(record, structure), given.added)
    record = with_force_windows(record)
    scored = _channels_of_rig(record, structure) if structure.on_rig else usable(record, structure)
    unscored = _unscored_remark(record, scored)
    scored, taken_out = without_found_errors(scored, given.sensor_errors, corrected or {})
    remarks = (*taken_as_exact(given), *exchanged, *unscored, *taken_out, *unknown_sensors(scored))
    predicted = _predicted_on_rig if structure.on_rig else _predicted_motion
    first = part(progress, 0.0, 0.6 if refit else 1.0)
    samples, prediction, steps, noise = predicted(scored, given, burn, law_error, first)
    refittable = () if posterior is None else refittable_names(posterior)
    agreed: tuple[CoefficientAgreement, ...] = ()
    refuted = False
    if refit and posterior is not None and refittable:
        try:
            again = estimated_again(scored, posterior, part(progress, 0.7, 1.0))
            agreed = agreements(again, posterior)
            if not again.trusted:
                remarks = (*remarks, _failed_alone(again))
                refuted = law_error == 0.0 and not _REFUTING.isdisjoint(again.verdicts)
        except IdentificationError as error:
            remarks = (*remarks, f"The coefficients cannot be estimated from this record alone: {error}")
    prediction = with_stated_sensors(prediction, scored)
    sigma = np.array([noise[name] for name in scored.responses])
    deviation = np.sqrt(sigma**2 + prediction.variances.sum(axis=1))
    deviation[np.isnan(prediction.predicted)] = np.nan
    return Validation(
        structure=structure,
        record=scored,
        predicted=_record_of_responses(scored, prediction.predicted, "predicted"),
        deviation=_record_of_responses(scored, deviation, "expected deviation"),
        channels=channel_scores(scored, structure, prediction, steps, noise),
        burn=samples * scored.step,
        window=prediction.window,
        windows=prediction.starts,
        horizon=prediction.horizon,
        profiles=error_profiles(scored, structure, prediction),
        spectra=error_spectra(scored, prediction.predicted),
        coefficients=agreed,
        model_error=law_error,
        remarks=remarks,
        refuted=refuted,
        basis=given.basis,
        refittable=() if refit else refittable,
    )


def _predicted_motion(
    scored: Record, given: KnownAnswer, burn: float | None, law_error: float, progress: Progress
) -> _Predicted:
    """Samples of the burn, the prediction of masses that move freely, that one step ahead, and the noise by channel."""
    structure = given.structure
    frame = framed(scored, structure)
    used = frame.record
    samples = _burn_samples(used, burn)
    noise = sensor_noise(used)
    sigma = np.array([noise[name] for name in used.responses])
    free, values, covariance = with_uncertain(given)
    predictor = WindowPredictor(used, free, values, covariance_root(covariance), sigma, law_error)
    prediction = predict(predictor, samples, progress)
    ahead, variance = one_step(predictor, samples)
    prediction = replace(prediction, predicted=prediction.predicted + frame.shown)
    named: dict[str, float] = dict(zip(scored.responses, noise.values(), strict=True))
    return samples, prediction, (ahead + frame.shown, variance), named


def _unscored_remark(record: Record, scored: Record) -> tuple[str, ...]:
    """A sentence on responses that no prediction is compared with."""
    unscored = [name for name in record.responses if name not in scored.channels]
    predicted = "a validation predicts what the structure's masses and links show"
    return (f"{', '.join(unscored)} were not scored: {predicted}.",) if unscored else ()


def _failed_alone(again: Estimate) -> str:
    """That the laws do not hold by an estimate from the record alone, and the likeliest cause."""
    said = f"Estimated from this record alone, the laws do not hold: {again.status}."
    if not again.diagnosis:
        return said
    return f"{said} Most of what they leave would be explained by {again.diagnosis[0].description}."


def _law_error(part_of_force: float) -> float:
    if not (math.isfinite(part_of_force) and part_of_force >= 0.0):
        message = f"model_error must be 0 or a positive part of the forces, got {part_of_force:g}"
        raise IdentificationError(message)
    return part_of_force


def _burn_samples(record: Record, burn: float | None) -> int:
    count = len(record)
    if burn is None:
        samples = min(max(round(_BURN * count), _FEWEST), _MOST)
    elif not (math.isfinite(burn) and burn > 0.0):
        raise RecordError(f"burn must be a positive time, got {burn:g} s", arguments=("burn",))
    else:
        samples = round(burn * record.rate)
    if samples < 2 or count - samples < _SCORED:
        raise RecordError(
            f"a burn of {samples * record.step:g} s leaves {max(count - samples, 0)} of {count} samples to score and uses "
            f"{samples} to determine the state: it needs at least 2, and {_SCORED} must be left",
            arguments=("burn",),
        )
    for name in record.responses:
        present = np.isfinite(record.channel(name))
        if not present[samples:].any():
            raise RecordError("has no sample after the burn", channel=name)
    return samples


def _record_of_responses(record: Record, values: Floats, label: str) -> Record:
    source = f"{record.source or 'record'}, {label}"
    units = record.select(record.responses).units
    return Record(record.start, record.rate, record.responses, values, source=source, units=units)


_SUBSTEPS = 8  # between samples
_PRIOR = 1e-6  # of the normal matrix, for combinations of states that the start does not determine


def _channels_of_rig(record: Record, structure: Structure) -> Record:
    """The motion of the base and the forces of the links; RecordError where the record does not hold them."""
    cells = [cell_name(structure, link) for link in range(len(structure.links))]
    shown = [name for name in cells if name in record.channels]
    if not shown or BASE_CHANNEL not in record.channels:
        raise RecordError(
            f"links alone on a rig are compared along {BASE_CHANNEL} with {', '.join(cells)}, and the record holds "
            f"{', '.join(record.channels)}"
        )
    return record.select([BASE_CHANNEL, *shown])


def _predicted_on_rig(
    scored: Record, given: KnownAnswer, burn: float | None, law_error: float, progress: Progress
) -> _Predicted:
    """The same of links along the recorded motion of a rig, whose states are estimated from the samples of the burn alone.

    Noise is that of the load cell and of the recorded motion beside it.
    """
    samples = _burn_samples(scored, burn)
    structure = given.structure
    try:
        of_structure = RigProblem.of([scored], structure).with_substeps(_SUBSTEPS)
    except IdentificationError as error:
        raise RecordError(str(error)) from None
    free, theta, known = with_uncertain(given)
    started, covariance = _states_at_start(of_structure, samples)
    fit = replace(
        started, problem=replace(of_structure, structure=free), unknowns=np.append(theta, started.unknowns)
    )
    count, cells = len(scored), fit.problem.cells
    slopes = fit.jacobian.reshape(len(cells), count, -1)
    of_states = slopes[..., len(theta) :], covariance
    of_coefficients = slopes[..., : len(theta)], known
    moved = fit.by_motion.reshape(len(cells), count)
    predicted = np.stack([path.force()[::_SUBSTEPS] for path in fit.paths], axis=1)
    predicted[:samples] = np.nan
    spread = np.zeros(predicted.shape) + law_error * np.nanstd(predicted, axis=0)
    d, v = fit.problem.motions[0].at_samples[:, :, None] * structure.base_incidence
    prediction = Prediction(
        predicted=predicted,
        variances=np.stack([_variance(*of_states), _variance(*of_coefficients), spread**2], axis=1),
        d=d,
        v=v,
    )
    levels: dict[str, float] = {
        cell.channel: float(
            np.hypot(
                fit.problem.noise[cell.channel], np.sqrt(np.mean(deviations[np.isfinite(cell.measured)] ** 2))
            )
        )
        for cell, deviations in zip(cells, moved, strict=True)
    }
    progress(ProgressReport(1.0, "forces along the motion"))
    variance = np.where(np.isnan(predicted), np.nan, prediction.variances.sum(axis=1))
    return samples, prediction, (predicted, variance), levels


def _states_at_start(problem: RigProblem, burn: int) -> tuple[RigFit, Floats]:
    """The states at the start that explain the forces of the first `burn` samples best, and their covariance."""
    fit = RigFit.at(problem, np.zeros(problem.size))
    if not fit.converged:
        raise RecordError("the states of a link run away along the recorded motion")
    burnt = [np.arange(len(cell.measured)) < burn for cell in problem.cells]
    weights = np.concatenate(burnt) / fit.cells
    fit = minimise(problem, fit.unknowns, weights) if problem.size else fit
    slopes = weights[:, None] * fit.jacobian
    normal = slopes.T @ slopes
    powers = np.concatenate([np.mean(path.states**2, axis=0) for path in fit.paths])
    # a state that the start does not show, as behind backlash, is as uncertain as it is large later on
    normal += _PRIOR * np.diag(normal.diagonal()) + np.diag(1.0 / np.where(powers > 0.0, powers, 1.0))
    return fit, np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _variance(slopes: Floats, covariance: Floats) -> Floats:
    """Variances (N, C) of forces with derivatives (C, N, q) by what has this covariance."""
    return np.asarray(np.einsum("cnq,qr,cnr->nc", slopes, covariance, slopes))
