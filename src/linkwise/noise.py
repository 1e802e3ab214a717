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


def noise_sigma(samples: ArrayLike) -> Array:
    """Standard deviation of the white measurement noise of each channel.

    `samples` is (N, C) or (N,), any unit, NaN where a sample is missing; the answer is (C,) in that unit, or
    (1,). Blocks that miss a sample are left out, and where gaps are frequent shorter blocks are taken; a
    channel with fewer than two whole blocks of 20 samples gives NaN. The error of the estimate is about 1.2 %
    at N = 6001 and falls with sqrt(N).

    Noise that is not white (a recorder's filter) is judged by its weakest quarter of cells.
    """
    columns = _columns(samples)
    sigma = np.full(columns.shape[1], np.nan)
    for block in (64, 32, 16):
        open_ones = np.isnan(sigma)
        if not open_ones.any():
            break
        power = _block_powers(columns[:, open_ones], block, _LOWEST, _HIGHEST)
        if power.shape[0] >= 2:
            enough = 8 if block > 16 else 2
            sigma[open_ones] = np.sqrt(_shared_level(power, enough))
    return sigma


def bandwidth(samples: ArrayLike, rate: float, sigma: ArrayLike | None = None) -> Array:
    """Highest frequency in Hz at which each channel's motion stands above its noise.

    `samples` is (N, C) or (N,), `rate` the sampling rate in Hz, `sigma` (C,) the noise where it is known, else found by
    `noise_sigma`; the answer is (C,). It is the highest bin of the averaged spectrum that holds more than twice the
    power of the white noise, half the sampling rate where the motion fills the whole band and the width of one bin
    where nothing stands above the noise. Blocks of 256 samples (shorter where the record is) that miss a sample are
    left out. Raises RecordError where no block is complete.
    """
    columns = _columns(samples)
    block = min(256, 2 ** int(np.log2(max(len(columns) // 3, 16))))
    power = _block_powers(columns, block, 1.0 / block, 0.5)
    whole = np.asarray(np.isfinite(power).all(axis=2))
    counts: NDArray[np.intp] = np.sum(whole, axis=0)
    lost = np.flatnonzero(counts == 0)
    if lost.size:
        raise RecordError(
            f"no {block} samples in a row are complete in column {lost[0]}, so its "
            "bandwidth cannot be told; cut out a longer complete piece with record.between(t0, t1)"
        )
    mean = np.sum(np.where(whole[:, :, None], power, 0.0), axis=0) / counts[:, None]
    margin = np.maximum(2.0, 1.0 + 4.0 / np.sqrt(counts))
    level = (noise_sigma(columns) if sigma is None else np.asarray(sigma)) ** 2 * margin
    bins = np.arange(1, mean.shape[1] + 1)
    return np.asarray(np.maximum(np.max(np.where(mean > level[:, None], bins, 0), axis=1), 1) * rate / block)


def _columns(samples: ArrayLike) -> Array:
    values = np.asarray(samples, dtype=np.float64)
    return values[:, None] if values.ndim == 1 else values


def _shared_level(power: Array, enough: int) -> Array:
    """Power that the quiet cells of each channel share; power (B, C, K) -> (C,), NaN with fewer than `enough`
    whole blocks.
    """
    whole = np.isfinite(power[:, :, 0])
    if whole.all() and len(power) >= enough:
        return _quiet_level(power)
    level = np.full(power.shape[1], np.nan)
    for channel in range(power.shape[1]):
        kept = power[whole[:, channel], channel]
        if len(kept) >= enough:
            level[channel] = _quiet_level(kept[:, None])[0]
    return level


def _quiet_level(power: Array) -> Array:
    """Mean power of the cells that hold noise alone; power (B, C, K), all finite -> (C,)."""
    blocks, channels, bins = power.shape
    deep = min(_CELL_BLOCKS, blocks)
    groups = max(1, bins // _CELL_BINS)
    wide = bins // groups
    whole = power[: blocks // deep * deep, :, : groups * wide]
    cells = whole.reshape(blocks // deep, deep, channels, groups, wide).mean(axis=(1, 4))
    cells = cells.transpose(1, 0, 2).reshape(channels, -1)
    level = np.quantile(cells, _QUIET, axis=1) / _QUIET_LEVEL
    for _ in range(5):
        quiet = cells <= np.maximum(_LOUD * level, cells.min(axis=1))[:, None]
        level = np.sum(cells * quiet, axis=1) / quiet.sum(axis=1)
    return np.asarray(level)


def _block_powers(columns: Array, block: int, lowest: float, highest: float) -> Array:
    """Power in blocks that overlap by half, in units of the samples' variance: (B, C, K) for white noise of
    variance 1 has mean 1.

    A block that misses a sample is NaN in all its bins.
    """
    weights, bins = _spectral_rows(block, lowest, highest)
    long = len(weights)
    if len(columns) < long:
        return np.empty((0, columns.shape[1], bins))
    pieces = np.lib.stride_tricks.sliding_window_view(columns, long, axis=0)[:: block // 2]
    count, channels, _ = pieces.shape
    parts = pieces.reshape(count * channels, long) @ weights
    return np.asarray(parts[:, :bins] ** 2 + parts[:, bins:] ** 2).reshape(count, channels, bins)


@lru_cache(maxsize=32)
def _spectral_rows(block: int, lowest: float, highest: float) -> tuple[Array, int]:
    """Difference, Hann window, Fourier bin and unit noise gain folded into one matrix (block + order, 2 K):
    cosines, then sines.
    """
    bins = np.arange(int(lowest * block), int(highest * block))
    inside = np.arange(block)
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * (inside + 0.5) / block)
    fourier = hann * np.exp(-2j * np.pi * np.outer(bins, inside) / block)
    rows = np.zeros((len(bins), block + _ORDER), dtype=complex)
    for lag in range(_ORDER + 1):
        rows[:, lag : lag + block] += (-1) ** lag * comb(_ORDER, lag) * fourier
    rows /= np.sqrt(np.sum(np.abs(rows) ** 2, axis=1))[:, None]
    return np.ascontiguousarray(np.concatenate([rows.real, rows.imag]).T), len(bins)
