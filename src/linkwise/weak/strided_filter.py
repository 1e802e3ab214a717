"""Correlation of signals with kernels at every so many samples, by blocked matrix products."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats

_AT_ONCE = 2**17  # samples that are processed together: they fit in the cache
_BLOCK = 8  # outputs in one row of the blocked product


def strided_filter(signals: Floats, kernels: Floats, stride: int) -> Floats:
    """Correlate signals with kernels at every stride-th sample.

    Each block of outputs is one product with a banded Toeplitz matrix.

    Parameters
    ----------
    signals : array of shape (S, N)
        The signals.
    kernels : array of shape (Q, T)
        The kernels.
    stride : int
        Distance of the outputs in samples.

    Returns
    -------
    array of shape (Q, S, (N - T) // stride + 1)
        The correlations.
    """
    (count, samples), (filters, length) = signals.shape, kernels.shape
    rows = (samples - length) // stride + 1
    per_block = max(1, min(rows, _BLOCK))
    blocks, span = rows // per_block, (per_block - 1) * stride + length
    toeplitz = np.zeros((filters, span, per_block))
    for row in range(per_block):
        toeplitz[:, row * stride : row * stride + length, row] = kernels
    pieces = _windows(signals, blocks, span, per_block * stride)
    result, last = np.empty((filters, count, rows)), blocks * per_block
    group = max(1, _AT_ONCE // (blocks * span))
    for first in range(0, count, group):
        part = np.ascontiguousarray(pieces[first : first + group])
        for kernel in range(filters):
            target = result[kernel, first : first + group, :last]
            np.matmul(part, toeplitz[kernel], out=target.reshape(len(target), blocks, per_block))
    if last < rows:  # fewer than a block
        ends = _windows(signals[:, last * stride :], rows - last, length, stride)
        result[:, :, last:] = (ends @ kernels.T).transpose(2, 0, 1)
    return result


def _windows(signals: Floats, count: int, length: int, stride: int) -> Floats:
    """(S, count, length) pieces of signals at every stride-th sample, which must all be inside; as views."""
    by_signal, by_sample = (
        signals.strides
    )  # as `sliding_window_view`, whose checks cost as much as a short filter
    shape, strides = (len(signals), count, length), (by_signal, stride * by_sample, by_sample)
    return np.lib.stride_tricks.as_strided(signals, shape, strides, writeable=False)
