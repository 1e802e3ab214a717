"""The floor of the spectrum: motion up to half the sampling rate, and noise that is not white."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.alert import Alert
from linkwise.inspection.record_signals import RecordSignals
from linkwise.inspection.spikes import without_spikes

_TOP = 0.9  # of half the sampling rate
_SHARE = 0.03  # of the power if it were spread evenly: what a band at the top may hold
_NOISE = 4.0  # times the noise
_BANDS = (0.3, 0.6), (0.7, 1.0)  # of half the sampling rate: noise that is white is as strong in both
_TILTED = 0.3  # logarithm of their ratio
_CERTAIN = 5.0  # standard errors
_MEDIAN_ERROR = (
    1.44 * 1.25
)  # relative, times the root of the bins, of the median of a periodogram with a Hann window
# of the autocovariance: how far the thirds of a rest may be apart; motion that decays is not noise
_STEADY = 0.3
_QUIET = 1e-6  # of the root mean square: what is quieter is rounding


def aliasing(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose spectrum does not fall before half the sampling rate."""
    for signal in map(without_spikes, signals.responses):
        spectrum = signal.spectrogram
        top = spectrum.frequency >= 0.5 * _TOP * signal.rate
        if not top.any():
            continue
        level = float(np.mean(spectrum.mean[top]))
        even = signal.rms**2 / (0.5 * signal.rate)
        noise = 2.0 * float(np.nan_to_num(signal.sigma)) ** 2 / signal.rate
        if level < max(_SHARE * even, _NOISE * noise):
            continue
        message = (
            f"moves up to half the sampling rate, {0.5 * signal.rate:g} Hz, with {100.0 * level / even:.2g} % of its mean "
            "spectral density there: faster motion is aliased to lower frequencies, where no law explains it; sample faster, "
            "and behind an anti-alias filter"
        )
        yield Alert("aliasing", signal.name, message, float(min(1.0, level / even)) ** 0.5)


def coloured(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose noise at rest is not white."""
    for signal in signals.responses:
        rest = signals.rest_of(signal)
        if rest is None:
            continue
        values = _detrended(signal.filled[rest])
        sigma = float(values.std())
        tilt, error = _tilt(values)
        if sigma < max(_QUIET * signal.rms, 2.0 * signal.step) or abs(tilt) < max(_TILTED, _CERTAIN * error):
            continue
        correlations = [float(part[1:] @ part[:-1]) / len(part) for part in np.array_split(values, 3)]
        correlation = float(np.mean(correlations)) / sigma**2
        if np.ptp(correlations) > _STEADY * sigma**2:
            continue
        message = (
            f"has noise at rest of {sigma:.3g} {signal.channel.unit} whose neighbouring samples are correlated by "
            f"{correlation:.2g}: the weak form takes noise for white, and its values and intervals come out wrong; use "
            "maximum likelihood, which allows for such noise, or reduce the rate until the noise is white"
        )
        yield Alert("coloured", signal.name, message, sigma / signal.rms)


def _detrended(values: Floats) -> Floats:
    """Values without the parabola through them."""
    index = np.arange(len(values)) / len(values) - 0.5
    polynomial = np.polynomial.Polynomial.fit(index, values, 2)
    return np.asarray(values - polynomial(index))


def _tilt(values: Floats) -> tuple[float, float]:
    """Logarithm of the ratio of the power in two bands above the motion, and its standard error for noise.

    Medians leave the lines of a motion out.
    """
    power: Floats = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    bands = [power[int(low * len(power)) : int(high * len(power))] for low, high in _BANDS]
    medians = [float(np.median(band)) for band in bands]
    if not min(medians) > 0.0:
        return 0.0, 1.0
    error = _MEDIAN_ERROR * float(np.sqrt(sum(1.0 / len(band) for band in bands)))
    return float(np.log(medians[0] / medians[1])), error
