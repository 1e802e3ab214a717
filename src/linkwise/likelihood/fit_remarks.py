"""Sentences on what a fit found beside the coefficients: random forces, errors of sensors, other optima."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.causes import ErrorKind, SensorErrorEstimate
from linkwise.inspection.missing_samples import EstimatedError
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.low_signal import is_loosened
from linkwise.model.names import Name
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
    names = fit.segments.system.parameters.names
    tied = [
        "Another set of values explains the records as well: "
        f"{', '.join(f'{name} = {value:.4g}' for name, value in zip(names, values, strict=True))}."
        for values in fit.others
    ]
    loosened = [_LOOSENED] if is_loosened(fit) else []
    return (
        *(force.description for force in fit.random_forces),
        *(error.description for error in sensor_errors),
        *_disturbances(fit, records[0]),
        *_unused_bounds(fit, records),
        *loosened,
        *tied,
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
    inflation = _inflation(fit.covariance[np.ix_(free, free)])
    names = [fit.segments.system.parameters.names[column] for column in free[inflation > _INSEPARABLE]]
    if len(names) < 2:
        return ()
    return (
        f"The record hardly tells {', '.join(names[:-1])} and {names[-1]} apart: each would be determined more than "
        f"{np.sqrt(_INSEPARABLE):.0f} times better beside known values of the others. Hold one of them at a known value, or "
        "record a wider range of motion.",
    )


def _inflation(covariance: Floats) -> Floats:
    """(q,) the variance of each unknown over what it has where the others are known; infinite where it has none."""
    variances = covariance.diagonal()
    inflation = np.full(len(variances), np.inf)
    usable = np.flatnonzero(np.isfinite(covariance).all(axis=1) & (variances > 0.0))
    deviations = np.sqrt(variances[usable])
    correlation = covariance[np.ix_(usable, usable)] / np.outer(deviations, deviations)
    inflation[usable] = np.linalg.pinv(correlation, rcond=1e-12, hermitian=True).diagonal()
    return inflation


def sensor_errors(
    fit: LikelihoodFit, delays: Mapping[str, float], units: Mapping[str, str]
) -> tuple[SensorErrorEstimate, ...]:
    """The errors of sensors of a fit.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    delays : mapping of str to float
        All of the delays in s by channel, of which the fit has what is left beside shifts by whole samples.
    units : mapping of str to str
        The SI units of channels.

    Returns
    -------
    tuple of SensorErrorEstimate
        Offsets, gains and delays, in this order; none that a search left without a finite standard error.
    """
    sizes: tuple[tuple[ErrorKind, Mapping[str, float]], ...] = (
        ("offset", fit.offsets),
        ("gain", fit.gains),
        ("delay", delays),
    )
    named = [(kind, name, value) for kind, values in sizes for name, value in values.items()]
    of_kind = {"gain": "1", "delay": "s"}
    return tuple(
        SensorErrorEstimate(
            name, kind, float(value), float(deviation), of_kind.get(kind, units.get(name, ""))
        )
        for (kind, name, value), deviation in zip(named, fit.sensor_deviations, strict=True)
        if np.isfinite(value) and np.isfinite(deviation)
    )


def estimated_disturbances(fit: LikelihoodFit) -> tuple[EstimatedError, ...]:
    """Drifts and hums of sensors that were found with the coefficients.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    tuple of EstimatedError
        One for each channel and frequency.
    """
    places = dict.fromkeys((disturbance.channel, disturbance.frequency) for disturbance in fit.disturbances)
    return tuple(
        EstimatedError("drift" if frequency is None else "hum", channel, frequency)
        for channel, frequency in places
    )


def _disturbances(fit: LikelihoodFit, record: Record) -> Iterator[str]:
    """What was found of drifts and hums of channels of a record."""
    first = 0
    for disturbance in fit.disturbances:
        sizes, deviations = fit.waveforms[:, first : first + disturbance.count]
        yield disturbance.describe(sizes, deviations, record.unit(disturbance.channel))
        first += disturbance.count


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
        verb, intervals = (
            ("is", "its interval is that") if len(names) == 1 else ("are", "their intervals are those")
        )
        subject = f"{' and '.join(names)} {verb} hardly determined by the record"
        yield f"{subject}, whose noise hides the mode: {intervals} of the prior."
