"""Test functions on short windows (METHODS section 4), and signals under them.

phi(u) = (1 - u^2)^p on |u| < 1 vanishes with its derivatives at the edges of its window, so an integral by parts leaves no
boundary term. Sums over samples approximate the integrals up to the aliasing of phi at the sampling rate; p = 8 keeps it
below 1e-6 for windows with a standard deviation of 1.6 samples and more, where p = 4 needs windows three times as wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil, pi, sqrt

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from linkwise.arrays import Bools, Floats, Indices
from linkwise.weak.weak_form import PHI, PHI_2

ORDER = 8
_NARROWEST = 1.8  # samples of standard deviation: the aliasing of a narrower phi exceeds noise at 40 dB
_NARROWEST_EXACT = 2.2  # the same for a record without noise, where the alias leaves 1e-5 of the coefficients
_WIDEST = 400.0
_DISTANCE = 1.6  # standard deviations from one window to the next


@dataclass(frozen=True)
class Window:
    """Test functions of one record, all of one shape.

    Attributes
    ----------
    half : int
        Samples on each side of the centre.
    stride : int
        Distance of neighbouring windows in samples.
    step : float
        Sampling interval in s.
    """

    half: int
    stride: int
    step: float

    @classmethod
    def of_deviation(cls, deviation: float, step: float) -> Window:
        """Window in which phi has a standard `deviation` in samples; neighbours are 1.6 of them apart."""
        return _window(ceil(deviation * sqrt(2 * ORDER + 3)), max(1, round(_DISTANCE * deviation)), step)

    @classmethod
    def for_band(cls, highest: float, rate: float, noise_free: bool) -> Window:
        """Window for motion of given bandwidth.

        With the noise bias removed, the accuracy hardly depends on the width while phi is shorter than the fastest motion; its
        cut-off at 2 pi f deviation = 1 satisfies this with a margin.

        Parameters
        ----------
        highest : float
            Highest frequency of the motion in Hz.
        rate : float
            Sampling rate in Hz.
        noise_free : bool
            Whether noise is negligible; the window then is at least so wide that the aliasing of phi is small.

        Returns
        -------
        Window
            The window.
        """
        narrowest = _NARROWEST_EXACT if noise_free else _NARROWEST
        return cls.of_deviation(min(max(rate / (2.0 * pi * highest), narrowest), _WIDEST), 1.0 / rate)

    @property
    def length(self) -> int:
        """Number of samples in a window."""
        return 2 * self.half + 1

    def rows(self, samples: int) -> int:
        """Number of windows R in a record of so many samples."""
        return max(0, (samples - self.length) // self.stride + 1)

    @cached_property
    def kernels(self) -> Floats:
        """(3, length) phi, phi' and phi'' at the samples, divided by the norm of phi''.

        phi' and phi'' contain a small multiple of phi, so that sums over samples satisfy integration by parts exactly for
        polynomials of degree five; without it their aliasing, of 1e-6, would be a spurious acceleration of slow motion.
        """
        u = np.arange(-self.half, self.half + 1) / self.half
        inside = 1.0 - u * u
        phi = inside**ORDER
        first = -2.0 * ORDER * u * inside ** (ORDER - 1)
        second = (4.0 * ORDER * (ORDER - 1) * u * u - 2.0 * ORDER * inside) * inside ** (ORDER - 2)
        first = _exact(first, phi, (1, 3, 5), -np.array([1.0, 3.0, 5.0]) * ((u ** [[0], [2], [4]]) @ phi))
        moments = np.append(0.0, np.array([2.0, 12.0]) * ((u ** [[0], [2]]) @ phi))
        second = _exact(second, phi, (0, 2, 4), moments)
        reach = self.half * self.step
        kernels: Floats = np.stack([phi, first / reach, second / reach**2])
        return kernels / np.linalg.norm(kernels[PHI_2])

    @cached_property
    def slope(self) -> Floats:
        """(1, length) filter for the derivative at the centre of a polynomial of degree six, fitted with the weight phi."""
        u = np.arange(-self.half, self.half + 1) / self.half
        odd = u ** np.array([[1], [3], [5]])
        weighted = odd * self.kernels[PHI]
        first = np.linalg.solve(weighted @ odd.T, [1.0, 0.0, 0.0])
        return np.asarray(first @ weighted / (self.half * self.step))[None]

    def filter(self, signals: Floats, kernels: Floats) -> Floats:
        """(Q, S, R) sums of kernels (Q, T) times signals (S, N) over the samples of every window."""
        windows = sliding_window_view(signals, kernels.shape[1], axis=1)[:, :: self.stride]
        return np.stack([kernels @ np.ascontiguousarray(own).T for own in windows], axis=1)

    def sums(self, signal: Floats) -> Floats:
        """(R,) sums of phi times a signal (N,), 0 where it is missing."""
        return np.asarray(self.filter(np.nan_to_num(signal)[None], self.kernels[:1])[0, 0])

    @property
    def area(self) -> float:
        """Sum of phi."""
        return float(self.kernels[PHI].sum())

    def whole(self, missing: Bools) -> Floats:
        """(R,) 1 for windows without a sample that is `missing` (N,), 0 for others."""
        count = self.filter(missing[None].astype(float), np.ones((1, self.length)))[0, 0]
        return np.asarray(count < 0.5, dtype=float)

    @cached_property
    def cross_correlations(self) -> Floats:
        """(K, K, K, K) sums over lags j of <a, b at j> <c, d at -j>, at [a, c, b, d], for kernels a, b, c, d.

        <a, b at j> is the sum over samples of kernel a times kernel b shifted by j windows.
        """
        lags = self.stride * np.arange(-self.neighbours, self.neighbours + 1)
        padded = np.pad(self.kernels, ((0, 0), (self.length, self.length)))
        shifted = np.stack([padded[:, self.length - lag : 2 * self.length - lag] for lag in lags], axis=2)
        overlaps = np.einsum("at,btj->abj", self.kernels, shifted)
        return np.asarray(np.einsum("abj,cdj->acbd", overlaps, overlaps[:, :, ::-1]))

    @property
    def neighbours(self) -> int:
        """Number of windows to each side whose centre lies within one window."""
        return self.half // self.stride

    def coverage(self, kernels: Floats, valid: Floats, samples: int) -> Floats:
        """(Q, N) sums of kernels (Q, length) at every sample over windows of weights `valid` (R,): the adjoint of `filter`."""
        reach = -(-self.length // self.stride)
        taps = np.zeros((len(kernels), reach * self.stride))
        taps[:, : self.length] = kernels
        padded = np.zeros(len(valid) + 2 * (reach - 1))
        padded[reach - 1 : reach - 1 + len(valid)] = valid
        windows = np.ascontiguousarray(sliding_window_view(padded, reach))
        covered = np.zeros((len(kernels), max(samples, len(windows) * self.stride)))
        inside = covered[:, : len(windows) * self.stride].reshape(len(kernels), -1, self.stride)
        np.matmul(windows, taps.reshape(len(kernels), reach, self.stride)[:, ::-1], out=inside)
        return covered[:, :samples]

    def adjoint_windows(self, windows: int, thinning: int) -> Indices:
        """(P,) the window nearest to each point of `adjoint`, of R windows thinned by a stride.

        Every second of the thinned windows, then the others of them, then `half` times the first and the last.
        """
        thinned = np.arange(0, windows, thinning)
        return np.concatenate([thinned[::2], thinned[1::2], np.repeat(thinned[[0, -1]], self.half)])

    def adjoint(self, rows: Floats, thinning: int) -> Floats:
        """Sums of kernels over all windows at points that represent all samples.

        Points lie near the centre of every `thinning`-th window, every second of them moved by half a stride so that all
        phases are sampled evenly. Before the first and after the last centre every sample is a point, since there the sums of
        neighbouring windows do not cancel.

        Parameters
        ----------
        rows : array of shape (S, R)
            Weights of the windows.
        thinning : int
            Stride of the points in windows.

        Returns
        -------
        array of shape (K, S, P)
            The sums for each of the K kernels, multiplied by the root of the number of samples that a point represents.
        """
        centres = self.half + self.stride * np.arange(0, rows.shape[1], thinning)
        centres[1::2] += self.stride // 2
        last, ends = self.half + self.stride * (rows.shape[1] - 1), np.arange(self.half)
        points = np.concatenate([centres[::2], centres[1::2], ends, last + 1 + ends])
        roots = np.sqrt(np.repeat([float(thinning * self.stride), 1.0], [len(centres), 2 * len(ends)]))
        samples = last + self.half + 1
        sums = [self.coverage(self.kernels, row, samples)[:, points] * roots for row in rows]
        return np.stack(sums, axis=1) if sums else np.empty((len(self.kernels), 0, len(points)))


@lru_cache(maxsize=64)
def _window(half: int, stride: int, step: float) -> Window:
    """One object for equal windows, which keeps its kernels."""
    return Window(half, stride, step)


def _exact(kernel: Floats, phi: Floats, powers: Sequence[int], moments: Floats) -> Floats:
    """A kernel with multiples of phi and powers of u, so that its sums with these over samples are the `moments`."""
    u = np.linspace(-1.0, 1.0, len(phi))
    functions = u ** np.array(powers)[:, None]
    added = np.linalg.solve((functions * phi) @ functions.T, moments - functions @ kernel)
    return np.asarray(kernel + phi * (added @ functions))
