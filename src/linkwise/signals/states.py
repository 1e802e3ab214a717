"""Displacements, velocities and accelerations by differentiation, as in the paper (its section 3, step 3), and by
integration.

Measured quantities are used as measured. The others are derived from the next channel: v from x, and a from v if it is
measured, else from x. A channel that is smoothed for this is replaced by its smoothed samples.

Smoothers with derivatives are local polynomials (Savitzky-Golay) and a smoothing spline with cross-validated smoothness.
Both take evenly sampled channels without gaps and are linear, so they act on noise as filters do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, comb, factorial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve_banded, cholesky_banded

from linkwise.arrays import Floats, bridged, stretches
from linkwise.errors import RecordError
from linkwise.records.channel import MOTIONS, Channel
from linkwise.records.record import Record
from linkwise.signals.noise import bandwidth

_VALUE = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120  # quintic B-splines and their derivatives at the knots
_SLOPE = np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24
_CURVATURE = np.array([1.0, 2.0, -6.0, 2.0, 1.0]) / 6
_DEGREE = 5  # of the polynomials of a Savitzky-Golay filter
_MARGIN = 1.4  # cut-off of a Savitzky-Golay window in bandwidths; gives the best derivatives at 20 to 60 dB
_PENALTY = 4  # order of the penalised differences; 4 gives the best second derivatives
_DIFFERENCES = np.array([(-1.0) ** lag * comb(_PENALTY, lag) for lag in range(_PENALTY + 1)])
_SMOOTHINGS = np.logspace(-8, 12, 41)  # from interpolation to a cut-off at 1/200 of the sampling rate


def savitzky_golay(samples: ArrayLike, rate: float, *, half: int) -> tuple[Floats, Floats, Floats]:
    """Smoothed channels (N, C) and their first and second time derivative, by polynomials over `half` samples on each side
    of the centre (A. Savitzky and M. J. E. Golay, Anal. Chem. 36, 1627 (1964)). Closer than half a window to an end, the
    polynomial of the first or last complete window is evaluated off its centre. RecordError if samples are missing, or the
    window is longer than the record or too short for the degree.
    """
    values = _columns(samples)
    length = 2 * half + 1
    if length <= _DEGREE or length > len(values):
        raise RecordError(
            f"a Savitzky-Golay window for degree {_DEGREE} must have more than {_DEGREE} and at most {len(values)} samples "
            f"(the record), got {length}"
        )
    u = np.arange(-half, half + 1) / half
    fit = np.linalg.pinv(np.vander(u, _DEGREE + 1, increasing=True))  # (degree + 1, length)
    derivatives = []
    for order in range(3):
        slopes = np.polynomial.polynomial.polyval(
            u, np.polynomial.polynomial.polyder(fit, order)
        ).T  # at each u
        slopes *= (rate / half) ** order
        derivative = np.empty_like(values)
        for samples_in, derived in zip(values.T, derivative.T, strict=True):
            derived[half : len(values) - half] = np.correlate(samples_in, slopes[half], mode="valid")
        derivative[:half] = slopes[:half] @ values[:length]
        derivative[len(values) - half :] = slopes[half + 1 :] @ values[-length:]
        derivatives.append(derivative)
    return derivatives[0], derivatives[1], derivatives[2]


def savitzky_golay_half(bandwidth: float, rate: float) -> int:
    """Half width in samples of a Savitzky-Golay window for motion of given bandwidth in Hz: f_c = (degree + 1) / (3.2 half
    - 4.6) in half sampling rates (R. W. Schafer, IEEE Signal Process. Mag. 28 (4), 111 (2011), Eq. (12)). The -3 dB
    cut-off is at 1.4 times the bandwidth, since the second derivative is attenuated well before the value.
    """
    cut = 2 * _MARGIN * bandwidth / rate
    # by symmetry the value is smoothed as with the even degree below
    return max(ceil((_DEGREE / cut + 4.6) / 3.2), _DEGREE // 2 + 1)


@dataclass(frozen=True, eq=False)
class SmoothingSpline:
    """Smoothing splines of C channels: quintic B-splines with a knot at every sample, by their coefficients (N + 4, C),
    and the weights of the penalty (C,), from 1e-8, which interpolates, to 1e12, which passes 1/200 of the sampling rate in
    Hz.
    """

    coefficients: Floats
    rate: float
    smoothing: Floats

    def value(self) -> Floats:
        """Smoothed samples (N, C)."""
        return _stencil(self.coefficients, _VALUE)

    def first(self) -> Floats:
        """First time derivative (N, C), in units per s."""
        return _stencil(self.coefficients, _SLOPE) * self.rate

    def second(self) -> Floats:
        """Second time derivative (N, C), in units per s^2."""
        return _stencil(self.coefficients, _CURVATURE) * self.rate**2

    def smoothed(self, samples: Floats) -> SmoothingSpline:
        """Splines of other samples (N, C) with the smoothing of the first channel."""
        return smoothing_spline(samples, self.rate, smoothing=float(self.smoothing[0]))

    def transposed(self, by_coefficient: Floats) -> Floats:
        """How q sums over the spline of the first channel change with its samples (N, q), from their derivatives by the
        coefficients of the B-splines (N + 4, q).
        """
        solved = _solver(self.smoothing[0], len(self.coefficients) - 4)(by_coefficient)
        return _stencil(solved, _VALUE)

    @property
    def reach(self) -> int:
        """Number of samples at each end with a less accurate first derivative, for the smoothest channel.

        Beyond it the error is larger than inside by less than a fifth.
        """
        smoothest = max(float(np.max(self.smoothing)), 1e-3)
        return ceil(5 * float(smoothest ** (0.5 / _PENALTY)))


def smoothing_spline(samples: ArrayLike, rate: float, *, smoothing: float | None = None) -> SmoothingSpline:
    """Splines of channels (N, C) without gaps that minimise sum (y - s)^2 + smoothing * sum (fourth difference of the
    coefficients)^2 (P. H. C. Eilers and B. D. Marx, Stat. Sci. 11, 89 (1996)). By default `smoothing` is the one of 41
    from 1e-8 to 1e12 that minimises the generalised cross-validation score N rss / (N - trace)^2, with the trace of the
    smoother from its spectrum, exact up to the ends. RecordError if there are fewer than 16 samples, samples are missing,
    or the weight is out of range.
    """
    values = _columns(samples)
    if len(values) < 16:
        raise RecordError(f"{len(values)} samples are too few for a smoothing spline, which needs 16")
    if smoothing is not None and not _SMOOTHINGS[0] <= smoothing <= _SMOOTHINGS[-1]:
        raise RecordError(f"smoothing must be between 1e-8 and 1e12, got {smoothing!r}")
    weights = _SMOOTHINGS if smoothing is None else np.array([smoothing])
    best = np.full(values.shape[1], np.inf)
    coefficients, chosen = np.zeros((len(values) + 4, values.shape[1])), np.zeros(values.shape[1])
    right = _transposed(values, _VALUE)
    for weight in weights.tolist():
        solved = _solver(weight, len(values))(right)
        rest = len(values) - _trace(weight, len(values))
        score = np.sum((values - _stencil(solved, _VALUE)) ** 2, axis=0) / rest**2
        better = score < best
        best[better], chosen[better] = score[better], weight
        coefficients[:, better] = solved[:, better]
    for weight in np.unique(chosen).tolist():
        which, solve = chosen == weight, _solver(weight, len(values))
        for _ in range(2):  # iterative refinement, for the digits that a strong penalty costs
            left = _transposed(values[:, which] - _stencil(coefficients[:, which], _VALUE), _VALUE)
            left -= weight * _transposed(_stencil(coefficients[:, which], _DIFFERENCES), _DIFFERENCES)
            coefficients[:, which] += solve(left)
    return SmoothingSpline(coefficients, rate, chosen)


def _solver(weight: float, samples: int) -> Callable[[Floats], Floats]:
    """What solves the normal equations of splines through so many samples, whose fourth differences have a weight."""
    bands = _normal_bands(_VALUE, samples) + weight * _normal_bands(_DIFFERENCES, samples + 4 - _PENALTY)
    factor = cholesky_banded(bands, lower=True, check_finite=False)
    return lambda right: np.asarray(cho_solve_banded((factor, True), right, check_finite=False))


def _columns(samples: ArrayLike) -> Floats:
    values = np.asarray(samples, dtype=np.float64)
    values = values[:, None] if values.ndim == 1 else values
    missing = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if missing.size:
        raise RecordError(
            f"{missing.size} samples are missing, the first at index {missing[0]}; smoothers cannot bridge a gap: smooth the "
            "complete pieces separately"
        )
    return values


def _stencil(coefficients: Floats, weights: Floats) -> Floats:
    """Weighted sums of neighbouring rows: (N + 4, C) -> (N, C)."""
    count = len(coefficients) - len(weights) + 1
    total = weights[0] * coefficients[:count]
    for lag in range(1, len(weights)):
        if weights[lag]:
            total += weights[lag] * coefficients[lag : lag + count]
    return np.asarray(total)


def _transposed(rows: Floats, weights: Floats) -> Floats:
    """The transpose of `_stencil`: (N, C) -> (N + 4, C)."""
    total = np.zeros((len(rows) + len(weights) - 1, rows.shape[1]))
    for lag, weight in enumerate(weights):
        total[lag : lag + len(rows)] += weight * rows
    return total


def _normal_bands(stencil: Floats, rows: int) -> Floats:
    """S'S in LAPACK's lower banded form, S (rows, rows + len - 1) with `stencil` along its diagonals."""
    bands = np.zeros((len(stencil), rows + len(stencil) - 1))
    for left, weight in enumerate(stencil):
        for right in range(left, len(stencil)):
            bands[right - left, left : left + rows] += weight * stencil[right]
    return bands


def _trace(weight: float, samples: int) -> float:
    """Degrees of freedom of the smoother: its gain averaged over the band, plus one for each coefficient of a cubic."""
    angle = (np.arange(4096) + 0.5) * np.pi / 4096
    gain = ((66 + 52 * np.cos(angle) + 2 * np.cos(2 * angle)) / 120) ** 2
    passed = np.mean(gain / (gain + weight * (2 * np.sin(angle / 2)) ** (2 * _PENALTY)))
    return float(_PENALTY + (samples - _PENALTY) * passed)


DifferentiationMethod = Literal["spline", "savgol", "differences"]

_METHODS = {
    "spline": "smoothing spline, smoothness by generalised cross-validation",
    "savgol": "Savitzky-Golay, window by the bandwidth of the channel",
    "differences": "central differences of fourth order, for data without noise",
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


def differentiate(record: Record, method: DifferentiationMethod = "spline") -> States:
    """Displacement, velocity and acceleration of every mass with a sensor.

    Parameters
    ----------
    record : Record
        A record without missing samples, with a displacement channel for every mass.
    method : {"spline", "savgol", "differences"}, optional
        Quintic smoothing spline with cross-validated smoothness; Savitzky-Golay filter of degree 5 with a window from the
        bandwidth; or central differences of fourth order without smoothing.

    Returns
    -------
    States
        The motion. Samples near both ends, where derivatives are one-sided, are left out unless x, v and a are measured.

    Raises
    ------
    RecordError
        If a mass or the base has no displacement channel, samples are missing, or the method is unknown.

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
    x, v, a, margin = _motions(record, bodies, method)
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


