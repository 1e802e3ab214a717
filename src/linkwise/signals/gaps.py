"""Averages of periodic tests, short gaps bridged for starting values, and denser samples of records with few of them a
period.

Sums over samples of powers of a motion are integrals only where the powers, too, are sampled densely. A motion that fills
most of the band up to half the sampling rate, but not more, is known between its samples: that of the band is unique.
White noise in the samples then has the same variance between them, and is shared by neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil, isfinite

import numpy as np
import scipy

from linkwise.arrays import Floats, bridged, stretches
from linkwise.errors import RecordError
from linkwise.records.channel import BAND_LIMITED, Channel
from linkwise.records.record import Record
from linkwise.records.timeline import MIN_SAMPLES
from linkwise.signals.noise import channel_noise, noise_and_bandwidth

_WHOLE = 0.05  # samples that the last period may be off: a clock error that is lost in the noise
# standard deviations of a sum of squares: what differs from the last period by more has not settled
_SETTLED = 6.0
_WHITE = 0.5  # of the power of a difference: more is left of it by second differences where it is white
_NOTHING = 1e-10  # of the power of a channel: periods of inputs that differ by rounding are alike
_ALIKE = 0.5  # of the power of a channel: periods that differ by more are not repetitions


def average_periods(record: Record, period: float) -> Record:
    """Average a periodic test over its periods.

    The noise of a response is what the scatter of its periods shows, unless it is stated. Periods at the start in which the
    motion has not settled are left out.

    Parameters
    ----------
    record : Record
        A record of two periods or more under a periodic excitation.
    period : float
        The period in s, a whole number of sampling intervals.

    Returns
    -------
    Record
        One period, at the time of the last one.

    Raises
    ------
    RecordError
        If the period is not a whole number of sampling intervals, is too short or too long for the record, or the record does
        not repeat after it.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> time = np.arange(1000) / 100.0
    >>> force = lw.Record.from_arrays(time, {"force:m1": np.sin(np.pi * time), "x:m1": np.cos(np.pi * time)})
    >>> lw.records.average_periods(force, 2.0)
    Record of 200 samples at 100 Hz, 8 to 9.99 s: force:m1, x:m1
    """
    size = _samples(record, period)
    count = len(record) // size
    cube = record.values[len(record) - count * size :].reshape(count, size, -1)
    _check_repeats(record, cube, period)
    first = _settled(cube)
    settled = cube[first:]
    present = np.isfinite(settled)
    number = present.sum(axis=0)
    mean = np.where(number > 0, np.nansum(settled, axis=0) / np.maximum(number, 1), np.nan)
    square = np.nansum((settled - mean) ** 2, axis=(0, 1)) / np.maximum((number - 1).clip(0).sum(axis=0), 1)
    noise = {name: sigma / np.sqrt(len(settled)) for name, sigma in record.noise.items()}
    for name, variance in zip(record.channels, square.tolist(), strict=True):
        if name in record.responses and name not in noise and variance > 0.0:
            noise[name] = float(np.sqrt(variance / len(settled)))
    which = "the first was" if first == 1 else f"the first {first} were"
    left_out = f"; {which} left out, in which the motion had not settled" if first else ""
    return replace(
        record,
        start=record.start + (len(record) - size) / record.rate,
        values=mean,
        noise=noise,
        simulated=None,
        notes=(
            *record.notes,
            f"Averaged over {len(settled)} periods of {size / record.rate:g} s, whose scatter shows the noise{left_out}.",
            *_not_white(record, cube),
        ),
    )


def _samples(record: Record, period: float) -> int:
    """Samples of a period; RecordError where it is not a whole number of them, or the record has not two periods."""
    if not (isfinite(period) and period > 0.0):
        raise RecordError(f"period must be positive, got {period!r} s", arguments=("period",))
    exact = period * record.rate
    size = round(exact)
    if size < MIN_SAMPLES:
        raise RecordError(
            f"a period of {period:g} s has {exact:.4g} samples at {record.rate:g} Hz; {MIN_SAMPLES} are needed: take "
            "several periods as one",
            arguments=("period",),
        )
    if len(record) < 2 * size:
        message = f"a period of {period:g} s is {size} samples, and the record has {len(record)}: two periods are needed"
        raise RecordError(message, arguments=("period",))
    if abs(exact - size) * (len(record) // size) > _WHOLE:
        raise RecordError(
            f"a period of {period:.9g} s is {exact:.6f} samples at {record.rate:.9g} Hz, not a whole number: check it, or "
            "resample the record to a rate that makes it one",
            arguments=("period", "resample"),
        )
    return size


def _check_repeats(record: Record, cube: Floats, period: float) -> None:
    """Raise RecordError where the inputs, or without inputs the responses, differ between the last two periods."""
    names = record.inputs or record.responses
    for name in names:
        last, before = (cube[number, :, record.channels.index(name)] for number in (-1, -2))
        power = np.nanvar(last)
        if power > 0.0 and np.nanvar(last - before) > _ALIKE * power:
            raise RecordError(
                f"does not repeat after {period:g} s: its last two periods differ by "
                f"{100.0 * np.sqrt(np.nanvar(last - before) / power):.0f} % of their size; check the period",
                channel=name,
                arguments=("period",),
            )


def _not_white(record: Record, cube: Floats) -> tuple[str, ...]:
    """A sentence on responses whose last two periods differ by more than white noise, which second differences show."""
    change = cube[-1] - cube[-2]
    white = np.nanmean(np.diff(change, 2, axis=0) ** 2, axis=0) / 6.0
    smooth = white < _WHITE * np.nanvar(change, axis=0)
    names = [name for name in record.responses if smooth[record.channels.index(name)]]
    note = (
        f"{', '.join(names)}: the last two periods differ by more than white noise: the motion has not settled or does not "
        "repeat, or its noise is coloured; an identification from the whole record needs no period."
    )
    return (note,) if names else ()


def _settled(cube: Floats) -> int:
    """The first of the periods (P, M, C) from which on all are as alike as the last two."""
    power = np.nanvar(cube[-1], axis=0)
    difference = np.nanmean((cube[:-1] - cube[-1]) ** 2, axis=1) / np.where(power > 0.0, power, 1.0)
    usual = np.maximum(np.nan_to_num(difference[-1]), _NOTHING)
    settled = np.nan_to_num(difference) <= (1.0 + _SETTLED * np.sqrt(4.0 / cube.shape[1])) * usual
    unsettled = np.flatnonzero(~settled.all(axis=1))
    return int(unsettled[-1]) + 1 if len(unsettled) else 0


_SHORT = 6  # samples: longer gaps are left, as a cubic may swing far out in them
_FEWEST = 4  # samples that a cubic needs


SILENT = 0.01
"""Of the largest force: less is none."""


def short_gaps_bridged(record: Record) -> Record | None:
    """A record with a cubic spline in each gap of at most six samples of its responses; None where there is no such gap."""
    return _with_channels(record, {name: _bridged(record.channel(name)) for name in record.responses})


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


def _bridged(samples: Floats) -> Floats:
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
    dense it is; it states the noise of its responses. The given one where it is dense or long, where samples are missing,
    or an input does not run band-limited between its samples.
    """
    stated = any(record.interpolation.get(name, BAND_LIMITED) != BAND_LIMITED for name in record.inputs)
    if stated or np.isnan(record.values).any() or not is_sparse([record]):
        return record, 1
    factor = ceil(_DENSE * highest_frequency(record) / record.rate)
    noise, values = dict(record.noise) | channel_noise(record), _between(record.values, factor)
    return replace(record, values=values, rate=factor * record.rate, noise=noise), factor


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
