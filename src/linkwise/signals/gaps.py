"""Short gaps bridged, and denser samples of records with few of them a period.

Sums over samples of powers of a motion are integrals only where the powers, too, are sampled densely. A motion that fills
most of the band up to half the sampling rate, but not more, is known between its samples: that of the band is unique.
White noise in the samples then has the same variance between them, and is shared by neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil

import numpy as np
import scipy

from linkwise.arrays import Floats, bridged, stretches
from linkwise.records.channel import BAND_LIMITED, Channel
from linkwise.records.record import Record
from linkwise.signals.noise import channel_noise, noise_and_bandwidth

_SHORT = 6  # samples: longer gaps are left, as a cubic may swing far out in them
_FEWEST = 4  # samples that a cubic needs


SILENT = 0.01
"""Of the largest force: less is none."""


def short_gaps_bridged(record: Record) -> Record | None:
    """A record with a cubic spline in each gap of at most six samples of its responses; None where there is no such gap."""
    return _with_channels(record, {name: _spline_bridged(record.channel(name)) for name in record.responses})


def forces_bridged(record: Record) -> Record:
    """A record whose inputs have gaps of at most six samples bridged by lines where none acts on either side."""
    inputs = {name: _silence_bridged(record.channel(name)) for name in record.inputs}
    return _with_channels(record, inputs) or record


def _with_channels(record: Record, columns: Mapping[Channel, Floats]) -> Record | None:
    """A record with other samples of some channels; None where these are the same."""
    values = record.values.copy()
    for name, samples in columns.items():
        values[:, record.channels.index(name)] = samples
    same = np.array_equal(values, record.values, equal_nan=True)
    return None if same else replace(record, values=values, simulated=None)


def _silence_bridged(force: Floats) -> Floats:
    """The samples (N,) with lines through short gaps in which nothing acts."""
    missing = np.isnan(force)
    if not missing.any() or missing.all():
        return force
    filled, lines = force.copy(), bridged(force)
    largest = np.abs(force[~missing]).max()
    for gap in stretches(missing):
        inside = gap.start > 0 and gap.stop < len(force) and gap.stop - gap.start <= _SHORT
        if inside and np.all(np.abs(lines[gap]) <= SILENT * largest):
            filled[gap] = lines[gap]
    return filled


def _spline_bridged(samples: Floats) -> Floats:
    """The samples (N,) with short gaps interpolated, except at the ends."""
    present = np.flatnonzero(np.isfinite(samples))
    if len(present) < _FEWEST:
        return samples
    distance = np.repeat(np.diff(present), np.diff(present))  # from the sample before to the one after
    inside = np.arange(present[0], present[-1])
    filled = inside[(distance <= _SHORT + 1) & np.isnan(samples[inside])]
    whole = samples.copy()
    whole[filled] = scipy.interpolate.CubicSpline(present, samples[present])(filled)
    return whole


_SPARSE = 6.0  # samples a period: the cube of faster motion is beyond the band
_FAST = 0.03  # of the power of the motion: less of it is slow enough
_CLEARLY = 0.5  # of the power of the noise in that part of the band: less may be chance
_DENSE = 12.0  # samples a period that a denser record has
_MOST = 2000  # samples of all records: longer ones tell enough by their slow motion, and cost more
_REFLECTED = 48  # samples reflected at each end, from which a band-limited motion goes on beside it


def highest_frequency(record: Record) -> float:
    """The highest frequency in Hz at which the motion in a channel of a response exceeds its noise; NaN where gaps leave
    no channel a complete block.
    """
    stated = [record.noise.get(name, np.nan) for name in record.responses]
    highest = noise_and_bandwidth(record.select(record.responses).values, record.rate, stated)[1]
    return float(np.nanmax(highest)) if np.isfinite(highest).any() else np.nan


def is_sparse(records: Sequence[Record]) -> bool:
    """Whether records are short, and 3 % of the power of a response is clearly above a sixth of the sampling rate: fewer
    than six samples a period.
    """
    if sum(len(record) for record in records) > _MOST:
        return False
    return any(_moves_fast(record) for record in records)


def _moves_fast(record: Record) -> bool:
    """Whether the power above a sixth of the sampling rate is that of motion, in a response without gaps."""
    for name, sigma in channel_noise(record).items():
        samples = record.channel(name)
        if np.isnan(samples).any():
            continue
        count = len(samples)
        hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
        power = np.abs(np.fft.rfft(hann * (samples - samples.mean()))) ** 2 / np.sum(hann**2)
        noise = np.full(len(power), sigma**2)
        fast = np.arange(len(power)) * _SPARSE > count
        excess = float(np.sum((power - noise)[fast]))
        if excess > max(_FAST * float(np.sum(power - noise)), _CLEARLY * float(np.sum(noise[fast]))):
            return True
    return False


def denser(record: Record) -> tuple[Record, int]:
    """A record with samples between those that were measured, twelve a period of the fastest motion, and how many times as
    dense it is; it states the noise of its responses. The given one where it is dense or long, or too short to tell, where
    samples are missing, or an input does not run band-limited between its samples.
    """
    stated = any(record.interpolation.get(name, BAND_LIMITED) != BAND_LIMITED for name in record.inputs)
    if stated or np.isnan(record.values).any() or not is_sparse([record]):
        return record, 1
    highest = highest_frequency(record)
    if np.isnan(highest):
        return record, 1
    factor = ceil(_DENSE * highest / record.rate)
    noise, values = dict(record.noise) | channel_noise(record), _band_limited_between(record.values, factor)
    return replace(record, values=values, rate=factor * record.rate, noise=noise), factor


def _band_limited_between(values: Floats, factor: int) -> Floats:
    """((N - 1) `factor` + 1, C) band-limited samples through `values` (N, C), which go on by reflection in their ends."""
    samples = len(values)
    around = min(samples - 1, _REFLECTED)
    before, after = 2.0 * values[0] - values[around:0:-1], 2.0 * values[-1] - values[-2 : -around - 2 : -1]
    extended = np.concatenate([before, values, after])
    count = len(extended)
    line = np.linspace(0.0, 1.0, count)[:, None] * (extended[-1] - extended[0]) + extended[0]
    periodic = np.concatenate([extended - line, -(extended - line)[-2:0:-1]])
    spectrum = np.fft.rfft(periodic, axis=0)
    dense = factor * np.fft.irfft(spectrum, factor * len(periodic), axis=0)
    between = dense[around * factor : (around + samples - 1) * factor + 1]
    fine = np.arange(around * factor, (around + samples - 1) * factor + 1)[:, None] / (factor * (count - 1))
    return np.asarray(between + fine * (extended[-1] - extended[0]) + extended[0])