def finite_differences(samples: Floats, rate: float, derivative: int) -> Floats:
    """First or second derivative, of the shape of `samples` (N, ...), in units per s or s^2, by finite differences of fourth
    order up to both ends; RecordError for too few samples.
    """
    length = 4 + derivative  # points of a one-sided stencil of this order
    if len(samples) < length:
        raise RecordError(f"{len(samples)} samples are too few for differences of order 4")
    result = np.zeros_like(samples)
    count = len(samples) - 4
    for lag, weight in enumerate(_difference_weights(5, 2, derivative)):
        result[2:-2] += weight * samples[lag : lag + count]
    for row in range(2):
        weights = _difference_weights(length, row, derivative)
        result[row] = np.tensordot(weights, samples[:length], axes=1)
        result[-1 - row] = (-1) ** derivative * np.tensordot(weights, samples[: -length - 1 : -1], axes=1)
    return result * rate**derivative


def _motions(
    record: Record, bodies: tuple[str, ...], method: DifferentiationMethod
) -> tuple[Floats, Floats, Floats, int]:
    """x, v, a (N, len(bodies)) of masses or the base, and the number of inaccurate samples at each end."""
    sources = {body: source for body in bodies if (source := _source(record, body))}
    derived: dict[str, tuple[Floats, ...]] = {}
    margin = 0
    if sources:
        samples = np.column_stack([record.channel(source) for source in sources.values()])
        *derivatives, margin = _derivatives(samples, record.rate, method, list(sources.values()))
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
    samples: Floats, rate: float, method: DifferentiationMethod, names: Sequence[str]
) -> tuple[Floats, Floats, Floats, int]:
    """Value, first and second derivative of channels (N, C), whose `names` errors tell, and the number of inaccurate samples
    at each end.
    """
    if method == "differences":
        first, second = (finite_differences(samples, rate, which) for which in (1, 2))
        return samples, first, second, 0
    if method == "spline":
        spline = smoothing_spline(samples, rate)
        return spline.value(), spline.first(), spline.second(), spline.reach
    halves = [savitzky_golay_half(float(band), rate) for band in bandwidth(samples, rate, names=names)]
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
    advice = "no row is complete"
    if complete := stretches(np.asarray(~missing.any(axis=1))):
        piece = record.time[max(complete, key=lambda piece: piece.stop - piece.start)]
        advice = f"record.between({piece[0]:g}, {piece[-1]:g}) is the longest complete piece"
    raise RecordError(
        f"{int(missing[:, column].sum())} samples are missing, the first at {first:g} s, and derivatives cannot cross a gap; "
        f"{advice}, and the weak form needs no derivatives",
        channel=record.channels[column],
    )


