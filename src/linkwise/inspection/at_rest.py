"""What sensors say while nothing moves: levels that are not zero, and levels that change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals

_CERTAIN = 8.0  # standard errors, by blocks of the rest
_BLOCKS = 12
_LEVEL = 0.005  # of the root mean square
_CHANGE = 0.02  # of the root mean square, over the record
_LONG = 0.2  # of the record: a rest that shows a drift
_SCATTER = 2.0  # times as much as white noise, of block means about the line: what has more still moves
# standard errors between the slopes of both halves at most: a creep slows down, a drift does not
_SLOPES_AGREE = 4.0


def offset_at_rest(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of velocities and accelerations that are not zero while nothing moves; a mass may rest in a well."""
    for signal in signals.responses:
        rest = signals.rest_of(signal)
        if rest is None or signal.channel.kind not in "va":
            continue
        value, error = _mean(signal.filled[rest])
        if abs(value) < max(_LEVEL * signal.rms, _CERTAIN * error):
            continue
        message = (
            f"is {value:.3g} +- {error:.1g} {signal.channel.unit} while nothing moves, {_when(signal, rest)}: it acts like "
            "a constant force, and shifts wells and quadratic terms; subtract it, or estimate it with the laws"
        )
        yield Alert("offset", signal.name, message, abs(value) / signal.rms, arguments=("offsets",))


def drift_at_rest(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that change steadily while nothing moves."""
    for signal in signals.responses:
        rest = signals.rest_of(signal)
        if rest is None or rest.stop - rest.start < _LONG * len(signal.values):
            continue
        piece = signal.filled[rest]
        slope, error = _slope(piece)
        halves = [_slope(half) for half in np.array_split(piece, 2)]
        apart = abs(halves[0][0] - halves[1][0])
        allowed = _SLOPES_AGREE * np.hypot(halves[0][1], halves[1][1])
        over = slope * len(signal.values)
        if not _is_line(piece, slope):
            continue
        if abs(slope) < _CERTAIN * error or abs(over) < _CHANGE * signal.rms or apart > allowed:
            continue
        message = (
            f"drifts by {slope * signal.rate:.3g} {signal.channel.unit}/s while nothing moves, {_when(signal, rest)}: by "
            f"{over:.3g} {signal.channel.unit} over the record: it acts like a slow force, and biases stiffness; let the "
            "sensor warm up, subtract the trend, or use shorter pieces"
        )
        yield Alert(
            "drift",
            signal.name,
            message,
            0.3 * abs(over) / signal.rms,
            arguments=("drifts", "earliest", "latest"),
        )


def _when(signal: ChannelSignal, rest: slice) -> str:
    ends = [signal.start + sample / signal.rate for sample in (rest.start, rest.stop - 1)]
    return f"from {ends[0]:.4g} to {ends[1]:.4g} s"


def _mean(values: Floats) -> tuple[float, float]:
    """Mean and its standard error, from blocks, so that noise need not be white."""
    means = np.array([block.mean() for block in np.array_split(values, _BLOCKS)])
    return float(values.mean()), float(means.std(ddof=1) / _BLOCKS**0.5)


def _slope(values: Floats) -> tuple[float, float]:
    """Slope per sample and its standard error, from block means about the line."""
    middles = np.array(
        [block.mean() for block in np.array_split(np.arange(len(values), dtype=float), _BLOCKS)]
    )
    means = np.array([block.mean() for block in np.array_split(values, _BLOCKS)])
    centred = middles - middles.mean()
    slope = float(centred @ means / (centred @ centred))
    left = means - means.mean() - slope * centred
    return slope, float(np.sqrt(left @ left / (_BLOCKS - 2) / (centred @ centred)))


def _is_line(values: Floats, slope: float) -> bool:
    """Whether block means scatter about the line as noise of the samples does."""
    left = values - values.mean() - slope * (np.arange(len(values)) - 0.5 * (len(values) - 1))
    means = np.array([block.mean() for block in np.array_split(left, _BLOCKS)])
    return bool(means.std() < _SCATTER * left.std() * (_BLOCKS / len(values)) ** 0.5)
