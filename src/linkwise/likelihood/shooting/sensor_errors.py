"""Errors that sensors may have: what each would add to the samples of its channel, per unit of its size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.late_sensors import late_motion
from linkwise.likelihood.shooting.residuals import Misfit, forces_at_samples
from linkwise.likelihood.shooting.segments import A, F, S, Segments, V, X
from linkwise.registry import Registry

_COUPLED = 8  # channels up to which crosstalk between every two of them is tested

ADDED: Registry[Callable[[Floats, Floats, Floats], Floats]] = Registry(
    "error of a sensor",
    {
        "gain": lambda shown, rate, ramp: shown,
        "offset": lambda shown, rate, ramp: np.ones_like(shown),
        "drift": lambda shown, rate, ramp: ramp,
        "delay": lambda shown, rate, ramp: -rate,
    },
)
"""What an error of unit size adds to a channel, from what it shows of the motion, its rate, and a ramp from 0 to 1 (M, K)."""


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """c errors of unit size: `channel` (c,), `kind` (c,) of a `Cause`, and `values` (M, c, K) what they add to its samples.

    A gain is relative, an offset in the unit of the channel, a drift the change from the start of a record to its end, a
    delay in s, crosstalk the part of the channel number `other` (c,), of the same unit, that is seen as well; -1 for the rest.
    """

    channel: Indices
    kind: tuple[str, ...]
    source: Indices
    values: Floats

    @classmethod
    def of(cls, segments: Segments, misfit: Misfit) -> SensorErrors:
        """All kinds of errors of all channels along the fitted motion."""
        ramp = _ramp(segments)
        sensors = segments.sensors
        motions = [
            _shown(segments, misfit, channel, int(kind), int(mass))
            for channel, (kind, mass) in enumerate(zip(sensors.kind, sensors.mass, strict=True))
        ]
        rows = [
            (channel, kind, -1, value)
            for channel, (shown, rate) in enumerate(motions)
            for kind, value in ((kind, added(shown, rate, ramp)) for kind, added in ADDED.items())
        ]
        if len(motions) <= _COUPLED:
            rows += [
                (channel, "crosstalk", source, motions[source][0])
                for channel in range(len(motions))
                for source in range(len(motions))
                if channel != source and sensors.kind[channel] == sensors.kind[source]
            ]
        channel, kind, source, values = zip(*rows, strict=True)
        return cls(np.array(channel), kind, np.array(source), np.stack(values, axis=1))


def common_filter(segments: Segments, misfit: Misfit) -> SensorErrors:
    """What a filter that all sensors share does to each channel beside a delay: the second derivative of what it shows.

    A low pass of first order with the time constant T takes exp(i w t) to (1 - T^2 w^2 / 2) exp(i w (t - T)) at low
    frequencies, so its size here, in s^2, is T^2 / 2.
    """
    sensors = segments.sensors
    values = []
    for channel, (kind, mass) in enumerate(zip(sensors.kind, sensors.mass, strict=True)):
        if kind == X and segments.carried is None:
            values.append(motion_of(segments, misfit, V, int(mass))[1])
        else:
            rate = _shown(segments, misfit, channel, int(kind), int(mass))[1]
            values.append(_with_rate(segments, rate)[1])
    count = len(values)
    return SensorErrors(np.arange(count), ("filter",) * count, np.full(count, -1), np.stack(values, axis=1))


def relative_to_gain(filtered: SensorErrors, errors: SensorErrors) -> float:
    """Largest ratio, among the channels, of what a common filter does per unit of its size to what a gain does."""
    gains = np.array([kind == "gain" for kind in errors.kind])
    power = np.mean(errors.values[:, gains] ** 2, axis=(0, 2))
    changed = np.mean(filtered.values[:, errors.channel[gains]] ** 2, axis=(0, 2))
    return float(np.sqrt(np.max(changed / np.maximum(power, np.finfo(float).tiny))))


def _shown(segments: Segments, misfit: Misfit, channel: int, kind: int, mass: int) -> tuple[Floats, Floats]:
    """(M, K) what a sensor shows of a mass and of moving coordinates, and its rate."""
    late = channel in segments.sensors.late
    value, rate = (
        _late(segments, misfit, channel, kind, mass) if late else motion_of(segments, misfit, kind, mass)
    )
    carried = carried_by(segments, misfit, channel)
    return (value, rate) if carried is None else (value + carried[0], rate + carried[1])


def carried_by(segments: Segments, misfit: Misfit, channel: int) -> tuple[Floats, Floats] | None:
    """(M, K) what a sensor shows of moving coordinates, as late as it was found to be, and its rate; None without any."""
    if segments.carried is None:
        return None
    if segments.late_base is None or channel not in segments.late_base.channels:
        return segments.carried[0, :, channel], segments.carried[1, :, channel]
    return segments.late_base.at(channel, float(misfit.point.delays[segments.sensors.delay[channel]]))


def _late(segments: Segments, misfit: Misfit, channel: int, kind: int, mass: int) -> tuple[Floats, Floats]:
    """(M, K) what a late sensor of this kind shows of a mass, and its rate."""
    sensors = segments.sensors.at(segments.system.at(misfit.point.theta))
    return late_motion(
        sensors.orbit_with_points(misfit.trajectories),
        segments.step * segments.refine,
        segments.refine,
        mass=mass,
        kind=kind,
        delay=float(misfit.point.delays[sensors.delay[channel]]),
    )


def motion_of(segments: Segments, misfit: Misfit, kind: int, mass: int) -> tuple[Floats, Floats]:
    """(M, K) what a sensor of this kind shows of a mass, and its rate."""
    every = slice(None, segments.steps, segments.refine)
    mechanics = segments.system.at(misfit.point.theta)
    orbit = segments.sensors.at(mechanics).orbit_with_points(misfit.trajectories)
    if kind in (F, S):
        inside = orbit.memory[every]
        if kind == F:
            inside = forces_at_samples(segments, mechanics, orbit)
        return _with_rate(segments, inside[:, mass])
    x = orbit.states[every, 0, mass]
    v = orbit.states[every, 1, mass] / segments.step
    a = orbit.accelerations[every, mass]
    if kind == X:
        return x, v
    if kind == V:
        return v, a
    assert kind == A
    return _with_rate(segments, a)


def _with_rate(segments: Segments, shown: Floats) -> tuple[Floats, Floats]:
    """A signal (M, K) and its rate."""
    series = np.gradient(shown.T.ravel()).reshape(shown.T.shape).T
    return shown, series / (segments.step * segments.refine)


def _ramp(segments: Segments) -> Floats:
    """(M, K) from 0 at the start of each chain of segments to 1 at its end."""
    M, K = len(segments.samples), segments.count
    edges = np.concatenate([[0], np.flatnonzero(~segments.linked) + 1, [K]])
    ramp = np.empty((K, M))
    for first, last in pairwise(edges.tolist()):
        ramp[first:last] = np.linspace(0.0, 1.0, (last - first) * M).reshape(-1, M)
    return ramp.T