@lru_cache(maxsize=64)
def _difference_weights(points: int, at: int, derivative: int) -> tuple[float, ...]:
    """Weights of samples at spacing 1 for a derivative at sample `at`, exact for the highest possible degree."""
    powers = np.vander(np.arange(points, dtype=np.float64) - at, points, increasing=True).T
    right = np.zeros(points)
    right[derivative] = factorial(derivative)
    return tuple(np.linalg.solve(powers, right))


DRIFT_FREQUENCY = 3.0  # Hz: below it a twice integrated acceleration is drift, unless the structure is slow
_BELOW = 0.2  # of the frequency below which half of the power lies: the noise of an integral grows towards low ones
_ROUNDING = 1e-24  # of the power of a constant


def smoothed(record: Record, channel: str, sigma: float) -> tuple[Floats, Floats, Floats]:
    """A channel with noise `sigma`, smoothed, and its first and second time derivative, each (N,), by a Savitzky-Golay
    filter.
    """
    values = bridged(record.channel(channel))
    highest = float(bandwidth(values, record.rate, [sigma], [channel])[0])
    half = min(savitzky_golay_half(highest, record.rate), (len(values) - 1) // 2)
    value, first, second = savitzky_golay(values, record.rate, half=half)
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
    values = bridged(record.channel(channel))
    if kind == "v":
        velocity, acceleration, _ = smoothed(record, channel, sigma)
        return np.stack([integral(values, record.step), velocity, acceleration])
    velocity = integral(values, record.step)
    return np.stack([integral(velocity, record.step), velocity, values])
