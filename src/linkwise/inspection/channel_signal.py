"""Channels as the checks look at them, each quantity computed once: noise, levels, spectra, coherence, rest, and whether
one is a derivative of another.

Against test functions p of bounded support, integral(p v) = -integral(p' x) for v = dx/dt, without any derivative of
samples. A gain g, a delay tau, an offset b and a slope s of the higher channel give

    integral(p v) = g (-integral(p' x)) + g tau (-integral(p'' x)) + b integral(p) + s integral(p t),

for small tau, and likewise for v and a, and with one more derivative for x and a. A tau that is not small is found in
steps, with test functions of the higher channel that are moved by what is known of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices, bridged
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma

_LONGEST = 512  # samples of a block
_BLOCKS = 8  # that fit into a record side by side, where it is long enough
_CHANCE = 0.05
# blocks in place of one: neighbours under Hann windows that overlap by half (Welch 1967)
SHARED_BLOCKS = 1.0 + 2.0 / 36.0


@dataclass(frozen=True, eq=False)
class Spectrogram:
    """One-sided spectral densities (B, F) in the squared unit of the samples per Hz, of B blocks that overlap by half,
    with their middles `time` in s from the first sample, at F frequencies in Hz.
    """

    frequency: Floats
    time: Floats
    power: Floats

    @classmethod
    def of(cls, values: Floats, rate: float) -> Spectrogram:
        """That of samples (N,) at `rate` in Hz, without their mean, straight lines over missing samples."""
        first, block, window = _spectral_blocks(len(values))
        power = np.abs(_transformed(values)) ** 2 * (2.0 / (rate * np.sum(window**2)))
        power[:, 0] *= 0.5
        if block % 2 == 0:
            power[:, -1] *= 0.5
        time = np.asarray((first + 0.5 * block) / rate, dtype=float)
        return cls(_frequencies(block, rate), time, np.asarray(power, dtype=float))

    @property
    def mean(self) -> Floats:
        """Density averaged over time, shape (F,)."""
        return np.asarray(self.power.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Coherence:
    """The part (F,) of the power of one channel that follows linearly from another, 0 where a channel has no power, and
    what independent noise exceeds in one of 20 frequencies `by_chance`; 1 where there is only one block. G. C. Carter, C.
    H. Knapp, A. H. Nuttall, IEEE Transactions on Audio and Electroacoustics 21 (1973), 337-344.
    """

    frequency: Floats
    values: Floats
    by_chance: float

    @classmethod
    def of(cls, first: Floats, second: Floats, rate: float) -> Coherence:
        """That of samples (N,) and (N,) at `rate` in Hz, without their means, straight lines over missing samples."""
        of_first, of_second = _transformed(first), _transformed(second)
        cross = np.abs(np.mean(of_first * of_second.conj(), axis=0)) ** 2
        power = np.mean(np.abs(of_first) ** 2, axis=0) * np.mean(np.abs(of_second) ** 2, axis=0)
        values = np.divide(cross, power, out=np.zeros(len(cross)), where=power > 0.0)
        blocks = len(of_first) / SHARED_BLOCKS
        by_chance = 1.0 - _CHANCE ** (1.0 / (blocks - 1.0)) if blocks > 1.0 else 1.0
        return cls(_frequencies(_spectral_blocks(len(first))[1], rate), values, by_chance)


def _frequencies(block: int, rate: float) -> Floats:
    return np.asarray(np.fft.rfftfreq(block, 1.0 / rate), dtype=float)


def _transformed(values: Floats) -> NDArray[np.complex128]:
    """Fourier transforms (B, F) of the blocks of samples (N,); importing `scipy.signal` takes longer than an answer does."""
    first, block, window = _spectral_blocks(len(values))
    filled = bridged(values)
    frames = (filled - filled.mean())[first[:, None] + np.arange(block)] * window
    return np.fft.rfft(frames, axis=1)


def _spectral_blocks(count: int) -> tuple[Indices, int, Floats]:
    """The first samples (B,) of the blocks of `count` samples, the samples in each, and the window over them."""
    block = min(_LONGEST, 2 ** int(np.log2(max(count // _BLOCKS, 16))), count)
    return np.arange(0, count - block + 1, max(block // 2, 1)), block, np.hanning(block + 2)[1:-1]


_REST_BLOCKS = 40  # in which a record is looked at
_FEWEST_REST_BLOCKS = 6  # blocks of rest
_SHORTEST = 240  # samples of rest
QUIET = 0.2  # of the root mean square of the record
# ratio of the root mean squares of blocks at rest, greatest to least; correlated noise scatters more
_STEADY = 1.8
_ORDER = 8  # of the autoregression that tells resonances
_RESONANT = 0.97  # radius of a pole of it from which on something rings


def rest_period(values: Floats) -> slice | None:
    """The samples at rest of `values` (N,), at the end or else at the start; None where there are none."""
    for at_end in (True, False):
        run = _quiet_blocks(values[::-1] if at_end else values)
        if run:
            piece = slice(len(values) - run, len(values)) if at_end else slice(0, run)
            if not _rings(values[piece]):
                return piece
    return None


def _quiet_blocks(values: Floats) -> int:
    """Number of samples from the first on that are quiet and steady."""
    size = len(values) // _REST_BLOCKS
    if size < 8:
        return 0
    blocks = values[: size * _REST_BLOCKS].reshape(_REST_BLOCKS, size)
    level = blocks.std(axis=1)
    least, greatest = np.minimum.accumulate(level), np.maximum.accumulate(level)
    moves = (greatest > _STEADY * least) | (greatest > QUIET * values.std())
    count = int(np.argmax(moves)) if moves.any() else _REST_BLOCKS
    return count * size if count >= _FEWEST_REST_BLOCKS and count * size >= _SHORTEST else 0


def _rings(values: Floats) -> bool:
    """Whether an autoregression has a pole of a vibration, or there is nothing but rounding."""
    centred = values - values.mean()
    power = float(centred @ centred)
    if not power > 0.0:
        return False
    lags = np.array([centred[: len(centred) - lag] @ centred[lag:] for lag in range(_ORDER + 1)]) / power
    matrix = lags[np.abs(np.subtract.outer(np.arange(_ORDER), np.arange(_ORDER)))]
    weights = np.linalg.solve(matrix + 1e-9 * np.eye(_ORDER), lags[1:])
    poles = np.roots(np.concatenate([[1.0], -weights]))
    return bool(np.any((np.abs(poles) > _RESONANT) & (np.abs(poles.imag) > 1e-6)))


_POWER = 8  # of the test function (1 - u^2)^p, which is zero with its first p - 1 derivatives at both ends


def bumps(width: int, derivatives: int, step: float, late: float = 0.0) -> Floats:
    """The test function and its derivatives at 2 `width` + 1 samples `step` s apart, shape (derivatives + 1, 2 width + 1).

    It is moved by `late` samples, less than one.
    """
    base = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** _POWER
    u = np.clip((np.arange(-width, width + 1) - late) / width, -1.0, 1.0)
    scale = 1.0 / (width * step)
    rows = [base.deriv(order)(u) * scale**order if order else base(u) for order in range(derivatives + 1)]
    return np.array(rows) * step


def projections(values: Floats, tests: Floats, hop: int) -> Floats:
    """Integrals (K, W) of samples (N,) against each of K test functions (K, 2 w + 1), moved by `hop` samples W times."""
    frames = np.lib.stride_tricks.sliding_window_view(values, tests.shape[1])[::hop]
    return np.asarray((frames @ tests.T).T)


_EVEN = 0.02  # of a step: how far the differences of levels are from multiples of it
_ROUNDED = 8.0  # units in the last place by which a level may be off, after conversion of its unit
_LOOKED_AT = 300  # samples whose digits are counted
_PRINTED = 11  # digits from which on decimal rounding is no coarser than any measurement
# of the power of a motion: below the frequency that this share lies under, it is to be resolved
_CARRYING = 0.99
# of the power that noise leaves above a frequency, whose sums over few frequencies are skew
_DEVIATIONS = 5.0
# of a record, each worth one for the variance of its noise, as it is taken from differences
_NOISE_SAMPLES = 8.0


@dataclass(frozen=True, eq=False)
class ChannelSignal:
    """Samples `values` (N,) of a channel in `unit` at `rate` in Hz from `start` in s.

    `sigma` is the standard deviation of its noise, NaN where it cannot be estimated.
    """

    channel: Channel
    values: Floats
    unit: str
    rate: float
    start: float
    sigma: float

    @property
    def is_input(self) -> bool:
        """Whether it drives the structure."""
        return self.channel.is_input

    @cached_property
    def present(self) -> Bools:
        """True where there is a sample, shape (N,)."""
        return ~np.isnan(self.values)

    @cached_property
    def observed(self) -> Floats:
        """The samples that there are."""
        return self.values[self.present]

    @cached_property
    def is_constant(self) -> bool:
        """Whether it has no two different samples."""
        return not self.observed.size or bool(np.all(self.observed == self.observed[0]))

    @cached_property
    def rms(self) -> float:
        """Root mean square deviation from the mean."""
        return 0.0 if self.is_constant else float(np.std(self.observed))

    @cached_property
    def filled(self) -> Floats:
        """Samples (N,) with gaps bridged by lines; zeros for a channel without samples."""
        return bridged(self.values)

    @cached_property
    def levels(self) -> Floats:
        """The different values, in rising order."""
        return np.unique(self.observed)

    @cached_property
    def step(self) -> float:
        """Quantisation step in the unit of the channel; 0 where there is none or it is as small as rounding."""
        levels = self.levels
        if len(levels) < 3:
            return 0.0
        gaps = np.diff(levels)
        rounding = _ROUNDED * float(np.spacing(np.abs(self.observed).max()))
        step = float(gaps[gaps > rounding].min(initial=np.inf))
        if not rounding < _EVEN * step < np.inf:
            return 0.0
        multiples = gaps / step
        return step if np.mean(np.abs(multiples - np.rint(multiples)) < _EVEN) > _CARRYING else 0.0

    @cached_property
    def digits(self) -> int:
        """Significant decimal digits of the samples; 17 where they are as many as a number holds."""
        looked_at = self.observed[:: max(1, len(self.observed) // _LOOKED_AT)]
        looked_at = looked_at[looked_at != 0.0]
        roundings = _ROUNDED * np.spacing(np.abs(looked_at))
        for digits in range(1, _PRINTED):
            pairs = zip(looked_at.tolist(), roundings.tolist(), strict=True)
            if all(abs(float(f"{value:.{digits - 1}e}") - value) <= least for value, least in pairs):
                return digits
        return 17

    @cached_property
    def grain(self) -> Floats:
        """Distance (N,) between a sample and the next value that could have been recorded."""
        size = np.maximum(np.abs(self.filled), np.finfo(float).tiny)
        decimal = 10.0 ** (np.floor(np.log10(size)) + 1 - self.digits)
        return np.asarray(np.maximum(np.maximum(self.step, decimal), np.spacing(size)))

    @cached_property
    def spectrogram(self) -> Spectrogram:
        """Power over time and frequency."""
        return Spectrogram.of(self.filled, self.rate)

    @cached_property
    def highest(self) -> float:
        """Frequency in Hz below which lie 99 % of the power beyond the noise, as far as the noise lets it be seen; 0 where
        no power is beyond the noise.
        """
        spectrum = self.spectrogram
        noise = 0.0 if np.isnan(self.sigma) else 2.0 * self.sigma**2 / self.rate
        above = np.cumsum((spectrum.mean[1:-1] - noise)[::-1])[::-1]
        count = np.arange(len(above), 0, -1)
        of_blocks = np.sqrt(SHARED_BLOCKS / len(spectrum.time) / count)
        by_noise = _DEVIATIONS * noise * count * np.hypot(of_blocks, self.noise_power_error)
        resolved = above > (1.0 - _CARRYING) * above.max(initial=0.0) + by_noise
        return float(spectrum.frequency[1:-1][resolved].max(initial=0.0))

    @property
    def noise_power_error(self) -> float:
        """Relative standard error of the power of the noise."""
        return float(np.sqrt(_NOISE_SAMPLES / max(len(self.observed), 1)))

    @cached_property
    def rest(self) -> slice | None:
        """Samples at the end, or else at the start, in which nothing moves; None where there is motion throughout."""
        return None if self.is_constant else rest_period(self.filled)


_PERIODS = 1.0  # of the fastest motion that half a test function spans
_FEWEST = 24  # test functions side by side
_JACKKNIFE_BLOCKS = 12  # of the record that are left out in turn, for standard errors
# condition of normal equations without a block, from which on the motion of one block decides
_SINGULAR = 1e10
_STEPS = 8  # until what is left of the delay is small
_SMALL = 0.02  # samples
_FAR = 0.1  # of the fastest period: a delay beyond it is searched from several starts


@dataclass(frozen=True)
class KinematicFit:
    """How the channel `upper` follows from `lower`: each parameter with its standard error.

    `delay` is in s, positive where `upper` comes late; `offset` in the unit of `upper`, `trend` in that per s, both at the
    middle of the record; `share` is the part of the power of `upper` that this explains.
    """

    lower: ChannelSignal
    upper: ChannelSignal
    gain: tuple[float, float]
    delay: tuple[float, float]
    offset: tuple[float, float]
    trend: tuple[float, float]
    share: float


def _kinematic_fit(lower: ChannelSignal, upper: ChannelSignal) -> KinematicFit | None:
    """The fit of two channels; None where the record is too short or has too few complete pieces.

    A delay as long as a part of the fastest period has several valleys, of which the one that explains most is taken. Where
    none settles, the fit about no delay stands.
    """
    width = _test_width(lower, upper)
    first = _fit_about(lower, upper, 0.0)
    if first is None:
        return None
    far = abs(first.delay[0]) * upper.rate > _FAR * width
    starts = np.arange(-1.0, 1.25, 0.25) * width if far else (0.0,)
    settled = (_fit_at_own_delay(lower, upper, float(start)) for start in starts)
    return max(filter(None, settled), key=lambda fit: fit.share, default=first)


def _fit_at_own_delay(lower: ChannelSignal, upper: ChannelSignal, late: float) -> KinematicFit | None:
    """The fit about its own delay, which enters to first order, searched from `late` samples; None if there is none."""
    for _ in range(_STEPS):
        fit = _fit_about(lower, upper, late)
        if fit is None:
            return None
        rest = fit.delay[0] * upper.rate
        late += rest
        if abs(rest) < _SMALL:
            return replace(fit, delay=(late / upper.rate, fit.delay[1]))
        if not abs(late) < len(upper.values) // 4:
            return None
    return None


def _test_width(lower: ChannelSignal, upper: ChannelSignal) -> int:
    """Samples that half a test function spans; 0 where nothing moves."""
    highest = max(lower.highest, min(upper.highest, 0.1 * upper.rate))
    return max(8, round(_PERIODS * lower.rate / highest)) if highest > 0.0 else 0


def _fit_about(lower: ChannelSignal, upper: ChannelSignal, late: float) -> KinematicFit | None:
    """The fit of two channels, of which `upper` comes `late` by so many samples and by the delay of the fit."""
    shift = round(late)
    order = upper.channel.order - lower.channel.order
    width = _test_width(lower, upper)
    count = len(lower.values) - abs(shift)
    if not width or count < width * _FEWEST:
        return None
    of_lower, of_upper = (slice(start, start + count) for start in (max(-shift, 0), max(shift, 0)))
    tests = bumps(width, order + 1, 1.0 / lower.rate)
    hop = max(width // 4, 1)
    reached = (np.isnan(lower.values[of_lower]) | np.isnan(upper.values[of_upper])).astype(float)
    complete = projections(reached, np.ones((1, tests.shape[1])), hop)[0] == 0.0
    sign = (-1.0) ** order
    x = projections(lower.filled[of_lower], tests, hop)
    half = 0.5 * (count - 1) / lower.rate
    time = np.linspace(-half, half, count)
    lines = [projections(line, tests[:1], hop)[0] for line in (np.ones(count), time)]
    columns = np.column_stack([sign * x[order], sign * x[order + 1], *lines])[complete]
    moved = bumps(width, 0, 1.0 / lower.rate, late - shift)
    target = projections(upper.filled[of_upper], moved, hop)[0][complete]
    if len(target) < 4 * _FEWEST or not target.any():
        return None
    noise = np.array([lower.sigma**2 * float(row @ row) for row in tests[order : order + 2]])
    return _jackknifed_fit(lower, upper, columns, target, noise)


def _jackknifed_fit(
    lower: ChannelSignal, upper: ChannelSignal, columns: Floats, target: Floats, noise: Floats
) -> KinematicFit | None:
    """Least squares without the bias of the `noise` (2,) in the first two columns, with errors by a jackknife over blocks."""
    blocks = np.array_split(np.arange(len(target)), _JACKKNIFE_BLOCKS)
    grams = np.array([columns[rows].T @ columns[rows] for rows in blocks])
    right = np.array([columns[rows].T @ target[rows] for rows in blocks])
    for gram, rows in zip(grams, blocks, strict=True):
        gram[[0, 1], [0, 1]] -= len(rows) * np.nan_to_num(noise)
    total, of_right = grams.sum(axis=0), right.sum(axis=0)
    scale = 1.0 / np.sqrt(np.abs(np.diagonal(total)))
    if not np.all(np.isfinite(scale)) or total[0, 0] <= 0.5 * float(columns[:, 0] @ columns[:, 0]):
        return None

    left_out = total - grams  # one block each
    if np.linalg.cond(left_out * np.outer(scale, scale)).max() > _SINGULAR:
        return None

    def solve(gram: Floats, side: Floats) -> Floats:
        solution = scale * np.linalg.solve(gram * np.outer(scale, scale), side * scale)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a gain of 0
            return np.array([solution[0], solution[1] / solution[0], solution[2], solution[3]])

    whole = solve(total, of_right)
    without = np.array([solve(g, of_right - r) for g, r in zip(left_out, right, strict=True)])
    if not np.isfinite(whole).all() or not np.isfinite(without).all():
        return None
    spread = np.sqrt((_JACKKNIFE_BLOCKS - 1) * np.var(without, axis=0))
    left = target - columns @ np.array([whole[0], whole[0] * whole[1], whole[2], whole[3]])
    share = 1.0 - float(left @ left) / float(target @ target)
    gain, delay, offset, trend = zip(whole.tolist(), spread.tolist(), strict=True)
    return KinematicFit(lower, upper, gain, delay, offset, trend, share)


@dataclass(frozen=True, eq=False)
class RecordSignals:
    """The `channels` of a `record`."""

    record: Record
    channels: tuple[ChannelSignal, ...]

    @classmethod
    def of(cls, record: Record) -> RecordSignals:
        """Those of a record; noise is what the record states, else estimated."""
        every = zip(record.channels, record.values.T, noise_sigma(record.values), strict=True)
        signals = []
        for channel, values, estimated in every:
            sigma, unit = float(record.noise.get(channel, estimated)), record.unit(channel)
            signals.append(ChannelSignal(channel, values, unit, record.rate, record.start, sigma))
        return cls(record, tuple(signals))

    @property
    def moving(self) -> tuple[ChannelSignal, ...]:
        """Channels that are not constant."""
        return tuple(signal for signal in self.channels if not signal.is_constant)

    @property
    def responses(self) -> tuple[ChannelSignal, ...]:
        """Channels of masses that are not constant."""
        return tuple(signal for signal in self.moving if not signal.is_input)

    def rest_of(self, signal: ChannelSignal) -> slice | None:
        """The samples at an end in which a channel rests and nothing drives the structure; None where there are none."""
        if signal.rest is None:
            return None
        inputs = [drive for drive in self.moving if drive.is_input]
        driven = any(float(np.std(drive.filled[signal.rest])) > QUIET * drive.rms for drive in inputs)
        return None if driven else signal.rest

    @cached_property
    def kinematics(self) -> tuple[KinematicFit, ...]:
        """How channels of one place follow from each other: neighbours in displacement, velocity and acceleration."""
        places: dict[tuple[str, bool], list[ChannelSignal]] = {}
        for signal in self.moving:
            if signal.channel.is_motion:
                places.setdefault((signal.channel.place, signal.channel.relative), []).append(signal)
        ordered = (sorted(beside, key=lambda signal: signal.channel.order) for beside in places.values())
        fits = (_kinematic_fit(*pair) for beside in ordered for pair in pairwise(beside))
        return tuple(fit for fit in fits if fit is not None)
