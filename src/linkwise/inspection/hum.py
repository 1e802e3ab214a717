"""Hum of the mains: a line at 50 or 60 Hz or a harmonic that keeps its size and phase over the record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.inspection.alert import Alert
from linkwise.inspection.channel_signal import ChannelSignal
from linkwise.inspection.record_signals import RecordSignals

_MAINS = (50.0, 60.0)  # Hz
_HARMONICS = 3
_OFF = 0.1  # Hz by which the mains may be off
_PIECES = 16
_QUIET = 9  # of them, those with the least motion, that are looked at
_CYCLES = 4.0  # in a piece
_SPREAD = 0.3  # of its size: how far the line may be from steady in a piece, root mean square
_ABOVE = 5.0  # times the noise of a line in all pieces together
_INPUT = 12  # harmonics of the frequency of an input that are no hum, of a sine all
_SPACED = 10.0  # times as far apart as they are sharp: harmonics of a sine, of any order, that a line hardly meets by chance
_REFINEMENTS = 3  # of the frequency of an input
_SINE = 0.95  # of the power of an input in one line: a sine


@dataclass(frozen=True)
class _Driven:
    """The `frequency` in Hz at which an input is strongest, and its number of harmonics that a motion may have."""

    frequency: float
    harmonics: float


def hum(signals: RecordSignals) -> Iterator[Alert]:
    """Alerts of channels with a steady line of the mains."""
    driven = [_peak(signal) for signal in signals.moving if signal.is_input]
    for signal in signals.responses:
        steady = [
            line
            for mains in _MAINS
            for order in range(1, _HARMONICS + 1)
            if (frequency := order * mains) < 0.45 * signal.rate
            and not any(_is_harmonic(frequency, of, signals.record.duration) for of in driven)
            and (line := _steady_line(signal, frequency))[1]
        ]
        if not steady:
            continue
        lines = " and ".join(
            f"{size:.3g} {signal.channel.unit} at {frequency:.5g} Hz" for frequency, size in steady
        )
        message = (
            f"carries a line that neither grows nor decays, of {lines}: hum of the mains acts like an applied force and "
            "biases damping; shield and ground the sensor, or find the line with the laws"
        )
        error = float(np.sqrt(0.5 * sum(size**2 for _, size in steady))) / signal.rms
        frequencies = tuple(frequency for frequency, _ in steady)
        yield Alert("hum", signal.name, message, error, arguments=("hums",), frequencies=frequencies)


def _peak(signal: ChannelSignal) -> _Driven:
    """The strongest line of an input, between the lines of its spectrum: a harmonic is off by a multiple of what it is off."""
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
    return _Driven(frequency, np.inf if is_sine else _INPUT)


def _is_harmonic(frequency: float, driven: _Driven, duration: float) -> bool:
    """Whether a line belongs to the frequency of an input, or to the half or the third of it."""
    resolution, of = 2.0 / duration, driven.frequency
    near = resolution + _OFF
    most = driven.harmonics if of > _SPACED * near else min(driven.harmonics, _INPUT)
    multiples = [frequency * part / max(of, resolution) for part in (1, 2, 3)]
    return any(
        round(multiple) <= most and abs(multiple - round(multiple)) * of < near for multiple in multiples
    )


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
    quiet = np.argsort(np.std(values.reshape(_PIECES, size), axis=1))[
        :_QUIET
    ]  # there a motion hides the line least
    pieces, middles = pieces[quiet], middles[quiet]
    sums = np.exp(-2j * np.pi * np.outer(offsets, middles)) @ pieces / _QUIET
    best = int(np.argmax(np.abs(sums)))
    amplitude = float(abs(sums[best]))
    left = pieces * np.exp(-2j * np.pi * offsets[best] * middles) - sums[best]
    scatter = float(np.sqrt(np.mean(np.abs(left) ** 2)))
    noise = float(np.nan_to_num(signal.sigma)) * 2.0 * float(np.sqrt(np.sum(window**2)) / window.sum())
    steady = (
        scatter < _SPREAD * amplitude + 1.5 * noise and amplitude > _ABOVE * max(noise, scatter) / _QUIET**0.5
    )
    at = frequency + float(offsets[best])
    return at, amplitude if steady and _is_line(signal, at) else 0.0


def _is_line(signal: ChannelSignal, frequency: float) -> bool:
    """Whether the line stands out of its neighbourhood in the spectrum of the whole record."""
    values = signal.filled - signal.observed.mean()
    window = np.hanning(len(values))
    power: Floats = np.abs(np.fft.rfft(values * window)) ** 2
    at = round(frequency * len(values) / signal.rate)
    near = slice(max(at - 40, 1), at + 41)
    line = power[max(at - 2, 0) : at + 3].max()
    around = np.delete(power[near], np.arange(max(at - 4, 1) - near.start, at + 5 - near.start))
    return bool(line > 25.0 * np.median(around))
