"""What a test at one level shows of linearity, without a model: response functions, distortion, restoring force,
ring-down.

A linear structure answers at the frequencies of the force alone. Where these are odd multiples of the reciprocal of the
period, what even terms of the laws add is at even multiples, and what odd terms add at odd multiples that the force
leaves out (Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2012), section 4.3). The scatter
from period to period is noise, and what of the motion at the start has not died out in the second half of the periods,
which alone counts.

Where no force acts, the acceleration of a mass is its restoring force over the mass, with the sign reversed. At a place
of a structure the other coordinates take part in it: points scatter about a surface, and where the structure is not
linear near the sensor the surface is bent (Masri and Caughey, J. Appl. Mech. 46, 433 (1979); Dossogne, Noël and Kerschen,
Nonlinear Dynamics 81, 1 (2015)).

Of a decay, the motion is shifted by the frequency of a mode and low-pass filtered: the complex envelope has its amplitude
and phase. The frequencies are those of the linear modes that explain the later half of the decay, where amplitudes are
small. In each window straight lines through phase and logarithm of the amplitude give frequency and damping; white noise
of variance s^2 leaves their slopes with the variance 24 s^2 / (A^2 N T^2) over N samples and T seconds, the Cramer-Rao
bound (Rife and Boorstyn, IEEE Trans. Inf. Theory 20, 591 (1974)). A few missing samples change a window of a hundred or
more by next to nothing, so that short gaps are bridged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from linkwise.arrays import Bools, Floats, bridged
from linkwise.modal.measurement import ModalMeasurement
from linkwise.modal.pursuit import RefinedModes, pursued_modes, refined_modes
from linkwise.model.link import ANGLE, LENGTH
from linkwise.progress import silent
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.gaps import SILENT
from linkwise.signals.states import channel_motion, highpass

_TINY = float(np.finfo(float).tiny)
_BLOCKS = 8  # that fit into a record side by side
_EXCITED = 1e-4  # of the largest power density of the force: below it there is no information
_LEAST = 32  # samples of a block


@dataclass(frozen=True, eq=False)
class ResponseFunction:
    """The response of one channel to one force.

    Attributes
    ----------
    response, force : str
        The channels.
    frequency : array of shape (F,)
        Frequencies in Hz.
    magnitude : array of shape (F,)
        Absolute value of the response function, in units of the response per N (the estimate H1); NaN where the force has
        next to no power.
    coherence : array of shape (F,)
        The part of the power of the response that follows from the force linearly; NaN as well.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> force = np.random.default_rng(1).standard_normal(4000)
    >>> record = lw.Record.from_arrays(np.arange(4000) / 1000.0, {"force:m1": force, "a:m1": 2.0 * force})
    >>> found = lw.inspection.compare_levels([record, record], modes=1).responses[0]
    >>> round(float(np.median(found.magnitude)), 6), round(float(np.median(found.coherence)), 6)
    (2.0, 1.0)
    """

    response: str
    force: str
    frequency: Floats
    magnitude: Floats
    coherence: Floats

    @classmethod
    def of(cls, record: Record, response: str, force: str) -> ResponseFunction:
        """Estimate that of two channels of a record; missing samples are bridged by straight lines.

        Parameters
        ----------
        record : Record
            The record.
        response, force : str
            The channels.

        Returns
        -------
        ResponseFunction
            The response function.
        """
        values, applied = bridged(record.channel(response)), record.channel(force)
        block = max(min(len(record), _LEAST), 2 * len(record) // (_BLOCKS + 1))
        options = {"fs": record.rate, "nperseg": block, "detrend": "constant"}
        frequency, cross = scipy.signal.csd(applied, values, **options)
        of_force, of_response = (scipy.signal.welch(signal, **options)[1] for signal in (applied, values))
        magnitude = np.abs(cross) / np.maximum(of_force, _TINY)
        coherence = np.abs(cross) ** 2 / np.maximum(of_force * of_response, _TINY)
        unexcited = of_force < _EXCITED * of_force.max()
        magnitude[unexcited] = coherence[unexcited] = np.nan
        return cls(response, force, frequency[1:], magnitude[1:], coherence[1:])


_ALIKE = 0.02  # power of the difference of two periods of a force over its own
_SHORTEST_PERIOD = 8  # samples of a period
_EXCITED_FORCE = 0.01  # of the largest amplitude of the force: a frequency that it excites
_SETTLING = 0.5  # of the periods, at the start, which are left out where two remain


@dataclass(frozen=True)
class Distortion:
    """Distortion of the response in one channel.

    Attributes
    ----------
    channel : str
        The response.
    period : float
        Period of the force in s.
    odd, even : float or None
        Power at odd and even multiples that the force leaves out, over that of the response, in dB; None where the force
        excites even multiples, or leaves none out.
    noise : float
        Power of the scatter from period to period, over that of the response, in dB: noise, and what of the start has not died
        out. Odd or even distortion below it may be a part of these.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_sine.csv"), lw.read_record("hard_sine.csv")], modes=1)
    >>> found.distortions[0].period
    0.0625
    """

    channel: str
    period: float
    odd: float | None
    even: float | None
    noise: float


def distortion(record: Record, response: str, force: str) -> Distortion | None:
    """That of a response to a force; None where the force does not repeat, or samples are missing."""
    applied, values = record.channel(force), record.channel(response)
    period = _force_period(applied)
    if period is None or not np.isfinite(values).all():
        return None
    count = len(record) // period
    skipped = min(int(_SETTLING * count), count - 2)
    first = len(record) - (count - skipped) * period
    blocks = [signal[first:].reshape(-1, period) for signal in (applied, values)]
    of_force, of_response = (np.fft.rfft(block, axis=1)[:, 1 : period // 2] for block in blocks)
    lines = np.arange(1, of_force.shape[1] + 1)
    amplitude = np.abs(of_force.mean(axis=0))
    excited = amplitude > _EXCITED_FORCE * amplitude.max()
    mean = of_response.mean(axis=0)
    scatter = np.sum(np.abs(of_response - mean) ** 2, axis=0) / max(len(of_response) - 1, 1)
    power = float(np.sum(np.abs(mean[excited]) ** 2))
    only_odd = not excited[lines % 2 == 0].any()

    def decibel(part: float) -> float:
        return float(10.0 * np.log10(max(part, _TINY) / max(power, _TINY)))

    def of_parity(parity: int) -> float | None:
        unexcited = ~excited & (lines % 2 == parity)
        left_out = only_odd and unexcited.any()
        return decibel(float(np.sum(np.abs(mean[unexcited]) ** 2))) if left_out else None

    noise = decibel(float(scatter.sum()) / len(of_response))
    return Distortion(response, period * record.step, of_parity(1), of_parity(0), noise)


def _force_period(force: Floats) -> int | None:
    """The shortest shift in samples after which a force repeats, twice or more in the record; None if there is none."""
    values = force - force.mean()
    n = len(values)
    spectrum = np.fft.rfft(values, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: n // 2 + 1]
    squares = np.concatenate([[0.0], np.cumsum(values**2)])
    shift = np.arange(n // 2 + 1)
    power = squares[n] - squares[shift] + squares[n - shift]  # of both parts
    difference = np.divide(power - 2.0 * products, power, out=np.ones_like(power), where=power > 0.0)
    repeats = difference[_SHORTEST_PERIOD:-1] < _ALIKE
    dips = repeats & (difference[_SHORTEST_PERIOD:-1] <= difference[_SHORTEST_PERIOD - 1 : -2])
    dips &= difference[_SHORTEST_PERIOD:-1] <= difference[_SHORTEST_PERIOD + 1 :]
    shifts = np.flatnonzero(dips) + _SHORTEST_PERIOD
    return int(shifts[0]) if len(shifts) else None


SIGNIFICANT = 4.0
"""Standard errors by which it must differ: by chance once in 16 000."""
FREQUENCY, DAMPING = 5e-4, 0.05
"""Relative changes that matter: less is what temperature and sensors do."""


def differ(
    values: ArrayLike, errors: ArrayLike, others: ArrayLike, other_errors: ArrayLike, least: float
) -> Bools:
    """Whether `values` differ from `others` by more than errors, and by more than `least` of the others."""
    certain, matters = SIGNIFICANT * np.hypot(errors, other_errors), least * np.abs(others)
    return np.asarray(np.abs(np.subtract(values, others)) > np.maximum(certain, matters))


_PERIODS = 6.0  # of a window, at least
_FEWEST_WINDOWS, _MOST_WINDOWS = 4, 40  # windows
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
_LEAST_AMPLITUDE = 0.05  # of the largest amplitude in a channel: smaller ones may be harmonics of a motion that is not linear
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
    channel : Channel
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
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> [ring] = found.ring_downs
    >>> bool(abs(ring.frequency[0] - 20.0) < 0.1), bool(abs(ring.damping[0] - 0.005) < 0.001)
    (True, True)
    >>> ring.moves
    False
    """

    mode: int
    channel: Channel
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
        matters = np.abs(first - last) > np.array([FREQUENCY, DAMPING]) * np.abs(last)
        return bool(np.any(significant & matters))

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
    decay = decay[: _samples_of_decay(decay, names, noise)] if len(centers) else decay
    rings = filter(None, (_ring_down(decay, names, centers, mode, noise) for mode in range(len(centers))))
    return tuple(replace(ring, mode=number) for number, ring in enumerate(rings, start=1))


