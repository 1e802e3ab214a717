"""Power of a channel over time and frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices

_LONGEST = 512  # samples of a block
_BLOCKS = 8  # that fit into a record side by side, where it is long enough


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
        """That of samples (N,) at `rate` in Hz, without their mean."""
        first, block, window = _blocks(len(values))
        frequency = np.linspace(0.0, block // 2 * rate / block, block // 2 + 1)
        time = np.asarray((first + 0.5 * block) / rate, dtype=float)
        power = np.abs(cls.transformed(values)) ** 2 * (2.0 / (rate * np.sum(window**2)))
        return cls(frequency, time, np.asarray(power, dtype=float))

    @staticmethod
    def transformed(values: Floats) -> NDArray[np.complex128]:
        """The Fourier transforms (B, F) of the blocks of samples (N,) without their mean."""
        first, block, window = _blocks(len(values))
        frames = (values - values.mean())[first[:, None] + np.arange(block)] * window
        return np.fft.rfft(frames, axis=1)

    @property
    def mean(self) -> Floats:
        """Density averaged over time, shape (F,)."""
        return np.asarray(self.power.mean(axis=0))


def _blocks(count: int) -> tuple[Indices, int, Floats]:
    """The first samples (B,) of the blocks of `count` samples, the samples in each, and the window over them."""
    block = min(_LONGEST, 2 ** int(np.log2(max(count // _BLOCKS, 16))), count)
    return np.arange(0, count - block + 1, max(block // 2, 1)), block, np.hanning(block + 2)[1:-1]
