"""Samples of one channel that a logger lost or wrote twice: what follows is early or late by so many samples.

The weak equations of the record as it stands, and with the channel shifted as a whole by some samples, leave residuals at the
values of an answer; the ones count up to a moment, the others from there. That moment and shift leave least.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
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
_LIKELY = 16.0  # of the power of independent windows: 84 shifts at any moment of noise give less; the likelihood decides
_OUTLIER = 5.0  # standard deviations: a window that is farther off counts as that
_ENDS = 0.05  # of a record: what is left of it there is as well the motion behind a hit that no channel shows
_ACTS = 0.1  # of the energy of an input: less before or behind a slip tells nothing of it
_LARGEST = 8  # masses up to which all shifts of all channels take a few seconds
_CHANNELS, _NEXT = 2, 2  # in which one slip looks alike, and shifts of each that do
_MEDIAN = (
    0.4549  # of chi-square with one degree of freedom, by which the noise is told beside what a slip leaves
)


def slips(
    record: Record, structure: Structure, values: Mapping[str, float]
) -> Iterator[tuple[Cause, Record]]:
    """The likeliest slips of displacements, each with the record without it; none where the weak form does not apply.

    Nor of a channel without another or an input that acts all along, which a hit that no channel shows makes late as well.

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
    channels = [name for name in record.responses if name.kind == "x" and name not in record.clipped]
    hidden = not all(record.motions_of(name) for name in structure.mass_names)
    alone = len(channels) + len(record.inputs) < 2
    if hidden or not channels or alone or structure.size > _LARGEST:
        return
    try:
        identified = structure.with_values(values)
        stated = _equations(record, identified)
        found = [_likeliest_first(record, channel, identified, stated) for channel in channels]
    except (LinkwiseError, np.linalg.LinAlgError):
        return
    likeliest = sorted(found, reverse=True)[:_CHANNELS]
    for gain, shift, sample, name in sorted((one for of in likeliest for one in of[:_NEXT]), reverse=True):
        if gain > _LIKELY and (len(channels) > 1 or _is_driven(record, sample)):
            cause = Cause(SLIP, name, float(shift), "1", gain, 0.0, source=f"{record.time[sample]:.4g} s")
            yield cause, without_slip(record, name, sample, shift, stated.window.length)


def _is_driven(record: Record, sample: int) -> bool:
    """Whether inputs that were recorded act before a sample and from it on, so that they tell what follows from a hit."""
    inputs = np.nan_to_num(record.select(record.inputs).values)
    power = np.cumsum((inputs - inputs.mean(axis=0)) ** 2, axis=0)
    share = power[sample] / np.maximum(power[-1], np.finfo(float).tiny)
    return bool(np.any((share > _ACTS) & (share < 1.0 - _ACTS)))


def without_slip(record: Record, name: str, sample: int, shift: int, margin: int) -> Record:
    """The record with a channel later by `shift` samples from one `sample` on, and without a `margin` around that.

    Samples that were lost are in neither part, so that the windows tell the moment to within as many.
    """
    values, column = record.values.copy(), list(map(str, record.channels)).index(name)
    values[sample:, column] = _shifted(record.values[:, column], shift)[sample:]
    margin += max(shift, 0)
    values[max(0, sample - margin) : sample + margin, column] = np.nan
    return replace(record, values=values, simulated=None)


def _shifted(values: Floats, shift: int) -> Floats:
    """(N,) values later by `shift` samples; NaN at the end that this leaves open."""
    moved = np.roll(values, shift)
    moved[slice(0, shift) if shift > 0 else slice(shift, None)] = np.nan
    return moved


def _likeliest_first(
    record: Record, channel: Channel, structure: Structure, stated: WeakEquations
) -> list[tuple[float, int, int, str]]:
    """What slips of a channel explain, their shifts and the first samples behind them, and the channel.

    Windows at an end that a shift leaves open count neither before it nor behind it.
    """
    number, neighbourhoods = structure.topology.index[channel.place], stated.structure_layout.neighbourhoods
    only = np.flatnonzero(neighbourhoods[:, number]).tolist() if number >= 0 else None
    residual = weak_residual(stated, np.zeros(0))
    scale = np.sqrt(np.nanmedian(residual**2, axis=0) / _MEDIAN)
    overlap = max(1.0, 0.5 * stated.window.length / stated.window.stride)

    def power(residual: Floats) -> Floats:
        return np.cumsum(np.nansum(np.minimum((residual / scale) ** 2, _OUTLIER**2), axis=1)) / overlap

    column = record.channels.index(channel)
    found = []
    for shift in (sign * size for size in _SHIFTS for sign in (1, -1)):
        shown = record.values.copy()
        shown[:, column] = _shifted(shown[:, column], shift)
        late = replace(record, values=shown, simulated=None)
        shifted = weak_residual(_equations(late, structure, stated.window, only), np.zeros(0))
        before, behind = power(np.where(np.isfinite(shifted), residual, np.nan)), power(shifted)
        left = before + behind[-1] - behind
        ends = int(_ENDS * len(left)) + 1
        window = ends + int(np.argmin(left[ends:-ends]))
        sample = round((stated.time[window] - record.start) * record.rate)
        found.append((float(before[-1] - left[window]), shift, sample, str(channel)))
    return sorted(found, reverse=True)


def _equations(
    record: Record, structure: Structure, window: Window | None = None, only: Collection[int] | None = None
) -> WeakEquations:
    shown = with_displacements(framed(record, structure, integrated=True).record, structure.masses)
    return weak_equations(shown, structure, read_displacements(shown, structure), window=window, only=only)
