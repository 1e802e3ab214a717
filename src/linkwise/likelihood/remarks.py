"""What a fit found beside the coefficients: errors of sensors as results, and remarks on forces, bounds and other optima."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkwise.display import enumerated
from linkwise.estimates.causes import HARMONIC, HUM, Cause, SensorErrorEstimate
from linkwise.estimates.estimate import Estimate
from linkwise.inspection.inspect import EstimatedError
from linkwise.likelihood.fit import LikelihoodFit, inflation_beside_others
from linkwise.likelihood.harmonics import MAY_FADE
from linkwise.likelihood.optima.other_optima import is_loosened
from linkwise.likelihood.options import OF_FORCE
from linkwise.likelihood.terms import Disturbance, Hum, Waveform
from linkwise.model.coefficient import Name
from linkwise.records.record import Record

_LOOSENED = (
    "If the motion had to follow the laws exactly, the likelihood would have many optima because of the noise, and a "
    "search finds one of them. The motion was therefore allowed to depart from the laws by a small part "
    "of the noise, which widens the intervals."
)
_INSEPARABLE = 100.0  # variance of an unknown over that beside known others: a correlation of 0.995 of two
_NEARLY = 2.0  # times the noise, in power: laws that leave no more nearly explain the records


def fit_remarks(
    fit: LikelihoodFit,
    records: Sequence[Record],
    sensor_errors: Sequence[SensorErrorEstimate],
    faint: Sequence[Name] = (),
) -> tuple[str, ...]:
    """What was found beside the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    records : sequence of Record
        The records.
    sensor_errors : sequence of SensorErrorEstimate
        Errors of sensors that were found.
    faint : sequence of str, optional
        Frequencies and damping of modes that the record hardly shows.

    Returns
    -------
    tuple of str
        Sentences on random forces, on sensors, with standard errors, and on other values that are as likely.
    """
    others = (zip(fit.names, values, strict=True) for values in fit.others)
    tied = (", ".join(f"{name} = {value:.4g}" for name, value in pairs) for pairs in others)
    return (
        *(force.description for force in fit.random_forces),
        *(error.description for error in sensor_errors),
        *(
            found.term.description(found, records[0].unit(found.term.channel))
            for found in fit.found
            if isinstance(found.term, Disturbance)
        ),
        *_unused_bounds(fit, records),
        *[_LOOSENED] * is_loosened(fit),
        *(f"Another set of values explains the records as well: {values}." for values in tied),
        *_of_faint_modes(faint),
    )


def inseparable(fit: LikelihoodFit) -> tuple[str, ...]:
    """Unknowns that the records hardly tell apart, where no intervals show it.

    Parameters
    ----------
    fit : LikelihoodFit
        A fit that is not trusted.

    Returns
    -------
    tuple of str
        A sentence; none where there are no such unknowns, or where the laws leave much more than the noise.
    """
    if fit.chi_square > _NEARLY:
        return ()
    free = np.flatnonzero(fit.free)
    inflation = inflation_beside_others(fit.covariance)[free]
    names = [fit.names[column] for column in free[inflation > _INSEPARABLE]]
    if len(names) < 2:
        return ()
    return (
        f"The record hardly tells {enumerated(names)} apart: each would be determined more than "
        f"{np.sqrt(_INSEPARABLE):.0f} times better beside known values of the others. Hold one of them at a known value, or "
        "record a wider range of motion.",
    )


def sensor_errors(fit: LikelihoodFit, units: Mapping[str, str]) -> tuple[SensorErrorEstimate, ...]:
    """The errors of sensors of a fit, in the SI `units` of channels.

    Offsets, gains and delays come first, in this order; without those that a search left without a finite standard error.
    """
    of_time_last = sorted(fit.terms, key=lambda term: isinstance(term, Waveform))
    estimates = (term.estimate(*fit.size_of(term), units.get(term.channel, "")) for term in of_time_last)
    return tuple(
        error
        for error in estimates
        if error is not None and np.isfinite(error.value) and np.isfinite(error.standard_error)
    )


def disturbances(fit: LikelihoodFit) -> tuple[EstimatedError, ...]:
    """Drifts and hums of sensors that were found with the coefficients, one for each channel and frequency."""
    return tuple(
        EstimatedError(one.kind, one.channel, one.frequency if isinstance(one, Hum) else None)
        for one in fit.terms
        if isinstance(one, Disturbance)
    )


def _unused_bounds(fit: LikelihoodFit, records: Sequence[Record]) -> Iterator[str]:
    """Channels whose clipped samples are not taken as bounds, though they were marked."""
    unused = dict.fromkeys(
        name
        for record in records
        for name, clipped in record.clipped.items()
        if name in record.responses
        and (fit.segments.clipped is None or clipped.of(record.channel(name)) is None)
    )
    if unused:
        yield (
            f"The clipped samples of {', '.join(unused)} are taken as missing, not as bounds: a robust loss, random forces, a "
            "late sensor on a moving base, or a change of the channel after they were marked leaves no other way. Where noise "
            "decided what was clipped, the values are off by a part of their standard errors."
        )


def _of_faint_modes(faint: Sequence[Name]) -> Iterator[str]:
    """What is said of modes that the record hardly shows."""
    by_mode: dict[str, list[Name]] = {}
    for name in faint:
        by_mode.setdefault(name.owner, []).append(name)
    for names in by_mode.values():
        are, intervals = (
            ("is", "its interval is that") if len(names) == 1 else ("are", "their intervals are those")
        )
        yield (
            f"{' and '.join(names)} {are} hardly determined by the record, whose noise hides the mode: {intervals} of the "
            "prior."
        )


def with_added(answer: Estimate, added: Sequence[Cause]) -> Estimate:
    """The answer, whose message begins with what was added to the model, with sizes as they were found."""
    found, message = _as_found(added, answer), answer.message
    causes = " and ".join(cause.description for cause in found)
    message = f"With {causes} taken into the model, {message[:1].lower()}{message[1:]}"
    return replace(answer, added=found, message=message)


def _as_found(added: Sequence[Cause], answer: Estimate) -> tuple[Cause, ...]:
    """What was added, with the sizes and standard errors of the answer beside it."""
    sizes = []
    for cause in added:
        what = cause.kind.removeprefix(OF_FORCE), cause.where
        errors = [error for error in answer.sensor_errors if (error.kind, error.channel) == what]
        if errors:  # several lines of one mass
            error = min(errors, key=lambda one: abs(one.value - cause.size))
            size = error.value - 1.0 if cause.kind.endswith("gain") else error.value
            cause = replace(cause, size=size, standard_error=error.standard_error)
        if cause.kind in (HARMONIC, HUM) and cause.size in answer.may_fade:
            cause = replace(cause, remark=MAY_FADE)
        sizes.append(cause)
    return tuple(sizes)
