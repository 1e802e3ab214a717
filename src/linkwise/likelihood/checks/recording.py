"""What is wrong with the recording itself: samples at an end of a range, lost or written twice, noise that is stated smaller
than it is, and errors of a whole channel.

A score test says what a small error would explain, and of an error of -200 % it says anything. The wrong sign, another unit,
the place of another channel and a high pass are hypotheses of their own: each is taken out of the records, and the weak form
says how well the laws explain what is left, with coefficients of their own. One is named where the records as they stand are
not explained, and those without it are to within their noise, which no other cause does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, zip_longest
from typing import Any

import numpy as np
import scipy

from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import DEGREES, SLIP, Cause
from linkwise.inspection.channel_signal import RecordSignals
from linkwise.inspection.inspect import inspect, without_copies
from linkwise.inspection.sample_faults import rails
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.whiteness import is_white
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.progress import silent
from linkwise.records.channel import BASE, KINDS, OF_CHANNELS, Channel
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed_records
from linkwise.signals.noise import noise_sigma
from linkwise.verdict import Verdict
from linkwise.weak.displacements import with_displacements
from linkwise.weak.estimate import WeakForm, record_misfit

_BEYOND = 4.0  # standard errors, of the mean or of the power, which noise exceeds once in 30 000 and in 2 000 channels


def clipped_samples(fit: LikelihoodFit, records: Sequence[Record]) -> Iterator[Cause]:
    """The channels with samples at an end of their range that a fit contradicts: its motion goes on beyond it.

    The largest samples of a sensor that was not overloaded have noise to the outside, so that the motion is inside. A motion
    with a large model error follows the samples, and is beyond them by less than it misses them by.
    """
    ends: dict[str, set[tuple[float, float]]] = {}
    for record in records:
        for signal in RecordSignals.of(record).responses:
            ends.setdefault(signal.channel, set()).update(rails(signal))
    for number, name in enumerate(records[0].responses):
        samples, observed = fit.segments.samples[:, number], fit.segments.observed[:, number]
        residuals = fit.misfit.residuals[:, number] / fit.optimum.noise
        beyond = [-side * residuals[(samples == value) & observed] for value, side in ends.get(name, ())]
        outside = np.concatenate(beyond) if beyond else np.empty(0)
        count, total = len(outside), float(np.sum(outside))
        gain = float(np.sum(outside**2)) - count
        if total > _BEYOND * np.sqrt(count) or (total > 0.0 and gain > _BEYOND * np.sqrt(2.0 * count)):
            yield Cause("clipped", name, float(count), "1", gain, 0.0)


_JUMPS = "jumps between two samples"  # of a channel that lacks samples, without a gap in the times
_SYSTEMATIC = (Verdict.MEASUREMENT_ERROR, Verdict.SYSTEMATIC_MISFIT, Verdict.UNEXPLAINED_FORCES)


def uneven_samples(of: Examined, before: Judgement) -> Judgement | None:
    """Whether samples were lost or written twice, which all causes of a diagnosis resemble.

    A step in time moves everything behind it, which gains and delays explain in part.
    """
    if of.fit.random_forces or before.verdict not in _SYSTEMATIC or not before.diagnosis:
        return None
    shown = {
        f"{alert.channel} {alert.message.partition(',' if alert.kind == 'dropped' else ':')[0]}"
        for alert in inspect(tuple(of.records)).alerts
        if alert.kind == "doubled" or (alert.kind == "dropped" and alert.message.startswith(_JUMPS))
    }
    if not shown:
        return None
    message = (
        f"The record shows by itself what comes before any cause below: {'; '.join(sorted(shown))}. Samples were lost or "
        "written twice, so that what follows is early or late. Mend that first, as the alerts say, and identify again. "
        f"As it stands: {before.message[:1].lower()}{before.message[1:]}"
    )
    return replace(before, message=message)


def copied_samples(records: Sequence[Record]) -> list[Cause]:
    """The samples that are there twice, bit for bit, by record and response."""
    twice = ((record, *copied) for record in records for copied in without_copies(record)[1].items())
    return [
        _error(
            SLIP,
            name,
            -float(sum(copy.stop - copy.start for copy in copies)),
            source=f"{record.start + copies[0].start / record.rate:.4g} s",
        )
        for record, name, copies in twice
    ]


def samples_written_twice(of: Examined) -> Judgement | None:
    """Whether samples are there twice, so that one measurement counts as two and the motion begins anew."""
    twice = copied_samples(of.records)
    if not twice:
        return None
    message = (
        f"The record holds {' and '.join(cause.description for cause in twice)}, bit for bit: noise repeats none, intervals "
        "take them for a second measurement, and the motion begins anew. Identify the parts of the record without them."
    )
    return Judgement(Verdict.MEASUREMENT_ERROR, message, of.share, tuple(twice))


_LARGEST = 12  # masses up to which the weak form is fast enough for all hypotheses
_MOST = 60  # unknowns, likewise
# of a record, the part with the largest motion, which a whole channel shows as well as all of it
_SAMPLES = 20_000
_CONVINCING = 30.0  # of -2 log likelihood: chance gives one of 200 hypotheses that much in a million records
_ALIKE_MASSES = (
    0.1  # relative: by more, an exchange leaves more than noise in some record of a hundred samples
)
_PLACES, _SEED = 7, 20261129  # at which the symmetry of a law is looked at
_MAY_BE = 9.0  # the same of a high pass that the likelihood, which sees more of it, decides on: three standard errors
_ALIKE = 10.0  # of -2 log likelihood: "very strong" evidence between two errors (Kass and Raftery 1995)
_G = 9.80665  # m/s^2
_UNITS = {"x": (1e3, 1e-3), "v": (1e3, 1e-3), "a": (1.0 / _G, _G, 1e3, 1e-3), "force": (1e3, 1e-3)}
"""Times that values in mm told as m are too large, the usual error, and the reverse; of accelerations those in g as well."""
_ALL = {"x": "all displacements", "v": "all velocities", "a": "all accelerations"}
_ALL_CHANNELS = "all channels"
_ANGLES = (DEGREES, 1.0 / DEGREES)  # likewise those in deg told as rad
_CORNERS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Hz: AC coupling lies inside. What is best at an end is no high pass, but slow residuals or motion that any makes smaller."""
_HINT = 5.0  # of -2 log likelihood, from which a corner is looked for between these
_REFINED = 12  # records that are tried for it
_EXPLAINED = (Verdict.CONVERGED, Verdict.HARDLY_DETERMINED)
"""Verdicts of the weak form on laws that explain a record to within its noise."""

