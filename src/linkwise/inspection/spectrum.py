"""Power of a channel over time and frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats

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
        wanted = max(len(values) // _BLOCKS, 16)
        block = min(_LONGEST, 2 ** int(np.log2(wanted)), len(values))
        hop = max(block // 2, 1)
        first = np.arange(0, len(values) - block + 1, hop)
        window = np.hanning(block + 2)[1:-1]
        frames = (values - values.mean())[first[:, None] + np.arange(block)] * window
        power: Floats = np.abs(np.fft.rfft(frames, axis=1)) ** 2 * (2.0 / (rate * np.sum(window**2)))
        return cls(
            np.linspace(0.0, block // 2 * rate / block, block // 2 + 1), (first + 0.5 * block) / rate, power
        )

    @property
    def mean(self) -> Floats:
        """Density averaged over time, shape (F,)."""
        return np.asarray(self.power.mean(axis=0))