def decaying_modes(decay: Record, noise: Mapping[str, float]) -> Floats:
    """(n, 2) frequencies in Hz and damping of the modes that a decay shows, those of its latest, smallest motion first of all.

    Modes are looked for in its later half, then in the later half of what is before: those of more damping have died out
    later on. There a frequency counts as another mode where no shift of one that is known already would explain it.
    """
    names = motions(decay)
    count = _samples_of_decay(decay, names, noise) if names else 0
    known = np.empty((0, 2))
    for _ in range(_HALVES):
        first, last = count // 2, count
        if last - first < _SHORTEST:
            break
        part = ModalMeasurement.of_decay(decay.select(names)[first:last])
        count, pursued = first, pursued_modes(part, None, silent, most=_MODES)
        if not len(pursued.frequencies):
            continue
        modes = _separate_modes(refined_modes(part, pursued.frequencies, pursued.damping))
        shift = np.abs(np.log(modes[:, :1] / known[:, 0])).min(axis=1, initial=np.inf)
        known = np.concatenate([known, modes[shift > _SHIFT] if len(known) else modes])
    return np.asarray(known[np.argsort(known[:, 0])])


def motions(record: Record) -> list[Channel]:
    """The responses that are motions and lack no sample."""
    return [name for name in record.motions if np.isfinite(record.channel(name)).all()]


