"""Frequency and damping of modes over their amplitude, as they ring down after the force has ended.

The motion is shifted by the frequency of a mode and low-pass filtered: the complex envelope has its amplitude and phase. The
frequencies are those of the linear modes that explain the later half of the decay, where amplitudes are small. In each window
straight lines through phase and logarithm of the amplitude give frequency and damping; white noise of variance s^2 leaves
their slopes with the variance 24 s^2 / (A^2 N T^2) over N samples and T seconds, the Cramer-Rao bound.

References
----------
D. C. Rife and R. R. Boorstyn, IEEE Trans. Inf. Theory 20, 591 (1974).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.inspection.levels.significance import DAMPING, FREQUENCY
from linkwise.modal.measured import ModalMeasurement
from linkwise.modal.pursuit import RefinedModes, pursued_modes, refined_modes
from linkwise.progress import silent
from linkwise.records.channel import Channel
from linkwise.records.record import Record

SILENT = 0.01
"""Of the largest force: less is none."""
_PERIODS = 6.0  # of a window, at least
_FEWEST, _MOST = 4, 40  # windows
_WIDEST = 0.25  # of the frequency: half the band that is kept
_NEIGHBOUR = 0.5  # of the distance to the next mode
_FLOOR = 10.0  # times the noise in the band: a mode that is smaller is not followed
_ABOVE_NOISE = 4.0  # times the power of the noise, which the motion has until it has decayed
_PIECES = 50  # of a decay, whose powers show where that is
_SHORTEST = 100  # samples of a decay
_MODES = 6  # that are looked for
_HALVES = 3  # of what is left of a decay, from its end on, in which modes are looked for
_SHIFT = 0.3  # of the frequency: what a mode moves by at most from one such half to the next
_RINGS = 0.2  # damping of a mode that rings down, at most
_LEAST = 0.05  # of the largest amplitude in a channel: smaller ones may be harmonics of a motion that is not linear
_CHANCE = 1e-6  # of windows that scatter like this about a constant
_ROUNDING = 1e-12  # of values: errors of a decay without noise
_THIRD = 3  # of the windows, at each end, are compared


@dataclass(frozen=True, eq=False)
class RingDown:
    """A mode as it rings down.

    Attributes
    ----------
    mode : int
        Its number among the modes that ring down, from 1, in the order of frequencies.
    channel : str
        The response that was taken.
    unit : str
        The unit of the amplitude.
    amplitude, frequency, damping : array of shape (W,)
        Amplitude in the channel, frequency in Hz, and damping as a part of the critical one, window by window.
    frequency_error, damping_error : array of shape (W,)
        Standard errors of frequency and damping: those that noise leaves, or what scatters about straight lines where that is
        more.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> [ring] = found.ring_downs
    >>> bool(abs(ring.frequency[0] - 20.0) < 0.1), bool(abs(ring.damping[0] - 0.005) < 0.001)
    (True, True)
    >>> ring.moves
    False
    """

    mode: int
    channel: str
    unit: str
    amplitude: Floats
    frequency: Floats
    damping: Floats
    frequency_error: Floats
    damping_error: Floats

    @property
    def moves(self) -> bool:
        """Whether frequency or damping scatter by more than their errors, and change by what matters from end to end."""
        values, errors = self._windows
        mean = np.average(values, axis=1, weights=errors**-2.0)
        chi_square = np.sum(((values - mean[:, None]) / errors) ** 2, axis=1)
        significant = scipy.stats.chi2.sf(chi_square, values.shape[1] - 1) < _CHANCE
        first, last = self.ends[0]
        return bool(
            np.any(significant & (np.abs(first - last) > np.array([FREQUENCY, DAMPING]) * np.abs(last)))
        )

    @property
    def ends(self) -> Floats:
        """(2, 2, 2) frequency in Hz and damping over the first and the last third, weighted by their errors, and theirs."""
        third = max(len(self.amplitude) // _THIRD, 1)
        values, errors = self._windows
        ends = []
        for part in (slice(third), slice(-third, None)):
            weight = errors[:, part] ** -2.0
            total = weight.sum(axis=1)
            ends.append([np.sum(weight * values[:, part], axis=1) / total, total**-0.5])
        return np.array(ends).swapaxes(0, 1)

    @property
    def _windows(self) -> tuple[Floats, Floats]:
        """(2, W) frequencies and damping, and their errors, above zero."""
        values = np.array([self.frequency, self.damping])
        errors = np.array([self.frequency_error, self.damping_error])
        return values, np.maximum(errors, _ROUNDING * np.abs(values).max(axis=1, keepdims=True))


def ring_downs(record: Record, noise: Mapping[str, float]) -> tuple[RingDown, ...]:
    """Those of all modes that a record shows; none where it has too little of a decay.

    `noise` holds the standard deviations of the noise of responses.
    """
    decay = decay_of(record)
    centers = decaying_modes(decay, noise)[:, 0]
    names = motions(decay)
    decay = decay[: _decayed(decay, names, noise)] if len(centers) else decay
    followed = (_ring_down(decay, names, centers, mode, noise) for mode in range(len(centers)))
    rings = [ring for ring in followed if ring is not None]
    return tuple(replace(ring, mode=number) for number, ring in enumerate(rings, start=1))


def decaying_modes(decay: Record, noise: Mapping[str, float]) -> Floats:
    """(n, 2) frequencies in Hz and damping of the modes that a decay shows, those of its latest, smallest motion first of all.

    Modes are looked for in its later half, then in the later half of what is before: those of more damping have died out
    later on. There a frequency counts as another mode where no shift of one that is known already would explain it.
    """
    names = motions(decay)
    count = _decayed(decay, names, noise) if names else 0
    known = np.empty((0, 2))
    for _ in range(_HALVES):
        first, last = count // 2, count
        if last - first < _SHORTEST:
            break
        part = ModalMeasurement.of_decay(decay.select(names)[first:last])
        count, pursued = first, pursued_modes(part, None, silent, most=_MODES)
        if not len(pursued.frequencies):
            continue
        modes = _separate(refined_modes(part, pursued.frequencies, pursued.damping))
        shift = np.abs(np.log(modes[:, :1] / known[:, 0])).min(axis=1, initial=np.inf)
        known = np.concatenate([known, modes[shift > _SHIFT] if len(known) else modes])
    return np.asarray(known[np.argsort(known[:, 0])])


def motions(record: Record) -> list[str]:
    """The responses that are motions and lack no sample."""
    names = [name for name in record.responses if Channel.parse(name).kind in "xva"]
    return [name for name in names if np.isfinite(record.channel(name)).all()]


def decay_of(record: Record) -> Record:
    """The part of a record in which no force acts; where none was recorded, from the largest motion on."""
    first = 0
    for name in record.inputs:
        applied = np.abs(record.channel(name))
        if applied.any():
            first = max(first, int(np.flatnonzero(applied > SILENT * applied.max())[-1]) + 1)
    if not record.inputs:
        values = np.nan_to_num(record.select(record.responses).values)
        scale = np.maximum(np.std(values, axis=0), np.finfo(float).tiny)
        first = int(np.argmax(np.sum((values / scale) ** 2, axis=1)))
    return record[min(first, len(record) - 1) :]


def _decayed(decay: Record, names: list[str], noise: Mapping[str, float]) -> int:
    """The number of samples until the motion in all channels has sunk into the noise."""
    edges = np.linspace(0, len(decay), min(_PIECES, len(decay)) + 1).astype(int)
    values = decay.select(names).values
    power = np.add.reduceat(values**2, edges[:-1], axis=0) / np.diff(edges)[:, None]
    variance = np.array([noise[name] ** 2 for name in names])
    moves = np.flatnonzero(np.any(power > _ABOVE_NOISE * variance, axis=1))
    return int(edges[moves[-1] + 1]) if len(moves) else 0


def _separate(modes: RefinedModes) -> Floats:
    """(n, 2) frequencies in Hz and damping of the modes that ring; of two whose half-power bands overlap, that with less."""
    half = modes.damping * modes.frequencies
    share = (modes.free / modes.free.max(axis=0, initial=np.finfo(float).tiny)).max(axis=1, initial=0.0)
    separate: list[int] = []
    for mode in np.argsort(modes.damping).tolist():
        distances = np.abs(modes.frequencies[mode] - modes.frequencies[separate])
        if (
            share[mode] > _LEAST
            and modes.damping[mode] < _RINGS
            and np.all(distances > half[mode] + half[separate])
        ):
            separate.append(mode)
    return np.stack([modes.frequencies[separate], modes.damping[separate]], axis=1)


def _ring_down(
    decay: Record, names: list[str], centers: Floats, mode: int, noise: Mapping[str, float]
) -> RingDown | None:
    """That of one of the modes about `centers` in Hz; None where the record has too little of it."""
    center = float(centers[mode])
    gap = float(np.min(np.abs(np.delete(centers, mode) - center), initial=np.inf))
    half = min(_WIDEST * center, _NEIGHBOUR * gap)
    edge = int(decay.rate / half)  # that the filter needs
    count = len(decay) - 2 * edge
    length = max(round(_PERIODS / center * decay.rate), edge, count // _MOST)
    if length < 8 or count < _FEWEST * length:
        return None
    envelopes = {name: _envelope(decay.channel(name), center, half, decay.rate) for name in names}
    inner = slice(edge, len(decay) - edge)
    channel = max(names, key=lambda name: float(np.mean(np.abs(envelopes[name][inner])) / noise[name]))
    floor = _FLOOR * noise[channel] * float(np.sqrt(4.0 * half / decay.rate))
    lines = []
    for first in range(edge, edge + count - length + 1, length):
        line = _line(envelopes[channel][first : first + length], center, half, decay.rate, noise[channel])
        if line[0] <= floor:
            break
        lines.append(line)
    if len(lines) < _FEWEST:
        return None
    return RingDown(mode + 1, channel, decay.unit(channel), *np.array(lines).T)


def _envelope(values: Floats, center: float, half: float, rate: float) -> np.ndarray:
    """(N,) complex envelope of the motion within `half` a band around `center`, in Hz."""
    count = len(values)
    frequency = np.fft.fftfreq(2 * count, 1.0 / rate)
    weight = np.clip(2.0 * (1.0 - np.abs(frequency - center) / half), 0.0, 1.0)  # flat in its middle half
    mirrored = np.concatenate([values, -values[::-1]])
    analytic = np.fft.ifft(2.0 * np.fft.fft(mirrored) * weight)[:count]
    return np.asarray(analytic * np.exp(-2j * np.pi * center * np.arange(count) / rate))


def _line(
    envelope: np.ndarray, center: float, half: float, rate: float, noise: float
) -> tuple[float, float, float, float, float]:
    """Amplitude, frequency, damping and the errors of both, from lines through phase and logarithm of the amplitude."""
    tiny = np.finfo(float).tiny
    time = (np.arange(len(envelope)) - 0.5 * (len(envelope) - 1)) / rate
    duration = len(envelope) / rate
    logarithm = np.log(np.maximum(np.abs(envelope), tiny))
    phase = np.unwrap(np.angle(envelope))
    amplitude = float(np.exp(np.mean(logarithm)))
    independent = max(2.0 * half * duration, 3.0)  # complex samples of a band as wide as this
    of_noise = 2.0 * noise**2 * (2.0 * half / rate) / amplitude**2  # variance of phase, and of the logarithm
    slopes, errors = [], []
    for values in (phase, logarithm):
        slope = float(time @ values) / float(time @ time)
        scatter = float(np.var(values - slope * time)) * independent / (independent - 2.0)
        slopes.append(slope)
        errors.append(np.sqrt(12.0 * max(of_noise, scatter) / independent) / duration)
    frequency = center + slopes[0] / (2.0 * np.pi)
    per_cycle = 2.0 * np.pi * frequency
    return amplitude, frequency, -slopes[1] / per_cycle, errors[0] / (2.0 * np.pi), errors[1] / per_cycle
