"""A channel whose gain is another one from some moment on: an amplifier or a logger that changed its range.

It is taken out of the record by factors of usual ranges and a few per cent, at moments all along it, and the weak form says
what the laws leave then, with coefficients of their own; what leaves least is refined from there. Accelerations, which the
weak form integrates, tell a moment less well than an event that the likelihood names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.estimates.causes import EVENT, RANGE, Cause
from linkwise.likelihood.checks.recording import MAY_BE, left_by_weak_form
from linkwise.likelihood.terms import Range
from linkwise.model.structure import Structure
from linkwise.records.channel import BASE
from linkwise.records.record import Record

_MOMENTS = 12  # along a record
_NEAR = np.array([0.75, -0.75, 0.5, -0.5, 0.25, -0.25])  # of the distance between two of these
_FACTORS = (0.1, 0.2, 0.5, 0.9, 0.97, 1.03, 1.1, 2.0, 5.0, 10.0)
_APART = 1.6  # ratio, within which the likeliest is: the factors of usual ranges are at most so far from one of these
_REFINED = 25  # records that are tried for the likeliest factor
_FAR = 1e30  # more than anything leaves
_MARGIN = 0.02  # of a record, to which the moment is told: samples so near to it are left out
_ACTS = 0.1  # of the power of a motion before and behind a moment: less does not tell a change from a gain of all of it
_LARGEST = 4  # masses up to which all moments take a few seconds
_SAMPLES = 10_000  # likewise

Ranged = tuple[Cause, Range, Record]
"""A change of range, what is left of it to be estimated, and the record without it."""


def changed_range(records: Sequence[Record], structure: Structure, named: Sequence[Cause]) -> Ranged | None:
    """The change of range that explains more of a record than chance, by the weak form; None of several records, and where it
    does not apply.

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
        The change, of the kind "range" with its factor, what is left of it, and the record without it.
    """
    [record, *others], shown = records, structure.mass_names
    hidden = not all(record.motions_of(name) for name in shown) or record.motions_of(BASE)
    if others or hidden or structure.size > _LARGEST or len(record) > _SAMPLES:
        return None
    event = next((cause for cause in named if cause.kind == EVENT), None)
    likeliest = _range(replace(record, noise={}, simulated=None), structure, event)
    return likeliest if likeliest is not None and likeliest[0].gain > MAY_BE else None


def _range(record: Record, structure: Structure, event: Cause | None) -> Ranged | None:
    """The change of range that explains most, at an event where there is one."""
    margin, spacing = _MARGIN * record.duration, record.duration / _MOMENTS
    moments = spacing * (np.arange(_MOMENTS) + 0.5)
    if event is not None:
        margin, moments = margin + event.standard_error, np.array([event.size - record.start])

    def left(channel: str, moment: float, factor: float) -> float:
        without = _without_range(record, channel, moment, factor, 0.0)
        if not _ACTS < _share(without.channel(channel), moment / record.duration) < 1.0 - _ACTS:
            return np.inf
        gap = margin if channel.startswith("x:") else 0.0
        return left_by_weak_form([_without_range(record, channel, moment, factor, gap)], structure)

    every = product(map(str, record.responses), moments.tolist(), _FACTORS)
    channel, moment, factor = min(every, key=lambda one: left(*one))
    if event is None:
        near = [moment, *(moment + spacing * _NEAR).tolist()]
        moment = min(near, key=lambda one: left(channel, one, factor))
    if not np.isfinite(left(channel, moment, factor)):
        return None
    factor, least = _refined(lambda factor: left(channel, moment, factor), factor, _APART)
    gain = left_by_weak_form([_without_range(record, channel, moment, 1.0, margin)], structure) - least
    cause = Cause(RANGE, channel, factor, "1", gain, 0.0, source=f"{record.start + moment:.4g} s")
    error = Range(channel, moment=moment, factor=factor)
    return cause, error, _without_range(record, channel, moment, factor, margin)


def _share(values: Floats, part: float) -> float:
    """The share of the power of a motion that is in a part of it from the start on."""
    power = np.nan_to_num(values) ** 2
    return float(np.sum(power[: int(part * len(power))]) / max(np.sum(power), np.finfo(float).tiny))


def _refined(left: Callable[[float], float], start: float, apart: float) -> tuple[float, float]:
    """The number by which least is left, within a ratio of one to start at, and that."""
    found = scipy.optimize.minimize_scalar(
        lambda logarithm: float(np.nan_to_num(left(float(np.exp(logarithm))), posinf=_FAR)),
        bounds=np.log(start) + np.log(apart) * np.array([-1.0, 1.0]),
        method="bounded",
        options={"maxiter": _REFINED},
    )
    return float(np.exp(found.x)), float(found.fun)


def _without_range(record: Record, channel: str, moment: float, factor: float, margin: float) -> Record:
    """The record with the samples of a channel from a moment on divided by a factor, and those within a margin left out."""
    values, behind = record.values.copy(), record.time - record.start - moment
    column = record.channels.index(channel)
    values[behind >= 0.0, column] /= factor
    values[abs(behind) < margin, column] = np.nan
    return replace(record, values=values)
