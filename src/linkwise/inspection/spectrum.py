"""Power of a channel over time and frequency, and coherence of two over frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices

_LONGEST = 512  # samples of a block
_BLOCKS = 8  # that fit into a record side by side, where it is long enough
_CHANCE = 0.05
# blocks in place of one: neighbours under Hann windows that overlap by half (Welch 1967)
SHARED_BLOCKS = 1.0 + 2.0 / 36.0


@dataclass(frozen=True, eq=False)
class Spectrogram:
    """One-sided spectral densities of blocks that overlap by half.

    Attributes
    ----------
    frequency : array of shape (F,)
        Frequencies in Hz.
    time : array of shape (B,)
        Middles of the blocks in s from the first sample.
    power : array of shape (B, F)
        Spectral densities in the squared unit of the samples per Hz.
    """

    frequency: Floats
    time: Floats
    power: Floats

    @classmethod
    def of(cls, values: Floats, rate: float) -> Spectrogram:
        """That of samples (N,) at `rate` in Hz, without their mean, straight lines over missing samples."""
        first, block, window = _blocks(len(values))
        time = np.asarray((first + 0.5 * block) / rate, dtype=float)
        power = np.abs(_transformed(values)) ** 2 * (2.0 / (rate * np.sum(window**2)))
        power[:, 0] *= 0.5
        if block % 2 == 0:
            power[:, -1] *= 0.5
        return cls(_frequencies(len(values), rate), time, np.asarray(power, dtype=float))

    @property
    def mean(self) -> Floats:
        """Density averaged over time, shape (F,)."""
        return np.asarray(self.power.mean(axis=0))


@dataclass(frozen=True, eq=False)
class Coherence:
    """The part of the power of one channel that follows linearly from another.

    Attributes
    ----------
    frequency : array of shape (F,)
        Frequencies in Hz.
    values : array of shape (F,)
        From 0 to 1; 0 where a channel has no power.
    by_chance : float
        What independent noise exceeds in one of 20 frequencies; 1 where there is only one block.

    References
    ----------
    G. C. Carter, C. H. Knapp, A. H. Nuttall, "Estimation of the magnitude-squared coherence function via overlapped fast
    Fourier transform processing", IEEE Transactions on Audio and Electroacoustics 21 (1973), 337-344.
    """

    frequency: Floats
    values: Floats
    by_chance: float

    @classmethod
    def of(cls, first: Floats, second: Floats, rate: float) -> Coherence:
        """That of samples (N,) and (N,) at `rate` in Hz, without their means, straight lines over missing samples."""
        of_first, of_second = _transformed(first), _transformed(second)
        cross = np.abs(np.mean(of_first * of_second.conj(), axis=0)) ** 2
        power = np.mean(np.abs(of_first) ** 2, axis=0) * np.mean(np.abs(of_second) ** 2, axis=0)
        values = np.divide(cross, power, out=np.zeros(len(cross)), where=power > 0.0)
        blocks = len(of_first) / SHARED_BLOCKS
        by_chance = 1.0 - _CHANCE ** (1.0 / (blocks - 1.0)) if blocks > 1.0 else 1.0
        return cls(_frequencies(len(first), rate), values, by_chance)


def _transformed(values: Floats) -> NDArray[np.complex128]:
    """The Fourier transforms (B, F) of the blocks of samples (N,) without their mean."""
    first, block, window = _blocks(len(values))
    frames = _without_gaps(values)[first[:, None] + np.arange(block)] * window
    return np.fft.rfft(frames, axis=1)


def _without_gaps(values: Floats) -> Floats:
    """Samples (N,) less their mean, with straight lines over missing ones; zeros where all are missing."""
    present = np.flatnonzero(~np.isnan(values))
    if not len(present):
        return np.zeros(len(values))
    filled = np.interp(np.arange(len(values)), present, values[present])
    return np.asarray(filled - filled.mean())


def _frequencies(count: int, rate: float) -> Floats:
    """Frequencies (F,) in Hz of the transforms of `count` samples."""
    block = len(_blocks(count)[2])
    return np.linspace(0.0, block // 2 * rate / block, block // 2 + 1)


def _blocks(count: int) -> tuple[Indices, int, Floats]:
    """The first samples (B,) of the blocks of `count` samples, the samples in each, and the window over them."""
    block = min(_LONGEST, 2 ** int(np.log2(max(count // _BLOCKS, 16))), count)
    return np.arange(0, count - block + 1, max(block // 2, 1)), block, np.hanning(block + 2)[1:-1]
