"""An uneven time made even: quintic splines through the samples as they were taken."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.timeline import FEWEST, refuse_disorder

ORDER = 5
FINEST = 100.0  # samples made of each at most: more hold nothing that is not in these
WIDEST = 3.0  # typical steps: across a longer gap a spline invents motion


def resample_evenly(
    time: Floats,
    columns: Mapping[str, Floats],
    rate: float,
    *,
    file: str | None = None,
    lines: NDArray[np.int64] | None = None,
) -> tuple[float, dict[str, Floats]]:
    """Start in s and each column (N,) at start + k/`rate`, within the span of `time` (N,).

    Missing samples are left out of the spline; across more than `WIDEST` typical steps without one, samples stay missing.
    Raises RecordError for a time that is not in order, for a rate below the mean rate of the samples, which would fold high
    frequencies into low ones, and for one above `FINEST` times as much.
    """
    moments = np.asarray(time, dtype=np.float64)
    refuse_disorder(moments, file, lines)
    mean = (len(moments) - 1) / (moments[-1] - moments[0])
    if not (np.isfinite(rate) and rate > 0.0):
        raise RecordError(f"a rate of {rate!r} Hz cannot be; it is a number above 0", file)
    if rate < 0.999 * mean:
        raise RecordError(
            f"resampling to {rate:g} Hz folds what is above {rate / 2:g} Hz into what is below, since the record has "
            f"{mean:.6g} Hz "
            f"on average; resample to at least that and decimate the record afterwards",
            file,
        )
    if rate > FINEST * mean:
        raise RecordError(
            f"resampling to {rate:g} Hz makes more than {FINEST:g} samples of each, since the record has {mean:.6g} Hz on "
            f"average; resample to {FINEST * mean:.6g} Hz at most",
            file,
        )
    step = float(np.median(np.diff(moments)))
    count = int(np.floor((moments[-1] - moments[0]) * rate + 1e-6)) + 1
    grid = np.minimum(moments[0] + np.arange(count) / rate, moments[-1])
    return float(moments[0]), {
        name: _interpolated(moments, np.asarray(values, dtype=np.float64), grid, WIDEST * step, name, file)
        for name, values in columns.items()
    }


def _interpolated(
    moments: Floats, values: Floats, grid: Floats, widest: float, name: str, file: str | None
) -> Floats:
    """One column on the grid."""
    if values.shape != moments.shape:
        raise RecordError(f"has the shape {values.shape}, the time {moments.shape}", file, channel=name)
    there = ~np.isnan(values)
    if np.isinf(values).any():
        raise RecordError(
            "has infinite values; an overload is no sample, leave its cell empty", file, channel=name
        )
    if there.sum() < FEWEST:
        raise RecordError(
            f"{there.sum()} samples are too few; a record needs at least {FEWEST}", file, channel=name
        )
    known = moments[there]
    smooth: Floats = scipy.interpolate.make_interp_spline(known, values[there], k=ORDER)(grid)
    after = np.clip(np.searchsorted(known, grid), 1, len(known) - 1)
    hollow = (known[after] - known[after - 1] > widest) & (grid != known[after]) & (grid != known[after - 1])
    outside = (grid < known[0]) | (grid > known[-1])
    smooth[hollow | outside] = np.nan
    return smooth
