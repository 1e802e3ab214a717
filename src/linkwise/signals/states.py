"""Displacements, velocities and accelerations by differentiation, as in the paper (its section 3, step 3), and by
integration.

Measured quantities are used as measured. The others are derived from the next channel: v from x, and a from v if it is
measured, else from x. A channel that is smoothed for this is replaced by its smoothed samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Literal

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.channel import MOTIONS, Channel
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth
from linkwise.signals.smooth import savitzky_golay, savitzky_golay_half, smoothing_spline

DifferentiationMethod = Literal["spline", "savgol", "differences"]

_METHODS = {
    "spline": "smoothing spline, smoothness by generalised cross-validation",
    "savgol": "Savitzky-Golay, window by the bandwidth of the channel",
    "differences": "central differences of order 2, 4 or 6, for data without noise",
}


@dataclass(frozen=True, eq=False)
class States:
    """Motion of n masses at N times, measured and derived.

    Attributes
    ----------
    time : array of shape (N,)
        Times in s.
    masses : tuple of str
        Names of the masses.
    x, v, a : array of shape (N, n)
        Displacements in m, velocities in m/s and accelerations in m/s^2.
    forces : array of shape (N, n)
        Applied forces in N, zero where none was recorded.
    driven : tuple of str
        Names of the masses with a force channel.
    base, base_velocity : array of shape (N,) or None
        Motion of the base in m and m/s; None without a base channel.

    See Also
    --------
    differentiate : Derive them from a record.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> lw.sindy.differentiate(record, "differences").a.shape
    (501, 2)
    """

    time: Floats
    masses: tuple[str, ...]
    x: Floats
    v: Floats
    a: Floats
    forces: Floats
    driven: tuple[str, ...] = ()
    base: Floats | None = None
    base_velocity: Floats | None = None

    def __len__(self) -> int:
        return len(self.time)


def differentiate(record: Record, method: DifferentiationMethod = "spline", *, order: int = 4) -> States:
    """Displacement, velocity and acceleration of every mass with a sensor.

    Parameters
    ----------
    record : Record
        A record without missing samples, with a displacement channel for every mass.
    method : {"spline", "savgol", "differences"}, optional
        Quintic smoothing spline with cross-validated smoothness; Savitzky-Golay filter of degree 5 with a window from the
        bandwidth; or central differences without smoothing.
    order : {2, 4, 6}, optional
        Order of the differences.

    Returns
    -------
    States
        The motion. Samples near both ends, where derivatives are one-sided, are left out unless x, v and a are measured.

    Raises
    ------
    RecordError
        If a mass or the base has no displacement channel, samples are missing, or the method or order is unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0)
    >>> states = lw.sindy.differentiate(record.with_noise(40.0, seed=1))
    >>> states.masses
    ('m1', 'm2')
    """
    if method not in _METHODS:
        listed = ", ".join(f'"{name}" ({description})' for name, description in _METHODS.items())
        raise RecordError(f"unknown method {method!r}; choose from {listed}")
    _require_complete(record)
    if not record.masses:
        named = ", ".join(record.channels)
        raise RecordError(f"the record has no response channel to differentiate, only {named}")
    bodies = (*record.masses, *(["base"] if any(name.endswith(":base") for name in record.channels) else []))
    x, v, a, margin = _motions(record, bodies, method, order)
    if len(record) <= 2 * margin:
        why = f"{margin} at each end have one-sided derivatives only"
        raise RecordError(f"{len(record)} samples are too few, since {why}")
    inner = slice(margin, len(record) - margin)
    count = len(record.masses)
    driven = tuple(mass for mass in record.masses if f"force:{mass}" in record.channels)
    forces = np.zeros((len(record), count))
    for mass in driven:
        forces[:, record.masses.index(mass)] = record.channel(f"force:{mass}")
    return States(
        time=record.time[inner],
        masses=record.masses,
        x=x[inner, :count],
        v=v[inner, :count],
        a=a[inner, :count],
        forces=forces[inner],
        driven=driven,
        base=x[inner, count] if len(bodies) > count else None,
        base_velocity=v[inner, count] if len(bodies) > count else None,
    )


def finite_differences(samples: Floats, rate: float, derivative: int, *, order: int = 4) -> Floats:
    """First or second derivative, of the shape of `samples` (N, ...), in units per s or s^2, by finite differences of
    `order` 2, 4 or 6 up to both ends; RecordError for another order or too few samples.
    """
    if order not in (2, 4, 6) or derivative not in (1, 2):
        message = f"order must be 2, 4 or 6 and derivative 1 or 2, got order {order!r} and derivative {derivative!r}"
        raise RecordError(message)
    half = order // 2
    length = order + derivative  # points of a one-sided stencil of this order
    if len(samples) < max(length, 2 * half + 1):
        raise RecordError(f"{len(samples)} samples are too few for differences of order {order}")
    result = np.zeros_like(samples)
    count = len(samples) - 2 * half
    for lag, weight in enumerate(_stencil(2 * half + 1, half, derivative)):
        result[half : half + count] += weight * samples[lag : lag + count]
    for row in range(half):
        weights = _stencil(length, row, derivative)
        result[row] = np.tensordot(weights, samples[:length], axes=1)
        result[-1 - row] = (-1) ** derivative * np.tensordot(weights, samples[: -length - 1 : -1], axes=1)
    return result * rate**derivative


def _motions(
    record: Record, bodies: tuple[str, ...], method: DifferentiationMethod, order: int
) -> tuple[Floats, Floats, Floats, int]:
    """x, v, a (N, len(bodies)) of masses or the base, and the number of inaccurate samples at each end."""
    sources = {body: source for body in bodies if (source := _source(record, body))}
    derived: dict[str, tuple[Floats, ...]] = {}
    margin = 0
    if sources:
        samples = np.column_stack([record.channel(source) for source in sources.values()])
        *derivatives, margin = _derivatives(samples, record.rate, method, order)
        derived = dict(zip(sources, zip(*(values.T for values in derivatives), strict=True), strict=True))
    motions: list[dict[str, Floats]] = []
    for body in bodies:
        motion = {
            kind: record.channel(f"{kind}:{body}") for kind in MOTIONS if f"{kind}:{body}" in record.channels
        }
        first = sources.get(body, "a")[0]  # the kind that was differentiated, "x" or "v"
        for kind, values in zip(MOTIONS[MOTIONS.index(first) :], derived.get(body, ()), strict=False):
            # a differentiated channel is replaced by its smoothed samples; other measured ones are kept
            motion[kind] = values if kind == first or kind not in motion else motion[kind]
        motions.append(motion)
    x, v, a = (np.column_stack([motion[kind] for motion in motions]) for kind in MOTIONS)
    return x, v, a, margin


def _source(record: Record, body: str) -> str | None:
    """The channel to differentiate for a mass or the base; None where x, v and a are measured."""
    measured = {kind: f"{kind}:{body}" in record.channels for kind in MOTIONS}
    if not measured["x"]:
        given = " and ".join(f"{kind}:{body}" for kind in "va" if measured[kind])
        raise RecordError(
            f"{body} has {given} but no displacement x:{body}, and integrating a record causes drift; add the channel, or "
            "use a method that needs no derivatives ('weak', 'ml')"
        )
    if not measured["v"]:
        return f"x:{body}"
    return None if measured["a"] else f"v:{body}"


def _derivatives(
    samples: Floats, rate: float, method: DifferentiationMethod, order: int
) -> tuple[Floats, Floats, Floats, int]:
    """Value, first and second derivative of channels (N, C), and the number of inaccurate samples at each end."""
    if method == "differences":
        first, second = (finite_differences(samples, rate, which, order=order) for which in (1, 2))
        return samples, first, second, 0
    if method == "spline":
        spline = smoothing_spline(samples, rate)
        return spline.value(), spline.first(), spline.second(), spline.reach
    halves = [savitzky_golay_half(float(band), rate) for band in bandwidth(samples, rate)]
    smoothed = [savitzky_golay(samples[:, column], rate, half=half) for column, half in enumerate(halves)]
    value, first, second = (np.concatenate(columns, axis=1) for columns in zip(*smoothed, strict=True))
    return value, first, second, max(halves)


def _require_complete(record: Record) -> None:
    """Raise RecordError where samples are missing, with the first time and the longest complete piece."""
    missing = record.missing
    if not missing.any():
        return
    column = int(np.argmax(missing.sum(axis=0)))
    first = float(record.time[int(np.argmax(missing[:, column]))])
    edges = np.flatnonzero(np.concatenate([[True], missing.any(axis=1), [True]]))
    longest = int(np.argmax(np.diff(edges)))
    piece = record.time[edges[longest] : edges[longest + 1] - 1]
    advice = "no row is complete"
    if piece.size:
        advice = f"record.between({piece[0]:g}, {piece[-1]:g}) is the longest complete piece"
    raise RecordError(
        f"{int(missing[:, column].sum())} samples are missing, the first at {first:g} s, and derivatives cannot cross a gap; "
        f"{advice}, and the weak form needs no derivatives",
        channel=record.channels[column],
    )


@lru_cache(maxsize=64)
def _stencil(points: int, at: int, derivative: int) -> tuple[float, ...]:
    """Weights of samples at spacing 1 for a derivative at sample `at`, exact for the highest possible degree."""
    powers = np.vander(np.arange(points, dtype=np.float64) - at, points, increasing=True).T
    right = np.zeros(points)
    right[derivative] = factorial(derivative)
    return tuple(np.linalg.solve(powers, right))


DRIFT_FREQUENCY = 3.0  # Hz: below it a twice integrated acceleration is drift, unless the structure is slow
_BELOW = 0.2  # of the frequency below which half of the power lies: the noise of an integral grows towards low ones
_ROUNDING = 1e-24  # of the power of a constant
_DEGREE = 5


def bridged(record: Record, channel: str) -> Floats:
    """Samples (N,) of a channel with gaps interpolated linearly, for starting values."""
    values = record.channel(channel)
    missing = np.isnan(values)
    if missing.any():
        index = np.arange(len(values))
        values = np.interp(index, index[~missing], values[~missing])
    return values


def smoothed(record: Record, channel: str, sigma: float) -> tuple[Floats, Floats, Floats]:
    """A channel with noise `sigma`, smoothed, and its first and second time derivative, each (N,), by a Savitzky-Golay
    filter.
    """
    values = bridged(record, channel)
    highest = float(bandwidth(values, record.rate, [sigma])[0])
    half = min(savitzky_golay_half(highest, record.rate, degree=_DEGREE), (len(values) - 1) // 2)
    value, first, second = savitzky_golay(values, record.rate, half=half, degree=_DEGREE)
    return value[:, 0], first[:, 0], second[:, 0]


def integral(values: Floats, step: float) -> Floats:
    """Cumulative integral (N,) by Simpson's rule, 0 at the first sample; `step` in s.

    It is that of `scipy.integrate.cumulative_simpson` to the last digit; importing that takes longer than a fit. Each
    interval belongs to the parabola through its ends and the sample after or before it; two samples give the trapezoidal
    rule.
    """
    result = np.zeros(len(values))
    if len(values) < 3:
        result[1:] = np.cumsum(step * (values[1:] + values[:-1]) / 2.0)
        return result
    result[1:-1:2] = _first_interval(values, step)[::2]
    result[2:-1:2] = _first_interval(values[::-1], step)[::-1][:-1:2]
    result[-1] = _first_interval(values[::-1], step)[0]
    return np.cumsum(result)


def _first_interval(values: Floats, step: float) -> Floats:
    """Integrals (N - 2,) of the parabolas through three samples in a row, from the first to the second of them."""
    first, second, third = values[:-2], values[1:-1], values[2:]
    return np.asarray(step / 3 * (5 * first / 4 + 2 * second - third / 4))


def drift_frequency(acceleration: Floats, rate: float) -> float:
    """Frequency in Hz below which the integral of an acceleration (N,) is taken for drift: a part of that below which half
    of the power lies, so that slow structures keep their motion and a weaker drift of the sensor does not count, and at
    most `DRIFT_FREQUENCY`.
    """
    power = np.cumsum(np.abs(np.fft.rfft(acceleration - acceleration.mean())) ** 2)
    if not power[-1] > _ROUNDING * len(acceleration) * float(acceleration @ acceleration):
        return DRIFT_FREQUENCY  # at rest
    median = float(np.searchsorted(power, 0.5 * power[-1])) * rate / len(acceleration)
    return min(_BELOW * median, DRIFT_FREQUENCY)


def highpass(values: Floats, rate: float, cutoff: float) -> Floats:
    """Samples (N,) without what is slower than a cut-off in Hz: a Gaussian in frequency, with mirrored ends."""
    mirrored = np.concatenate([values, values[::-1]])
    frequency = np.fft.rfftfreq(len(mirrored), 1.0 / rate)
    gain = 1.0 - np.exp(-0.5 * (frequency / cutoff) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(mirrored) * gain, len(mirrored))[: len(values)])


def channel_motion(record: Record, channel: Channel, sigma: float) -> Floats:
    """Displacement in m, velocity in m/s and acceleration in m/s^2 (3, N) from one channel of any of the three with noise
    `sigma`; integrals start at 0.
    """
    kind = channel.kind
    if kind == "x":
        return np.stack(smoothed(record, channel, sigma))
    values = bridged(record, channel)
    if kind == "v":
        velocity, acceleration, _ = smoothed(record, channel, sigma)
        return np.stack([integral(values, record.step), velocity, acceleration])
    velocity = integral(values, record.step)
    return np.stack([integral(velocity, record.step), velocity, values])
