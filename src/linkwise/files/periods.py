"""Periods of a periodic test that stand beside each other in an array, as one record after the other."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from linkwise.errors import RecordError
from linkwise.files.arrays import spelled_as_channel
from linkwise.files.header import ColumnHeader
from linkwise.files.table import Column
from linkwise.records.channel import Channel


def with_joined_periods(arrays: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Arrays by name with the periods of each channel joined, and a note on that; as they are where none has periods.

    The samples of a period are the axis as long as the time array, else the longest; the last of the others counts periods,
    and a third one realisations, which become groups `realisation 1/NAME`.
    Time goes on at its mean step, and an input that is given for one period is repeated.

    Raises
    ------
    RecordError
        If channels have different numbers of periods.
    """
    channels = {name: channel for name in arrays if (channel := _channel(name)) is not None}
    stacked = [
        name
        for name in channels
        if isinstance(arrays[name], np.ndarray) and np.squeeze(arrays[name]).ndim in (2, 3)
    ]
    if not stacked:
        return dict(arrays), ()
    time = next((name for name in arrays if ColumnHeader.parse(name).is_time), None)
    samples = None if time is None else int(np.size(arrays[time]))
    periods = {name: _periods(np.squeeze(arrays[name]), samples) for name in stacked}
    counts = {value.shape[1:] for value in periods.values()}
    if len(counts) > 1:
        shapes = ", ".join(f"{name} has {' x '.join(map(str, np.shape(arrays[name])))}" for name in stacked)
        raise RecordError(f"channels differ in the number of periods or of their samples: {shapes}")
    count, length = counts.pop()
    joined: dict[str, Any] = {}
    for name, value in arrays.items():
        if name in periods:
            several = len(periods[name]) > 1
            for number, realisation in enumerate(periods[name], start=1):
                joined[f"realisation {number}/{name}" if several else name] = realisation.ravel()
        elif name == time and np.size(value) == length:
            joined[name] = _continued(np.ravel(value), count)
        elif name in channels and channels[name].is_input and np.size(value) == length:
            joined[name] = np.tile(np.ravel(value), count)
        else:
            joined[name] = value
    note = (
        f"{', '.join(stacked)}: {count} periods of {length} samples were joined one after the other; averaged over that "
        "period, their scatter shows the noise."
    )
    return joined, (note,)


def _channel(name: str) -> Channel | None:
    """The channel that a name means."""
    column = spelled_as_channel(Column(name, None))
    return ColumnHeader.parse(column.meaning or name).leaf.channel


def _periods(array: np.ndarray[Any, Any], samples: int | None) -> np.ndarray[Any, Any]:
    """An array (realisations, periods, samples) of one with its axes in any order, of which `samples` has that length."""
    shape = array.shape
    if samples is None or samples == prod(shape[-2:]):  # the last of the longest
        samples = max(shape)
    if samples not in shape:
        sides = " x ".join(map(str, shape))
        raise RecordError(
            f"time has {samples} samples, and an array of a channel is {sides}: no side is as long"
        )
    axis = max(number for number, side in enumerate(shape) if side == samples)
    last = np.moveaxis(array, axis, -1)
    return last if last.ndim == 3 else last[np.newaxis]


def _continued(time: np.ndarray[Any, Any], count: int) -> np.ndarray[Any, Any]:
    """Times of one period, carried on for `count` periods."""
    step = (time[-1] - time[0]) / (len(time) - 1)
    return np.asarray(time[0] + step * np.arange(count * len(time)))
