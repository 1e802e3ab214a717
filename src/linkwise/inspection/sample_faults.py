"""Checks of single samples: dead and equal channels, quantisation, clipping, dropped and doubled samples, spikes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools, Floats, Indices, stretches
from linkwise.inspection.channel_signal import ChannelSignal, RecordSignals
from linkwise.inspection.result import Alert
from linkwise.records.timeline import sampled_every
from linkwise.signals.states import smoothing_spline

_MOTION = 0.2  # of the power of its noise: a channel with more moves, however short it is
_DEVIATIONS = 5.0  # of the power of the noise of a long channel


def dead(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that hold nothing, and of inputs without samples."""
    for signal in signals.channels:
        if not signal.observed.size:
            yield Alert("dead", signal.channel, "every sample is missing; leave the channel out", np.inf)
        elif signal.is_constant and not signal.is_input:
            message = (
                f"every sample is {signal.observed[0]:g}: it shows no motion, and a fit to it is wrong throughout; "
                "leave the channel out, and check sensor and cable"
            )
            yield Alert("dead", signal.channel, message, np.inf)
        elif not signal.is_input and _is_noise(signal):
            message = (
                f"holds nothing but noise of {signal.sigma:.3g} {signal.unit}: nothing of the motion is in it; check "
                "sensor, cable and range, excite more strongly, or leave the channel out"
            )
            yield Alert("dead", signal.channel, message, np.inf)


def _is_noise(signal: ChannelSignal) -> bool:
    """Whether it has no more power than its noise, neither in all nor at some frequency."""
    motion = min(_MOTION, _DEVIATIONS * signal.noise_power_error)
    return signal.rms**2 < (1.0 + motion) * signal.sigma**2 and signal.highest == 0.0