EXCHANGES = frozenset({"sign", "unit", "swapped", "place", "relative"})
"""Kinds of errors of a whole channel that a record can be freed of without loss."""


def recording_errors(records: Sequence[Record], structure: Structure) -> tuple[Cause, ...]:
    """The errors without which the records are explained to within their noise, the usual ones first.

    Several where the equations cannot tell them apart, as a displacement that is too large from another that is too small;
    none where the weak form does not apply. `structure` has its unknowns, all of the terms that were offered in a search.
    """
    parts = [*map(_loudest_part, records)]
    return tuple(
        error
        for error in _alike(_convincing(parts, structure))
        if all(_is_explained(error, corrected(part, error), structure) for part in parts)
    )


def exchanges(records: Sequence[Record], structure: Structure) -> list[Cause]:
    """The signs, units, places and references of channels that explain by far most; several that are not told apart."""
    convincing = _convincing([*map(_loudest_part, records)], structure)
    return _alike([error for error in convincing if error.kind in EXCHANGES])


def likeliest_errors(
    records: Sequence[Record], structure: Structure, named: Sequence[str] = ()
) -> list[Cause]:
    """The sign, the unit or the place of a channel that explains by far most, then the high pass that may explain something.

    None of these where another one explains as much; a high pass, whose corner is fitted, may explain more of the noise than
    such an error does. Of several units the one that is `named` by an alert counts, of several high passes the likeliest, and
    of several signs the first, as the others differ by the direction that is positive; but for laws that hold it, none of one
    sensor or an input, where no others outvote it.
    """
    convincing = _convincing([*map(_loudest_part, records)], structure, _MAY_BE)
    passes = sorted(
        (error for error in _alike(convincing) if error.kind == "high pass"), key=lambda e: -e.gain
    )
    likeliest = _alike([error for error in convincing if error.kind in EXCHANGES])
    signs = [error.where for error in likeliest if error.kind == "sign"]
    outvoted = len(signs) == 1 and signs[0] in records[0].responses and len(records[0].channels) > 2
    if signs and not outvoted and not all(map(_is_odd, structure.links)):
        likeliest = []
    elif 1 < len(likeliest) == len(signs):
        likeliest = likeliest[:1]
    elif len(likeliest) > 1:
        likeliest = [error for error in likeliest if error.where in named]
    if len(likeliest) != 1 or (likeliest[0].kind == "swapped" and _are_alike(likeliest[0], structure)):
        return passes[:1]
    others = " or ".join(signs[1:]) or "all others"
    remark = f"or of {others}, by the direction that is positive" if signs else ""
    return [replace(likeliest[0], remark=remark), *passes[:1]]


