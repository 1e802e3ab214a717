"""Checks of spectra: hum of the mains, motion up to half the sampling rate, coloured noise, too few samples, implausible
units.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.channel_signal import ChannelSignal, RecordSignals
from linkwise.inspection.result import Alert
from linkwise.inspection.sample_faults import without_spikes
from linkwise.signals.force_window import UNDERSAMPLED, coarse_hits, coarseness

_MAINS = (50.0, 60.0)  # Hz
_HARMONICS = 3
_OFF = 0.1  # Hz by which the mains may be off
_PIECES = 16
_QUIETEST = 9  # of them, those with the least motion, that are looked at
_CYCLES = 4.0  # in a piece
_SPREAD = 0.3  # of its size: how far the line may be from steady in a piece, root mean square
_ABOVE = 5.0  # times the noise of a line in all pieces together
_INPUT = 12  # harmonics of the frequency of an input that are no hum, of a sine all
_SPACED = 10.0  # times as far apart as they are sharp: harmonics of a sine, of any order, that a line hardly meets by chance
_REFINEMENTS = 3  # of the frequency of an input
_SINE = 0.95  # of the power of an input in one line: a sine


def hum(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels with a steady line of the mains."""
    driven = [_strongest_frequency(signal) for signal in signals.moving if signal.is_input]
    for signal in signals.responses:
        steady = [
            line
            for mains in _MAINS
            for order in range(1, _HARMONICS + 1)
            if (frequency := order * mains) < 0.45 * signal.rate
            and not any(_is_harmonic_of_input(frequency, of, signals.record.duration) for of in driven)
            and (line := _steady_line(signal, frequency))[1]
        ]
        if not steady:
            continue
        lines = " and ".join(f"{size:.3g} {signal.unit} at {frequency:.5g} Hz" for frequency, size in steady)
        message = (
            f"carries a line that neither grows nor decays, of {lines}: hum of the mains acts like an applied force and "
            "biases damping; shield and ground the sensor, or find the line with the laws"
        )
        error = float(np.sqrt(0.5 * sum(size**2 for _, size in steady))) / signal.rms
        frequencies = tuple(frequency for frequency, _ in steady)
        yield Alert("hum", signal.channel, message, error, arguments=("hums",), frequencies=frequencies)


def _strongest_frequency(signal: ChannelSignal) -> tuple[float, float]:
    """The frequency in Hz at which an input is strongest, and the number of its harmonics that a motion may have.

    It is found between the lines of the spectrum: a harmonic is off by a multiple of what it is off.
    """
    values = signal.filled - signal.filled.mean()
    window = np.hanning(len(values) + 2)[1:-1]
    time = np.arange(len(values)) / signal.rate
    power = np.abs(np.fft.rfft(values)) ** 2
    line, spacing = int(np.argmax(power)), signal.rate / len(values)

    def size(frequency: float) -> float:
        return float(abs(np.exp(-2j * np.pi * frequency * time) @ (window * values)))

    frequency = line * spacing
    for _ in range(_REFINEMENTS):  # of which each is ten times as fine
        nearby = np.maximum(frequency + spacing * np.linspace(-1.0, 1.0, 21), 0.0)
        frequency = float(nearby[int(np.argmax([size(f) for f in nearby.tolist()]))])
        spacing *= 0.1
    amplitude = 2.0 * size(frequency) / float(np.sum(window))
    is_sine = 0.5 * amplitude**2 > _SINE * float(np.mean(values**2))
    return frequency, np.inf if is_sine else _INPUT


def _is_harmonic_of_input(frequency: float, driven: tuple[float, float], duration: float) -> bool:
    """Whether a line belongs to the frequency of an input, or to the half or the third of it."""
    resolution, (of, harmonics) = 2.0 / duration, driven
    near = resolution + _OFF
    most = harmonics if of > _SPACED * near else min(harmonics, _INPUT)
    multiples = [frequency * part / max(of, resolution) for part in (1, 2, 3)]
    return any(round(times) <= most and abs(times - round(times)) * of < near for times in multiples)