def equal(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that are copies of another channel."""
    known: dict[bytes, tuple[str, bool]] = {}
    for signal in signals.moving:
        peak = signal.observed[np.argmax(np.abs(signal.observed))]
        # single precision: copies in different units compare equal
        shape = (signal.values / peak).astype(np.float32)
        first, mirrored = known.setdefault(shape.tobytes(), (signal.channel, bool(peak < 0.0)))
        if first == signal.channel or signal.is_input:
            continue
        how = "the samples of" if mirrored == (peak < 0.0) else "the samples, with the opposite sign, of"
        message = (
            f"holds {how} {first}: one measurement counts twice, and one mass gets the motion of another; find out which of "
            "the two is mislabelled and leave it out"
        )
        yield Alert("equal", signal.channel, message, np.inf)


_WHITE = 0.58  # of a step: noise, rounding included, below which rounding is not white; noise of half a step whitens it
_FINE_STEP = 1e-3  # of the root mean square: finer steps are as good as none


def quantised(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels whose steps are not hidden by noise."""
    for signal in signals.moving:
        if signal.step <= _FINE_STEP * signal.rms or not signal.sigma < _WHITE * signal.step:
            continue
        unit, rounding = signal.unit, signal.step / 12.0**0.5
        steps = (signal.observed.max() - signal.observed.min()) / signal.step
        message = (
            f"comes in steps of {signal.step:.3g} {unit}, {steps:.0f} over its range, and its noise is smaller: rounding then "
            "follows the motion, and intervals are too narrow; use a smaller range of the converter, or state a noise of "
            f"{rounding:.2g} {unit}"
        )
        yield Alert("quantised", signal.channel, message, rounding / signal.rms, arguments=("noise",))


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
        ends = {value: int(np.sum(signal.observed == value)) for value, _ in rails(signal)}
        if not ends:
            continue
        total = sum(ends.values())
        where = " and ".join(f"{count} at {value:.4g} {signal.unit}" for value, count in ends.items())
        message = (
            f"{total} samples are at the end of the range ({where}): the sensor or the amplifier was overloaded, and "
            "stiffness and damping at large motion come out wrong; mark these samples as missing (mark_missing), or measure "
            "with a larger range"
        )
        error = float(total / len(signal.observed)) ** 0.5
        yield Alert("clipped", signal.channel, message, error, arguments=("mark_missing",))


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
    runs = stretches(marked)
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
    ends = zip(signal.levels[[0, -1]].tolist(), (-1.0, 1.0), strict=True)
    clipped = tuple((value, side) for value, side in ends if _cuts_off(signal, value))
    at_ends = np.isin(signal.observed, [value for value, _ in clipped])
    return clipped if np.mean(at_ends) <= _FLAT else ()


def _cuts_off(signal: ChannelSignal, value: float) -> bool:
    """Whether an end of the range cuts a motion off."""
    filled = signal.filled
    at = (filled == value) & signal.present
    count = int(at.sum())
    if count < _FEWEST or len(signal.levels) < 8 or not np.any(at[1:] & at[:-1]):
        return False
    if np.median(np.abs(filled - value)) <= 0.02 * (signal.levels[-1] - signal.levels[0]):
        return False  # a signal that starts from or decays to this level
    grain = float(signal.grain[np.argmax(at)])
    near = (np.abs(filled - value) < 1.5 * grain) & ~at
    if grain > _FINE * (signal.levels[-1] - signal.levels[0]) and count < _CROWDED * max(int(near.sum()), 1):
        return False
    entered = np.flatnonzero(at[1:] & ~at[:-1])  # the last sample before each plateau
    before = entered[entered > 0]
    if not before.size:
        return False
    # a motion that comes to rest slows down before, one that is cut off does not
    slope = np.median(np.abs(filled[before] - filled[before - 1]))
    return bool(slope > 2.0 * grain)


_NEIGHBOURS = np.array([1.0, -6.0, 15.0, 0.0, 15.0, -6.0, 1.0]) / 20.0  # the quintic through six of them
_HALF_WINDOW = 3
_NOISE = float(np.sqrt(1.0 + _NEIGHBOURS @ _NEIGHBOURS))  # deviation of a sample of unit noise from it
_MEDIAN = 0.6745  # of a normal deviation's size
_BLOCK = 32  # samples whose median deviation is the usual one
_FAR = 8.0  # usual deviations where they are noise: of 1e12 normal samples one
_FARTHER = 16.0  # where they are motion, whose deviations come and go
_SCATTER = 0.75  # of the noise, by which usual deviations that are noise alone may seem to be motion
_SHARP = 0.3  # of the root mean square of an acceleration, which a force that changes sign can turn within a sample
# of the deviation that neighbours may have once the sample is mended: a jump or a kink leaves more
_LEFT = 0.35

_JUMP_REACH = 6  # samples on either side of an outlier by which a jump is told from a spike
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
            f"{size[largest]:.3g} {signal.unit} at {when:.6g} s: least squares follows such samples, and noise and "
            "intervals come out too wide; mark them as missing (mark_missing), or use a robust loss"
        )
        error = float(np.sqrt(np.sum(size**2) / len(signal.values))) / signal.rms
        yield Alert("spikes", signal.channel, message, error, arguments=("mark_missing", "loss"))


def _deviations(values: Floats) -> Floats:
    """How far each sample (N,) is from what its neighbours say; 0 at both ends."""
    deviations, inner = np.zeros(len(values)), slice(_HALF_WINDOW, -_HALF_WINDOW)
    deviations[inner] = values[inner] - np.convolve(values, _NEIGHBOURS, "valid")
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
    """The first samples behind jumps of a displacement, from which on it goes on elsewhere as smoothly as before.

    Not where it comes to an end of its range, or from there.
    """
    rows = _outliers(signal)
    if signal.channel.kind != "x":
        return rows[:0]
    clipped = np.flatnonzero(np.isin(signal.filled, [value for value, _ in rails(signal)]))
    apart = np.abs(rows[:, None] - clipped).min(axis=1, initial=len(signal.filled)) > _JUMP_REACH
    behind = [_jump_at(signal.filled, int(row)) for row in rows[apart]]
    rows = np.unique([row for row in behind if row is not None]).astype(int)
    return rows[np.diff(rows, prepend=-_JUMP_REACH) > 2]