def _are_alike(swapped: Cause, structure: Structure) -> bool:
    """Whether the masses of two channels may be equal: laws that are stated at the other one look like an exchange then."""
    known = {mass.name: mass.mass.value if mass.mass.known else None for mass in structure.masses}
    places = (name.partition(":")[2] for name in (swapped.where, swapped.source))
    first, second = (known.get(place, np.inf) for place in places)
    return first is None or second is None or abs(first - second) < _ALIKE_MASSES * abs(first)


def _is_odd(link: Link) -> bool:
    """Whether motion the other way makes the force of a link the other way, by its law at a few places."""
    law = link.law
    if not law.is_plain:
        return True
    d, v = np.random.default_rng(_SEED).normal(size=(2, _PLACES))
    ones = dict.fromkeys(law.coefficients, 1.0)
    force = law.force(d, v, ones)
    return bool(
        np.allclose(law.force(-d, -v, ones), -force, rtol=1e-9, atol=1e-9 * float(np.abs(force).max()))
    )


def corrected(record: Record, error: Cause) -> Record:
    """A record without the wrong sign, unit, place or reference of a channel, or without a high pass.

    Parameters
    ----------
    record : Record
        The record.
    error : Cause
        A cause of the kind "sign", "unit", "swapped", "place", "relative" or "high pass".

    Returns
    -------
    Record
        The record without it; itself where it lacks the channels.
    """
    values, places = record.values.copy(), {str(name): place for place, name in enumerate(record.channels)}
    channels, names = list(record.channels), dict(zip(record.channels, record.channels, strict=True))
    of_all = {kinds: [name for name in record.responses if name.kind == kind] for kind, kinds in _ALL.items()}
    of_all[_ALL_CHANNELS] = [name for name in record.responses if f"{name.kind}:{BASE}" in places]
    for name in of_all.get(error.where, [name for name in record.channels if name == error.where]):
        column = places[name]
        match error.kind:
            case "sign":
                values[:, column] *= -1.0
            case "unit":
                values[:, column] /= error.size
            case "relative" if f"{name.kind}:{BASE}" in places:
                values[:, column] += record.channel(f"{name.kind}:{BASE}")
            case "swapped" if error.source in places:
                values[:, [column, places[error.source]]] = record.values[:, [places[error.source], column]]
            case "place" if f"force:{error.source}" not in places:
                channels[column] = names[name] = Channel("force", error.source)
            case "high pass":  # y' + w y = x' that was at rest: x = y + w times the integral of y
                integral = scipy.integrate.cumulative_trapezoid(
                    values[:, column], dx=record.step, initial=0.0
                )
                values[:, column] += 2.0 * np.pi * error.size * integral
    stated: dict[str, Any] = {
        what: {names.get(key, key): value for key, value in getattr(record, what).items()}
        for what in OF_CHANNELS
    }
    return replace(record, channels=tuple(channels), values=values, simulated=None, **stated)


