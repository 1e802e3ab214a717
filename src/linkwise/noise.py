"""What a channel's spectrum tells of its measurement: the white noise in it and the band of the motion.

Both read the same windowed spectra of short blocks. Vibrations fill the low frequencies, and transients the
high ones for a while; white noise fills every cell of the time-frequency plane alike. So the noise is the
level that the quiet cells share.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkwise.errors import RecordError

Array = NDArray[np.float64]

_ORDER = 4  # differences before the window: they keep a strong slow motion from leaking into high bins
_LOWEST, _HIGHEST = 0.125, 0.5  # cycles per sample between which noise is looked for
_CELL_BINS, _CELL_BLOCKS = 6, 4  # one cell of the plane averages so many bins and blocks
_QUIET = 0.25  # quantile of the cells that is surely free of motion ...
_QUIET_LEVEL = 0.8  # ... and where it stands when all cells are noise: gamma law, shape about 11
_LOUD = 2.2  # a cell above twice the level holds motion
_AT_ONCE = 192  # blocks transformed together: they stay in the cache


def noise_sigma(samples: ArrayLike) -> Array:
    """Standard deviation of the white measurement noise of each channel.

    `samples` is (N, C) or (N,), any unit, NaN where a sample is missing; the answer is (C,) in that unit, or
    (1,). Blocks that miss a sample are left out, and where gaps are frequent shorter blocks are taken; a
    channel with fewer than two whole blocks of 20 samples gives NaN. The error of the estimate is about 1.2 %
    at N = 6001 and falls with sqrt(N).

    Noise that is not white (a recorder's filter) is judged by its weakest quarter of cells.
    """
    channels = _channels(samples)
    sigma = np.full(len(channels), np.nan)
    for block in (64, 32, 16):
        untold = np.isnan(sigma)
        if not untold.any():
            break
        power = _cell_powers(channels if untold.all() else channels[untold], block)
        if power.shape[1] >= 2:
            sigma[untold] = np.sqrt(_shared_level(power, enough=8 if block > 16 else 2))
    return sigma


def bandwidth(samples: ArrayLike, rate: float, sigma: ArrayLike | None = None) -> Array:
    """Highest frequency in Hz at which each channel's motion stands above its noise.

    `samples` is (N, C) or (N,), `rate` the sampling rate in Hz, `sigma` (C,) the noise where it is known, else found by
    `noise_sigma`; the answer is (C,). It is the highest bin of the averaged spectrum that holds more than twice the
    power of the white noise, half the sampling rate where the motion fills the whole band and the width of one bin
    where nothing stands above the noise. Blocks of 256 samples (shorter where the record is) that miss a sample are
    left out. Raises RecordError where no block is complete.
    """
    channels = _channels(samples)
    block = min(256, 2 ** int(np.log2(max(channels.shape[1] // 3, 16))))
    mean, counts = _mean_powers(channels, block)
    lost = np.flatnonzero(counts == 0)
    if lost.size:
        raise RecordError(
            f"no {block} samples in a row are complete in column {lost[0]}, so its "
            "bandwidth cannot be told; cut out a longer complete piece with record.between(t0, t1)"
        )
    margin = np.maximum(2.0, 1.0 + 4.0 / np.sqrt(counts))
    level = (noise_sigma(samples) if sigma is None else np.asarray(sigma)) ** 2 * margin
    bins = np.arange(1, mean.shape[1] + 1)
    return np.asarray(np.maximum(np.max(np.where(mean > level[:, None], bins, 0), axis=1), 1) * rate / block)


def _channels(samples: ArrayLike) -> Array:
    """(C, N), each channel in one piece."""
    values = np.asarray(samples, dtype=np.float64)
    return np.ascontiguousarray(np.atleast_2d(values.T))


def _shared_level(power: Array, enough: int) -> Array:
    """Power that the quiet cells of each channel share; power (C, B, G) -> (C,), NaN with fewer than `enough`
    whole blocks.
    """
    whole = np.isfinite(power[:, :, 0])
    if whole.all() and power.shape[1] >= enough:
        return _quiet_level(power)
    level = np.full(len(power), np.nan)
    for channel, kept in enumerate(whole):
        if np.sum(kept) >= enough:
            level[channel] = _quiet_level(power[channel, kept][None])[0]
    return level


def _quiet_level(power: Array) -> Array:
    """Mean power of the cells that hold noise alone; power (C, B, G), all finite -> (C,)."""
    channels, blocks, groups = power.shape
    deep = min(_CELL_BLOCKS, blocks)
    columns = power[:, : blocks // deep * deep].reshape(channels, -1, deep, groups)
    cells = columns.mean(axis=2).reshape(channels, -1)
    cells.sort(axis=1)
    level = cells[:, int(_QUIET * cells.shape[1])] / _QUIET_LEVEL
    lowest = cells[:, 0]
    for _ in range(5):
        quiet = cells <= np.maximum(_LOUD * level, lowest)[:, None]
        level = np.sum(cells * quiet, axis=1) / quiet.sum(axis=1)
    return np.asarray(level)


def _cell_powers(channels: Array, block: int) -> Array:
    """Mean power (C, B, G) of groups of bins where noise is looked for, in blocks that overlap by half; 1 on average for
    white noise of variance 1.

    A block that misses a sample is NaN in all its groups.
    """
    rows, groups = _spectral_rows(block)
    if channels.shape[1] < len(rows):
        return np.empty((len(channels), 0, groups.shape[1]))
    pieces = np.lib.stride_tricks.sliding_window_view(channels, len(rows), axis=1)[:, :: block // 2]
    power = np.empty((*pieces.shape[:2], groups.shape[1]))
    for channel, blocks in zip(power, pieces, strict=True):
        for first in range(0, len(blocks), _AT_ONCE):
            waves = blocks[first : first + _AT_ONCE] @ rows
            waves *= waves
            np.matmul(waves, groups, out=channel[first : first + _AT_ONCE])
    return power


def _mean_powers(channels: Array, block: int) -> tuple[Array, NDArray[np.intp]]:
    """Mean power (C, K) in all bins but that of 0 Hz over the whole blocks that overlap by half, and their number (C,)."""
    hann, unit = _spectrum(block)
    total, counts = np.zeros((len(channels), len(unit), 2)), np.zeros(len(channels), dtype=int)
    if channels.shape[1] < block + _ORDER:
        return total[:, :, 0], counts
    steep = np.empty(channels.shape[1] - _ORDER)
    blocks = np.lib.stride_tricks.sliding_window_view(steep, block)[:: block // 2]
    for channel, samples in enumerate(channels):
        steep[:] = np.diff(samples, _ORDER)
        for first in range(0, len(blocks), _AT_ONCE):
            waves = np.fft.rfft(blocks[first : first + _AT_ONCE] * hann)
            whole = np.isfinite(waves[:, 0].real)
            parts = (waves if whole.all() else waves[whole])[:, 1:-1].view(np.float64)
            total[channel] += np.einsum("bk,bk->k", parts, parts).reshape(-1, 2)
            counts[channel] += len(parts)
    return total.sum(axis=2) * unit / np.maximum(counts, 1)[:, None], counts


@lru_cache(maxsize=32)
def _spectral_rows(block: int) -> tuple[Array, Array]:
    """Difference, Hann window, Fourier bin and unit noise gain folded into one matrix (block + order, 2 K): cosines, then
    sines; and what takes their squares to means over groups of bins, (2 K, G).
    """
    rows = _filters(block, np.arange(int(_LOWEST * block), int(_HIGHEST * block)))
    rows /= np.sqrt(np.sum(np.abs(rows) ** 2, axis=1))[:, None]
    groups = np.kron(np.eye(len(rows) // _CELL_BINS), np.full((_CELL_BINS, 1), 1.0 / _CELL_BINS))
    return np.ascontiguousarray(np.concatenate([rows.real, rows.imag]).T), np.tile(groups, (2, 1))


@lru_cache(maxsize=32)
def _spectrum(block: int) -> tuple[Array, Array]:
    """The Hann window (block,), and what takes the power of white noise, once differenced, to 1 in each bin (K,)."""
    return _hann(block), 1.0 / np.sum(np.abs(_filters(block, np.arange(1, block // 2))) ** 2, axis=1)


def _filters(block: int, bins: NDArray[np.intp]) -> NDArray[np.complex128]:
    """(K, block + order) what difference, window and Fourier bin do to samples."""
    fourier = _hann(block) * np.exp(-2j * np.pi * np.outer(bins, np.arange(block)) / block)
    rows = np.zeros((len(bins), block + _ORDER), dtype=complex)
    for lag in range(_ORDER + 1):
        rows[:, lag : lag + block] += (-1) ** lag * comb(_ORDER, lag) * fourier
    return rows


def _hann(block: int) -> Array:
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(block) + 0.5) / block))
