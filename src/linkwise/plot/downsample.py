"""Fewer points for the same picture: a trace keeps the extremes of every block of samples that is narrower than a pixel."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats


def envelope(time: Floats, values: Floats, points: int = 4000) -> tuple[Floats, Floats]:
    """`time` (N,) and `values` (N,) as at most about `points` points whose line covers the same pixels.

    Each block gives its least and its greatest value in order of time. A block that lacks all its samples gives NaN, so gaps
    stay gaps.
    """
    block = -(-len(time) // max(points // 2, 1))
    if block <= 2:
        return time, values
    count = -(-len(time) // block)
    padded = np.full(count * block, np.nan)
    padded[: len(values)] = values
    blocks = padded.reshape(count, block)
    least = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    greatest = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    picked = np.sort(np.stack([least, greatest], axis=1), axis=1) + block * np.arange(count)[:, None]
    index = np.minimum(picked.ravel(), len(time) - 1)
    return time[index], values[index]


def scattered(count: int, points: int = 3000) -> slice:
    """Every k-th of `count` samples, so that about `points` are left; order and spread over time are kept."""
    return slice(None, None, max(1, -(-count // points)))