def _convincing(parts: Sequence[Record], structure: Structure, high_pass: float = _CONVINCING) -> list[Cause]:
    """The errors that explain more of what the weak form leaves of records than chance; by more than that a `high_pass`."""
    hidden = not all(parts[0].motions_of(name) for name in structure.mass_names)
    if hidden or structure.size > _LARGEST or len(structure.parameters) > _MOST:
        return []

    def gain(error: Cause) -> float:
        return as_recorded - _misfit([corrected(part, error) for part in parts], structure)

    as_recorded = _misfit(parts, structure)
    if not np.isfinite(as_recorded):
        return []
    errors = [*_exchanged(parts[0], structure), *_high_passes(parts, structure, gain)]
    errors = [replace(error, gain=gain(error)) for error in errors]
    return [
        error for error in errors if error.gain > (high_pass if error.kind == "high pass" else _CONVINCING)
    ]


def _alike(errors: Sequence[Cause]) -> list[Cause]:
    """The errors that explain most."""
    least = max((error.gain for error in errors), default=-np.inf) - _ALIKE
    return [error for error in errors if error.gain > least]


def _loudest_part(record: Record) -> Record:
    """The part of a long record in which its responses have the largest power, its noise not stated: it is found, as units
    change.
    """
    record = replace(record, noise={}, simulated=None)
    if len(record) <= _SAMPLES:
        return record
    responses = np.nan_to_num(record.select(record.responses).values)
    power = np.sum((responses / np.maximum(np.std(responses, axis=0), np.finfo(float).tiny)) ** 2, axis=1)
    firsts = (*range(0, len(record) - _SAMPLES, _SAMPLES // 4), len(record) - _SAMPLES)
    first = max(firsts, key=lambda first: float(np.sum(power[first : first + _SAMPLES])))
    return record[first : first + _SAMPLES]


def _misfit(records: Sequence[Record], structure: Structure) -> float:
    """What the weak form leaves of records; infinite where it does not apply."""
    try:
        framed = framed_records(records, structure, integrated=True)
        return sum(record_misfit(with_displacements(one, structure.masses), structure) for one in framed)
    except (LinkwiseError, np.linalg.LinAlgError):
        return np.inf


def _is_explained(error: Cause, record: Record, structure: Structure) -> bool:
    """Whether the weak form finds no more than noise in what the laws leave of a `record` that is without an error.

    Without a high pass, and in displacements that are integrated, slow noise is larger than elsewhere, and follows slow
    motion; there the power decides.
    """
    try:
        shown = with_displacements(record, structure.masses)
        answer = WeakForm().estimate([shown], structure, silent)
    except (LinkwiseError, np.linalg.LinAlgError):
        return False
    verdict, slow = answer.fit_verdicts[0], error.kind == "high pass" or shown is not record
    if slow and verdict is Verdict.NOISE_MISMATCH:
        return (answer.chi_square_per_sample or 0.0) < 1.0
    return verdict in _EXPLAINED or (slow and verdict is Verdict.SYSTEMATIC_MISFIT)


def _exchanged(record: Record, structure: Structure) -> Iterator[Cause]:
    """Channels of the wrong sign, in another unit, in each other's place, or relative to the base, or all of them; forces on
    another mass.
    """
    places = (*structure.mass_names, BASE)
    measured = [name for name in record.channels if name.kind in _UNITS and name.place in places]
    forces = [name for name in measured if name.kind == "force"]
    motions = [name for name in measured if name.kind != "force"]
    for name in (*forces, *motions):
        yield _error("sign", name)
    angles = {name: _ANGLES for name in motions if unit_in(structure, name) == KINDS["x"].angular_unit}
    units = {name: (*_UNITS[name.kind], *angles.get(name, ())) for name in (*motions, *forces)}
    for usual in zip_longest(*units.values()):  # the most usual of all channels first
        yield from (_error("unit", name, times) for name, times in zip(units, usual, strict=True) if times)
    for kind, where in _ALL.items():
        if sum(name.kind == kind for name in record.responses) > 1:
            yield from (_error("unit", where, times) for times in _UNITS[kind])
    for first, second in combinations(measured, 2):
        if first.kind == second.kind:
            yield _error("swapped", first, source=second)
    others = [mass for mass in structure.mass_names if f"force:{mass}" not in forces]
    yield from (_error("place", name, source=mass) for name in forces for mass in others)
    for base in (name for name in motions if name.place == BASE):
        moved = [name for name in motions if name.kind == base.kind and name.place != BASE]
        for where in (*moved, *([_ALL_CHANNELS] if len(moved) > 1 else ())):
            yield _error("relative", where)


def _high_passes(
    records: Sequence[Record], structure: Structure, gain: Callable[[Cause], float]
) -> Iterator[Cause]:
    """Of each displacement without gaps the high pass of first order that explains most, if one of usual corners does."""
    for name in (f"x:{name}" for name in structure.mass_names):
        if not all(name in record.channels and np.isfinite(record.channel(name)).all() for record in records):
            continue
        gains = [gain(_error("high pass", name, corner, "Hz")) for corner in _CORNERS]
        best = int(np.argmax(gains))
        if gains[best] < _HINT or best in (0, len(_CORNERS) - 1):
            continue
        refined = scipy.optimize.minimize_scalar(
            lambda log_corner, name=name: -gain(_error("high pass", name, float(np.exp(log_corner)), "Hz")),
            bounds=np.log([_CORNERS[best - 1], _CORNERS[best + 1]]),
            method="bounded",
            options={"maxiter": _REFINED},
        )
        yield _error("high pass", name, float(np.exp(refined.x)), "Hz")


def _error(kind: str, where: str, size: float = 0.0, unit: str = "1", source: str = "") -> Cause:
    return Cause(kind, str(where), size, unit, 0.0, standard_error=0.0, source=str(source))


# times the noise: 1.44 in chi-square, which no number of samples that a fit has gives by chance
_EXCEEDED = 1.2
# times the noise: what neighbouring samples scatter by is noise within a few per cent where the motion is resolved
_SCATTERED = 100.0
_DOUBTED = (Verdict.NOT_CONVERGED, Verdict.NOISE_MISMATCH)


def understated_noise(of: Examined, before: Judgement) -> Judgement | None:
    """Whether the noise of channels is stated too small, and nothing else is wrong.

    What laws lack leaves residuals that follow the motion, from one sample to the next; those of noise are white.
    """
    fit, records, unsettled = of.fit, of.records, before.verdict is Verdict.NOT_CONVERGED
    if before.verdict not in _DOUBTED or fit.random_forces:
        return None
    if unsettled and (scattered := beyond_statement(records)):
        return replace(before, message=f"{before.message} {scattered}", is_final=True)
    if not np.isfinite(fit.chi_square):
        return None
    stated = {name for record in records for name in record.noise}
    exceeded = []
    parts = zip(
        fit.noise.items(), fit.misfit.residuals.transpose(1, 2, 0), fit.optimum.scales.sigma, strict=True
    )
    for (name, noise), residuals, counted_as in parts:
        ratio = noise / records[0].noise.get(name, counted_as)
        if ratio > _EXCEEDED:
            if name not in stated or not is_white(residuals.ravel()):
                return None
            exceeded.append(f"{ratio:.2g} times in {name}, {noise:.2g} {records[0].unit(name)}")
    if not exceeded:
        return None
    message = (
        f"The residuals exceed the noise that is stated ({' and '.join(exceeded)}), and are white, as noise is and what "
        f"laws lack is not: it is stated too small.{' The search did not converge with it.' if unsettled else ''} "
        "State what it is, or leave it out, so that it is found with the laws."
    )
    return replace(before, message=message, is_final=True)


def beyond_statement(records: Sequence[Record]) -> str:
    """Whether samples of responses scatter far more than the noise that is stated of them.

    Parameters
    ----------
    records : sequence of Record
        The records.

    Returns
    -------
    str
        A sentence on such channels; empty where there are none.
    """
    scatters: dict[Channel, tuple[float, float]] = {}
    for record in records:
        responses = record.select(record.responses)
        for name, sigma in zip(responses.channels, noise_sigma(responses.values).tolist(), strict=True):
            stated = record.noise.get(name, 0.0)
            ratio = sigma / stated if stated > 0.0 else 0.0
            if ratio > max(_SCATTERED, scatters.get(name, (0.0, 0.0))[0]):
                scatters[name] = ratio, sigma
    if not scatters:
        return ""
    which = " and ".join(
        f"{ratio:.2g} times in {name}, {sigma:.2g} {name.unit}" for name, (ratio, sigma) in scatters.items()
    )
    return (
        f"Before any law, neighbouring samples scatter by far more than the noise that is stated ({which}): state what it is, "
        "or leave it out, so that it is found with the laws."
    )


def errors_of_records(of: Examined, before: Judgement) -> Judgement | None:
    """Whether samples are clipped, or a whole channel has the wrong sign, another unit or place, or a high pass.

    Without such an error one of the structures explains the records to within their noise, or the record itself shows it, and
    no other cause is likelier.
    """
    if of.fit.random_forces or not (before.verdict.forbids or before.diagnosis):
        return None
    clipped = tuple(clipped_samples(of.fit, of.records))
    unexplained = of.is_unexplained(before.verdict)
    of_channels = (recording_errors(of.records, structure) for structure in of.structures if unexplained)
    errors = (*clipped, *next(filter(None, of_channels), ()))
    if not errors:
        return None
    unsettled = before.verdict is Verdict.NOT_CONVERGED
    verdict = Verdict.NOT_CONVERGED if unsettled else Verdict.MEASUREMENT_ERROR
    message = (f"{before.message} " if unsettled else "") + _explanation(errors, is_clipped=bool(clipped))
    return before.overruled(verdict, message, *errors, is_final=True)


def _explanation(errors: Sequence[Cause], *, is_clipped: bool) -> str:
    """What the first of the errors means, and what mends it; the others look like it."""
    first, others = errors[0], errors[1:]
    advice = _ADVICE[first.kind].format(
        where=first.where, source=first.source, factor=1.0 / (first.size or 1.0)
    )
    if is_clipped:
        more = f" There is also {' and '.join(error.description for error in others)}." if others else ""
        return (
            f"The motion goes on beyond the range of {first.where}: {first.description} would lower -2 log likelihood by "
            f"{first.gain:.3g}.{more} Intervals of exact laws would not include that: {advice}."
        )
    alike = f" ({' or '.join(error.description for error in others)} would do the same)" if others else ""
    return (
        f"The laws do not explain the record as it stands, and explain it to within its noise but for one error: "
        f"{first.description}{alike}: {advice}, and identify again."
    )


_ADVICE = {
    "sign": "change the sign of {where}",
    "unit": "multiply {where} by {factor:g}, or state its unit",
    "swapped": "exchange {where} and {source}",
    "place": "name {where} as force:{source}",
    "relative": "name {where} as relative, rel:x:MASS, or add the motion of the base",
    "high pass": "couple the sensor of {where} directly (DC), or integrate what it took off",
    "clipped": "mark these samples as missing (mark_missing), or measure with a larger range",
}
