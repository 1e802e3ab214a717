"""Noise of sensors that is correlated from sample to sample: its autoregression, and what it does to scores.

The residuals r of a channel with such noise follow r_t = a_1 r_(t-1) + ... + a_p r_(t-p) + e_t, e white, whatever the motion.
Residuals of laws that are wrong do not: they resonate where the motion does, and fade with it. Noise is distinguished from
them by innovations e that are white and of one size throughout, and by poles that are far from the unit circle.

References
----------
W. K. Newey and K. D. West, Econometrica 55, 703 (1987), for the variance of scores under correlated noise.

D. W. K. Andrews and J. C. Monahan, Econometrica 60, 953 (1992), for whitening before the spectrum is smoothed.

Model error: the most likely error of the flow, beside the noise of the sensors, where the laws are not exact.

A fit whose residuals are autoregressive noise of sensors: channels weighted anew, and the covariance by the scores.

The likelihood goes on as if the noise were white, each channel with the variance that its noise has where the motion is. The
estimates are then as good as their weights, which need not be exact, and their covariance is that of an M-estimator, H^-1 J
H^-1: H the information, J the covariance of the scores under the noise that was found (Newey and West 1987).

Noise that was found too large: motion that fills the band up to half the sampling rate is taken for a part of it.

A fit of laws that are right shows less. Its residuals, per degree of freedom, are no less than the noise, whatever the laws
are, and so the noise of each channel may be lowered to them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.linear_model import EliminatedRows, eliminated_rows, linear_model
from linkwise.likelihood.shooting.minimise import (
    Annealer,
    AnnealingFit,
    AnnealingSchedule,
    AnnealingStatus,
    freedom,
)
from linkwise.likelihood.shooting.residuals import Gaussian, Loss, Misfit
from linkwise.likelihood.shooting.segments import Iterate, Scales, Segments
from linkwise.likelihood.whiteness import is_white

_RATIO = 3.0  # of neighbouring relaxations on the grid
_COUNT = 19  # relaxations on the grid, from q = 1e-5 to 4e3
# of all fits of a grid; a search that takes more creeps, and its laws are not those of the record
_MOST_STEPS = 400
_WORSE = 0.1  # of the cost: a point less than this above the best is on a plateau; the cost may fall beyond


@dataclass(frozen=True, eq=False)
class ModelErrorCandidate:
    """A fit at a relaxation, its factor on the noise, and -2 log of its marginal likelihood.

    `exact` where the laws need no model error: the search went down to them from one, and they are as likely without.
    `surpassed` where a search at the next relaxation, which may be likelier, did not converge.
    """

    fit: AnnealingFit
    noise: float
    cost: float
    exact: bool = False
    surpassed: bool = False


def with_model_error(
    segments: Segments, fit: AnnealingFit, start: Iterate, annealer: Annealer
) -> ModelErrorCandidate | None:
    """The most likely division of the residuals into noise of the sensors and errors of the flow.

    For every relaxation q of a geometric grid the orbit is fitted again and the noise profiled out; the marginal likelihood
    in the Laplace approximation selects q. The search goes up from a converged fit; without one, where the laws are too far
    off, it goes down from the `start`, to exact laws at most. None where no point of the grid is the best.
    """
    if fit.status is AnnealingStatus.CONVERGED:
        grid = [fit.q * _RATIO**power for power in range(_COUNT)]
        return _grid_search(segments, fit.point, fit.scales, grid, annealer)
    exact = AnnealingSchedule.final_q
    above = [q for q in (_RATIO**-power for power in range(_COUNT)) if q > exact]
    best = _grid_search(segments, start, fit.scales, [*above, exact], annealer)
    if best is not None and best.fit.q == 1.0:
        grid = [_RATIO**power for power in range(_COUNT)]
        return _grid_search(segments, best.fit.point, fit.scales, grid, annealer)
    return best


def _grid_search(
    segments: Segments, point: Iterate, scales: Scales, grid: Sequence[float], annealer: Annealer
) -> ModelErrorCandidate | None:
    """The best relaxation, once two worse ones follow it, or of those before a search that does not converge, or takes too
    many steps; None where the grid ends before.

    The last point of a grid that goes down stands for exact laws, and is taken where it is as likely. An interrupt from the
    keyboard ends the search where it is.
    """
    best, worse, steps = None, 0, 0
    for q in grid:
        fit = annealer(segments, point, scales, AnnealingSchedule(initial_q=q, final_q=q))
        if fit.status is AnnealingStatus.INTERRUPTED:
            return ModelErrorCandidate(fit, 1.0, np.inf)
        steps += len(fit.path)
        if fit.status is not AnnealingStatus.CONVERGED or steps > _MOST_STEPS:
            return best and replace(best, surpassed=True)
        point = fit.point
        noise, cost = evidence(segments, fit, q, annealer.loss)
        if best is None or cost < best.cost:
            best, worse = ModelErrorCandidate(fit, noise, cost), 0
        elif cost > best.cost + _WORSE:
            worse += 1
        if worse == 2:
            return best
    if best is not None and grid[-1] < grid[0] and cost <= best.cost + _WORSE:
        return ModelErrorCandidate(fit, noise, cost, exact=True)
    return best if best is not None and best.fit.q != grid[-1] else None


def evidence(segments: Segments, fit: AnnealingFit, q: float, loss: Loss) -> tuple[float, float]:
    """The most likely factor on the noise (and on q) of this orbit, and -2 log of the marginal likelihood with it."""
    linear = linear_model(fit.misfit)
    factor = linear.equations(q).factor()
    if factor is None:
        return 1.0, np.inf
    freedom = degrees_of_freedom(segments, fit)
    defects = segments.system.dimension * int(segments.linked.sum())
    noise = np.sqrt(fit.misfit.cost_of_samples(q) / (freedom * loss.expected))
    return float(noise), float(
        2.0 * freedom * np.log(noise) + 2.0 * defects * np.log(q) + factor.log_determinant(~fit.at_bound)
    )


def degrees_of_freedom(segments: Segments, fit: AnnealingFit) -> int:
    """Residuals, priors and defects less nodes and parameters."""
    defects = segments.system.dimension * int(segments.linked.sum())
    nodes = segments.system.dimension * int((~segments.unconstrained).sum())
    known = 0 if segments.prior is None else segments.prior.count
    return fit.samples + known + defects - nodes - int((~fit.at_bound).sum())


def lag_one_autocorrelation(misfit: Misfit) -> float:
    """Largest autocorrelation at one sample among the channels' residuals."""
    r = misfit.residuals
    before, after = r[:-1], r[1:]
    power = np.maximum(np.sum(r**2, axis=(0, 2)) * (1.0 - 1.0 / len(r)), np.finfo(float).tiny)
    return float(np.max(np.sum(before * after, axis=(0, 2)) / power))


