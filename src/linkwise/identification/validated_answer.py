"""What is validated, a structure with the errors of its coefficients, laws and sensors, and whether a record agrees with
its coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, RecordError, StructureError
from linkwise.estimates.causes import CROSSTALK, Cause, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Answer, KnownAnswer, Posterior
from linkwise.identification.validation_result import CoefficientAgreement
from linkwise.likelihood.checks.recording import EXCHANGES, corrected
from linkwise.likelihood.estimate import MaximumLikelihood
from linkwise.model.coefficient import MASS, Coefficient, Name
from linkwise.model.host import is_between_modes
from linkwise.model.structure import Structure
from linkwise.output import RESULT
from linkwise.progress import Progress
from linkwise.records.channel import SensorUncertainty
from linkwise.records.joining import without_delays
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise

_STRUCTURE = "structure.toml"


def answer_in_numbers(answer: Answer) -> KnownAnswer:
    """What an answer in any of its forms says; StructureError where a coefficient has no value."""
    given = KnownAnswer.of(answer)
    for parameter in given.structure.parameters:
        path = Path(answer) if isinstance(answer, str | Path) else None
        file = path / _STRUCTURE if path and path.is_dir() else path
        inside = file.parent / "answer" if file else Path()
        raise StructureError(
            f"{parameter.name} is unknown, and every coefficient must be a number here: identify it first, or give one"
            f"{f'; an answer is in {inside}' if (inside / RESULT).is_file() else ''}",
            str(file or ""),
        )
    return given


def taken_as_exact(given: KnownAnswer) -> tuple[str, ...]:
    """A sentence on the coefficients of an answer that does not tell their errors."""
    why = "The coefficients are taken as exact, since the answer does not say how far they may be off"
    return (f"{why} ({given.without}).",) if given.posterior is None and given.without else ()


def with_uncertain(given: KnownAnswer) -> tuple[Structure, Floats, Floats]:
    """The structure with its uncertain coefficients as unknowns, their values (p,) in that order, and their covariance."""
    posterior = given.posterior
    if posterior is None or not posterior.names:
        return given.structure, np.zeros(0), np.zeros((0, 0))
    free = uncertain(posterior)
    order = [posterior.names.index(parameter.name) for parameter in free.parameters]
    return free, posterior.values[order], posterior.beside_terms_kept[np.ix_(order, order)]


_ORDER = (CROSSTALK, "offset", "gain", "delay", "clock")  # in which they are undone: an offset is added last


def without_found_errors(
    record: Record, errors: Sequence[SensorErrorEstimate], corrected: Mapping[str, Sequence[str]]
) -> tuple[Record, tuple[str, ...]]:
    """The record as it would be without the `errors`, and sentences on what was taken out and what was not.

    The standard errors are what is known of the sensors then, in place of what the record states. Errors of the kinds that
    are `corrected`, by channel, stay: the record is without them. Raises IdentificationError for another kind or channel.
    """
    _require_kinds(corrected, record)
    taken_out, remarks, given = [], [], record
    undone = [error for error in errors if error.kind in _ORDER and error.channel in record.channels]
    for error in sorted(undone, key=lambda error: _ORDER.index(error.kind)):
        name = f"{error.kind} of {error.channel}"
        if error.kind in corrected.get(error.channel, ()):
            unit = "" if error.unit == "1" else f" {error.unit}"
            remarks.append(
                f"The {name} that the answer found, {error.value:.6g}{unit}, was not removed: what is stated of it for this "
                "record counts."
            )
            continue
        try:
            record = _without_error(record, error, given)
        except RecordError as refusal:
            remarks.append(f"The {name} that the answer found was not removed: {refusal}")
        else:
            taken_out.append(name)
    if taken_out:
        remarks.append(
            f"Removed from the record, as found by the answer: {', '.join(taken_out)}. If a sensor was exchanged or "
            f"adjusted since, identify again."
        )
    return record, tuple(remarks)


def without_exchanges(record: Record, added: Sequence[Cause]) -> tuple[Record, tuple[str, ...]]:
    """The record without the signs, units and places that an answer took out of its own, and a sentence on it."""
    changed = []
    for cause in (cause for cause in added if cause.kind in EXCHANGES):
        given, record = record, corrected(record, cause)
        changed += [] if np.array_equal(record.values, given.values, equal_nan=True) else [cause.description]
    if not changed:
        return record, ()
    named = " and ".join(changed)
    remark = f"Taken out of the record, as of that of the answer: {named}."
    return record, (
        f"{remark} Of a record without it, give the {_STRUCTURE} of the answer in place of its folder.",
    )


def _require_kinds(corrected: Mapping[str, Sequence[str]], record: Record) -> None:
    for channel, kinds in corrected.items():
        wrong = next((kind for kind in kinds if kind not in _ORDER), None)
        if wrong is not None or channel not in record.channels:
            of_kind = f"the {wrong} of a channel; choose from {', '.join(_ORDER)}"
            reason = of_kind if wrong else "a channel of the record"
            raise IdentificationError(
                f"corrected takes errors that the record is without, by channel, got {channel}: {', '.join(kinds)}, which is "
                f"not {reason}",
                arguments=("corrected",),
            )


def _without_error(record: Record, error: SensorErrorEstimate, given: Record) -> Record:
    """The record without one error, as it was `given` with all; RecordError where it cannot be taken out."""
    column, values = record.channels.index(error.channel), record.values.copy()
    if error.kind == "clock":
        return without_delays(record, {}, clocks={error.channel: error.value})
    if error.kind == CROSSTALK:
        values[:, column] -= error.value * given.channel(error.source)
        return replace(record, values=values)
    if error.kind == "delay":
        record = without_delays(record, {error.channel: error.value})
    elif error.kind == "offset":
        values[:, column] -= error.value
    elif error.value > 0.0:
        values[:, column] /= error.value
    else:
        raise RecordError(f"a gain must be positive, got {error.value:g}")
    if error.kind != "delay":
        record = replace(record, values=values)
    stated = record.uncertainty.get(error.channel, SensorUncertainty())
    known = replace(stated, **{error.kind: error.standard_error})
    return replace(record, uncertainty={**record.uncertainty, error.channel: known})


LEVEL = 1e-3  # probability that a right answer is said to disagree


def uncertain(posterior: Posterior) -> Structure:
    """The structure with its uncertain coefficients as unknowns."""
    masses = posterior.structure.mass_names
    of_masses = [name.key == MASS and name.owner in masses for name in posterior.names]
    named = zip(posterior.names, of_masses, strict=True)
    return posterior.structure.unknown(*(f"mass:{name.owner}" if mass else name for name, mass in named))


def estimated_again(record: Record, posterior: Posterior, progress: Progress) -> Estimate:
    """The uncertain coefficients from the record alone, by maximum likelihood that starts at the answer.

    Shapes of hosts, and damping between their modes, stay known to within what the answer says: a record need not show again
    what they are.
    """
    starts: dict[str, float] = dict(zip(posterior.names, map(float, posterior.values), strict=True))
    deviations = dict(zip(posterior.names, posterior.covariance.diagonal() ** 0.5, strict=True))
    free = uncertain(posterior)
    free_names = {parameter.name for parameter in free.parameters}  # not those that share one of these
    known = {
        name: Coefficient.unknown(starts[name], sigma=float(deviation))
        for name, deviation in deviations.items()
        if _is_of_host(name) and deviation > 0.0 and name in free_names
    }
    structure = free.with_coefficients(known)
    again = MaximumLikelihood(starts=starts).estimate([record], structure, progress)
    if all(cause.kind == "input noise" for cause in again.added):
        return again  # the sensors are those of the answer
    return MaximumLikelihood(starts=starts, as_stated=True).estimate([record], structure, progress)


def agreements(estimate: Estimate, posterior: Posterior) -> tuple[CoefficientAgreement, ...]:
    """The answer beside an estimate from another record, coefficient by coefficient, but for those known to within there."""
    count = len(posterior.names)
    limit = float(-scipy.special.ndtri(LEVEL / (2 * max(count, 1))))
    rows = []
    for name in refittable_names(posterior):
        index = posterior.names.index(name)
        again = estimate.coefficient(name)
        error = math.sqrt(max(posterior.covariance[index, index], 0.0))
        if again.standard_error is None or not again.standard_error > 0.0:
            continue
        rows.append(
            CoefficientAgreement(
                name=name,
                unit=again.unit,
                value=float(posterior.values[index]),
                standard_error=error,
                record_value=again.value,
                record_error=again.standard_error,
                z=(again.value - float(posterior.values[index])) / math.hypot(error, again.standard_error),
                limit=limit,
            )
        )
    return tuple(rows)


def refittable_names(posterior: Posterior) -> tuple[Name, ...]:
    """What a record alone is asked to determine again: all that has a covariance, but for what is said of modes of hosts."""
    return tuple(name for name in posterior.names if not _is_of_host(name))


def _is_of_host(name: Name) -> bool:
    return name.is_shape or is_between_modes(name)


# of the RMS of a channel: interpolated inputs and sensitivities in single precision are not better
_FLOOR = 1e-5


def sensor_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response, at least what the prediction of it is off by."""
    noise = channel_noise(record)
    return {
        n: max(size, _FLOOR * float(np.sqrt(np.nanmean(record.channel(n) ** 2)))) for n, size in noise.items()
    }
