"""Test functions on short windows: the only filters that the weak form needs (METHODS section 4).

phi(u) = (1 - u^2)^p on |u| < 1 vanishes with its derivatives at the edges of its window, so an integral by parts leaves no
boundary term. The sums over samples that stand for the integrals agree with each other to the alias of phi at the sampling
rate; p = 8 keeps it below 1e-6 for windows of deviation 1.6 samples and more, where p = 4 needs windows three times as wide.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, pi, sqrt

import numpy as np

from linkwise.arrays import Floats, Indices

ORDER = 8
_NARROWEST = 1.8  # samples of deviation: the alias of a narrower phi shows above noise of 40 dB
_NARROWEST_EXACT = 2.2  # the same for a record without noise, where the alias leaves 1e-5 of the coefficients
_WIDEST = 400.0
_AT_ONCE = 2**17  # samples that `strided_filter` lays out together: they stay in the cache
_BLOCK = 8  # places that make one row of the blocked product in `strided_filter`


@dataclass(frozen=True)
class Window:
    """The windows of one record: `half` samples to each side of the centre, a new one every `stride` samples of `step` s."""

    half: int
    stride: int
    step: float

    @classmethod
    def of_deviation(cls, deviation: float, step: float) -> Window:
        """The window whose phi has the standard deviation `deviation` in samples; neighbours are 1.6 deviations apart."""
        return _window(ceil(deviation * sqrt(2 * ORDER + 3)), max(1, round(1.6 * deviation)), step)

    @classmethod
    def for_band(cls, highest: float, rate: float, noise_free: bool) -> Window:
        """The window for motion up to `highest` Hz at `rate` Hz: phi passes it and no more.

        Where the noise bias is removed the accuracy hardly depends on the width while phi stays shorter than the fastest
        motion; its cut at 2 pi f deviation = 1 is safe on that side. `noise_free` records (no noise to speak of) get at
        least a width at which the alias of phi is small.
        """
        narrowest = _NARROWEST_EXACT if noise_free else _NARROWEST
        return cls.of_deviation(min(max(rate / (2.0 * pi * highest), narrowest), _WIDEST), 1.0 / rate)

    @property
    def length(self) -> int:
        """Samples that one window spans."""
        return 2 * self.half + 1

    def rows(self, samples: int) -> int:
        """Windows that fit into a record of so many samples."""
        return max(0, (samples - self.length) // self.stride + 1)

    @cached_property
    def kernels(self) -> Floats:
        """(3, length): phi, phi' and phi'' at the samples, divided by the norm of phi''.

        phi' and phi'' carry a small multiple of phi, so that sums over samples obey the integrals by parts exactly for
        polynomials of the fifth degree. Else their alias, of 1e-6, would be an acceleration that slow motion does not have.
        """
        u = np.arange(-self.half, self.half + 1) / self.half
        inside = 1.0 - u * u
        phi = inside**ORDER
        first = -2.0 * ORDER * u * inside ** (ORDER - 1)
        second = (4.0 * ORDER * (ORDER - 1) * u * u - 2.0 * ORDER * inside) * inside ** (ORDER - 2)
        odd, even = u ** np.array([[1], [3], [5]]), u ** np.array([[0], [2], [4]])
        first_moments = -np.array([1.0, 3.0, 5.0]) * (even @ phi)
        second_moments = np.append(0.0, np.array([2.0, 12.0]) * (even[:2] @ phi))
        first += phi * (np.linalg.solve((odd * phi) @ odd.T, first_moments - odd @ first) @ odd)
        second += phi * (np.linalg.solve((even * phi) @ even.T, second_moments - even @ second) @ even)
        reach = self.half * self.step
        kernels: Floats = np.stack([phi, first / reach, second / reach**2])
        return kernels / np.linalg.norm(kernels[2])

    @cached_property
    def slope(self) -> Floats:
        """(1, length): the derivative at the centre of a polynomial of the sixth degree fitted under phi."""
        u = np.arange(-self.half, self.half + 1) / self.half
        odd = u ** np.array([[1], [3], [5]])
        weighted = odd * self.kernels[0]
        first = np.linalg.solve(weighted @ odd.T, [1.0, 0.0, 0.0])
        return np.asarray(first @ weighted / (self.half * self.step))[None]

    def filter(self, signals: Floats, kernels: Floats) -> Floats:
        """Every kernel (Q, length) over every signal (S, N) at every window: (Q, S, R)."""
        return strided_filter(signals, kernels, self.stride)

    @cached_property
    def cross_correlations(self) -> Floats:
        """(3, 3, 3, 3): sums over windows j of <a, b at j> <c, d at -j>, at [a, c, b, d], for kernels a, b, c, d.

        <a, b at j> is the sum over samples of kernel a times kernel b that is j windows later.
        """
        lags = self.stride * np.arange(-self.neighbours, self.neighbours + 1)
        padded = np.pad(self.kernels, ((0, 0), (self.length, self.length)))
        later = np.stack([padded[:, self.length - lag : 2 * self.length - lag] for lag in lags], axis=2)
        overlaps = np.einsum("at,btj->abj", self.kernels, later)
        return np.asarray(np.einsum("abj,cdj->acbd", overlaps, overlaps[:, :, ::-1]))

    @property
    def neighbours(self) -> int:
        """Windows to each side whose centre lies within one window."""
        return self.half // self.stride

    def coverage(self, kernels: Floats, valid: Floats, samples: int) -> Floats:
        """(Q, N) sums over windows, weighted by `valid` (R,), of kernels (Q, length) at each of so many samples.

        A sum over samples and windows of a signal under a kernel is the product of the signal and this.
        """
        reach = -(-self.length // self.stride)
        taps = np.zeros((len(kernels), reach * self.stride))
        taps[:, : self.length] = kernels
        padded = np.zeros(len(valid) + 2 * (reach - 1))
        padded[reach - 1 : reach - 1 + len(valid)] = valid
        windows = np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(padded, reach))
        covered = np.zeros((len(kernels), max(samples, len(windows) * self.stride)))
        inside = covered[:, : len(windows) * self.stride].reshape(len(kernels), -1, self.stride)
        np.matmul(windows, taps.reshape(len(kernels), reach, self.stride)[:, ::-1], out=inside)
        return covered[:, :samples]

    def adjoint_windows(self, windows: int, thin: int) -> Indices:
        """(P,) the window that is nearest to each place of `adjoint`.

        First every second of every `thin`-th window, then the others of them, then `half` times the first and the last.
        """
        kept = np.arange(0, windows, thin)
        return np.concatenate([kept[::2], kept[1::2], np.repeat(kept[[0, -1]], self.half)])

    def adjoint(self, rows: Floats, thin: int) -> Floats:
        """(S, 3, P) sums of kernels over all windows, weighted by `rows` (S, R), at places that stand for all samples.

        Places lie near the centre of every `thin`-th window, every second of them moved half a stride, so that what they see
        of all times is even; before the first and after the last centre every sample is a place, since what other windows
        cancel inside the record stays there. The sums are multiplied by the root of the samples for which their place stands.
        """
        taps = _taps(self, thin)
        windows, reach, width = rows.shape[1], self.neighbours + 1, taps.shape[1]
        padded = np.zeros((len(rows), windows + width - 1))
        padded[:, reach : reach + windows] = rows
        around = np.lib.stride_tricks.sliding_window_view(padded, width, axis=1)[:, :: 2 * thin]
        around = np.ascontiguousarray(around.transpose(2, 0, 1))
        sums = (taps @ around.reshape(width, -1)).reshape(2, 3, *around.shape[1:])
        places = np.arange(0, windows, thin)
        split, inside = len(places[::2]), len(places)
        found = np.empty((3, len(rows), inside + 2 * self.half))
        found[:, :, :split] = sums[0, :, :, :split]
        found[:, :, split:inside] = sums[1, :, :, : inside - split]
        found[:, :, inside:] = self._edges(rows)
        return found.transpose(1, 0, 2)

    def _edges(self, rows: Floats) -> Floats:
        """(3, S, 2 half) the sums of `adjoint` at every sample before the first and after the last centre."""
        count = min(self.neighbours + 1, rows.shape[1])
        taps = np.zeros((2, 3, count, self.half))
        for later in range(count):
            shift = later * self.stride
            taps[0, :, later, shift:] = self.kernels[:, : self.half - shift]
            taps[1, :, -1 - later, : self.half - shift] = self.kernels[:, self.half + 1 + shift :]
        return np.concatenate([rows[:, :count] @ taps[0], rows[:, -count:] @ taps[1]], axis=2)


@lru_cache(maxsize=64)
def _window(half: int, stride: int, step: float) -> Window:
    """One object for equal windows: what follows from it is worked out once."""
    return Window(half, stride, step)


@lru_cache(maxsize=64)
def _taps(window: Window, thin: int) -> Floats:
    """(6, width): kernels at the windows around two places of `spread`, times the root of the samples of a place."""
    reach = window.neighbours + 1
    windows = np.arange(thin + 2 * reach + 1) - reach
    centres = window.half + np.array([[0], [thin * window.stride + window.stride // 2]])
    at = centres - window.stride * windows
    inside = (at >= 0) & (at < window.length)
    taps = np.where(inside, window.kernels[:, np.where(inside, at, 0)], 0.0)
    return np.asarray(np.sqrt(thin * window.stride) * taps.transpose(1, 0, 2).reshape(6, -1))


def strided_filter(signals: Floats, kernels: Floats, stride: int) -> Floats:
    """Correlations of `signals` (S, N) with `kernels` (Q, T) at every `stride`-th sample: (Q, S, (N - T) // stride + 1).

    Blocks of places share one product with a banded Toeplitz matrix: a BLAS call in place of a strided loop.
    """
    (count, samples), (filters, length) = signals.shape, kernels.shape
    rows = (samples - length) // stride + 1
    per_block = max(1, min(rows, _BLOCK))
    blocks = -(-rows // per_block)
    span = (per_block - 1) * stride + length
    needed = (blocks - 1) * per_block * stride + span
    if needed > samples:
        signals = np.concatenate([signals, np.zeros((count, needed - samples))], axis=1)
    toeplitz = np.zeros((filters, span, per_block))
    for row in range(per_block):
        toeplitz[:, row * stride : row * stride + length, row] = kernels
    pieces = np.lib.stride_tricks.sliding_window_view(signals, span, axis=1)[:, :: per_block * stride]
    found = np.empty((filters, count, blocks, per_block))
    group = max(1, _AT_ONCE // (blocks * span))
    for first in range(0, count, group):
        part = np.ascontiguousarray(pieces[first : first + group, :blocks])
        for kernel in range(filters):
            np.matmul(part, toeplitz[kernel], out=found[kernel, first : first + group])
    return found.reshape(filters, count, -1)[:, :, :rows]
