"""Errors of a whole channel: the wrong sign, another unit, the place of another channel, a high pass.

A score test says what a small error would explain, and of an error of -200 % it says anything. These are hypotheses of their
own: each is taken out of the records, and the weak form says how well the laws explain what is left, with coefficients of
their own. One is named where the records as they stand are not explained, and those without it are to within their noise,
which no other cause does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import DEGREES, Cause
from linkwise.model.structure import Structure
from linkwise.progress import silent
from linkwise.records.channel import KINDS
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed_records
from linkwise.verdict import Verdict
from linkwise.weak.estimate import WeakForm
from linkwise.weak.record_misfit import record_misfit

_LARGEST = 12  # masses up to which the weak form is fast enough for all hypotheses
_MOST = 60  # unknowns, likewise
# of a record, the part with the largest motion, which a whole channel shows as well as all of it
_SAMPLES = 20_000
_CONVINCING = 30.0  # of -2 log likelihood: chance gives one of 200 hypotheses that much in a million records
_ALIKE = 10.0  # of -2 log likelihood: "very strong" evidence between two errors (Kass and Raftery 1995)
_UNITS = (1e-3, 1e3)  # factors that take out values in mm told as m, the usual error, and the reverse
_ANGLES = (1.0 / DEGREES, DEGREES)  # likewise those in deg told as rad
_CORNERS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Hz: AC coupling lies inside. What is best at an end is no high pass, but slow residuals or motion that any makes smaller."""
_HINT = 5.0  # of -2 log likelihood, from which a corner is looked for between these
_REFINED = 12  # records that are tried for it
_EXPLAINED = (Verdict.CONVERGED, Verdict.HARDLY_DETERMINED)
"""Verdicts of the weak form on laws that explain a record to within its noise."""

Correction = Callable[[Record], Record]


@dataclass(frozen=True, eq=False)
class RecordingError:
    """An error of a channel, with the words of a `Cause`, and what takes it out of a record."""

    kind: str
    where: str
    correct: Correction
    source: str = ""
    size: float = 0.0
    unit: str = "1"

    def cause(self, gain: float) -> Cause:
        """It as a cause that takes `gain` off -2 log likelihood."""
        return Cause(
            self.kind, self.where, self.size, self.unit, gain, standard_error=0.0, source=self.source
        )


def recording_errors(records: Sequence[Record], structure: Structure) -> tuple[Cause, ...]:
    """The errors without which the records are explained to within their noise, the usual ones first.

    Several where the equations cannot tell them apart, as a displacement that is too large from another that is too small;
    none where the weak form does not apply. `structure` has its unknowns, all of the terms that were offered in a search.
    """
    if structure.size > _LARGEST or len(structure.parameters) > _MOST:
        return ()
    given = [
        replace(record, noise={}, simulated=None) for record in records
    ]  # noise is found, as units change
    parts = [_loudest_part(record) for record in given]

    def corrected(error: RecordingError) -> list[Record]:
        return [error.correct(record)[part] for record, part in zip(given, parts, strict=True)]

    def gain(error: RecordingError) -> float:
        try:
            return as_recorded - _misfit(corrected(error), structure)
        except (LinkwiseError, np.linalg.LinAlgError):
            return -np.inf

    try:
        as_recorded = _misfit([record[part] for record, part in zip(given, parts, strict=True)], structure)
    except (LinkwiseError, np.linalg.LinAlgError):
        return ()
    errors = [*_exchanged(given[0], structure), *_high_passes(given, structure, gain)]
    gains = [gain(error) for error in errors]
    least = max(_CONVINCING, max(gains, default=-np.inf) - _ALIKE)
    return tuple(
        error.cause(of_error)
        for error, of_error in zip(errors, gains, strict=True)
        if of_error > least and all(_is_explained(error, record, structure) for record in corrected(error))
    )


