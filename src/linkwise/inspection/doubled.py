"""Samples that repeat the one before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals

_EXPECTED = 4.0  # times as many repeats as rounding gives
_FEWEST = 8  # repeats beyond which that is compared
_NEVER = 1e-4  # repeats expected by rounding: below it a single one is no chance
_SMALL = 0.02  # of the differences between neighbours: the smallest, by which their density at 0 is estimated
_ROW = 3  # repeats in a row, which noise does not give
_FINER = 3.0  # times the grain of the samples: noise that no two samples hide
_NOISY = 1e-6  # of the root mean square: less is rounding
_HALF = 10  # samples on either side that show whether the channel moves


def doubled(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses with samples that were written twice, or held."""
    for signal in signals.responses:
        steps = np.abs(np.diff(signal.filled))
        known = signal.present[1:] & signal.present[:-1]
        repeats = (steps == 0.0) & known & (_moves(steps) | _in_rows(steps, signal))
        ends = (signal.filled[1:] == signal.levels[0]) | (signal.filled[1:] == signal.levels[-1])
        count = int((repeats & ~ends).sum())
        if not count:
            continue
        natural = _natural(steps[known], signal.grain[1:][known])
        if natural > _NEVER and count <= _FEWEST + _EXPECTED * natural:
            continue
        first = signal.start + int(np.argmax(repeats & ~ends)) / signal.rate
        held_share = count / max(int(known.sum()), 1)
        finding = (
            f"about every sample is held for {1.0 / (1.0 - held_share):.2g} samples"
            if held_share > 0.3
            else f"{count} sample{'s repeat' if count > 1 else ' repeats'} the one before, the first at {first:g} s"
        )
        message = (
            f"{finding}: if the logger wrote samples twice, everything after them comes late, and stiffness and damping are "
            "wrong by many standard errors; cut the record to a piece without them, or mark them as missing"
        )
        yield Alert("doubled", signal.name, message, float(held_share**0.5), arguments=("earliest", "latest"))


def _natural(steps: Floats, grain: Floats) -> float:
    """Number of repeats that rounding explains, for differences `steps` of samples with a `grain`."""
    width = max(float(np.quantile(steps, _SMALL)), 10.0 * float(np.median(grain)))
    return float(np.sum(grain[(steps > 0.0) & (steps < width)]) / width)


def _in_rows(steps: Floats, signal: ChannelSignal) -> Bools:
    """Whether each step is in a longer row of repeats, which begins and ends in motion, of a channel with noise.

    Noise shows in every sample, also of what rests; only a channel without noise, or rounded more coarsely, can repeat samples
    for as long as it rests.
    """
    grain = max(float(np.median(signal.grain)), signal.step)
    if not np.nan_to_num(signal.sigma) > max(_FINER * grain, _NOISY * signal.rms):
        return np.zeros(len(steps), dtype=bool)
    moving = np.flatnonzero(steps > 0.0)
    if not len(moving):
        return np.zeros(len(steps), dtype=bool)
    after = np.searchsorted(moving, np.arange(len(steps)))
    inside = (after > 0) & (after < len(moving))
    length = moving[np.minimum(after, len(moving) - 1)] - moving[np.maximum(after - 1, 0)] - 1
    return np.asarray(inside & (length >= _ROW))


def _moves(steps: Floats) -> Bools:
    """Whether the channel moves on either side of each step, so that a repeat is no rest."""
    moving = np.concatenate([[0], np.cumsum(steps > 0.0)])
    index = np.arange(len(steps))
    after = moving[np.minimum(index + 1 + _HALF, len(steps))] - moving[index + 1]
    before = moving[index] - moving[np.maximum(index - _HALF, 0)]
    return np.asarray((after >= _HALF // 3) & (before >= _HALF // 3))
