"""A channel whose gain is another one from some moment on: an amplifier or a logger that changed its range.

It is taken out of the record at moments all along it, by factors of usual ranges and by a few per cent, and the weak form says
what the laws leave then, with coefficients of their own; the moment and the factor that leave least are looked for from there.

Accelerations, which the weak form integrates, tell the moment less well than an event that the likelihood names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import scipy

from linkwise.estimates.causes import EVENT, RANGE, Cause
from linkwise.likelihood.checks.recording import MAY_BE, left_by_weak_form
from linkwise.likelihood.terms import Range
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.record import Record

_MOMENTS = 12  # along a record
_NEAR = np.array([0.75, -0.75, 0.5, -0.5, 0.25, -0.25])  # of the distance between two of these
_FACTORS = (0.1, 0.2, 0.5, 0.9, 0.97, 1.03, 1.1, 2.0, 5.0, 10.0)
_REFINED = 12  # records that are tried for the likeliest factor
_MARGIN = 0.02  # of a record, to which the moment is told: samples so near to it are left out
_LARGEST = 4  # masses up to which all moments take a few seconds
_SAMPLES = 10_000  # likewise


def changed_range(
    records: Sequence[Record], structure: Structure, named: Sequence[Cause]
) -> tuple[Cause, Range, Record] | None:
    """The change of range that explains most of a record, what is left of it, and the record without it; None where none
    explains more than chance, of several records, and where the weak form does not apply.

    Parameters
    ----------
    records : sequence of Record
        The record.
    structure : Structure
        The structure with its unknowns.
    named : sequence of Cause
        Causes that are named first: of an event, the moment counts.

    Returns
    -------
    tuple of (Cause, Range, Record) or None
        The change, of the kind "range", whose size is the factor.
    """
    record, event = records[0], next((cause for cause in named if cause.kind == EVENT), None)
    hidden = len(records) > 1 or not all(record.motions_of(name) for name in structure.mass_names)
    if hidden or record.motions_of(BASE) or structure.size > _LARGEST or len(record) > _SAMPLES:
        return None
    plain, margin = replace(record, noise={}, simulated=None), _MARGIN * record.duration
    spacing = record.duration / _MOMENTS
    moments = spacing * (np.arange(_MOMENTS) + 0.5)
    if event is not None:
        margin, moments = margin + event.standard_error, np.array([event.size - record.start])

    def left(channel: str, moment: float, factor: float) -> float:
        gap = margin if channel.startswith("x:") else 0.0
        return left_by_weak_form([_without(plain, channel, moment, factor, gap)], structure)

    every = product(map(str, record.responses), moments.tolist(), _FACTORS)
    channel, moment, factor = min(every, key=lambda one: left(*one))
    if event is None:
        near = [moment, *(moment + spacing * _NEAR).tolist()]
        moment = min(near, key=lambda one: left(channel, one, factor))
    refined = scipy.optimize.minimize_scalar(
        lambda logarithm: left(channel, moment, float(np.exp(logarithm))),
        bracket=np.log(factor) + np.array([0.0, 0.02]),
        options={"maxiter": _REFINED},
    )
    factor, gain = float(np.exp(refined.x)), left(channel, moment, 1.0) - float(refined.fun)
    if not gain > MAY_BE:
        return None
    cause = Cause(RANGE, channel, factor, "1", gain, 0.0, source=f"{record.start + moment:.4g} s")
    return (
        cause,
        Range(channel, moment=moment, factor=factor),
        _without(record, channel, moment, factor, margin),
    )


def _without(record: Record, channel: str, moment: float, factor: float, margin: float) -> Record:
    """The record with the samples of a channel from a moment on divided by a factor, and those within a margin left out."""
    values, behind = record.values.copy(), record.time - record.start - moment
    column = record.channels.index(channel)
    values[behind >= 0.0, column] /= factor
    values[abs(behind) < margin, column] = np.nan
    return replace(record, values=values, simulated=None)
