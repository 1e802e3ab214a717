"""Noise of sensors that is correlated from sample to sample: its autoregression, and the fit that allows for it.

The residuals r of a channel with such noise follow r_t = a_1 r_(t-1) + ... + a_p r_(t-p) + e_t, e white, whatever the motion.
Residuals of laws that are wrong do not: they resonate where the motion does, and fade with it. Noise is distinguished from
them by innovations e that are white and of one size throughout, and by poles that are far from the unit circle.

The likelihood goes on as if the noise were white, each channel with the variance that its noise has where the motion is. The
estimates are then as good as their weights, which need not be exact, and their covariance is that of an M-estimator, H^-1 J
H^-1: H the information, J the covariance of the scores under the noise that was found (Newey and West 1987).

References
----------
W. K. Newey and K. D. West, Econometrica 55, 703 (1987), for the variance of scores under correlated noise.

D. W. K. Andrews and J. C. Monahan, Econometrica 60, 953 (1992), for whitening before the spectrum is smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.noise import degrees_of_freedom, evidence
from linkwise.likelihood.shooting.linear_model import eliminated_rows
from linkwise.likelihood.shooting.minimise import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.residuals import Gaussian
from linkwise.likelihood.whiteness import is_white

_HIGHEST_ORDER = 24  # that is tried: differenced noise needs as many to be white to 3 % of its power
_SMOOTHED = 100  # lags of what an autoregression leaves: its spectrum is then known to 10 % from 6000 samples
_SAMPLES_PER_LAG = 50  # at least
_LARGEST_POLE = 0.95  # that remembers 20 samples; drifts and resonances of the motion remember more
# damping ratio; that of the sharpest poles of Butterworth's filter of order eight is 0.2
_LIGHTLY_DAMPED = 0.15
_BESIDE = 4.0  # half widths of a peak: one of a single mode is 17 times as high as its sides there
_PROMINENT = 4.0  # above both sides: one side of the edge of a filter is as high
_BLOCKS = 20  # whose innovations are compared in size
_FALSE_ALARM = 1e-6  # probability that those of steady noise differ by more
_APART = 200  # samples between chains of segments, after which nothing is remembered: 0.95^200 = 4e-5


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """Autoregressive noise of the channels.

    Attributes
    ----------
    coefficients : tuple of array of shape (p,)
        a_1 .. a_p of each channel; none where it is white.
    innovations : array of shape (C,)
        Variances of e, in units of the variances that the residuals are whitened by.
    correlations : tuple of array of shape (s,)
        Autocorrelations of e from lag 0 on, tapered: an autoregression of finite order leaves some.
    samples : array of int, shape (C,)
        Number of residuals.
    """

    coefficients: tuple[Floats, ...]
    innovations: Floats
    correlations: tuple[Floats, ...]
    samples: Indices

    @classmethod
    def of(cls, residuals: Floats, linked: Bools) -> ColouredNoise | None:
        """The noise of residuals.

        Parameters
        ----------
        residuals : array of shape (M, C, K)
            Residuals of K segments of M samples in C channels; 0 where a sample is missing.
        linked : array of bool, shape (K - 1,)
            Which neighbouring segments are continuous.

        Returns
        -------
        ColouredNoise or None
            None where all channels are white, or one of them is coloured in another way.
        """
        series = in_time(residuals, linked)
        series[series == 0.0] = np.nan
        coefficients = tuple(own for own in map(_autoregression, series) if own is not None)
        if len(coefficients) < len(series) or not any(map(len, coefficients)):
            return None
        innovations = list(map(_innovations, series, coefficients))
        correlations = (
            _tapered(left) if len(own) else np.ones(1)
            for left, own in zip(innovations, coefficients, strict=True)
        )
        variances = np.array([np.nanmean(left**2) for left in innovations])
        return cls(coefficients, variances, tuple(correlations), np.isfinite(series).sum(axis=1))

    @property
    def channels(self) -> Indices:
        """The channels that are not white."""
        return np.flatnonzero([len(coefficients) > 0 for coefficients in self.coefficients])

    @property
    def variances(self) -> Floats:
        """(C,) variances of the noise."""
        return np.array([np.mean(self._spectrum(channel, 4096)) for channel in range(len(self.innovations))])

    @property
    def information(self) -> float:
        """-2 log likelihood of the residuals but for a constant, and the penalty of Schwarz for the coefficients."""
        orders = np.array([len(coefficients) + 1 for coefficients in self.coefficients])
        return float(self.samples @ np.log(self.innovations) + orders @ np.log(self.samples))

    def at_motion(self, motion: Floats) -> Floats:
        """(C,) variances of white noise that is as strong where the `motion` (C, N) has its power; NaN where it is missing."""
        variances = self.variances
        for channel in self.channels:
            power = np.nanvar(motion[channel])
            whitened_power = np.nanvar(_innovations(motion[channel], self.coefficients[channel]))
            if power > 0.0 and whitened_power > 0.0:
                variances[channel] = self.innovations[channel] * power / whitened_power
        return variances

    def drawn(self, white: Floats, channel: int) -> Floats:
        """Noise of a channel, in units of the deviations that the residuals are whitened by, from `white` noise (N, d)."""
        power = self._spectrum(channel, len(white))[: len(white) // 2 + 1, None]
        return np.asarray(np.fft.irfft(np.fft.rfft(white, axis=0) * np.sqrt(power), len(white), axis=0))

    def score_covariance(self, rows: Floats, linked: Bools, samples: int) -> Floats:
        """(p, p) covariance that this noise gives to the sums of `rows` (K, M C, p) times residuals, in segments of so many
        `samples`.

        With white noise of unit variance it would be the information.
        """
        columns = rows.reshape(len(rows), samples, -1, rows.shape[2]).transpose(1, 2, 0, 3)
        total = np.zeros((columns.shape[-1],) * 2)
        for channel in range(len(self.innovations)):
            along = in_time(columns[:, channel].transpose(0, 2, 1), linked, fill=0.0)
            length = scipy.fft.next_fast_len(along.shape[1] + _APART, real=True)
            waves = np.fft.rfft(along, length)
            power = self._spectrum(channel, length)[: waves.shape[1]] / length
            power[1 : (length + 1) // 2] *= 2.0  # the negative frequencies
            total += ((waves * power) @ waves.conj().T).real
        return total

    def _spectrum(self, channel: int, length: int) -> Floats:
        """(length,) power at the frequencies of a discrete Fourier transform, whose mean is the variance.

        At frequencies at which the innovations have less than their mean power it is that of the autoregression.
        """
        response = np.fft.fft(np.append(1.0, -self.coefficients[channel]), length)
        left = 2.0 * np.fft.fft(self.correlations[channel], length).real - 1.0
        return np.asarray(self.innovations[channel] * np.maximum(left, 1.0) / np.abs(response) ** 2)


def in_time(values: Floats, linked: Bools, fill: float = np.nan) -> Floats:
    """(C, N) series of `values` (M, C, K) in segments; between chains of them `fill`, for longer than noise is remembered."""
    samples, channels, count = values.shape
    chain = np.append(0, np.cumsum(~linked))
    firsts = np.arange(count) * samples + chain * _APART
    series = np.full((channels, int(firsts[-1]) + samples), fill)
    series[:, firsts[:, None] + np.arange(samples)] = values.transpose(1, 2, 0)
    return series


def _autoregression(series: Floats) -> Floats | None:
    """Coefficients of a series with gaps (NaN), none of a white one; None where it is no such noise."""
    if is_white(series):
        return np.zeros(0)
    highest = min(_HIGHEST_ORDER, int(np.isfinite(series).sum()) // _SAMPLES_PER_LAG)
    coefficients = _of_order(_autocovariances(series, highest), int(np.isfinite(series).sum()))
    poles = np.roots(np.append(1.0, -coefficients))
    innovations = _innovations(series, coefficients)
    steady = is_white(innovations) and _is_steady(innovations)
    if not len(coefficients) or np.max(np.abs(poles)) > _LARGEST_POLE or not steady:
        return None
    return None if _resonates(coefficients) else coefficients


def _resonates(coefficients: Floats) -> bool:
    """Whether most power is in a peak as narrow as that of a lightly damped mode.

    Poles near the circle alone do not tell: noise whose spectrum has a notch has them all around it. At fewer than three
    samples a period a peak has its mirror image at the sampling rate less its frequency; its upper side is then looked at
    half-way to half the rate, where a mode stands out less. Noise in the last quarter of the band alone looks the same.
    """
    poles = np.roots(np.append(1.0, -coefficients))
    turning = poles[(poles.imag > 0.0) & (np.abs(poles) > 0.0)]
    decay, frequency = -np.log(np.abs(turning)), np.angle(turning)
    narrow = decay < _LIGHTLY_DAMPED * np.hypot(decay, frequency)
    mean = np.mean(_gain(coefficients, np.linspace(0.0, np.pi, 1024)))
    for width, peak in zip(decay[narrow], frequency[narrow], strict=True):
        above = min(_BESIDE, (np.pi - peak) / (2.0 * width))
        left, top, right = _gain(coefficients, peak + width * np.array([-_BESIDE, 0.0, above]))
        least = _PROMINENT * (1.0 + above**2) / (1.0 + _BESIDE**2)
        if top > mean and top > _PROMINENT * left and top > least * right:
            return True
    return False


def _gain(coefficients: Floats, frequency: Floats) -> Floats:
    """Power of the autoregression over that of its innovations at frequencies in radians a sample."""
    lag = np.arange(len(coefficients) + 1)
    response = np.exp(-1j * np.outer(frequency, lag)) @ np.append(1.0, -coefficients)
    return np.asarray(np.abs(response) ** -2.0)


def _autocovariances(series: Floats, highest: int) -> Floats:
    observed = np.isfinite(series)
    filled = np.where(observed, series, 0.0)
    count = len(series)
    return np.array(
        [
            np.dot(filled[: count - lag], filled[lag:])
            / max(int(np.sum(observed[: count - lag] & observed[lag:])), 1)
            for lag in range(highest + 1)
        ]
    )


def _of_order(covariances: Floats, samples: int) -> Floats:
    """The autoregression of the order that Schwarz's criterion chooses."""
    if not covariances[0] > 0.0:
        return np.zeros(0)
    best, lowest = np.zeros(0), samples * np.log(covariances[0])
    for order in range(1, len(covariances)):
        coefficients = scipy.linalg.solve_toeplitz(covariances[:order], covariances[1 : order + 1])
        variance = covariances[0] - coefficients @ covariances[1 : order + 1]
        if not variance > 0.0:
            break
        criterion = samples * np.log(variance) + order * np.log(samples)
        if criterion < lowest:
            best, lowest = coefficients, criterion
    return best


