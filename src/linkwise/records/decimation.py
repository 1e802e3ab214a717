"""The anti-alias filter of `Record.decimate`: a symmetric Kaiser-windowed low-pass."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError

ATTENUATION = 80.0  # dB, above the new Nyquist frequency
PASSBAND = 0.8  # of the new Nyquist frequency; there the gain is 1 within 10^(-ATTENUATION / 20)


@dataclass(frozen=True, eq=False)
class Lowpass:
    """A symmetric filter of `length` = 2 `half` + 1 taps that keeps every `factor`-th of its outputs."""

    factor: int
    taps: Floats

    @property
    def length(self) -> int:
        """Number of taps: samples that enter one output."""
        return len(self.taps)

    @property
    def half(self) -> int:
        """Number of samples dropped at each end."""
        return len(self.taps) // 2

    @property
    def noise_gain(self) -> float:
        """The factor by which the standard deviation of white noise shrinks."""
        return float(np.sqrt(np.sum(self.taps**2)))

    def apply(self, values: Floats) -> Floats:
        """`values` (N, C) filtered along time and decimated, both ends dropped: ((N - length) // factor + 1, C)."""
        size = (
            1 << (len(values) - 1).bit_length()
        )  # wrap-around affects the first length - 1 outputs only, which are dropped
        spectrum = np.fft.rfft(values, size, axis=0) * np.fft.rfft(self.taps, size)[:, np.newaxis]
        filtered = np.fft.irfft(spectrum, size, axis=0)
        return np.ascontiguousarray(filtered[self.length - 1 : len(values) : self.factor])


@lru_cache(maxsize=16)
def lowpass(factor: int) -> Lowpass:
    """The filter for decimation by `factor` >= 2: flat up to `PASSBAND`, `ATTENUATION` from the new Nyquist frequency on.

    Kaiser's formulas for window shape and length (Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5.3).
    """
    nyquist = np.pi / factor  # rad per sample before decimation
    width = (1.0 - PASSBAND) * nyquist
    beta = 0.1102 * (ATTENUATION - 8.7)
    half = int(np.ceil((ATTENUATION - 7.95) / (2.285 * width) / 2.0))
    lag = np.arange(-half, half + 1)
    cutoff = (nyquist - width / 2.0) / np.pi
    taps = cutoff * np.sinc(cutoff * lag) * np.kaiser(2 * half + 1, beta)
    return Lowpass(factor, taps / taps.sum())


def check_factor(factor: float) -> None:
    """Raise RecordError unless `factor` is a positive integer."""
    if isinstance(factor, bool) or int(factor) != factor or factor < 1:
        raise RecordError(f"factor must be a positive integer, got {factor!r}")


def lowpass_for(factor: int, samples: int) -> Lowpass:
    """The filter for a record of so many samples. Raises RecordError where it is longer than the record."""
    antialias = lowpass(factor)
    if samples < antialias.length:
        raise RecordError(
            f"{samples} samples are too few to decimate by {factor}: its anti-alias filter spans {antialias.length}"
        )
    return antialias
