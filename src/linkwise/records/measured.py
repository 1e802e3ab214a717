"""Measured columns on an even grid, with gaps filled by missing samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.checks import check_responses, column_notes
from linkwise.records.timeline import Timeline


def sampled_columns(
    time: ArrayLike,
    channels: Mapping[str, ArrayLike],
    file: str | None,
    lines: NDArray[np.int64] | None,
    *,
    informative: bool = True,
) -> tuple[Timeline, Floats, list[str]]:
    """The time grid, the values (N, C) and notes for the user; see `Record.from_arrays`.

    Unless responses must be `informative`, they may be constant, missing throughout or copies of each other.
    """
    times = np.asarray(time)
    if times.ndim != 1 or times.dtype.kind not in "iuf":
        raise RecordError(
            f"time must be a one-dimensional array of numbers, got {times.dtype} of shape {times.shape}", file
        )
    timeline = Timeline.fit(times, file=file, lines=lines)
    notes = list(timeline.notes)
    values = np.full((timeline.count, len(channels)), np.nan)
    for column, (name, array) in enumerate(channels.items()):
        samples = np.asarray(array)
        if samples.shape != times.shape:
            raise RecordError(
                f"has shape {samples.shape}, but time has shape {times.shape}; one sample of each channel belongs to each "
                "time: give a channel that was sampled more slowly NaN where it has no sample",
                file,
                channel=name,
            )
        notes += column_notes(name, samples, file, lines)
        values[timeline.index, column] = samples
    values.setflags(write=False)
    if informative:
        check_responses(tuple(channels), values, file)
    return timeline, values, notes