def _loudest_part(record: Record) -> slice:
    """The part of a long record in which its responses have the largest power; all of a short one."""
    if len(record) <= _SAMPLES:
        return slice(None)
    responses = np.nan_to_num(record.select(record.responses).values)
    power = np.sum((responses / np.maximum(np.std(responses, axis=0), np.finfo(float).tiny)) ** 2, axis=1)
    firsts = (*range(0, len(record) - _SAMPLES, _SAMPLES // 4), len(record) - _SAMPLES)
    first = max(firsts, key=lambda first: float(np.sum(power[first : first + _SAMPLES])))
    return slice(first, first + _SAMPLES)


def _misfit(records: Sequence[Record], structure: Structure) -> float:
    return sum(
        record_misfit(record, structure) for record in framed_records(records, structure, integrated=True)
    )


def _is_explained(error: RecordingError, record: Record, structure: Structure) -> bool:
    """Whether the weak form finds no more than noise in what the laws leave of a `record` that is without an error.

    Without a high pass, slow noise of the sensor is larger than before, and follows slow motion; there the power decides.
    """
    try:
        answer = WeakForm().estimate([record], structure, silent)
    except (LinkwiseError, np.linalg.LinAlgError):
        return False
    slow_noise = (Verdict.SYSTEMATIC_MISFIT,) if error.kind == "high pass" else ()
    return answer.fit_verdicts[0] in (*_EXPLAINED, *slow_noise)


def _exchanged(record: Record, structure: Structure) -> Iterator[RecordingError]:
    """Channels of the wrong sign, in another unit, or in each other's place."""
    displacements = [f"x:{name}" for name in structure.mass_names if f"x:{name}" in record.channels]
    forces = [f"force:{name}" for name in structure.mass_names if f"force:{name}" in record.channels]
    for name in (*forces, *displacements):
        yield RecordingError("sign", name, partial(_times, name, -1.0))
    for factor in _UNITS:
        for name in (*displacements, *forces):
            yield RecordingError("unit", name, partial(_times, name, factor), size=1.0 / factor)
    for name in (name for name in displacements if unit_in(structure, name) == KINDS["x"].angular_unit):
        for factor in _ANGLES:
            yield RecordingError("unit", name, partial(_times, name, factor), size=1.0 / factor)
    for channels in (displacements, forces):
        for first, second in combinations(channels, 2):
            yield RecordingError("swapped", first, partial(_swapped, first, second), source=second)


def _high_passes(
    records: Sequence[Record], structure: Structure, gain: Callable[[RecordingError], float]
) -> Iterator[RecordingError]:
    """Of each displacement without gaps the high pass that explains most, if one of usual corners does."""
    for name in (f"x:{name}" for name in structure.mass_names):
        if not all(name in record.channels and np.isfinite(record.channel(name)).all() for record in records):
            continue
        gains = [gain(_high_pass(name, corner)) for corner in _CORNERS]
        best = int(np.argmax(gains))
        if gains[best] < _HINT or best in (0, len(_CORNERS) - 1):
            continue
        refined = scipy.optimize.minimize_scalar(
            lambda log_corner, name=name: -gain(_high_pass(name, float(np.exp(log_corner)))),
            bounds=np.log([_CORNERS[best - 1], _CORNERS[best + 1]]),
            method="bounded",
            options={"maxiter": _REFINED},
        )
        yield _high_pass(name, float(np.exp(refined.x)))


def _high_pass(name: str, corner: float) -> RecordingError:
    """A high pass of first order with a corner in Hz."""
    return RecordingError("high pass", name, partial(_integrated, name, corner), size=corner, unit="Hz")


def _times(name: str, factor: float, record: Record) -> Record:
    return _with_channel(record, name, factor * record.channel(name))


def _swapped(first: str, second: str, record: Record) -> Record:
    exchanged = _with_channel(record, first, record.channel(second))
    return _with_channel(exchanged, second, record.channel(first))


def _integrated(name: str, corner: float, record: Record) -> Record:
    """The record before a high pass y' + w y = x' that was at rest: x = y + w times the integral of y."""
    y = record.channel(name)
    integral = scipy.integrate.cumulative_trapezoid(y, dx=record.step, initial=0.0)
    return _with_channel(record, name, y + 2.0 * np.pi * corner * integral)


def _with_channel(record: Record, name: str, values: Floats) -> Record:
    columns = record.values.copy()
    columns[:, record.channels.index(name)] = values
    return replace(record, values=columns)
