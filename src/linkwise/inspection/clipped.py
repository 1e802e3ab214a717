"""Samples that stand at the end of a range."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals
from linkwise.signals.smooth import smoothing_spline

_FEWEST = 4  # samples at an end
_CROWDED = 6.0  # times as many at the end of a range as on the level before it: a sine has 2.4
_FINE = 1e-7  # of the range: with finer steps no two samples are equal by chance
_PERIODS = 2.0  # of the motion: a motion is beyond the end of a range for half of one
_SHORTEST = 8  # samples that may be a long stay
_REACH = 3.0  # standard deviations of the noise, which a sample exceeds once in 700
# of the samples at the ends of a range: a signal that switches between two levels, not a clipped one
_FLAT = 0.5


def clipped(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels with samples at an end of their range."""
    for signal in signals.moving:
        ends = _clipped_ends(signal)
        if not ends:
            continue
        total = sum(count for count, _ in ends)
        where = " and ".join(f"{count} at {value:.4g} {signal.channel.unit}" for count, value in ends)
        message = (
            f"{total} samples are at the end of the range ({where}): the sensor or the amplifier was overloaded, and "
            "stiffness and damping at large motion come out wrong; mark these samples as missing (mark_missing), or measure "
            "with a larger range"
        )
        error = float(total / len(signal.observed)) ** 0.5
        yield Alert("clipped", signal.name, message, error, arguments=("mark_missing",))


def clipped_samples(signal: ChannelSignal) -> Bools:
    """Which samples (N,) are clipped, or would have been with another noise.

    Were those beside a clipped one kept that only their noise has held inside of the range, the noise of the samples that are
    left would no longer have a mean of zero.
    """
    ends = rails(signal)
    clipped = np.isin(signal.values, [value for value, _ in ends])
    if not ends:
        return clipped
    motion = smoothing_spline(signal.filled, signal.rate).value()[:, 0]
    reach = _REACH * float(np.nan_to_num(signal.sigma))
    for value, side in ends:
        clipped |= side * (motion - value) > -reach
    return clipped & signal.present


def clipped_readings(signal: ChannelSignal, marked: Bools) -> tuple[Floats, Floats]:
    """Readings (N,) of the `marked` samples (N,), NaN elsewhere, and on which sides of them the motion is: 0 where exact."""
    sides = np.zeros(len(signal.values))
    for value, side in rails(signal):
        sides[marked & (signal.values == value)] = side
    return np.where(marked, signal.values, np.nan), sides


def long_stays(signal: ChannelSignal, marked: Bools) -> list[slice]:
    """The stays at an end, among `marked` samples (N,), that last for longer than two periods of the motion.

    A motion that goes beyond a range comes back within half a period. What stays longer is no bound on it: an amplifier that
    recovers from an overload reads the end of its range whatever the motion is.
    """
    edges = np.diff(np.concatenate([[0], marked.astype(np.int8), [0]]))
    runs = [slice(*ends) for ends in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True)]
    longest = max((run.stop - run.start for run in runs), default=0)
    if longest <= _SHORTEST:
        return []
    motion = smoothing_spline(signal.filled, signal.rate).value()[:, 0]
    outside = np.ones(len(motion), dtype=bool)
    for run in runs:
        if run.stop - run.start > 0.5 * longest:
            outside[run] = False
    middle = float(np.median(motion[outside])) if outside.any() else 0.0
    above = motion > middle
    crossings = int(np.sum((above[1:] != above[:-1]) & outside[1:] & outside[:-1]))
    period = 2.0 * float(outside.sum()) / max(crossings, 1)
    return [run for run in runs if run.stop - run.start > _PERIODS * period]


def rails(signal: ChannelSignal) -> tuple[tuple[float, float], ...]:
    """The values at which samples are clipped, each with the side of it that the motion was beyond, 1 above and -1 below."""
    return tuple((value, 1.0 if value == signal.levels[-1] else -1.0) for _, value in _clipped_ends(signal))


def _clipped_ends(signal: ChannelSignal) -> list[tuple[int, float]]:
    """The ends of the range at which samples are clipped, each with their number."""
    ends = [(count, value) for value in _ends(signal) if (count := _at_end(signal, value))]
    return ends if sum(count for count, _ in ends) <= _FLAT * len(signal.observed) else []


def _ends(signal: ChannelSignal) -> tuple[float, float]:
    return float(signal.levels[0]), float(signal.levels[-1])


def _at_end(signal: ChannelSignal, value: float) -> int:
    """Samples at an end of the range, 0 where it is not an end that cuts a motion off."""
    filled = signal.filled
    at = (filled == value) & signal.present
    count = int(at.sum())
    if count < _FEWEST or len(signal.levels) < 8 or not np.any(at[1:] & at[:-1]):
        return 0
    if np.median(np.abs(filled - value)) <= 0.02 * (signal.levels[-1] - signal.levels[0]):
        return 0  # a signal that starts from or decays to this level
    grain = float(signal.grain[np.argmax(at)])
    near = (np.abs(filled - value) < 1.5 * grain) & ~at
    if grain > _FINE * (signal.levels[-1] - signal.levels[0]) and count < _CROWDED * max(int(near.sum()), 1):
        return 0
    entered = np.flatnonzero(at[1:] & ~at[:-1])  # the last sample before each plateau
    before = entered[entered > 0]
    if not before.size:
        return 0
    # a motion that comes to rest slows down before, one that is cut off does not
    slope = np.median(np.abs(filled[before] - filled[before - 1]))
    return count if slope > 2.0 * grain else 0
