"""What a channel's spectrum tells of its measurement: the white noise in it and the band of the motion.

Both read the same windowed spectra of short blocks. Vibrations fill the low frequencies, and transients the
high ones for a while; white noise fills every cell of the time-frequency plane alike. So the noise is the
level that the quiet cells share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats, Indices
from linkwise.errors import RecordError

_ORDER = 4  # differences before the window: they keep a strong slow motion from leaking into high bins
_DIFFERENCES = np.array([(-1.0) ** lag * comb(_ORDER, lag) for lag in range(_ORDER + 1)])
_LOWEST = 0.125  # cycles per sample from which noise is looked for
_CELLS = {
    256: (24, 1),
    128: (12, 2),
    64: (6, 4),
    32: (6, 4),
    16: (6, 4),
}  # bins and blocks of a cell, by block
_FEWEST = {256: 8, 128: 8, 64: 8, 32: 8, 16: 2}  # whole blocks that tell the noise
_QUIET = 0.25  # quantile of the cells that is surely free of motion ...
_QUIET_LEVEL = 0.8  # ... and where it stands when all cells are noise: gamma law, shape about 11
_LOUD = 2.2  # a cell above twice the level holds motion
_AT_ONCE = 64  # blocks transformed together: they stay in the cache


@dataclass(frozen=True, eq=False)
class BlockSpectra:
    """The power of channels in blocks of `block` samples that overlap by half, 1 for white noise of variance 1.

    `mean` (C, K) is that of the `counts` (C,) blocks that miss no sample, in all bins between 0 Hz and half the sampling rate;
    `cells` (C, B, G) that of every block in groups of high bins, NaN where it misses a sample.
    """

    block: int
    mean: Floats
    counts: Indices
    cells: Floats


def noise_sigma(samples: ArrayLike) -> Floats:
    """Standard deviation of the white measurement noise of each channel.

    `samples` is (N, C) or (N,), any unit, NaN where a sample is missing; the answer is (C,) in that unit, or
    (1,). Blocks that miss a sample are left out, and where gaps are frequent shorter blocks are taken; a
    channel with fewer than two whole blocks of 20 samples gives NaN. The error of the estimate is about 1.2 %
    at N = 6001 and falls with sqrt(N).

    Noise that is not white (a recorder's filter) is judged by its weakest quarter of cells.
    """
    return _sigma(_channels(samples), None)


def bandwidth(samples: ArrayLike, rate: float, sigma: ArrayLike | None = None) -> Floats:
    """Highest frequency in Hz at which each channel's motion stands above its noise.

    `samples` is (N, C) or (N,), `rate` the sampling rate in Hz, `sigma` (C,) the noise where it is known, else found by
    `noise_sigma`; the answer is (C,). It is the highest bin of the averaged spectrum that holds more than twice the
    power of the white noise, half the sampling rate where the motion fills the whole band and the width of one bin
    where nothing stands above the noise. Blocks of 256 samples (shorter where the record is) that miss a sample are
    left out. Raises RecordError where no block is complete.
    """
    highest = noise_and_bandwidth(samples, rate, sigma)[1]
    lost = np.flatnonzero(np.isnan(highest))
    if lost.size:
        raise RecordError(
            f"no {_block(_channels(samples))} samples in a row are complete in column {lost[0]}, so its "
            "bandwidth cannot be told; cut out a longer complete piece with record.between(t0, t1)"
        )
    return highest


def noise_and_bandwidth(
    samples: ArrayLike, rate: float, stated: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """`noise_sigma` (C,) and `bandwidth` (C,), NaN where it cannot be told, of `samples` (N, C) or (N,), in one look.

    Noise that is `stated` (C,), not NaN, is not looked for.
    """
    channels = _channels(samples)
    look = _look(channels, _block(channels))
    known = np.full(len(channels), np.nan) if stated is None else np.array(stated, dtype=float)
    sigma = known if np.isfinite(known).all() else np.where(np.isfinite(known), known, _sigma(channels, look))
    margin = np.maximum(2.0, 1.0 + 4.0 / np.sqrt(np.maximum(look.counts, 1)))
    bins = np.arange(1, look.mean.shape[1] + 1)
    loud = np.where(look.mean > (sigma**2 * margin)[:, None], bins, 1).max(axis=1)
    return sigma, np.where(look.counts > 0, loud * rate / look.block, np.nan)


def _channels(samples: ArrayLike) -> Floats:
    """(C, N), each channel in one piece."""
    values = np.asarray(samples, dtype=np.float64)
    return np.ascontiguousarray(np.atleast_2d(values.T))


def _block(channels: Floats) -> int:
    """Samples of a block that resolves the band: a third of the record at most."""
    return int(min(256, 2 ** int(np.log2(max(channels.shape[1] // 3, 16)))))


def _sigma(channels: Floats, seen: BlockSpectra | None) -> Floats:
    """(C,) noise of the channels, of which `seen` may be known."""
    sigma = np.full(len(channels), np.nan)
    for block, fewest in _FEWEST.items():
        untold = np.isnan(sigma)
        if not untold.any():
            break
        known = seen is not None and seen.block == block and untold.all()
        look = seen if seen is not None and known else _look(channels[untold], block)
        sigma[untold] = np.sqrt(_shared_level(look, fewest))
    return sigma


def _shared_level(look: BlockSpectra, fewest: int) -> Floats:
    """(C,) power that the quiet cells of each channel share, NaN with fewer than so many whole blocks."""
    deep = _CELLS[look.block][1]
    if look.cells.shape[1] >= fewest and (look.counts == look.cells.shape[1]).all():
        return _quiet_level(look.cells, deep)
    level = np.full(len(look.cells), np.nan)
    for channel, cells in enumerate(look.cells):
        if look.counts[channel] >= fewest:
            level[channel] = _quiet_level(cells[np.isfinite(cells[:, 0])][None], deep)[0]
    return level


def _quiet_level(power: Floats, deep: int) -> Floats:
    """(C,) mean power of the cells that hold noise alone; power (C, B, G), all finite, cells `deep` blocks long."""
    channels, blocks, groups = power.shape
    deep = min(deep, blocks)
    columns = power[:, : blocks // deep * deep].reshape(channels, -1, deep, groups)
    cells = np.sort(columns.sum(axis=2).reshape(channels, -1) / deep, axis=1)
    total, every = np.cumsum(cells, axis=1), np.arange(channels)
    level = cells[:, int(_QUIET * cells.shape[1])] / _QUIET_LEVEL
    for _ in range(5):
        last = np.maximum(np.sum(cells <= _LOUD * level[:, None], axis=1) - 1, 0)
        level = total[every, last] / (last + 1)
    return np.asarray(level)


def _look(channels: Floats, block: int) -> BlockSpectra:
    """At `channels` (C, N), in blocks of so many samples."""
    hann, unit, groups = _spectrum(block)
    blocks = max(0, (channels.shape[1] - _ORDER - block) // (block // 2) + 1)
    total, counts = np.zeros((len(channels), len(groups))), np.zeros(len(channels), dtype=int)
    cells = np.empty((len(channels), blocks, groups.shape[1]))
    steep = np.empty(max(channels.shape[1] - _ORDER, block))
    pieces = np.lib.stride_tricks.sliding_window_view(steep, block)[:: block // 2]
    for channel, samples in enumerate(channels if blocks else ()):
        steep[:] = np.correlate(samples, _DIFFERENCES)
        for first in range(0, blocks, _AT_ONCE):
            waves = np.fft.rfft(pieces[first : first + _AT_ONCE] * hann)[:, 1:-1].view(np.float64)
            waves *= waves
            part = cells[channel, first : first + _AT_ONCE]
            np.matmul(waves, groups, out=part)
            whole = np.isfinite(part[:, 0])
            total[channel] += (waves if whole.all() else waves[whole]).sum(axis=0)
            counts[channel] += np.count_nonzero(whole)
    mean = total.reshape(len(channels), -1, 2).sum(axis=2) * unit / np.maximum(counts, 1)[:, None]
    return BlockSpectra(block, mean, counts, cells)


@lru_cache(maxsize=32)
def _spectrum(block: int) -> tuple[Floats, Floats, Floats]:
    """The Hann window (block,), what takes the power of white noise, once differenced, to 1 in each bin (K,), and what takes
    squares of cosines and sines in turn to such power in groups of the bins where noise is looked for, (2 K, G).
    """
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(block) + 0.5) / block)
    bins = np.arange(1, block // 2)
    fourier = hann * np.exp(-2j * np.pi * np.outer(bins, np.arange(block)) / block)
    rows = np.zeros((len(bins), block + _ORDER), dtype=complex)
    for lag, weight in enumerate(_DIFFERENCES):
        rows[:, lag : lag + block] += weight * fourier
    unit = 1.0 / np.sum(np.abs(rows) ** 2, axis=1)
    wide, lowest = _CELLS[block][0], int(_LOWEST * block)
    groups = np.zeros((len(bins), (block // 2 - lowest) // wide))
    for group in range(groups.shape[1]):
        here = slice(lowest - 1 + group * wide, lowest - 1 + (group + 1) * wide)
        groups[here, group] = unit[here] / wide
    return hann, unit, np.repeat(groups, 2, axis=0)
