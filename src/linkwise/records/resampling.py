"""Channels at an even rate: samples whose times lie on it in their places, others interpolated by quintic splines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.channel import Channel
from linkwise.records.timeline import MIN_SAMPLES, check_increasing

ORDER = 5
FINEST = 2.5  # times the mean rate: a finer grid holds nothing new
EVEN = 1e-2  # of a step, within which times are even: then no grid finer than theirs has a use
WIDEST = 3.0  # median steps: across a longer gap a spline would invent motion
AMPLIFIED = 3.0  # times the noise of a sample: between uneven ones the noise of a spline may be any number of times that
_TRIALS = 32  # sequences of noise that tell by how much, to an eighth of it


@dataclass(frozen=True, eq=False)
class Resampled:
    """Columns at an even rate, from `start` in s on, and a sentence on how they were made."""

    start: float
    columns: dict[str, Floats]
    note: str


def resample_evenly(
    time: Floats,
    columns: Mapping[str, Floats],
    rate: float,
    *,
    file: str | None = None,
    lines: NDArray[np.int64] | None = None,
) -> Resampled:
    """Columns at start + k/`rate` within the span of `time` (N,) in s.

    Samples whose times all lie on that grid go to their places, and those that the file lacks are missing; only inputs, which
    must be complete, are interpolated then. Other samples are interpolated without the missing ones. In gaps of more than
    `WIDEST` median steps, and where noise would be amplified by more than `AMPLIFIED`, the result is missing. Raises
    RecordError for times that do not increase, for a rate below the mean sampling rate, which would cause aliasing, for one
    above `FINEST` times it, and for any above that of even times.
    """
    times = np.asarray(time, dtype=np.float64)
    check_increasing(times, file, lines)
    mean = (len(times) - 1) / (times[-1] - times[0])
    if not (np.isfinite(rate) and rate > 0.0):
        raise RecordError(f"rate must be positive, got {rate!r} Hz", file, arguments=("resample",))
    if rate < 0.999 * mean:
        raise RecordError(
            f"resampling to {rate:g} Hz would alias content above {rate / 2:g} Hz, since the record has {mean:.6g} Hz "
            "on average; resample to at least that rate, then decimate the record",
            file,
            arguments=("resample",),
        )
    even = bool(np.all(np.abs(np.diff(times) * mean - 1.0) < EVEN))
    if even and rate > 1.001 * mean:
        raise RecordError(
            f"the record has {mean:.6g} Hz and even times: samples at {rate:g} Hz would be interpolated and add no "
            "information, and their noise would not be independent, which looks like an error of a sensor; keep its rate",
            file,
            arguments=("resample",),
        )
    if rate > FINEST * mean:
        raise RecordError(
            f"resampling to {rate:g} Hz is finer than needed, since the record has {mean:.6g} Hz on average; resample to at "
            f"most {FINEST * mean:.6g} Hz",
            file,
            arguments=("resample",),
        )
    steps = (times - times[0]) * rate
    places = np.rint(steps).astype(np.int64)
    on_grid = bool(np.all(np.abs(steps - places) < EVEN)) and bool(np.all(np.diff(places) > 0))
    count = int(places[-1]) + 1 if on_grid else int(np.floor(steps[-1] + 1e-6)) + 1
    grid = np.minimum(times[0] + np.arange(count) / rate, times[-1])
    columns = {name: _checked(times, values, name, file) for name, values in columns.items()}
    splined = [name for name in columns if not on_grid or Channel.parse(name).is_input]
    resampled = {
        name: _interpolated(times, values, grid) if name in splined else _placed(values, places, count)
        for name, values in columns.items()
    }
    return Resampled(float(times[0]), resampled, _note(len(times), rate, splined if on_grid else None))


def _note(samples: int, rate: float, splined: list[str] | None) -> str:
    """How `samples` came to `rate` in Hz: all by splines, or the channels in `splined` alone."""
    if splined is None:
        return (
            f"Resampled from {samples} samples to {rate:g} Hz by quintic splines; "
            "noise of neighbouring samples is no longer independent."
        )
    note = f"The times of the {samples} samples lie on an even grid of {rate:g} Hz: no response was interpolated."
    return note + (f" Short gaps of {', '.join(splined)} were, by quintic splines." if splined else "")


def _checked(times: Floats, column: Floats, name: str, file: str | None) -> Floats:
    """A column with as many samples as times, enough of which are there, all of them finite."""
    values = np.asarray(column, dtype=np.float64)
    if values.shape != times.shape:
        raise RecordError(f"has shape {values.shape}, but time has shape {times.shape}", file, channel=name)
    if np.isinf(values).any():
        raise RecordError(
            "has infinite values; leave the cells of overloaded samples empty", file, channel=name
        )
    present = int(np.sum(~np.isnan(values)))
    if present < MIN_SAMPLES:
        raise RecordError(
            f"{present} samples are too few; a record needs at least {MIN_SAMPLES}", file, channel=name
        )
    return values


def _placed(values: Floats, places: NDArray[np.int64], count: int) -> Floats:
    """Samples at their places among `count`, the others missing."""
    column = np.full(count, np.nan)
    column[places] = values
    return column


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