def _steady_line(signal: ChannelSignal, frequency: float) -> tuple[float, float]:
    """The frequency and the amplitude of a steady line near a frequency; an amplitude of 0 where there is none."""
    size = len(signal.values) // _PIECES
    if size * frequency < _CYCLES * signal.rate:
        return frequency, 0.0
    values = signal.filled[: size * _PIECES] - signal.observed.mean()
    turns = np.exp(-2j * np.pi * frequency / signal.rate * np.arange(size * _PIECES))
    window = np.hanning(size + 2)[1:-1]
    pieces = ((values * turns).reshape(_PIECES, size) @ window) * (2.0 / window.sum())
    middles = (np.arange(_PIECES) + 0.5) * size / signal.rate
    offsets = np.linspace(-_OFF, _OFF, 81)
    # there a motion hides the line least
    quiet = np.argsort(np.std(values.reshape(_PIECES, size), axis=1))[:_QUIETEST]
    pieces, middles = pieces[quiet], middles[quiet]
    sums = np.exp(-2j * np.pi * np.outer(offsets, middles)) @ pieces / _QUIETEST
    best = int(np.argmax(np.abs(sums)))
    amplitude = float(abs(sums[best]))
    left = pieces * np.exp(-2j * np.pi * offsets[best] * middles) - sums[best]
    scatter = float(np.sqrt(np.mean(np.abs(left) ** 2)))
    noise = float(np.nan_to_num(signal.sigma)) * 2.0 * float(np.sqrt(np.sum(window**2)) / window.sum())
    audible = amplitude > _ABOVE * max(noise, scatter) / _QUIETEST**0.5
    steady = audible and scatter < _SPREAD * amplitude + 1.5 * noise
    at = frequency + float(offsets[best])
    return at, amplitude if steady and _stands_out(signal, at) else 0.0


def _stands_out(signal: ChannelSignal, frequency: float) -> bool:
    """Whether the line stands out of its neighbourhood in the spectrum of the whole record."""
    values = signal.filled - signal.observed.mean()
    window = np.hanning(len(values))
    power: Floats = np.abs(np.fft.rfft(values * window)) ** 2
    at = round(frequency * len(values) / signal.rate)
    near = slice(max(at - 40, 1), at + 41)
    line = power[max(at - 2, 0) : at + 3].max()
    around = np.delete(power[near], np.arange(max(at - 4, 1) - near.start, at + 5 - near.start))
    return bool(line > 25.0 * np.median(around))


_TOP = 0.9  # of half the sampling rate
_SHARE = 0.03  # of the power if it were spread evenly: what a band at the top may hold
_NOISE = 4.0  # times the noise
_BANDS = (0.3, 0.6), (0.7, 1.0)  # of half the sampling rate: noise that is white is as strong in both
_TILTED = 0.3  # logarithm of their ratio
_CERTAIN = 5.0  # standard errors
# relative, times the root of the bins, of the median of a periodogram with a Hann window
_MEDIAN_ERROR = 1.44 * 1.25
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
        yield Alert("aliasing", signal.channel, message, float(min(1.0, level / even)) ** 0.5)


