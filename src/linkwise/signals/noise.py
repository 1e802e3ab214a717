"""White noise and bandwidth of channels, from the spectra of short blocks, and outliers.

Vibrations occupy low frequencies, and transients high ones for a short time, while white noise has the same power in all
cells of the time-frequency plane. The noise level is that of the cells without motion. Where gaps leave few blocks,
divided differences of samples that follow one another in whatever distance replace the spectra: they annihilate
polynomials of their order, and their squares in short stretches of time are the cells.

Where motion fills the band up to half the sampling rate, as at five samples a period, no cell is free of it. Where the
power falls throughout the band, as that of motion does, the noise is no more than what is left at its end. Noise behind
an anti-aliasing filter falls there alone, and is left as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import RecordError
from linkwise.records.record import Record
from linkwise.records.timeline import sampled_every

_BANDS = ((0.125, 0.25), (0.25, 0.375), (0.4, 0.5))  # cycles per sample
_FEWEST_FOR_BANDS = 40  # samples: fewer leave the last band a power that is wrong by half of it
_MOST = 1156  # samples from which there are cells in which motion is absent for a time, if only at the edge of the band
_WINDOW_LOSS = 1.95  # by which the Hann window divides the number of independent bins
_SIGMAS = 2.0  # of the power in the last band: noise that is too low is not told from a misfit of laws, too high a one is
# of the power in the first band: what is left in the second, where motion falls towards the third
_FALLS = 0.5
_LOWER = 0.35  # of the power of the noise found otherwise: more may be chance


def noise_beside_motion(samples: Floats, level: float) -> float:
    """An upper bound of the power of the noise of a channel (N,) without gaps, at most the `level` that cells without
    motion tell, which it is where motion does not seem to fill the band.
    """
    if not _FEWEST_FOR_BANDS <= len(samples) < _MOST:
        return level
    differences = np.diff(samples, _ORDER)
    count = len(differences)
    hann = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    frequency = np.arange(1, (count + 1) // 2) / count
    gain = (2.0 * np.sin(np.pi * frequency)) ** (2 * _ORDER)
    power = np.abs(np.fft.rfft(differences * hann)[1 : len(frequency) + 1]) ** 2 / gain / np.sum(hann**2)
    bands = [power[(frequency >= lowest) & (frequency < highest)] for lowest, highest in _BANDS]
    low, middle, high = (float(np.mean(band)) for band in bands)
    freedom = 2.0 * len(bands[-1]) / _WINDOW_LOSS
    bound = high * (1.0 + _SIGMAS * np.sqrt(2.0 / freedom))
    return bound if middle < _FALLS * low and bound < _LOWER * level else level


_POWER = 70.0  # sum of the squares of their weights 1, 4, 6, 4, 1
_OUTLIER_MOTION = 1.15  # factor on the power of white noise beyond which the differences contain motion
# kurtosis less 3; that of 6000 normal samples scatters by 0.1, Student's t with 5 degrees has 2
_EXCESS = 1.0
_TYPICAL = 1.1  # of the power of the noise: the largest one of typical residuals, by their median
_NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal variable
_FEWEST_FOR_KURTOSIS = 500  # differences needed to estimate a kurtosis


def has_outliers(samples: Floats, sigma: Floats) -> bool:
    """Whether the noise `sigma` (C,) of a channel (N, C), NaN where a sample is missing, has outliers, by the kurtosis of
    fourth differences. Channels without noise, and those whose differences contain as much motion as noise, are not
    tested.
    """
    for column, deviation in zip(samples.T, sigma, strict=True):
        differences = np.diff(column, _ORDER)
        differences = differences[np.isfinite(differences)]
        if len(differences) < _FEWEST_FOR_KURTOSIS or not deviation > 0.0:
            continue
        motion = float(np.mean(differences**2)) / (_POWER * deviation**2)
        if 1.0 / _OUTLIER_MOTION < motion < _OUTLIER_MOTION and _is_heavy_tailed(differences):
            return True
    return False


def outliers_exceed_noise(residuals: Floats) -> bool:
    """Whether nothing but outliers makes residuals (N, C), over the standard deviations of the noise, larger than it:
    those of a channel have outliers, and typical ones are no larger than the noise in any. 0 or NaN where a sample is
    missing.
    """
    heavy_tailed = False
    for column in residuals.T:
        series = column[np.isfinite(column) & (column != 0.0)]
        few = len(series) < _FEWEST_FOR_KURTOSIS
        if few or (np.median(np.abs(series)) / _NORMAL_MEDIAN) ** 2 > _TYPICAL:
            return False
        heavy_tailed = heavy_tailed or _is_heavy_tailed(series)
    return heavy_tailed


def _is_heavy_tailed(series: Floats) -> bool:
    """Whether a series (N,) about 0 has a kurtosis that no normal one has."""
    return bool(np.mean(series**4) / np.mean(series**2) ** 2 - 3.0 > _EXCESS)


# order of the differences taken before the window, which keep slow motion from leaking into high bins
_ORDER = 4
_DIFFERENCES = np.array([(-1.0) ** lag * comb(_ORDER, lag) for lag in range(_ORDER + 1)])
_LOWEST = 0.125  # cycles per sample; lowest frequency of the cells
# bins and blocks in a cell, by length of a block
_CELLS = {256: (24, 1), 128: (12, 2), 64: (6, 4), 32: (6, 4), 16: (6, 4)}
# complete blocks needed for an estimate, by length of a block
_FEWEST = {256: 8, 128: 8, 64: 8, 32: 8, 16: 2}
_ACROSS_GAPS = 64  # samples: shorter blocks of a channel with gaps tell less than differences
_GAP_ORDER = 8  # order of divided differences
# of them in a cell: correlated as they are, they have as many degrees of freedom as a cell of spectra
_GAP_CELL = 80
_FEWEST_DIFFERENCES = 32
_QUANTILE = 0.25  # of the cells; assumed to be free of motion ...
_QUANTILE_LEVEL = 0.8  # ... and its value relative to the mean of noise: gamma distribution of shape 11
_MOTION = 2.2  # multiple of the noise level above which a cell contains motion
_CHUNK = 64  # blocks transformed at once, so that they stay in the cache


@dataclass(frozen=True, eq=False)
class BlockSpectra:
    """Power spectra of C channels in B blocks of so many samples that overlap by half, 1 for white noise of variance 1:
    the `mean` (C, K) over complete blocks, of which there are `counts` (C,), in all bins up to half the sampling rate, and
    the power of each block in G groups of high bins, `cells` (C, B, G). NaN where a sample is missing, and where the
    channel does not change, as a display or an encoder at rest: that says nothing of its noise.
    """

    block: int
    mean: Floats
    counts: Indices
    cells: Floats


def noise_sigma(samples: ArrayLike) -> Floats:
    """Standard deviation (C,) of the white measurement noise of channels (N, C), NaN where a sample is missing; NaN for a
    channel with fewer than two complete blocks of 20 samples and, with gaps, fewer than 40 samples. Incomplete blocks, and
    those in which a channel does not change at all, are left out; a channel that was sampled at a lower rate is judged by
    its own samples, and one with frequent gaps by divided differences. The standard error is about 1.2 % at N = 6001, with
    frequent gaps 2 %, and decreases with sqrt(N). For noise that is not white, the quarter of the cells with the least
    power determines the result.
    """
    return _sigma(_channels(samples), None)


def bandwidth(
    samples: ArrayLike, rate: float, sigma: ArrayLike | None = None, names: Sequence[str] = ()
) -> Floats:
    """Highest frequency in Hz (C,) at which the motion of each channel (N, C) exceeds its noise `sigma` (C,), by default
    that of `noise_sigma`: the highest bin of the averaged spectrum with more than twice the power of the white noise, half
    the sampling rate where motion fills the whole band, one bin where nothing exceeds the noise. RecordError if a channel,
    which `names` name, has no complete block of 256 samples, fewer in a short record.
    """
    highest = noise_and_bandwidth(samples, rate, sigma)[1]
    incomplete = np.flatnonzero(np.isnan(highest))
    if incomplete.size:
        which = names[incomplete[0]] if names else f"column {incomplete[0]}"
        raise RecordError(
            f"the bandwidth of {which} cannot be estimated: it has no {_block_length(_channels(samples))} consecutive samples "
            "without a gap; select a longer complete piece with record.between",
            arguments=("earliest", "latest"),
        )
    return highest


def noise_and_bandwidth(
    samples: ArrayLike, rate: float, stated: ArrayLike | None = None
) -> tuple[Floats, Floats]:
    """Noise and bandwidth (C,) of channels (N, C) from the same spectra, as from `noise_sigma`, where it is not `stated`
    (NaN), and from `bandwidth`, NaN without a complete block.
    """
    channels = _channels(samples)
    spectra = _spectra(channels, _block_length(channels))
    sigma = np.full(len(channels), np.nan) if stated is None else np.array(stated, dtype=float)
    if not np.isfinite(sigma).all():
        sigma = np.where(np.isfinite(sigma), sigma, _sigma(channels, spectra))
    margin = np.maximum(2.0, 1.0 + 4.0 / np.sqrt(np.maximum(spectra.counts, 1)))
    bins = np.arange(1, spectra.mean.shape[1] + 1)
    highest = np.where(spectra.mean > (sigma**2 * margin)[:, None], bins, 1).max(axis=1)
    return sigma, np.where(spectra.counts > 0, highest * rate / spectra.block, np.nan)


def _channels(samples: ArrayLike) -> Floats:
    """The channels as rows (C, N), contiguous."""
    values = np.asarray(samples, dtype=np.float64)
    return np.ascontiguousarray(np.atleast_2d(values.T))


def _block_length(channels: Floats) -> int:
    """Samples in a block for the bandwidth: a power of two, at most a third of the record."""
    return int(min(256, 2 ** int(np.log2(max(channels.shape[1] // 3, 16)))))


def _sigma(channels: Floats, computed: BlockSpectra | None) -> Floats:
    """Noise (C,) of the channels, whose spectra may be `computed` already."""
    sigma = np.full(len(channels), np.nan)
    gapped = np.isnan(channels).any(axis=1)
    for block, fewest in _FEWEST.items():
        pending = np.isnan(sigma) & ~(gapped & (block < _ACROSS_GAPS))
        if not pending.any():
            break
        reusable = computed is not None and computed.block == block and pending.all()
        spectra = computed if computed is not None and reusable else _spectra(channels[pending], block)
        sigma[pending] = np.sqrt(_spectral_levels(spectra, fewest))
    for channel in np.flatnonzero(np.isnan(sigma)):
        present = np.isfinite(channels[channel])
        every = sampled_every(present)
        if every > 1:  # sampled at a lower rate than others
            sigma[channel] = _sigma(channels[channel : channel + 1, np.argmax(present) :: every], None)[0]
        elif present.sum() >= _FEWEST_DIFFERENCES + _GAP_ORDER:
            sigma[channel] = _across_gaps(channels[channel])
    for channel in np.flatnonzero(~gapped & np.isfinite(sigma)):
        sigma[channel] = np.sqrt(noise_beside_motion(channels[channel], sigma[channel] ** 2))
    return sigma


def _across_gaps(samples: Floats) -> float:
    """Noise of samples (N,) with gaps, from divided differences of those that are present, each of variance 1 in its unit."""
    present = np.flatnonzero(np.isfinite(samples))
    width = _GAP_ORDER + 1
    places = np.lib.stride_tricks.sliding_window_view(present.astype(float), width)
    distances = places[:, :, None] - places[:, None, :] + np.eye(width)
    weights = 1.0 / distances.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    values = np.lib.stride_tricks.sliding_window_view(samples[present], width)
    power = np.einsum("ij,ij->i", weights, values) ** 2
    return float(np.sqrt(_noise_level(power[:, None], min(_GAP_CELL, len(power) // 4))))


def _spectral_levels(spectra: BlockSpectra, fewest: int) -> Floats:
    """Noise power (C,) of each channel, NaN with fewer than `fewest` complete blocks."""
    level = np.full(len(spectra.cells), np.nan)
    for channel, cells in enumerate(spectra.cells):
        telling = cells[np.isfinite(cells[:, 0])]
        if len(telling) >= fewest:
            level[channel] = _noise_level(telling, _CELLS[spectra.block][1])
        elif spectra.counts[channel] >= fewest and not len(telling):
            level[channel] = 0.0  # at rest throughout
    return level


def _noise_level(power: Floats, depth: int) -> float:
    """Mean power of the cells without motion, from the finite `power` (B, G); a cell has `depth` blocks."""
    blocks, groups = power.shape
    depth = min(depth, blocks)
    columns = power[: blocks // depth * depth].reshape(-1, depth, groups)
    cells = np.sort(columns.sum(axis=1).ravel() / depth)
    total = np.cumsum(cells)
    level = cells[int(_QUANTILE * len(cells))] / _QUANTILE_LEVEL
    for _ in range(5):
        last = max(int(np.count_nonzero(cells <= _MOTION * level)) - 1, 0)
        level = total[last] / (last + 1)
    return float(level)


def _spectra(channels: Floats, block: int) -> BlockSpectra:
    """Spectra of `channels` (C, N) in blocks of `block` samples."""
    hann, unit, groups = _window_and_bins(block)
    blocks = max(0, (channels.shape[1] - _ORDER - block) // (block // 2) + 1)
    total, counts = np.zeros((len(channels), len(groups))), np.zeros(len(channels), dtype=int)
    cells = np.empty((len(channels), blocks, groups.shape[1]))
    differences = np.empty(max(channels.shape[1] - _ORDER, block))
    pieces = np.lib.stride_tricks.sliding_window_view(differences, block)[:: block // 2]
    for channel, samples in enumerate(channels if blocks else ()):
        differences[:] = np.correlate(samples, _DIFFERENCES)
        for first in range(0, blocks, _CHUNK):
            waves = np.fft.rfft(pieces[first : first + _CHUNK] * hann)[:, 1:-1].view(np.float64)
            waves *= waves
            part = cells[channel, first : first + _CHUNK]
            np.matmul(waves, groups, out=part)
            complete = np.isfinite(part[:, 0])
            total[channel] += (waves if complete.all() else waves[complete]).sum(axis=0)
            counts[channel] += np.count_nonzero(complete)
        cells[channel, _at_rest(samples, block)[:blocks]] = np.nan
    mean = total.reshape(len(channels), -1, 2).sum(axis=2) * unit / np.maximum(counts, 1)[:, None]
    return BlockSpectra(block, mean, counts, cells)


def _at_rest(samples: Floats, block: int) -> Bools:
    """(B,) whether `samples` (N,) are the same in all of a block and the samples that its differences need."""
    changes, reach = np.concatenate([[0], np.cumsum(np.diff(samples) != 0.0)]), block + _ORDER - 1
    return np.asarray(changes[reach :: block // 2] == changes[: -reach : block // 2])


@lru_cache(maxsize=32)
def _window_and_bins(block: int) -> tuple[Floats, Floats, Floats]:
    """The Hann window (block,), the factor (K,) that makes the power of differenced white noise 1 in each bin, and the matrix
    (2 K, G) from squared cosine and sine parts, alternating, to power in G groups of bins.
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
        members = slice(lowest - 1 + group * wide, lowest - 1 + (group + 1) * wide)
        groups[members, group] = unit[members] / wide
    return hann, unit, np.repeat(groups, 2, axis=0)