def residual_levels(segments: Segments, misfit: Misfit) -> Floats:
    """(C,) root mean square of the residuals of each channel."""
    counts = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    return np.asarray(np.sqrt(np.sum(misfit.residuals**2, axis=(0, 2)) / counts))


_CHANCE = 2.0  # standard deviations of chi-square
_LEAST = 0.08  # by which chi-square is below 1: what the estimate of the noise scatters by in long records
_STEPS = 20  # beside the optimum; a search that takes more may creep along a bend of the likelihood ...
_LOOSE = 0.01  # ... which looser links straighten: the relaxation from which it starts again


def with_noise_of_residuals(
    segments: Segments, fit: AnnealingFit, annealer: Annealer, lowest: Floats
) -> AnnealingFit:
    """A fit whose chi-square is below 1 again, with the noise of its residuals in place of that found beforehand.

    Parameters
    ----------
    segments : Segments
        The records.
    fit : AnnealingFit
        The fit.
    annealer : Annealer
        Fits again.
    lowest : array of shape (C,)
        The least deviations; infinite where the noise of a channel is stated, which stays as it is.

    Returns
    -------
    AnnealingFit
        The fit; the given one where its chi-square is not below 1, or without an optimum.
    """
    least = max(_LEAST, _CHANCE * np.sqrt(2.0 / fit.samples))
    if fit.status is not AnnealingStatus.CONVERGED or fit.chi_square > 1.0 - least:
        return fit
    if not isinstance(annealer.loss, Gaussian):  # whose mean cost alone is that of the noise
        return fit
    levels = residual_levels(segments, fit.misfit) * np.sqrt(fit.samples / freedom(segments))
    factors = np.clip(levels, np.minimum(lowest / fit.scales.sigma, 1.0), 1.0)
    if (factors == 1.0).all():
        return fit
    scales = replace(fit.scales, sigma=fit.scales.sigma * factors)
    tight = AnnealingSchedule(initial_q=fit.q, final_q=fit.q, max_steps=_STEPS)
    again = annealer(segments, fit.point, scales, tight)
    if again.status in (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK):
        loose = AnnealingSchedule(initial_q=max(fit.q, _LOOSE), final_q=fit.q)
        again = annealer(segments, fit.point, scales, loose)
    if again.status is AnnealingStatus.INTERRUPTED:
        return again
    if again.status is not AnnealingStatus.CONVERGED:
        return fit
    return replace(again, path=(*fit.path, *again.path))


