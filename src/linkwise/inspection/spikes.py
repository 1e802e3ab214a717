"""Single samples that lie far from what their neighbours say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals

_NEIGHBOURS = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20.0  # the quintic through six of them
_HALF = 3
_NOISE = float(np.sqrt(1.0 + _NEIGHBOURS @ _NEIGHBOURS))  # deviation of a sample of unit noise from it
_MEDIAN = 0.6745  # of a normal deviation's size
_BLOCK = 32  # samples whose median deviation is the usual one
_FAR = 8.0  # usual deviations where they are noise: of 1e12 normal samples one
_FARTHER = 16.0  # where they are motion, whose deviations come and go
_SCATTER = 0.75  # of the noise, by which usual deviations that are noise alone may seem to be motion
_SHARP = 0.3  # of the root mean square of an acceleration, which a force that changes sign can turn within a sample
# of the deviation that neighbours may have once the sample is mended: a jump or a kink leaves more
_LEFT = 0.35

_REACH = 6  # samples on either side of an outlier by which a jump is told from a spike
_ROUGH = 0.3  # of the squared deviation, that a quartic leaves of all neighbours: of noise 0.1 at most, at a kink from 0.8 on
_SMOOTH = 0.2  # of what a motion without a jump leaves there: jumps leave 0.05 at most, spikes 1e4


def spikes(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses, and of the motion of the base, with outliers."""
    for signal in signals.moving:
        indices = _spikes(signal)
        if not len(indices):
            continue
        size = _deviations(signal.filled)[indices]
        largest = int(np.argmax(np.abs(size)))
        when = signal.start + indices[largest] / signal.rate
        message = (
            f"{len(indices)} sample{'s lie' if len(indices) > 1 else ' lies'} far from the neighbours, the farthest by "
            f"{size[largest]:.3g} {signal.channel.unit} at {when:.6g} s: least squares follows such samples, and noise and "
            "intervals come out too wide; mark them as missing (mark_missing), or use a robust loss"
        )
        error = float(np.sqrt(np.sum(size**2) / len(signal.values))) / signal.rms
        yield Alert("spikes", signal.name, message, error, arguments=("mark_missing", "loss"))


def _deviations(values: Floats) -> Floats:
    """How far each sample (N,) is from what its neighbours say; 0 at both ends."""
    deviations = np.zeros(len(values))
    deviations[_HALF:-_HALF] = values[_HALF:-_HALF] - np.convolve(values, _NEIGHBOURS, "valid")
    return deviations


def spiked_samples(signal: ChannelSignal) -> Bools:
    """Which samples (N,) are spikes."""
    spiked = np.zeros(len(signal.values), dtype=bool)
    spiked[_spikes(signal)] = True
    return spiked


def without_spikes(signal: ChannelSignal) -> ChannelSignal:
    """The channel with its spikes missing: single samples have power at all frequencies, and move at none."""
    spiked = spiked_samples(signal)
    return replace(signal, values=np.where(spiked, np.nan, signal.values)) if spiked.any() else signal


def jumps(signal: ChannelSignal) -> Indices:
    """The first samples behind jumps of a displacement, from which on it goes on elsewhere as smoothly as before."""
    rows = _outliers(signal)
    if signal.channel.kind != "x":
        return rows[:0]
    behind = [_jump(signal.filled, int(row)) for row in rows]
    rows = np.unique([row for row in behind if row is not None]).astype(int)
    return rows[np.diff(rows, prepend=-_REACH) > 2]


def _spikes(signal: ChannelSignal) -> Indices:
    """The outliers that stand alone, not those at which the motion jumps or turns, as by dry friction or a stop."""
    values, rows = signal.filled, _outliers(signal)
    alone = [row for row in rows.tolist() if _is_spike(values, row) and _jump(values, row) is None]
    return np.array(alone, dtype=int)


def _is_spike(values: Floats, row: int) -> bool:
    """Whether the neighbours of an outlier go on smoothly without it."""
    near = values[row - _HALF : row + _HALF + 1]
    return _left_by_neighbours(values, row) < _ROUGH * float(_deviations(near)[_HALF]) ** 2


def _left_by_neighbours(values: Floats, row: int) -> float:
    """Sum of squares that a quartic leaves of the neighbours of an outlier, without it."""
    near = np.arange(max(row - _REACH, 0), min(row + _REACH + 1, len(values)))
    near = near[near != row]
    return _left((near - row) / _REACH, values[near], 4)


def _jump(values: Floats, row: int) -> int | None:
    """The first sample behind a jump at an outlier; None where the neighbours of the outlier go on without it."""
    first, last = max(row - _REACH, 0), min(row + _REACH + 1, len(values))
    if last - first < 2 * _REACH + 1:
        return None
    time, piece = np.arange(-_REACH, _REACH + 1) / _REACH, values[first:last]
    splits = range(_REACH - 1, _REACH + 3)
    apart = [_left(time[:at], piece[:at], 2) + _left(time[at:], piece[at:], 2) for at in splits]
    if min(apart) > _SMOOTH * _left_by_neighbours(values, row):
        return None
    return first + splits[int(np.argmin(apart))]


def _left(time: Floats, values: Floats, degree: int) -> float:
    """Sum of squares that a polynomial of a degree leaves."""
    columns = np.vander(time, degree + 1)
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(left @ left)


def _outliers(signal: ChannelSignal) -> Indices:
    """The samples that lie far from what their neighbours say; none of a force, which may jump, and of a short record."""
    if signal.channel.kind in ("force", "f") or len(signal.values) < 4 * _BLOCK:
        return np.zeros(0, dtype=int)
    values = signal.filled
    deviations = _deviations(values)
    near_gap = np.convolve(~signal.present, np.ones(2 * _HALF + 1), "same") > 0.5
    deviations[near_gap] = 0.0
    size = np.abs(deviations)
    blocks = np.median(size[: len(size) // _BLOCK * _BLOCK].reshape(-1, _BLOCK), axis=1) / _MEDIAN
    widest = np.maximum(
        np.maximum(blocks, np.append(blocks[1:], blocks[-1])), np.append(blocks[0], blocks[:-1])
    )
    usual = widest[np.minimum(np.arange(len(size)) // _BLOCK, len(blocks) - 1)]
    noise = np.maximum(_NOISE * np.nan_to_num(signal.sigma), signal.grain)
    limit = np.maximum(_FAR * np.maximum(usual, noise), _FARTHER * (usual - _SCATTER * noise))
    if signal.channel.kind == "a":
        limit = np.maximum(limit, _SHARP * signal.rms)
    candidates = np.flatnonzero(size > limit)
    return np.array([row for row in candidates if _alone(values, deviations, int(row))], dtype=int)


def _alone(values: Floats, deviations: Floats, row: int) -> bool:
    """Whether nothing is odd around a sample once it is replaced by what its neighbours say."""
    first, last = max(row - 2 * _HALF, 0), min(row + 2 * _HALF + 1, len(values))
    mended = values[first:last].copy()
    mended[row - first] -= deviations[row]
    if len(mended) <= 2 * _HALF + 1:
        return False
    return bool(np.max(np.abs(_deviations(mended))) < _LEFT * abs(deviations[row]))
