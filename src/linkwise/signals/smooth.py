"""Smoothers with derivatives: local polynomials (Savitzky-Golay) and a smoothing spline with cross-validated smoothness.

Both take evenly sampled channels without gaps and are linear, so they act on noise as filters do.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, comb, factorial

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve_banded, cholesky_banded

from linkwise.arrays import Floats
from linkwise.errors import RecordError

_VALUE = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120  # quintic B-splines and their derivatives at the knots
_SLOPE = np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24
_CURVATURE = np.array([1.0, 2.0, -6.0, 2.0, 1.0]) / 6
_MARGIN = 1.4  # cut-off of a Savitzky-Golay window in bandwidths; gives the best derivatives at 20 to 60 dB
_PENALTY = 4  # order of the penalised differences; 4 gives the best second derivatives
_DIFFERENCES = np.array([(-1.0) ** lag * comb(_PENALTY, lag) for lag in range(_PENALTY + 1)])
_SMOOTHINGS = np.logspace(-8, 12, 41)  # from interpolation to a cut-off at 1/200 of the sampling rate


def savitzky_golay(
    samples: ArrayLike, rate: float, *, half: int, degree: int = 5
) -> tuple[Floats, Floats, Floats]:
    """Smoothed channels (N, C) and their first and second time derivative, by polynomials over `half` samples on each side
    of the centre (A. Savitzky and M. J. E. Golay, Anal. Chem. 36, 1627 (1964)). Closer than half a window to an end, the
    polynomial of the first or last complete window is evaluated off its centre. RecordError if samples are missing, or the
    window is longer than the record or too short for the degree.
    """
    values = _columns(samples)
    length = 2 * half + 1
    if length <= degree or length > len(values):
        raise RecordError(
            f"a Savitzky-Golay window for degree {degree} must have more than {degree} and at most {len(values)} samples (the "
            f"record), got {length}"
        )
    u = np.arange(-half, half + 1) / half
    fit = np.linalg.pinv(np.vander(u, degree + 1, increasing=True))  # (degree + 1, length)
    derivatives = []
    for order in range(3):
        unit = (rate / half) ** order
        kernel = fit[order] * factorial(order) * unit
        derivative = np.empty_like(values)
        for samples_in, derived in zip(values.T, derivative.T, strict=True):
            derived[half : len(values) - half] = np.correlate(samples_in, kernel, mode="valid")
        rows = np.zeros((length, degree + 1))  # derivatives of the powers
        for power in range(order, degree + 1):
            rows[:, power] = factorial(power) / factorial(power - order) * u ** (power - order)
        slopes = rows * unit @ fit
        derivative[:half] = slopes[:half] @ values[:length]
        derivative[len(values) - half :] = slopes[half + 1 :] @ values[-length:]
        derivatives.append(derivative)
    return derivatives[0], derivatives[1], derivatives[2]


def savitzky_golay_half(bandwidth: float, rate: float, *, degree: int = 5) -> int:
    """Half width in samples of a Savitzky-Golay window for motion of given bandwidth in Hz: f_c = (degree + 1) / (3.2 half
    - 4.6) in half sampling rates (R. W. Schafer, IEEE Signal Process. Mag. 28 (4), 111 (2011), Eq. (12)). The -3 dB
    cut-off is at 1.4 times the bandwidth, since the second derivative is attenuated well before the value.
    """
    cut = 2 * _MARGIN * bandwidth / rate
    even = degree // 2 * 2  # by symmetry the value is smoothed as with the even degree below
    return max(ceil(((even + 1) / cut + 4.6) / 3.2), degree // 2 + 1)


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
        rows = len(self.coefficients)
        penalty = self.smoothing[0] * _normal_bands(_DIFFERENCES, rows - _PENALTY)
        factor = cholesky_banded(_normal_bands(_VALUE, rows - 4) + penalty, lower=True, check_finite=False)
        return _stencil(cho_solve_banded((factor, True), by_coefficient, check_finite=False), _VALUE)

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
    bands = _normal_bands(_VALUE, len(values)), _normal_bands(_DIFFERENCES, len(values) + 4 - _PENALTY)
    right = _transposed(values, _VALUE)
    for weight in weights:
        factor = cholesky_banded(bands[0] + weight * bands[1], lower=True, check_finite=False)
        solved = cho_solve_banded((factor, True), right, check_finite=False)
        rest = len(values) - _trace(weight, len(values))
        score = np.sum((values - _stencil(solved, _VALUE)) ** 2, axis=0) / rest**2
        better = score < best
        best[better], chosen[better] = score[better], weight
        coefficients[:, better] = solved[:, better]
    for weight in np.unique(chosen):
        factor = cholesky_banded(bands[0] + weight * bands[1], lower=True, check_finite=False)
        which = chosen == weight
        coefficients[:, which] = _refined(factor, coefficients[:, which], values[:, which], weight)
    return SmoothingSpline(coefficients, rate, chosen)


def _refined(factor: Floats, solved: Floats, values: Floats, weight: float) -> Floats:
    """Spline coefficients after two steps of iterative refinement, for the digits that a strong penalty costs."""
    for _ in range(2):
        rest = _transposed(values - _stencil(solved, _VALUE), _VALUE)
        rest -= weight * _transposed(_stencil(solved, _DIFFERENCES), _DIFFERENCES)
        solved = solved + cho_solve_banded((factor, True), rest, check_finite=False)
    return solved


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