def decay_of(record: Record) -> Record:
    """The part of a record in which no force acts; where none was recorded, from the largest motion on."""
    first = 0
    for name in record.inputs:
        applied = np.nan_to_num(np.abs(record.channel(name)))  # a gap shows no force
        if applied.any():
            first = max(first, int(np.flatnonzero(applied > SILENT * applied.max())[-1]) + 1)
    if not record.inputs:
        values = np.nan_to_num(record.select(record.responses).values)
        scale = np.maximum(np.std(values, axis=0), _TINY)
        first = int(np.argmax(np.sum((values / scale) ** 2, axis=1)))
    return record[min(first, len(record) - 1) :]


def _samples_of_decay(decay: Record, names: list[Channel], noise: Mapping[str, float]) -> int:
    """The number of samples until the motion in all channels has sunk into the noise."""
    edges = np.linspace(0, len(decay), min(_PIECES, len(decay)) + 1).astype(int)
    values = decay.select(names).values
    power = np.add.reduceat(values**2, edges[:-1], axis=0) / np.diff(edges)[:, None]
    variance = np.array([noise[name] ** 2 for name in names])
    moves = np.flatnonzero(np.any(power > _ABOVE_NOISE * variance, axis=1))
    return int(edges[moves[-1] + 1]) if len(moves) else 0


def _separate_modes(modes: RefinedModes) -> Floats:
    """(n, 2) frequencies in Hz and damping of the modes that ring; of two whose half-power bands overlap, that with less."""
    half = modes.damping * modes.frequencies
    share = (modes.free / modes.free.max(axis=0, initial=_TINY)).max(axis=1, initial=0.0)
    separate: list[int] = []
    for mode in np.argsort(modes.damping).tolist():
        distances = np.abs(modes.frequencies[mode] - modes.frequencies[separate])
        rings = share[mode] > _LEAST_AMPLITUDE and modes.damping[mode] < _RINGS
        if rings and np.all(distances > half[mode] + half[separate]):
            separate.append(mode)
    return np.stack([modes.frequencies[separate], modes.damping[separate]], axis=1)


