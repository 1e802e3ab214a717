"""Records of few samples a period of their fastest motion, and denser samples of them.

Sums over samples of powers of a motion are integrals only where the powers, too, are sampled densely. A motion that fills most
of the band up to half the sampling rate, but not more, is known between its samples: that of the band is unique. White noise
in the samples then has the same variance between them, and is shared by neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.interpolation import BAND_LIMITED
from linkwise.records.record import Record
from linkwise.signals.channel_noise import channel_noise
from linkwise.signals.noise import noise_and_bandwidth

_SPARSE = 6.0  # samples a period: the cube of faster motion is beyond the band
_FAST = 0.03  # of the power of the motion: less of it is slow enough
_CLEARLY = 0.5  # of the power of the noise in that part of the band: less may be chance
_DENSE = 12.0  # samples a period that a denser record has
_MOST = 2000  # samples of all records: longer ones tell enough by their slow motion, and cost more
_REFLECTED = 48  # samples reflected at each end, from which a band-limited motion goes on beside it


def highest_frequency(record: Record) -> float:
    """The highest frequency in Hz at which the motion in a channel of a response exceeds its noise.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    float
        The frequency; NaN where gaps leave no channel a complete block.
    """
    stated = [record.noise.get(name, np.nan) for name in record.responses]
    highest = noise_and_bandwidth(record.select(record.responses).values, record.rate, stated)[1]
    return float(np.nanmax(highest)) if np.isfinite(highest).any() else np.nan


def is_sparse(records: Sequence[Record]) -> bool:
    """Whether records are short, and a part of the motion in a channel has fewer than six samples a period.

    Parameters
    ----------
    records : sequence of Record
        The records.

    Returns
    -------
    bool
        Whether 3 % of the power of a response is clearly above a sixth of the sampling rate; False for long records.
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
    """A record with samples between those that were measured, twelve a period of the fastest motion, where it has few.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    record : Record
        The denser record, which states the noise of its responses; the given one where it is dense or long, where samples are
        missing, or an input does not run band-limited between its samples.
    factor : int
        How many times as dense it is.
    """
    if np.isnan(record.values).any() or not is_sparse([record]):
        return record, 1
    if any(record.interpolation.get(name, BAND_LIMITED) != BAND_LIMITED for name in record.inputs):
        return record, 1
    factor = ceil(_DENSE * highest_frequency(record) / record.rate)
    noise = dict(record.noise) | channel_noise(record)
    return replace(
        record, values=_between(record.values, factor), rate=factor * record.rate, noise=noise
    ), factor


def _between(values: Floats, factor: int) -> Floats:
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
