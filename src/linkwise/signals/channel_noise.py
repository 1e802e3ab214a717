"""Noise of the channels of a record: stated by the record, or else estimated from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma

_FLOOR = 1e-12  # of the largest sample: smaller noise is lost in rounding


def channel_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response, in its SI unit; at least that of rounding."""
    names = record.responses
    sigma = _deviations(record, names, record.select(names).values.T)
    floor = {name: _FLOOR * float(np.nanmax(np.abs(record.channel(name)))) for name in names}
    return {name: max(float(value), floor[name]) for name, value in zip(names, sigma, strict=True)}


def noise_variance(record: Record, names: Sequence[str], values: Floats) -> Floats:
    """Variance (C,) of the noise in `values` (C, N) of the channels `names`."""
    return _deviations(record, names, values) ** 2


def _deviations(record: Record, names: Sequence[str], values: Floats) -> Floats:
    """Standard deviations (C,); 0 for a channel with too many gaps for an estimate."""
    stated = np.array([record.noise.get(name, np.nan) for name in names])
    if np.isfinite(stated).all():
        return stated
    estimated = np.nan_to_num(noise_sigma(values.T))
    return np.where(np.isfinite(stated), stated, estimated)