_ROUNDS = 4  # of a search with the noise that the one before left
_EVEN = 0.05  # by which that differs at most where it has settled


def with_noise_from_misfit(
    segments: Segments, start: Iterate, fit: AnnealingFit, annealer: Annealer
) -> AnnealingFit | None:
    """The fit of exact laws from a `start`, with what a `fit` that did not converge left of each channel as its noise.

    Beside noise that is far below what laws leave, what is known beforehand, as of the modes of a host, counts for nothing:
    the search creeps along directions that the records hardly determine. None where it does not converge either; an interrupt
    from the keyboard ends it where it is.
    """
    point, schedule = start, AnnealingSchedule()
    for _ in range(_ROUNDS):
        levels = residual_levels(segments, fit.misfit)
        settled = fit.status is AnnealingStatus.CONVERGED and np.abs(levels - 1.0).max() < _EVEN
        if settled or fit.status is AnnealingStatus.INTERRUPTED:
            break
        levels = np.where(levels > 0.0, levels, 1.0)
        fit = annealer(segments, point, replace(fit.scales, sigma=fit.scales.sigma * levels), schedule)
        point, schedule = fit.point, AnnealingSchedule(initial_q=fit.q, final_q=fit.q)
    return fit if fit.status in (AnnealingStatus.CONVERGED, AnnealingStatus.INTERRUPTED) else None


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

    def score_covariance(self, rows: Iterable[EliminatedRows], linked: Bools, samples: int) -> Floats:
        """(p, p) covariance that this noise gives to the sums of `rows` times residuals, in segments of so many `samples`.

        With white noise of unit variance it would be the information.
        """
        chunks = [
            chunk.data.reshape(len(chunk.data), samples, -1, chunk.data.shape[-1]).transpose(1, 2, 0, 3)
            for chunk in rows
        ]
        columns = np.concatenate(chunks, axis=2)
        total = np.zeros((columns.shape[-1],) * 2)
        for channel, variance in enumerate(self.innovations):
            own = columns[:, channel]
            if not len(self.coefficients[channel]):
                flat = own.reshape(-1, own.shape[-1]).astype(float)
                total += variance * (flat.T @ flat)
                continue
            along = in_time(own.transpose(0, 2, 1), linked, fill=0.0)
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


def with_coloured_noise(segments: Segments, fit: AnnealingFit, annealer: Annealer) -> ColouredFit | None:
    """The fit with noise as coloured as the residuals of `fit`; None where they are white, or not such noise.

    `fit` need not have converged: too tight a weight on a coloured channel may be the cause.
    """
    if fit.status is AnnealingStatus.INTERRUPTED or not isinstance(annealer.loss, Gaussian):
        return None
    first = ColouredNoise.of(fit.misfit.residuals, segments.linked)
    if first is None:
        return None
    left = fit.misfit.residuals * segments.deviations(fit.scales)
    shown = np.where(segments.observed, segments.samples - left, np.nan)
    weights = np.sqrt(first.at_motion(in_time(shown, segments.linked)))
    coloured = np.isin(np.arange(len(weights)), first.channels)
    scales = replace(fit.scales, sigma=fit.scales.sigma * np.where(coloured, weights, 1.0))
    again = annealer(segments, fit.point, scales, _REWEIGHTED)
    if again.status is not AnnealingStatus.CONVERGED:
        return None
    noise = ColouredNoise.of(again.misfit.residuals, segments.linked)
    covariance = None if noise is None else _covariance(segments, again, noise, annealer)
    if noise is None or covariance is None:
        return None
    factor, cost = evidence(segments, again, again.q, annealer.loss)
    cost -= 2.0 * degrees_of_freedom(segments, again) * np.log(factor)
    in_first_units = 2.0 * noise.samples @ np.log(scales.sigma / fit.scales.sigma)
    searched = fit.path if fit.status is AnnealingStatus.CONVERGED else ()
    return ColouredFit(
        replace(again, path=max(searched, again.path, key=len)),
        noise,
        covariance,
        float(cost + noise.information + in_first_units),
    )


def _covariance(
    segments: Segments, fit: AnnealingFit, noise: ColouredNoise, annealer: Annealer
) -> Floats | None:
    rows = eliminated_rows(fit.misfit, fit.q)
    if rows is None:
        return None
    units = fit.scales.theta
    scores = noise.score_covariance(rows, segments.linked, len(segments.samples)) / np.outer(units, units)
    if segments.prior is not None:
        scores[np.diag_indices(len(units))] += segments.prior.curvature(np.ones(len(units)))
    return np.asarray(fit.covariance @ scores @ fit.covariance)
