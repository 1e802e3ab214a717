"""Channels on the even time grid behind printed, rounded and missing times; samples between it are interpolated by
quintic splines, and a symmetric low-pass that leaves white noise white goes before a lower rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from linkwise.arrays import Bools, Floats
from linkwise.errors import RecordError
from linkwise.records.channel import BAND_LIMITED, Channel
from linkwise.records.sample_checks import NOWHERE, Rows, check_rate, check_responses, column_notes

MIN_SAMPLES = 32  # fewer do not hold one period of a vibration together with its noise
JITTER = 1e-3  # of a step: deviation of a clock up to which samples count as even
COARSEST = 0.4  # of a step: with printed digits coarser than that the grid is ambiguous
RESOLVED = 0.05  # of a decimal: where double precision resolves less, every number looks like a printed one
SLOW = 0.5  # s: no vibrating structure is sampled this slowly, but times in milliseconds look like it
EDGE = 1e-6  # of a step: a time typed in decimals is meant to hit its sample
LONGEST = 10  # times the number of rows: a grid with more missing samples than that is two records


@dataclass(frozen=True, eq=False)
class Timeline:
    """Samples `index` (N,) of an even grid of `count` points at `start` + k/`rate`; `notes` say what was assumed."""

    start: float
    rate: float
    index: NDArray[np.int64]
    count: int
    notes: tuple[str, ...] = ()

    @classmethod
    def fit(cls, time: NDArray[np.generic], rows: Rows = NOWHERE) -> Timeline:
        """The grid of the times `time` (N,) in s.

        Rounding in printing or to single precision is accepted, and so are gaps of whole steps. The rate is the roundest
        number that explains the column: 1000 Hz, or a step of 0.0016384 s, not the last digits of a least-squares fit. Raises
        RecordError with the line for missing, repeated, decreasing and uneven times.
        """
        times = np.asarray(time, dtype=np.float64)
        _check_increasing(times, rows)
        steps = np.diff(times)
        median = float(np.median(steps))
        # of neighbours without a gap, averaged so that their rounding cancels
        step = float(np.mean(steps[np.abs(steps - median) < 0.5 * median]))
        check_rate(float(1.0 / np.clip(step, 1e-300, 1e300)), rows.file)
        multiples = np.maximum(np.rint(steps / step), 1.0)
        index = np.concatenate([[0], np.cumsum(multiples)]).astype(np.int64)
        step = float(np.dot(index - index.mean(), times - times.mean()) / np.sum((index - index.mean()) ** 2))
        resolution = _resolution(times, step)
        _check_even(times, rows, index, step, np.maximum(JITTER * step, 1.01 * resolution))
        count = int(index[-1]) + 1
        if count > LONGEST * len(times):
            row = int(np.argmax(steps))
            gap = f"a gap of {steps[row]:g} s in a record of {len(times)} samples every {step:g} s"
            raise rows.error(f"{gap}; split the file there", row + 1, "time")
        rate = _roundest_rate(times, index, step, float(resolution.max()))
        return cls(float(times[0]), rate, index, count, tuple(_notes(times, index, rate)))


def _check_increasing(times: Floats, rows: Rows) -> None:
    """Raise RecordError for too few times, and for times that are missing, repeated or decreasing."""
    if len(times) < MIN_SAMPLES:
        message = f"{len(times)} samples are too few; a record needs at least {MIN_SAMPLES}"
        raise RecordError(message, rows.file)
    missing = np.flatnonzero(~np.isfinite(times))
    if len(missing):
        message = "the time is missing; fill it in or, if no row is missing, give the sampling rate instead (`rate`)"
        raise rows.error(message, int(missing[0]), "time", ("rate",))
    steps = np.diff(times)
    if np.all(steps > 0.0):
        return
    row = int(np.argmax(steps <= 0.0))
    time, previous = times[row + 1], times[row]
    if time == previous:
        repeated = f"the time {time:.12g} s is repeated; write more digits, remove one of the rows, or give the sampling"
        raise rows.error(f"{repeated} rate (`rate`)", row + 1, "time", ("rate",))
    message = (
        f"time decreases from {previous:.12g} to {time:.12g} s; a file must hold one record, sorted by time"
    )
    raise rows.error(message, row + 1, "time")


def _check_even(times: Floats, rows: Rows, index: NDArray[np.int64], step: float, tolerance: Floats) -> None:
    """Raise RecordError unless times and steps are within the `tolerance` (N,) in s of the grid `index` * `step`."""
    steps, counts = np.diff(times), np.diff(index)
    of_steps = np.maximum(tolerance[1:], tolerance[:-1])
    usual = float(np.median(steps))
    uneven = np.abs(steps - counts * step) > 2.0 * of_steps
    advice = "resample it to an even rate (`resample`)"
    wrong = uneven & (np.abs(steps - counts * usual) > 2.0 * of_steps)
    if np.any(wrong):
        row = int(np.argmax(wrong))
        message = f"uneven time: a step of {steps[row]:.6g} s where {usual:.6g} s was expected; {advice}"
        raise rows.error(message, row + 1, "time", ("resample",))
    deviation = times - times[0] - index * step
    deviation -= np.median(deviation)
    if np.any(uneven) or np.any(np.abs(deviation) > 2.0 * tolerance):
        row = int(np.argmax(np.abs(deviation)))
        time = times[row]
        message = (
            f"uneven time: {time:.9g} s is {deviation[row]:.3g} s off an even grid of {step:.9g} s; {advice}"
        )
        raise rows.error(message, row, "time", ("resample",))


def _notes(times: Floats, index: NDArray[np.int64], rate: float) -> list[str]:
    """What was assumed in fitting the grid, one sentence each."""
    notes = []
    deviation = float(np.max(np.abs(times - times[0] - index / rate)))
    if deviation > JITTER / rate:
        notes.append(
            f"The times are up to {deviation:.2g} s off an even grid, as rounding causes; {rate:.9g} Hz was assumed."
        )
    missing = np.diff(index) - 1
    gaps = np.flatnonzero(missing)
    if len(gaps):
        where, added = f"the first after {times[gaps[0]]:.9g} s", int(np.sum(missing))
        notes.append(f"Gaps in time: {len(gaps)}, {where}; {added} rows were added as missing samples.")
    if 1.0 / rate >= SLOW:
        advice = "If the times are in ms, name their column time[ms]."
        notes.append(f"The sampling interval is {1.0 / rate:g} s. {advice}")
    return notes


def _resolution(times: Floats, step: float) -> Floats:
    """The rounding (N,) of the column in s: the printed decimal or significant digit, or single or double precision."""
    largest = float(np.max(np.abs(times)))
    double = np.full(len(times), 2.0 * float(np.spacing(largest)))  # start + k/rate is rounded twice
    for digits in range(max(0, int(-np.floor(np.log10(step)))), 13):
        scaled, slack = times * 10.0**digits, 4.0 * float(np.spacing(largest * 10.0**digits))
        if slack > RESOLVED:
            break
        if np.max(np.abs(scaled - np.rint(scaled))) <= slack:
            if 10.0**-digits > COARSEST * step:
                return double
            decimal = np.maximum(10.0**-digits, double)
            return np.asarray(np.maximum(_digit_of_steps(times, COARSEST * step), decimal))
    if np.array_equal(times, times.astype(np.float32)):
        single = float(np.spacing(np.float32(largest)))
        return np.full(len(times), single) if single <= COARSEST * step else double
    return double


def _digit_of_steps(times: Floats, most: float) -> Floats:
    """The decimal (N,) in s, of at most `most`, of which all later or all earlier steps are multiples; 0 without one.

    Times of six significant digits lose a decimal at 1 s, and steps tell it wherever a script has set the start to zero.
    """
    steps, last = np.diff(times), np.zeros(len(times))
    for digits in range(12, int(np.ceil(-np.log10(most))) - 1, -1):
        scaled = steps * 10.0**digits
        finer = np.flatnonzero(np.abs(scaled - np.rint(scaled)) > RESOLVED * 1e-3)
        later, earlier = (finer[-1] + 1, finer[0]) if len(finer) else (0, len(times))
        for rows in (slice(later, None), slice(0, earlier)):
            if len(last[rows]) >= MIN_SAMPLES:  # fewer may be multiples by chance
                last[rows] = np.maximum(last[rows], 10.0**-digits)
    return last


def _roundest_rate(times: Floats, index: NDArray[np.int64], step: float, resolution: float) -> float:
    """The rate in Hz with the fewest digits, in itself or as a step, that reproduces every time to its rounding.

    Times rounded to a resolution, to the nearest or downwards, lie in a band as wide as that about their grid, wherever it
    starts. To ask that each lies within the resolution of a grid from the first time on would leave the rate open by twice
    the resolution over the length of the record: some 1e-4, which a stiffness shows in many of its standard errors.
    """
    band = max(resolution, float(np.ptp(times - index * step))) + 2.0 * float(np.spacing(np.abs(times).max()))
    # the rate, and the step
    rounded = ((float(f"{1.0 / step:.{n}e}"), 1.0 / float(f"{step:.{n}e}")) for n in range(15))
    for rate in (rate for rates in rounded for rate in rates):
        ends = abs(times[-1] - times[0] - index[-1] / rate)  # the quicker to see of the many that differ
        if ends <= band and np.ptp(times - index / rate) <= band:
            return _exact_neighbour(times, index, rate)
    return _exact_neighbour(times, index, 1.0 / step)


def _exact_neighbour(times: Floats, index: NDArray[np.int64], rate: float) -> float:
    """`rate`, or the number within 16 units in its last place that reproduces the column bit for bit."""
    probes = np.unique(np.linspace(0, len(index) - 1, 9).astype(np.int64))
    for units in sorted(range(-16, 17), key=abs):
        neighbour = rate + units * float(np.spacing(rate))
        reached = (times[0] + index[which] / neighbour == times[which] for which in (probes, slice(None)))
        if all(map(np.all, reached)):
            return neighbour
    return rate


ATTENUATION = 80.0  # dB, from STOPBAND on
PASSBAND = 0.8  # of the new Nyquist frequency; there the gain is 1 within 10^(-ATTENUATION / 20)
STOPBAND = 1.2  # of the new Nyquist frequency
_SPAN = 25  # outputs to either side that a sample enters: shorter filters miss ATTENUATION
_GRID = 64  # points of the spectrum for a tap
_AUDIBLE = 1e-3  # of the root mean square of a channel: motion between the bands that is told
_ABOVE_FLOOR = 4.0  # times the power density of what is above the filter


@dataclass(frozen=True, eq=False)
class Lowpass:
    """A symmetric filter of 2 `half` + 1 taps that keeps every `factor`-th of its outputs."""

    factor: int
    taps: Floats

    @property
    def half(self) -> int:
        """Number of samples dropped at each end."""
        return len(self.taps) // 2

    @property
    def noise_gain(self) -> float:
        """The factor by which the standard deviation of white noise shrinks."""
        return float(np.sqrt(np.sum(self.taps**2)))

    def notes(self, channels: Sequence[str], values: Floats, rate: float) -> tuple[str, ...]:
        """What it does to the `values` (N, C) of `channels`, sampled at `rate` in Hz, one sentence each."""
        note = (
            f"Decimated by {self.factor} behind an anti-alias filter, which leaves {100.0 * self.noise_gain:.0f} % of the "
            f"standard deviation of white noise; {self.half} samples at each end were dropped, where the filter is incomplete."
        )
        return (note, *_between_the_bands(channels, values, rate, self.factor))

    def apply(self, values: Floats) -> Floats:
        """`values` (N, C) filtered along time and decimated, both ends dropped: ((N - length) // factor + 1, C)."""
        # wrap-around affects the first length - 1 outputs only, which are dropped
        size = 1 << (len(values) - 1).bit_length()
        spectrum = np.fft.rfft(values, size, axis=0) * np.fft.rfft(self.taps, size)[:, np.newaxis]
        filtered = np.fft.irfft(spectrum, size, axis=0)
        return np.ascontiguousarray(filtered[2 * self.half : len(values) : self.factor])


@lru_cache(maxsize=16)
def lowpass(factor: int) -> Lowpass:
    """The filter for decimation by `factor` >= 2: flat up to `PASSBAND`, `ATTENUATION` from `STOPBAND` on.

    Its squared gain at a frequency and at that which folds onto it add up to 1, as those of the scaling function of Meyer's
    wavelet do (Daubechies, Ten Lectures on Wavelets, section 4.2): white noise stays white when every `factor`-th sample is
    kept. Any filter that is steep enough to stop at the Nyquist frequency would leave noise that is correlated from sample to
    sample, and residuals that no law explains.
    """
    half = _SPAN * factor
    size = 1 << (_GRID * half - 1).bit_length()
    frequency = np.arange(size // 2 + 1) * 2.0 * factor / size  # of the new Nyquist frequency
    x = np.clip((frequency - PASSBAND) / (STOPBAND - PASSBAND), 0.0, 1.0)
    gain = np.cos(0.5 * np.pi * x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3))
    response = np.fft.irfft(gain, size)
    taps = np.concatenate([response[-half:], response[: half + 1]])
    return Lowpass(factor, taps / taps.sum())


def _between_the_bands(channels: Sequence[str], values: Floats, rate: float, factor: int) -> tuple[str, ...]:
    """A sentence on the channels (C,) whose `values` (N, C) move where the filter neither keeps nor stops them."""
    nyquist = rate / factor / 2.0
    centred = (values - values.mean(axis=0)) * np.hanning(len(values))[:, np.newaxis]
    power = np.abs(np.fft.rfft(centred, axis=0)) ** 2
    frequency = np.arange(len(power)) * rate / len(values)
    between = (frequency > PASSBAND * nyquist) & (frequency < STOPBAND * nyquist)
    above = frequency >= STOPBAND * nyquist
    whole = power.sum(axis=0)
    moving = power[between].mean(axis=0) > _ABOVE_FLOOR * power[above].mean(axis=0)
    moving &= power[between].sum(axis=0) > _AUDIBLE**2 * whole
    names = ", ".join(name for name, moves in zip(channels, moving, strict=True) if moves)
    note = (
        f"{names}: the motion between {PASSBAND * nyquist:.4g} and {STOPBAND * nyquist:.4g} Hz is neither kept nor "
        f"removed by the filter, and is aliased; decimate by less."
    )
    return (note,) if names else ()


def lowpass_for(
    factor: int, channels: Sequence[str], missing: Bools, interpolation: Mapping[str, str]
) -> Lowpass:
    """The filter for a record with `missing` (N, C) samples.

    Raises RecordError where there are any, where the filter is longer than the record, and for channels that are not
    band-limited between samples: a filter of the samples is not a filter of the signal.
    """
    if missing.any():
        raise RecordError(
            "samples are missing, and the anti-alias filter cannot bridge a gap; select a complete piece with "
            "record.between first",
            channel=channels[int(np.argmax(missing.any(axis=0)))],
            arguments=("earliest", "latest"),
        )
    for name, kind in interpolation.items():
        if kind != BAND_LIMITED:
            raise RecordError(
                f"is stated as {kind} between its samples, which samples at a lower rate cannot show; keep the rate of the "
                "record, or record the force or motion itself and not its set value",
                channel=name,
            )
    antialias = lowpass(factor)
    if len(missing) < (taps := len(antialias.taps)):
        raise RecordError(
            f"{len(missing)} samples are too few to decimate by {factor}: its anti-alias filter spans {taps}"
        )
    return antialias


ORDER = 5
FINEST = 2.5  # times the mean rate: a finer grid holds nothing new
EVEN = 1e-2  # of a step, within which times are even: then no grid finer than theirs has a use
WIDEST = 3.0  # median steps: across a longer gap a spline would invent motion
AMPLIFIED = 3.0  # times the noise of a sample: between uneven ones the noise of a spline may be any number of times that
_TRIALS = 32  # sequences of noise that tell by how much, to an eighth of it


def resample_evenly(
    time: Floats, columns: Mapping[Channel, Floats], rate: float, rows: Rows = NOWHERE
) -> tuple[float, dict[Channel, Floats], str]:
    """A start in s, columns at start + k/`rate` within the span of `time` (N,) in s, and a sentence on how they were made.

    Samples whose times all lie on that grid go to their places, and those that the file lacks are missing; only inputs, which
    must be complete, are interpolated then. Other samples are interpolated without the missing ones. In gaps of more than
    `WIDEST` median steps, and where noise would be amplified by more than `AMPLIFIED`, the result is missing. Raises
    RecordError for times that do not increase, for a rate below the mean sampling rate, which would cause aliasing, for one
    above `FINEST` times it, and for any above that of even times.
    """
    times = np.asarray(time, dtype=np.float64)
    _check_increasing(times, rows)
    mean = (len(times) - 1) / (times[-1] - times[0])
    even = bool(np.all(np.abs(np.diff(times) * mean - 1.0) < EVEN))
    wrong = ""
    if not (np.isfinite(rate) and rate > 0.0):
        wrong = f"rate must be positive, got {rate!r} Hz"
    elif rate < 0.999 * mean:
        wrong = (
            f"resampling to {rate:g} Hz would alias content above {rate / 2:g} Hz, since the record has {mean:.6g} Hz "
            "on average; resample to at least that rate, then decimate the record"
        )
    elif even and rate > 1.001 * mean:
        wrong = (
            f"the record has {mean:.6g} Hz and even times: samples at {rate:g} Hz would be interpolated and add no "
            "information, and their noise would not be independent, which looks like an error of a sensor; keep its rate"
        )
    elif rate > FINEST * mean:
        wrong = (
            f"resampling to {rate:g} Hz is finer than needed, since the record has {mean:.6g} Hz on average; resample to at "
            f"most {FINEST * mean:.6g} Hz"
        )
    if wrong:
        raise RecordError(wrong, rows.file, arguments=("resample",))
    steps = (times - times[0]) * rate
    places = np.rint(steps).astype(np.int64)
    on_grid = bool(np.all(np.abs(steps - places) < EVEN)) and bool(np.all(np.diff(places) > 0))
    count = int(places[-1]) + 1 if on_grid else int(np.floor(steps[-1] + 1e-6)) + 1
    grid = np.minimum(times[0] + np.arange(count) / rate, times[-1])
    columns = {name: _checked(times, values, name, rows.file) for name, values in columns.items()}
    splined = [name for name in columns if not on_grid or name.is_input]
    resampled = {name: np.full(count, np.nan) for name in columns}
    for name, values in columns.items():
        if name in splined:
            resampled[name] = _interpolated(times, values, grid)
        else:
            resampled[name][places] = values
    note = (
        f"Resampled from {len(times)} samples to {rate:g} Hz by quintic splines; "
        "noise of neighbouring samples is no longer independent."
    )
    if on_grid:
        note = f"The times of the {len(times)} samples lie on an even grid of {rate:g} Hz: no response was interpolated."
        note += f" Short gaps of {', '.join(splined)} were, by quintic splines." if splined else ""
    return float(times[0]), resampled, note


def _checked(times: Floats, column: Floats, name: str, file: str | None) -> Floats:
    """A column with as many samples as times, enough of which are there, all of them finite."""
    values = np.asarray(column, dtype=np.float64)
    if values.shape != times.shape:
        raise RecordError(f"has shape {values.shape}, but time has shape {times.shape}", file, channel=name)
    present = int(np.sum(~np.isnan(values)))
    if np.isinf(values).any():
        wrong = "has infinite values; leave the cells of overloaded samples empty"
    elif present < MIN_SAMPLES:
        wrong = f"{present} samples are too few; a record needs at least {MIN_SAMPLES}"
    else:
        return values
    raise RecordError(wrong, file, channel=name)


def _interpolated(times: Floats, values: Floats, grid: Floats) -> Floats:
    """One column at the times `grid`; NaN in gaps wider than `WIDEST` median steps, and where noise is amplified."""
    present = ~np.isnan(values)
    known = times[present]
    interpolated: Floats = scipy.interpolate.make_interp_spline(known, values[present], k=ORDER)(grid)
    after = np.clip(np.searchsorted(known, grid), 1, len(known) - 1)
    wide = known[after] - known[after - 1] > WIDEST * float(np.median(np.diff(times)))
    in_gap = wide & (grid != known[after]) & (grid != known[after - 1])
    outside = (grid < known[0]) | (grid > known[-1])
    interpolated[in_gap | outside | (_amplification(known, grid) > AMPLIFIED)] = np.nan
    return interpolated


def _amplification(known: Floats, grid: Floats) -> Floats:
    """Deviations (G,) at the times `grid` of splines through white noise of deviation 1 at the times `known`."""
    rng, squares = np.random.default_rng(0), np.zeros(len(grid))
    for _ in range(_TRIALS):
        noise = rng.standard_normal(len(known))
        squares += scipy.interpolate.make_interp_spline(known, noise, k=ORDER)(grid) ** 2
    return np.sqrt(squares / _TRIALS)


def sampled_columns(
    time: ArrayLike, channels: Mapping[Channel, ArrayLike], rows: Rows = NOWHERE, *, informative: bool = True
) -> tuple[Timeline, Floats, list[str]]:
    """The time grid, the values (N, C) and notes for the user; see `Record.from_arrays`.

    Unless responses must be `informative`, they may be constant, missing throughout or copies of each other.
    """
    times = np.asarray(time)
    if times.ndim != 1 or times.dtype.kind not in "iuf":
        message = f"time must be a one-dimensional array of numbers, got {times.dtype} of shape {times.shape}"
        raise RecordError(message, rows.file)
    timeline = Timeline.fit(times, rows)
    notes = list(timeline.notes)
    values = np.full((timeline.count, len(channels)), np.nan)
    for column, (name, array) in enumerate(channels.items()):
        samples = np.asarray(array)
        if samples.shape != times.shape:
            raise RecordError(
                f"has shape {samples.shape}, but time has shape {times.shape}; one sample of each channel belongs to each "
                "time: give a channel that was sampled more slowly NaN where it has no sample",
                rows.file,
                channel=name,
            )
        if samples.dtype.kind not in "biuf":
            raise RecordError(f"the samples must be numbers, got {samples.dtype}", rows.file, channel=name)
        notes += column_notes(name, samples, rows)
        values[timeline.index, column] = samples
    values.setflags(write=False)
    if informative:
        check_responses(tuple(channels), values, rows.file)
    return timeline, values, notes


# of the distances, multiples of that of most samples: a few samples more or less make no other rate
_REGULAR = 0.9


def sampled_every(present: Bools) -> int:
    """Samples from most of those that are `present` (N,) to the next one.

    1 with less than two of them, and where the distances of many are no multiples of that, as where samples are missing at
    random.
    """
    distances = np.diff(np.flatnonzero(present))
    if not len(distances):
        return 1
    every = int(np.median(distances))
    return every if np.mean(distances % every == 0) > _REGULAR else 1
