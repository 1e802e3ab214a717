"""Checks between channels of one place, delay, gain, offset and drift, of what sensors say while nothing moves, and of forces
with the masses that they drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isclose

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.channel_signal import ChannelSignal, KinematicFit, RecordSignals
from linkwise.inspection.result import Alert
from linkwise.records.record import Record

_CERTAIN = 7.0  # standard errors from a jackknife over twelve blocks, whose quantiles are wide
_EXPLAINED = 0.5  # of the power: with less the channels have no common motion to compare
_DELAY = 0.1  # samples
_GAIN = 0.01
_LEVEL = 0.003  # of the root mean square: offset
_TREND = 0.03  # of the root mean square, over the record
_FACTORS = {
    1e3: "1000, as between m and mm",
    1e-3: "1/1000, as between mm and m",
    9.80665: "9.81, as between g and m/s^2",
    1.0 / 9.80665: "1/9.81, as between m/s^2 and g",
    39.3701: "39.4, as between m and in",
    0.0254: "0.0254, as between in and m",
    -1.0: "-1: one of them counts in the opposite direction",
}
_NEAR = 0.05  # of a factor


def delay(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels of one place that are not synchronous."""
    for fit in _fits_to_compare(signals):
        value, error = fit.delay
        samples = value * fit.upper.rate
        if abs(samples) < _DELAY or abs(value) < _CERTAIN * error:
            continue
        late, early = (fit.upper, fit.lower) if value > 0.0 else (fit.lower, fit.upper)
        message = (
            f"comes {1e3 * abs(value):.3g} ms ({abs(samples):.2g} samples) +- {1e3 * error:.1g} ms later than {early.channel} "
            "says: a delay turns stiffness into damping, by many standard errors; give both the same filter, shift "
            "the channel by that time, or estimate the delay with the laws"
        )
        share = min(1.0, 2.0 * 3.14 * late.highest * abs(value))
        yield Alert("delay", late.channel, message, share, arguments=("delays",))