_FLOOR = 1e-8  # of half the range, 160 dB: with less, a search would fit rounding, and inputs between their samples
_ROUNDING = 1e-12  # of the largest sample


def channel_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response in its SI unit, at least the `noise_floor` where the record does
    not state it.
    """
    names = record.responses
    sigma = noise_deviations(record, names)
    floor = noise_floor(record)
    return {name: max(float(value), floor[name]) for name, value in zip(names, sigma, strict=True)}


def noise_floor(record: Record) -> dict[str, float]:
    """Standard deviations by response, in its SI unit, that stand for no noise, as records of simulations have none; 0 for
    one whose noise the record states.
    """
    floor: dict[str, float] = dict.fromkeys(record.responses, 0.0)
    for name in floor.keys() - record.noise.keys():
        values = record.channel(name)
        lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
        floor[name] = max(0.5 * _FLOOR * (highest - lowest), _ROUNDING * max(abs(lowest), abs(highest)))
    return floor


def noise_deviations(record: Record, names: Sequence[str]) -> Floats:
    """Standard deviations (C,) of the noise of the named channels, stated or estimated; 0 for one with too many gaps for an
    estimate.
    """
    stated = np.array([record.noise.get(name, np.nan) for name in names])
    if np.isfinite(stated).all():
        return stated
    estimated = np.nan_to_num(noise_sigma(record.select(names).values))
    return np.where(np.isfinite(stated), stated, estimated)
