"""Interpolation of unevenly sampled channels to an even rate, by quintic splines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.timeline import MIN_SAMPLES, check_increasing

ORDER = 5
FINEST = 2.5  # times the mean rate: a finer grid holds nothing new
EVEN = 1e-2  # of a step, within which times are even: then no grid finer than theirs has a use
WIDEST = 3.0  # median steps: across a longer gap a spline would invent motion


def resample_evenly(
    time: Floats,
    columns: Mapping[str, Floats],
    rate: float,
    *,
    file: str | None = None,
    lines: NDArray[np.int64] | None = None,
) -> tuple[float, dict[str, Floats]]:
    """Start time in s, and each column at start + k/`rate` within the span of `time` (N,) in s.

    Missing samples are left out of the spline; in gaps of more than `WIDEST` median steps the result is missing. Raises
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
    step = float(np.median(np.diff(times)))
    count = int(np.floor((times[-1] - times[0]) * rate + 1e-6)) + 1
    grid = np.minimum(times[0] + np.arange(count) / rate, times[-1])
    return float(times[0]), {
        name: _interpolated(times, np.asarray(values, dtype=np.float64), grid, WIDEST * step, name, file)
        for name, values in columns.items()
    }


def _interpolated(
    times: Floats, values: Floats, grid: Floats, widest: float, name: str, file: str | None
) -> Floats:
    """One column at the times `grid`; NaN in gaps wider than `widest` in s."""
    if values.shape != times.shape:
        raise RecordError(f"has shape {values.shape}, but time has shape {times.shape}", file, channel=name)
    present = ~np.isnan(values)
    if np.isinf(values).any():
        raise RecordError(
            "has infinite values; leave the cells of overloaded samples empty", file, channel=name
        )
    if present.sum() < MIN_SAMPLES:
        raise RecordError(
            f"{present.sum()} samples are too few; a record needs at least {MIN_SAMPLES}", file, channel=name
        )
    known = times[present]
    interpolated: Floats = scipy.interpolate.make_interp_spline(known, values[present], k=ORDER)(grid)
    after = np.clip(np.searchsorted(known, grid), 1, len(known) - 1)
    in_gap = (known[after] - known[after - 1] > widest) & (grid != known[after]) & (grid != known[after - 1])
    outside = (grid < known[0]) | (grid > known[-1])
    interpolated[in_gap | outside] = np.nan
    return interpolated
