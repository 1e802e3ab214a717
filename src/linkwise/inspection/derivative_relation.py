"""Channels of one place that are no derivatives of each other: delay, gain, offset and drift between them."""

from __future__ import annotations

from collections.abc import Iterator
from math import isclose

import numpy as np

from linkwise.inspection.alert import Alert
from linkwise.inspection.kinematics import KinematicFit
from linkwise.inspection.record_signals import RecordSignals

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
    for fit in _comparable(signals):
        value, error = fit.delay
        samples = value * fit.upper.rate
        if abs(samples) < _DELAY or abs(value) < _CERTAIN * error:
            continue
        late, early = (fit.upper, fit.lower) if value > 0.0 else (fit.lower, fit.upper)
        message = (
            f"comes {1e3 * abs(value):.3g} ms ({abs(samples):.2g} samples) +- {1e3 * error:.1g} ms later than {early.name} "
            "says: a delay turns stiffness into damping, by many standard errors; give both the same filter, shift "
            "the channel by that time, or estimate the delay with the laws"
        )
        share = min(1.0, 2.0 * 3.14 * late.highest * abs(value))
        yield Alert("delay", late.name, message, share, arguments=("delays",))


def gain(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels of one place that disagree on the size of the motion."""
    named: list[KinematicFit] = []
    for fit in _comparable(signals):
        value, error = fit.gain
        if abs(value - 1.0) < max(_GAIN, _CERTAIN * error) or any(
            _accounts_for(earlier, fit) for earlier in named
        ):
            continue
        named.append(fit)
        lower, upper = fit.lower.name, fit.upper.name
        known = next(
            (text for factor, text in _FACTORS.items() if isclose(value, factor, rel_tol=_NEAR)), None
        )
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
    for fit in _comparable(signals):
        value, error = fit.offset
        if abs(value) < max(_LEVEL * fit.upper.rms, _CERTAIN * error):
            continue
        unit = fit.upper.channel.unit
        message = (
            f"has an offset of {value:.3g} +- {error:.1g} {unit}, while {fit.lower.name} has no drift: it acts "
            "like a constant force, and shifts wells and quadratic terms; subtract it, or estimate it with the laws"
        )
        yield Alert("offset", fit.upper.name, message, abs(value) / fit.upper.rms, arguments=("offsets",))


def drift(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of velocities and accelerations with a slow change, by the displacement or velocity beside them."""
    for fit in _comparable(signals):
        value, error = fit.trend
        over = value * signals.record.duration
        if abs(over) < _TREND * fit.upper.rms or abs(value) < _CERTAIN * error:
            continue
        message = (
            f"drifts by {over:.3g} {fit.upper.channel.unit} over the record, as {fit.lower.name} shows: a drift acts like a "
            "slow force, and biases stiffness; let the sensor warm up, subtract the trend, or use shorter pieces"
        )
        yield Alert(
            "drift",
            fit.upper.name,
            message,
            0.3 * abs(over) / fit.upper.rms,
            arguments=("earliest", "latest"),
        )


def _accounts_for(earlier: KinematicFit, fit: KinematicFit) -> bool:
    """Whether the channel between two others is off alone: what is above it agrees with what is below it."""
    (first, first_error), (second, second_error) = earlier.gain, fit.gain
    error = abs(first * second) * float(np.hypot(first_error / first, second_error / second))
    return earlier.upper is fit.lower and abs(first * second - 1.0) < max(_GAIN, _CERTAIN * error)


def _comparable(signals: RecordSignals) -> list[KinematicFit]:
    return [fit for fit in signals.kinematics if fit.share > _EXPLAINED]