def gain(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels of one place that disagree on the size of the motion."""
    named: list[KinematicFit] = []
    for fit in _fits_to_compare(signals):
        value, error = fit.gain
        right = abs(value - 1.0) < max(_GAIN, _CERTAIN * error)
        if right or any(_accounts_for(earlier, fit) for earlier in named):
            continue
        named.append(fit)
        lower, upper = fit.lower.channel, fit.upper.channel
        factors = (text for factor, text in _FACTORS.items() if isclose(value, factor, rel_tol=_NEAR))
        known = next(factors, None)
        if known is not None or not 0.3 < value < 3.0:
            message = (
                f"is {value:.4g} times what {lower} says, a factor of {known or 'no plausible calibration'}: the unit or the "
                "sign of one of the two is wrong, and so are all coefficients; state the unit in the name of the column"
            )
            yield Alert("unit", upper, message, 1e6, arguments=("channels",))
        else:
            message = (
                f"is {value:.4g} +- {error:.1g} times what {lower} says: a wrong gain of 1 % puts coefficients tens of "
                "standard errors off; calibrate, or estimate the gain with the laws"
            )
            yield Alert("gain", upper, message, abs(value - 1.0), arguments=("gains",))


def offset(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of velocities and accelerations with a constant error, by the displacement or velocity beside them."""
    for fit in _fits_to_compare(signals):
        value, error = fit.offset
        if abs(value) < max(_LEVEL * fit.upper.rms, _CERTAIN * error):
            continue
        unit = fit.upper.unit
        message = (
            f"has an offset of {value:.3g} +- {error:.1g} {unit}, while {fit.lower.channel} has no drift: it acts "
            "like a constant force, and shifts wells and quadratic terms; subtract it, or estimate it with the laws"
        )
        yield Alert("offset", fit.upper.channel, message, abs(value) / fit.upper.rms, arguments=("offsets",))


def drift(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of velocities and accelerations with a slow change, by the displacement or velocity beside them."""
    for fit in _fits_to_compare(signals):
        value, error = fit.trend
        over = value * signals.record.duration
        if abs(over) < _TREND * fit.upper.rms or abs(value) < _CERTAIN * error:
            continue
        message = (
            f"drifts by {over:.3g} {fit.upper.unit} over the record, as {fit.lower.channel} shows: a drift acts like a "
            "slow force, and biases stiffness; let the sensor warm up, subtract the trend, or use shorter pieces"
        )
        size = 0.3 * abs(over) / fit.upper.rms
        yield Alert("drift", fit.upper.channel, message, size, arguments=("earliest", "latest"))


def _accounts_for(earlier: KinematicFit, fit: KinematicFit) -> bool:
    """Whether the channel between two others is off alone: what is above it agrees with what is below it."""
    (first, first_error), (second, second_error) = earlier.gain, fit.gain
    error = abs(first * second) * float(np.hypot(first_error / first, second_error / second))
    return earlier.upper is fit.lower and abs(first * second - 1.0) < max(_GAIN, _CERTAIN * error)


def _fits_to_compare(signals: RecordSignals) -> list[KinematicFit]:
    return [fit for fit in signals.kinematics if fit.share > _EXPLAINED]


_REST_CERTAIN = 8.0  # standard errors, by blocks of the rest
_BLOCKS = 12
_REST_LEVEL = 0.005  # of the root mean square
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
        still = signal.filled[rest]
        # of blocks, so that noise need not be white
        value, error = float(still.mean()), float(_block_means(still).std(ddof=1) / _BLOCKS**0.5)
        if abs(value) < max(_REST_LEVEL * signal.rms, _REST_CERTAIN * error):
            continue
        message = (
            f"is {value:.3g} +- {error:.1g} {signal.unit} while nothing moves, {_time_of_rest(signal, rest)}: it acts like "
            "a constant force, and shifts wells and quadratic terms; subtract it, or estimate it with the laws"
        )
        yield Alert("offset", signal.channel, message, abs(value) / signal.rms, arguments=("offsets",))


def drift_at_rest(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that change steadily while nothing moves."""
    for signal in signals.responses:
        rest = signals.rest_of(signal)
        if rest is None or rest.stop - rest.start < _LONG * len(signal.values):
            continue
        piece = signal.filled[rest]
        slope, error = _slope_at_rest(piece)
        halves = [_slope_at_rest(half) for half in np.array_split(piece, 2)]
        apart = abs(halves[0][0] - halves[1][0])
        allowed = _SLOPES_AGREE * np.hypot(halves[0][1], halves[1][1])
        over = slope * len(signal.values)
        if not _is_straight(piece, slope):
            continue
        if abs(slope) < _REST_CERTAIN * error or abs(over) < _CHANGE * signal.rms or apart > allowed:
            continue
        message = (
            f"drifts by {slope * signal.rate:.3g} {signal.unit}/s while nothing moves, {_time_of_rest(signal, rest)}: by "
            f"{over:.3g} {signal.unit} over the record: it acts like a slow force, and biases stiffness; let the "
            "sensor warm up, subtract the trend, or use shorter pieces"
        )
        size = 0.3 * abs(over) / signal.rms
        yield Alert("drift", signal.channel, message, size, arguments=("drifts", "earliest", "latest"))


def _time_of_rest(signal: ChannelSignal, rest: slice) -> str:
    ends = [signal.start + sample / signal.rate for sample in (rest.start, rest.stop - 1)]
    return f"from {ends[0]:.4g} to {ends[1]:.4g} s"


def _block_means(values: Floats) -> Floats:
    return np.array([block.mean() for block in np.array_split(values, _BLOCKS)])


def _slope_at_rest(values: Floats) -> tuple[float, float]:
    """Slope per sample and its standard error, from block means about the line."""
    middles, means = _block_means(np.arange(len(values), dtype=float)), _block_means(values)
    centred = middles - middles.mean()
    slope = float(centred @ means / (centred @ centred))
    left = means - means.mean() - slope * centred
    return slope, float(np.sqrt(left @ left / (_BLOCKS - 2) / (centred @ centred)))


def _is_straight(values: Floats, slope: float) -> bool:
    """Whether block means scatter about the line as noise of the samples does."""
    left = values - values.mean() - slope * (np.arange(len(values)) - 0.5 * (len(values) - 1))
    return bool(_block_means(left).std() < _SCATTER * left.std() * (_BLOCKS / len(values)) ** 0.5)


_ALIKE, _IDLE = 0.3, 0.3  # of the mass: how far the one is from it, and the others from none
_ERROR = 0.1  # of the mass
_LONGEST = 64  # samples on either side
_HARD = 0.3  # of the largest force: where it outweighs that of the links


def driven_mass(record: Record, force: str, masses: Mapping[str, float]) -> str | None:
    """The mass on which a force acts.

    Over twice the time T, x(t + T) - 2 x(t) + x(t - T) is the acceleration of a mass in a triangular window, and so are the
    differences of its velocity; under the same window the force is that acceleration times the mass on which it acts, and
    not of the others, while T is short against the periods of the links.

    Parameters
    ----------
    record : Record
        A record with the force and a motion of each mass.
    force : str
        The channel of the force.
    masses : mapping of str to float
        Masses in kg by name.

    Returns
    -------
    str or None
        The mass; None where the record does not tell, as with a slow force.
    """
    responses = {name: record.motions_of(name) for name in masses}
    if not all(responses.values()) or np.isnan(record.channel(force)).any():
        return None
    half = 1
    while half <= min(_LONGEST, len(record) // 8):
        shares = {name: _share(record, force, responses[name][0], masses[name], half) for name in masses}
        if all(error < _ERROR for _, error in shares.values()):
            driven = [name for name, (share, _) in shares.items() if abs(share - 1.0) < _ALIKE]
            idle = [name for name, (share, _) in shares.items() if abs(share) < _IDLE]
            return driven[0] if len(driven) == 1 and len(driven) + len(idle) == len(shares) else None
        half *= 2
    return None


def _share(record: Record, force: str, motion: str, mass: float, half: int) -> tuple[float, float]:
    """Mass times acceleration over the force, where it is large, and the standard error of that."""
    kind, values = motion.partition(":")[0], record.channel(motion)
    triangle = np.concatenate([np.arange(1.0, half + 1.0), np.arange(half - 1.0, 0.0, -1.0)]) * record.step**2
    inner = slice(1, len(values) - 2 * half + 1)
    pushed = np.convolve(record.channel(force), triangle, "valid")[inner]
    if kind == "x":
        moved = values[2 * half :] - 2.0 * values[half:-half] + values[: -2 * half]
    elif kind == "v":
        moved = np.convolve(values[half:] - values[:-half], np.full(half, record.step), "valid")[inner]
    else:
        moved = np.convolve(values, triangle, "valid")[inner]
    pushed, moved = pushed[: len(moved)] - np.median(pushed), mass * (moved - np.nanmedian(moved))
    hard = (np.abs(pushed) > _HARD * np.max(np.abs(pushed))) & ~np.isnan(moved)
    power = float(np.sum(pushed[hard] ** 2))
    if not power > 0.0:
        return 0.0, np.inf
    share = float(pushed[hard] @ moved[hard]) / power
    rest = float(np.mean((moved[hard] - share * pushed[hard]) ** 2))
    alike = {"x": 2.0, "v": 1.0 * half, "a": 2.0 * half}[kind]  # neighbours with the same noise
    return share, float(np.sqrt(alike * rest / power))