def coloured(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose noise at rest is not white."""
    for signal in signals.responses:
        rest = signals.rest_of(signal)
        if rest is None:
            continue
        index, still = np.arange(rest.stop - rest.start), signal.filled[rest]
        values = still - np.polynomial.Polynomial.fit(index, still, 2)(index)
        sigma = float(values.std())
        tilt, error = _spectral_tilt(values)
        if sigma < max(_QUIET * signal.rms, 2.0 * signal.step) or abs(tilt) < max(_TILTED, _CERTAIN * error):
            continue
        correlations = [float(part[1:] @ part[:-1]) / len(part) for part in np.array_split(values, 3)]
        correlation = float(np.mean(correlations)) / sigma**2
        if np.ptp(correlations) > _STEADY * sigma**2:
            continue
        message = (
            f"has noise at rest of {sigma:.3g} {signal.unit} whose neighbouring samples are correlated by "
            f"{correlation:.2g}: the weak form takes noise for white, and its values and intervals come out wrong; use "
            "maximum likelihood, which allows for such noise, or reduce the rate until the noise is white"
        )
        yield Alert("coloured", signal.channel, message, sigma / signal.rms)


def _spectral_tilt(values: Floats) -> tuple[float, float]:
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


_FEWEST = 3.0  # samples in a period of the fastest motion that matters
_PERIODS = 3.0  # of the fastest motion
_SAMPLES = 100  # of a record


def few_samples(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses that move too fast for their sampling rate, and of forces whose hits are too short for it."""
    for signal in map(without_spikes, signals.responses):
        if signal.highest * _FEWEST <= signal.rate:
            continue
        message = (
            f"motion up to {signal.highest:.3g} Hz is sampled {signal.rate / signal.highest:.2g} times a period: derivatives "
            "and integrals between samples are guesses, and what is faster is aliased to lower frequencies; sample at "
            f"{10.0 * signal.highest:.2g} Hz or more, behind an anti-alias filter"
        )
        yield Alert("few-samples", signal.channel, message, 0.5)
    for name, samples in coarse_hits(signals.record, UNDERSAMPLED).items():
        within = f"{samples} samples, which tell the impulse of half a sine to within {100.0 * coarseness(samples):.2g} % only"
        message = f"its shortest hit has {within}: sample faster, or take a softer tip"
        yield Alert("few-samples", name, message, coarseness(samples))


def short(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of a record that holds too little."""
    record = signals.record
    moving = [signal for signal in map(without_spikes, signals.responses) if signal.highest > 0.0]
    for signal in moving:
        periods = record.duration * signal.highest
        if len(record) >= _SAMPLES and periods >= _PERIODS:
            continue
        message = (
            f"{len(record)} samples and {periods:.2g} periods of its motion are few: noise and spectrum cannot be estimated, "
            "and intervals are unreliable; record at least ten periods"
        )
        yield Alert("short", signal.channel, message, 0.3)


FASTEST = 340.0  # m/s, that of sound: no structure vibrates so fast over a whole record
STRONGEST = 1e5  # m/s^2: only microscopic structures are accelerated so strongly over a whole record


def unit(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of responses whose velocity or acceleration is beyond anything that vibrates."""
    motions = [signal for signal in signals.moving if signal.channel.is_motion]
    for signal in motions:
        if signal.unit == signal.channel.angular_unit or signal.highest <= 0.0:
            continue
        spectrum = signal.spectrogram
        inside = (spectrum.frequency > 0.0) & (spectrum.frequency <= signal.highest)
        omega = 2.0 * np.pi * spectrum.frequency[inside]
        velocity, acceleration = (
            float(np.sqrt(np.sum(spectrum.mean[inside] * omega**power) * spectrum.frequency[1]))
            for power in (2 * (order - signal.channel.order) for order in (1, 2))
        )
        if acceleration > STRONGEST:
            motion = f"accelerate by {acceleration:.2g} m/s^2 (root mean square), more than 100 km/s^2"
            unless = "unless the structure is microscopic, "
        elif velocity > FASTEST and signal.channel.kind != "a":  # whose drift is no velocity
            motion = f"move at {velocity:.2g} m/s (root mean square), faster than sound"
            unless = ""
        else:
            continue
        message = (
            f"would {motion}: {unless}its unit is not {signal.unit}, or the times are not in s, and all "
            "coefficients are wrong by powers of the factor; state the unit in the name of the column, such as [mm] or [ms]"
        )
        yield Alert("unit", signal.channel, message, np.inf, arguments=("channels",))