def _innovations(series: Floats, coefficients: Floats) -> Floats:
    """The innovations of `series` (N,); NaN where one of the samples that they follow from is missing."""
    return np.convolve(series, np.append(1.0, -coefficients), mode="valid")


def _tapered(innovations: Floats) -> Floats:
    """Their autocorrelations times Parzen's window, whose transform is never negative."""
    highest = min(_SMOOTHED, int(np.isfinite(innovations).sum()) // _SAMPLES_PER_LAG)
    covariances, lag = _autocovariances(innovations, highest), np.arange(highest + 1) / (highest + 0.5)
    # importing `scipy.signal`, which has it (Parzen 1961), takes longer than a fit
    window = np.where(lag <= 0.5, 1.0 - 6.0 * lag**2 * (1.0 - lag), 2.0 * (1.0 - lag) ** 3)
    return np.asarray(window * covariances / covariances[0])


def _is_steady(innovations: Floats) -> bool:
    """Whether the innovations of consecutive blocks have the same power."""
    squares = innovations[np.isfinite(innovations)] ** 2
    if len(squares) < _BLOCKS:
        return False
    blocks = np.array_split(squares / squares.mean(), _BLOCKS)
    power, count = np.array([block.mean() for block in blocks]), np.array([len(block) for block in blocks])
    departure = float(np.sum(0.5 * count * (power - 1.0) ** 2))
    return departure < float(scipy.special.chdtri(_BLOCKS - 1, _FALSE_ALARM))


_REWEIGHTED = AnnealingSchedule(initial_q=0.01, smallest_factor=0.003, trust_per_sample=10.0)


@dataclass(frozen=True, eq=False)
class ColouredFit:
    """A fit with coloured `noise`.

    Attributes
    ----------
    fit : AnnealingFit
        The optimum.
    noise : ColouredNoise
        The noise about it.
    covariance : array of shape (p + o + g, p + o + g)
        Of parameters, offsets, gains and delays.
    cost : float
        -2 log of the marginal likelihood and the penalty of the noise's coefficients, to be compared with a model error's.
    """

    fit: AnnealingFit
    noise: ColouredNoise
    covariance: Floats
    cost: float

    @property
    def chi_square(self) -> float:
        """Power of the residuals over that of the noise found."""
        squares = np.sum(self.fit.misfit.residuals**2, axis=(0, 2))
        return float(np.sum(squares / self.noise.variances) / self.noise.samples.sum())


def with_coloured_noise(fit: AnnealingFit, annealer: Annealer) -> ColouredFit | None:
    """The fit with noise as coloured as the residuals of `fit`; None where they are white, or not such noise.

    `fit` need not have converged: too tight a weight on a coloured channel may be the cause.
    """
    if fit.status is AnnealingStatus.INTERRUPTED or not isinstance(fit.misfit.loss, Gaussian):
        return None
    segments = fit.misfit.segments
    first = ColouredNoise.of(fit.misfit.residuals, segments.linked)
    if first is None:
        return None
    left = fit.misfit.residuals * segments.deviations(fit.scales)
    shown = np.where(segments.observed, segments.samples - left, np.nan)
    weights = np.sqrt(first.at_motion(in_time(shown, segments.linked)))
    coloured = np.isin(np.arange(len(weights)), first.channels)
    again = annealer(fit.misfit.at(fit.point, np.where(coloured, weights, 1.0)), _REWEIGHTED)
    if again.status is not AnnealingStatus.CONVERGED:
        return None
    noise = ColouredNoise.of(again.misfit.residuals, segments.linked)
    covariance = None if noise is None else _covariance(again, noise)
    if noise is None or covariance is None:
        return None
    factor, cost = evidence(again)
    cost -= 2.0 * degrees_of_freedom(again) * np.log(factor)
    in_first_units = 2.0 * noise.samples @ np.log(again.scales.sigma / fit.scales.sigma)
    searched = fit.path if fit.status is AnnealingStatus.CONVERGED else ()
    return ColouredFit(
        replace(again, path=max(searched, again.path, key=len)),
        noise,
        covariance,
        float(cost + noise.information + in_first_units),
    )


def _covariance(fit: AnnealingFit, noise: ColouredNoise) -> Floats | None:
    segments = fit.misfit.segments
    rows = eliminated_rows(fit.misfit, fit.q)
    if rows is None:
        return None
    units = fit.scales.theta
    scores = noise.score_covariance(rows, segments.linked, len(segments.samples)) / np.outer(units, units)
    if segments.prior is not None:
        scores[np.diag_indices(len(units))] += segments.prior.curvature(np.ones(len(units)))
    return np.asarray(fit.covariance @ scores @ fit.covariance)
