"""Averages of periodic tests."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.record import Record
from linkwise.records.timeline import MIN_SAMPLES

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
    size = _period_samples(record, period)
    count = len(record) // size
    cube = record.values[len(record) - count * size :].reshape(count, size, -1)
    _check_repeats(record, cube, period)
    first = _first_settled(cube)
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


def _period_samples(record: Record, period: float) -> int:
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


def _first_settled(cube: Floats) -> int:
    """The first of the periods (P, M, C) from which on all are as alike as the last two."""
    power = np.nanvar(cube[-1], axis=0)
    difference = np.nanmean((cube[:-1] - cube[-1]) ** 2, axis=1) / np.where(power > 0.0, power, 1.0)
    usual = np.maximum(np.nan_to_num(difference[-1]), _NOTHING)
    settled = np.nan_to_num(difference) <= (1.0 + _SETTLED * np.sqrt(4.0 / cube.shape[1])) * usual
    unsettled = np.flatnonzero(~settled.all(axis=1))
    return int(unsettled[-1]) + 1 if len(unsettled) else 0
