"""Samples of one channel that a logger lost or wrote twice: what follows is early or late by so many samples.

The weak equations of the record as it stands, and with the channel shifted as a whole by some samples, leave residuals at the
values of an answer; the ones count up to a moment, the others from there. That moment and shift leave least.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.estimates.causes import SLIP, Cause
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.base_frame import framed
from linkwise.weak.displacements import read_displacements, with_displacements
from linkwise.weak.equations import WeakEquations, weak_equations, weak_residual
from linkwise.weak.window import Window

_SHIFTS = (*range(1, 21), *range(22, 65, 2))  # samples: a block that a logger loses as a rule is not longer
_CONVINCING = 30.0  # of the power of independent windows: noise of a quiet end gives half of that
_OUTLIER = 5.0  # standard deviations: a window that is farther off counts as that
_CHANNELS = 2  # in which one slip looks alike
_MEDIAN = (
    0.4549  # of chi-square with one degree of freedom, by which the noise is told beside what a slip leaves
)


def slips(
    record: Record, structure: Structure, values: Mapping[str, float]
) -> Iterator[tuple[Cause, Record]]:
    """The likeliest slips of displacements, each with the record without it; none where the weak form does not apply.

    Parameters
    ----------
    record : Record
        The record.
    structure : Structure
        The structure with its unknowns.
    values : mapping of str to float
        Values of the unknowns, in SI units by name.

    Yields
    ------
    tuple of (Cause, Record)
        The slip, of the kind "slip", and the record in which the samples that follow it are in their places.
    """
    channels = [channel for channel in record.responses if channel.kind == "x"]
    if not all(record.motions_of(name) for name in structure.mass_names):
        return
    try:
        found = [_likeliest(record, channel, structure, values) for channel in channels]
    except (LinkwiseError, np.linalg.LinAlgError):
        return
    for gain, shift, sample, margin, name in sorted(found, reverse=True)[:_CHANNELS]:
        if gain > _CONVINCING:
            cause = Cause(SLIP, name, float(shift), "1", gain, 0.0, source=f"{record.time[sample]:.4g} s")
            yield cause, without_slip(record, name, sample, shift, margin)


def without_slip(record: Record, name: str, sample: int, shift: int, margin: int) -> Record:
    """The record with a channel later by `shift` samples from one `sample` on, and without a `margin` around that."""
    values, column = record.values.copy(), list(map(str, record.channels)).index(name)
    values[sample:, column] = _shifted(record.values[:, column], shift)[sample:]
    values[max(0, sample - margin) : sample + max(shift, 0) + margin, column] = np.nan
    return replace(record, values=values, simulated=None)


def _shifted(values: Floats, shift: int) -> Floats:
    """(N,) values later by `shift` samples; NaN at the end that this leaves open."""
    moved = np.roll(values, shift)
    moved[slice(0, shift) if shift > 0 else slice(shift, None)] = np.nan
    return moved


def _likeliest(
    record: Record, channel: Channel, structure: Structure, values: Mapping[str, float]
) -> tuple[float, int, int, int, str]:
    """What the best slip of a channel explains, its shift and the first sample behind it with its margin, and the channel."""
    stated = _equations(record, structure, values)
    residual = _residual(stated, values)
    scale = np.sqrt(np.nanmedian(residual**2, axis=0) / _MEDIAN)
    overlap = max(1.0, 0.5 * stated.window.length / stated.window.stride)

    def power(residual: Floats) -> Floats:
        return np.cumsum(np.nansum(np.minimum((residual / scale) ** 2, _OUTLIER**2), axis=1)) / overlap

    before, column = power(residual), record.channels.index(channel)
    best = (0.0, 0, 0, stated.window.length, str(channel))
    for shift in (sign * size for size in _SHIFTS for sign in (1, -1)):
        shown = record.values.copy()
        shown[:, column] = _shifted(shown[:, column], shift)
        moved = _equations(replace(record, values=shown, simulated=None), structure, values, stated.window)
        behind = power(_residual(moved, values))
        left = before + behind[-1] - behind
        window = int(np.argmin(left))
        sample = round((stated.time[window] - record.start) * record.rate)
        best = max(
            best, (float(before[-1] - left[window]), shift, sample, stated.window.length, str(channel))
        )
    return best


def _equations(
    record: Record, structure: Structure, values: Mapping[str, float], window: Window | None = None
) -> WeakEquations:
    shown = with_displacements(framed(record, structure, integrated=True).record, structure.masses)
    motion = read_displacements(shown, structure)
    return weak_equations(shown, structure, motion, window=window, values=dict(values))


def _residual(equations: WeakEquations, values: Mapping[str, float]) -> Floats:
    """(R, n) what the equations leave, in N."""
    return weak_residual(equations, np.array([values[name] for name in equations.parameters]))