def _ring_down(
    decay: Record, names: list[Channel], centers: Floats, mode: int, noise: Mapping[str, float]
) -> RingDown | None:
    """That of one of the modes about `centers` in Hz; None where the record has too little of it."""
    center = float(centers[mode])
    gap = float(np.min(np.abs(np.delete(centers, mode) - center), initial=np.inf))
    half = min(_WIDEST * center, _NEIGHBOUR * gap)
    edge = int(decay.rate / half)  # that the filter needs
    count = len(decay) - 2 * edge
    length = max(round(_PERIODS / center * decay.rate), edge, count // _MOST_WINDOWS)
    if length < 8 or count < _FEWEST_WINDOWS * length:
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
    if len(lines) < _FEWEST_WINDOWS:
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
    time = (np.arange(len(envelope)) - 0.5 * (len(envelope) - 1)) / rate
    duration = len(envelope) / rate
    logarithm = np.log(np.maximum(np.abs(envelope), _TINY))
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


_SLOW = 0.2  # of the lowest mode: what is slower in an integral is drift
_EDGE = 2.0  # periods of the lowest mode at the ends of the record, where integrals are uncertain
_MOST_CHANNELS = 4  # channels


@dataclass(frozen=True, eq=False)
class AccelerationSurface:
    """Restoring force per mass at one sensor, while no force acts.

    Attributes
    ----------
    channel : str
        The channel from which all three follow.
    displacement, velocity, acceleration : array of shape (N,)
        Its motion in m, m/s and m/s^2, or in rad and so on; integrals without what is slower than the modes.
    unit : str
        Unit of the displacement, ``"rad"`` of what turns.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> [surface] = found.surfaces
    >>> slope = -(surface.acceleration @ surface.displacement) / (surface.displacement @ surface.displacement)
    >>> round(float(slope**0.5 / 6.2832))  # Hz
    20
    """

    channel: str
    displacement: Floats
    velocity: Floats
    acceleration: Floats
    unit: str = LENGTH


def acceleration_surfaces(
    record: Record, frequencies: Floats, noise: Mapping[str, float]
) -> tuple[AccelerationSurface, ...]:
    """Those of the motions that move most, while no force acts; none where the record has no such part of a few periods.

    `frequencies` in Hz are those of the modes, `noise` holds the standard deviations of the noise of responses.
    """
    count = len(decay_of(record))
    slowest = float(frequencies.min())
    edge = round(_EDGE * record.rate / slowest)
    if count < 4 * edge:
        return ()
    inner = slice(max(len(record) - count, edge), len(record) - edge)
    surfaces = []
    for name in motions(record):
        motion = channel_motion(record, name, noise[name])
        unit = ANGLE if record.unit(name) == name.angular_unit else LENGTH
        parts = [
            highpass(part, record.rate, _SLOW * slowest) if order < name.order else part
            for order, part in enumerate(motion)
        ]
        displacement, velocity, acceleration = (part[inner] for part in parts)
        surfaces.append(AccelerationSurface(name, displacement, velocity, acceleration, unit))
    surfaces.sort(key=lambda surface: -float(np.std(surface.displacement)))
    return tuple(surfaces[:_MOST_CHANNELS])


@dataclass(frozen=True)
class BridgedGaps:
    """The short gaps of one channel.

    Attributes
    ----------
    record, channel : str
        Where they are: the label of the level, and the channel.
    samples : int
        How many samples were missing, and are interpolated.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.inspection.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> found.bridged
    ()
    """

    record: str
    channel: str
    samples: int


def bridged_gaps(
    labels: Sequence[str], records: Sequence[Record], bridged: Sequence[Record]
) -> tuple[BridgedGaps, ...]:
    """What of `records`, each with its label, was missing and is there in those that are `bridged`."""
    gaps: list[BridgedGaps] = []
    for label, record, complete in zip(labels, records, bridged, strict=True):
        counts = np.sum(np.isnan(record.values) & np.isfinite(complete.values), axis=0)
        gaps += [
            BridgedGaps(label, name, int(count))
            for name, count in zip(record.channels, counts.tolist(), strict=True)
            if count
        ]
    return tuple(gaps)
