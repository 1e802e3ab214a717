"""Noise of the channels of a record: stated by the record, else estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma

_FLOOR = 1e-12  # of the largest sample: smaller noise is below rounding


def channel_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    dict of str to float
        Standard deviations by channel in its SI unit, at least those of rounding.
    """
    names = record.responses
    sigma = _deviations(record, names, record.select(names).values.T)
    floor = {name: _FLOOR * float(np.nanmax(np.abs(record.channel(name)))) for name in names}
    return {name: max(float(value), floor[name]) for name, value in zip(names, sigma, strict=True)}


def noise_variance(record: Record, names: Sequence[str], values: Floats) -> Floats:
    """Variance of the noise of channels.

    Parameters
    ----------
    record : Record
        The record, whose stated noise is used.
    names : sequence of str
        Names of the C channels.
    values : array of shape (C, N)
        Their samples.

    Returns
    -------
    array of shape (C,)
        Variances; 0 for a channel with too many gaps for an estimate.
    """
    return _deviations(record, names, values) ** 2


def _deviations(record: Record, names: Sequence[str], values: Floats) -> Floats:
    """Standard deviations (C,); 0 for a channel with too many gaps for an estimate."""
    stated = np.array([record.noise.get(name, np.nan) for name in names])
    if np.isfinite(stated).all():
        return stated
    estimated = np.nan_to_num(noise_sigma(values.T))
    return np.where(np.isfinite(stated), stated, estimated)