def _spikes(signal: ChannelSignal) -> Indices:
    """The outliers that stand alone, not those at which the motion jumps or turns, as by dry friction or a stop."""
    values, rows = signal.filled, _outliers(signal)
    if not len(rows):  # of a record shorter than the neighbours of a sample, too
        return rows
    size = np.abs(_deviations(values))
    smooth = [row for row in rows.tolist() if _left_by_neighbours(values, row) < _ROUGH * size[row] ** 2]
    return np.array([row for row in smooth if _jump_at(values, row) is None], dtype=int)


def _left_by_neighbours(values: Floats, row: int) -> float:
    """Sum of squares that a quartic leaves of the neighbours of an outlier, without it."""
    near = np.arange(max(row - _JUMP_REACH, 0), min(row + _JUMP_REACH + 1, len(values)))
    near = near[near != row]
    return _left((near - row) / _JUMP_REACH, values[near], 4)


def _jump_at(values: Floats, row: int) -> int | None:
    """The first sample behind a jump at an outlier; None where the neighbours of the outlier go on without it."""
    first, last = max(row - _JUMP_REACH, 0), min(row + _JUMP_REACH + 1, len(values))
    if last - first < 2 * _JUMP_REACH + 1:
        return None
    time, piece = np.arange(-_JUMP_REACH, _JUMP_REACH + 1) / _JUMP_REACH, values[first:last]
    splits = range(_JUMP_REACH - 1, _JUMP_REACH + 3)
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
    near_gap = np.convolve(~signal.present, np.ones(2 * _HALF_WINDOW + 1), "same") > 0.5
    deviations[near_gap] = 0.0
    size = np.abs(deviations)
    blocks = np.median(size[: len(size) // _BLOCK * _BLOCK].reshape(-1, _BLOCK), axis=1) / _MEDIAN
    widest = np.lib.stride_tricks.sliding_window_view(np.pad(blocks, 1, "edge"), 3).max(axis=1)
    usual = widest[np.minimum(np.arange(len(size)) // _BLOCK, len(blocks) - 1)]
    noise = np.maximum(_NOISE * np.nan_to_num(signal.sigma), signal.grain)
    limit = np.maximum(_FAR * np.maximum(usual, noise), _FARTHER * (usual - _SCATTER * noise))
    if signal.channel.kind == "a":
        limit = np.maximum(limit, _SHARP * signal.rms)
    candidates = np.flatnonzero(size > limit)
    return np.array([row for row in candidates if _stands_alone(values, deviations, int(row))], dtype=int)


def _stands_alone(values: Floats, deviations: Floats, row: int) -> bool:
    """Whether nothing is odd around a sample once it is replaced by what its neighbours say."""
    first, last = max(row - 2 * _HALF_WINDOW, 0), min(row + 2 * _HALF_WINDOW + 1, len(values))
    mended = values[first:last].copy()
    mended[row - first] -= deviations[row]
    if len(mended) <= 2 * _HALF_WINDOW + 1:
        return False
    return bool(np.max(np.abs(_deviations(mended))) < _LEFT * abs(deviations[row]))


_EXPECTED = 4.0  # times as many repeats as rounding gives
_FEWEST_REPEATS = 8  # repeats beyond which that is compared
_NEVER = 1e-4  # repeats expected by rounding: below it a single one is no chance
_SMALL = 0.02  # of the differences between neighbours: the smallest, by which their density at 0 is estimated
_BY_CHANCE = 8  # differences within half as much again as the smallest, of which samples without a step have one or two
_ROW = 3  # repeats in a row, which noise does not give
_FINER = 3.0  # times the grain of the samples: noise that no two samples hide
_NOISY = 1e-6  # of the root mean square: less is rounding
_HALF = 10  # samples on either side that show whether the channel moves


def doubled(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses with samples that were written twice, or held."""
    for signal in signals.responses:
        steps = np.abs(np.diff(signal.filled))
        known = signal.present[1:] & signal.present[:-1]
        repeats = (steps == 0.0) & known & (_moves_around(steps) | _in_rows_of_repeats(steps, signal))
        ends = (signal.filled[1:] == signal.levels[0]) | (signal.filled[1:] == signal.levels[-1])
        count = int((repeats & ~ends).sum())
        if not count:
            continue
        natural = _repeats_by_rounding(steps[known], signal.grain[1:][known])
        if natural > _NEVER and count <= _FEWEST_REPEATS + _EXPECTED * natural:
            continue
        first = signal.start + int(np.argmax(repeats & ~ends)) / signal.rate
        held_share = count / max(int(known.sum()), 1)
        finding = f"{count} sample{'s repeat' if count > 1 else ' repeats'} the one before, the first at {first:g} s"
        if held_share > 0.3:
            finding = f"about every sample is held for {1.0 / (1.0 - held_share):.2g} samples"
        message = (
            f"{finding}: if the logger wrote samples twice, everything after them comes late, and stiffness and damping are "
            "wrong by many standard errors; cut the record to a piece without them, or mark them as missing"
        )
        size = float(held_share**0.5)
        yield Alert("doubled", signal.channel, message, size, arguments=("earliest", "latest"))


def _repeats_by_rounding(steps: Floats, grain: Floats) -> float:
    """Number of repeats that rounding explains, for differences `steps` of samples with a `grain`.

    Where many differences are about as small as the smallest, samples have a step of that size, whatever their digits: no
    change is then half as frequent as one up or down.
    """
    width = max(float(np.quantile(steps, _SMALL)), 10.0 * float(np.median(grain)))
    smallest = int(np.sum((steps > 0.0) & (steps < 1.5 * steps[steps > 0.0].min(initial=np.inf))))
    by_step = 0.5 * smallest if smallest > _BY_CHANCE else 0.0
    return max(by_step, float(np.sum(grain[(steps > 0.0) & (steps < width)]) / width))


def _in_rows_of_repeats(steps: Floats, signal: ChannelSignal) -> Bools:
    """Whether each step is in a longer row of repeats, which begins and ends in motion, of a channel with noise.

    Noise shows in every sample, also of what rests; only a channel without noise, or rounded more coarsely, can repeat samples
    for as long as it rests.
    """
    grain = max(float(np.median(signal.grain)), signal.step)
    noisy = np.nan_to_num(signal.sigma) > max(_FINER * grain, _NOISY * signal.rms)
    moving = np.flatnonzero(steps > 0.0)
    if not (noisy and len(moving)):
        return np.zeros(len(steps), dtype=bool)
    after = np.searchsorted(moving, np.arange(len(steps)))
    inside = (after > 0) & (after < len(moving))
    length = moving[np.minimum(after, len(moving) - 1)] - moving[np.maximum(after - 1, 0)] - 1
    return np.asarray(inside & (length >= _ROW))


def _moves_around(steps: Floats) -> Bools:
    """Whether the channel moves on either side of each step, so that a repeat is no rest."""
    moving = np.concatenate([[0], np.cumsum(steps > 0.0)])
    index = np.arange(len(steps))
    after = moving[np.minimum(index + 1 + _HALF, len(steps))] - moving[index + 1]
    before = moving[index] - moving[np.maximum(index - _HALF, 0)]
    return np.asarray((after >= _HALF // 3) & (before >= _HALF // 3))


BUFFER = 32
"""Samples: what is written twice is as long at least."""
_CHANGING = 24  # of them, that differ from the one before: with noise of three steps chance repeats none in 1e20 stretches
_SEED = 20261130  # of the weights by which stretches are compared


def may_be_copied(values: Floats) -> bool:
    """Whether so many samples (N,) are there twice that a buffer of them may be: each of a copy was there before."""
    known = values[np.isfinite(values)]
    return len(np.unique(known)) <= len(values) - BUFFER


def copies(signal: ChannelSignal) -> list[tuple[int, slice]]:
    """The stretches of samples that were there before, bit for bit, each with the first sample of the one before.

    None of a channel whose noise is as small as its steps: that repeats wherever the motion does.
    """
    if len(signal.values) < 2 * BUFFER or not may_be_copied(signal.values):
        return []
    grain = max(float(np.median(signal.grain)), signal.step) if signal.observed.size else 0.0
    if not np.nan_to_num(signal.sigma) > max(_FINER * grain, _NOISY * signal.rms):
        return []
    weights = np.random.default_rng(_SEED).integers(1, 2**63, BUFFER, dtype=np.uint64)
    _, values = np.unique(signal.filled, return_inverse=True)  # bits of few digits would cancel in the sums
    windows = np.lib.stride_tricks.sliding_window_view(values.astype(np.uint64), BUFFER)
    _, first, which = np.unique(windows @ weights, return_index=True, return_inverse=True)
    before = first[which]
    changing = np.convolve(np.diff(signal.filled) != 0.0, np.ones(BUFFER - 1), "valid")
    again = (before < np.arange(len(before))) & (changing >= _CHANGING)
    return [(int(before[run.start]), slice(run.start, run.stop + BUFFER - 1)) for run in stretches(again)]


def copied(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses with samples that were there before, as of a buffer that was written twice."""
    for signal in signals.responses:
        repeated = copies(signal)
        if not repeated:
            continue
        count = sum(copy.stop - copy.start for _, copy in repeated)
        first, copy = repeated[0]
        then, now = (signal.start + sample / signal.rate for sample in (first, copy.start))
        message = (
            f"{count} samples from {now:g} s on are those from {then:g} s on, bit for bit: a buffer was written twice, so "
            "that one measurement counts as two and the motion begins anew there; cut the record to a piece without them"
        )
        size = float((count / len(signal.values)) ** 0.5)
        yield Alert("doubled", signal.channel, message, size, arguments=("earliest", "latest"))


_NAMED = 3  # jumps whose times are told


def dropped(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels that lack samples."""
    for signal in signals.channels:
        missing = ~signal.present
        if not missing.any() or not signal.observed.size:
            continue
        lacking = stretches(missing)
        lengths = [gap.stop - gap.start for gap in lacking]
        longest = max(lengths)
        start = lacking[lengths.index(longest)].start
        gaps = "one gap" if len(lengths) == 1 else f"{len(lengths)} gaps"
        every = sampled_every(signal.present)
        if every > 1 and int(np.median(lengths)) == every - 1:
            message = (
                f"has a sample in one of {every} rows, so that its rate is {signal.rate / every:g} Hz: maximum likelihood and "
                "discovery take it as it is; the weak form alone and differentiation need samples that all channels have"
            )
            yield Alert("dropped", signal.channel, message, float(missing.mean()))
            continue
        message = (
            f"{missing.sum()} of {len(missing)} samples are missing in {gaps}, the longest of {longest} samples at "
            f"{signal.start + start / signal.rate:g} s: "
        )
        message += (
            "an input must be complete, so identification needs a piece without gaps: cut to one"
            if signal.is_input
            else "maximum likelihood and the weak form leave them out, which costs accuracy only; differentiation needs a "
            "piece without gaps: cut to one"
        )
        share, arguments = float(missing.mean()), ("earliest", "latest")
        yield Alert("dropped", signal.channel, message, share, arguments=arguments, is_of_gaps=True)


def lost(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of displacements that jump, as where a logger lost samples without a gap in the times."""
    for signal in signals.responses:
        rows = jumps(signal)
        if not len(rows):
            continue
        when = ", ".join(f"{signal.start + row / signal.rate:.6g}" for row in rows[:_NAMED])
        times = f"{when} s" if len(rows) <= _NAMED else f"{when} s and {len(rows) - _NAMED} other times"
        message = (
            f"jumps between two samples at {times}, and moves on smoothly from there: if the logger lost samples, "
            "everything after them comes early, and stiffness and damping are wrong by many standard errors; cut the record "
            "to a piece without a jump, or put the lost times back"
        )
        size = float(np.sqrt(np.sum(np.diff(signal.filled)[rows - 1] ** 2) / len(signal.values))) / signal.rms
        yield Alert("dropped", signal.channel, message, size**0.5, arguments=("earliest", "latest"))
