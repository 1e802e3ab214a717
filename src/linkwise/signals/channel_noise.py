"""Noise of the channels of a record: stated by the record, else estimated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.records.record import Record
from linkwise.signals.noise import noise_sigma

_FLOOR = 1e-8  # of half the range, 160 dB: with less, a search would fit rounding, and inputs between their samples
_ROUNDING = 1e-12  # of the largest sample


def channel_noise(record: Record) -> dict[str, float]:
    """Standard deviation of the noise of every response.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    dict of str to float
        Standard deviations by channel in its SI unit, at least the `noise_floor` where the record does not state them.
    """
    names = record.responses
    sigma = _deviations(record, names, record.select(names).values.T)
    floor = noise_floor(record)
    return {name: max(float(value), floor[name]) for name, value in zip(names, sigma, strict=True)}


def noise_floor(record: Record) -> dict[str, float]:
    """Standard deviations by response that stand for no noise, as records of simulations have none.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    dict of str to float
        Standard deviations by channel in its SI unit; 0 for one whose noise the record states.
    """
    floor = dict.fromkeys(record.responses, 0.0)
    for name in floor.keys() - record.noise.keys():
        values = record.channel(name)
        lowest, highest = float(np.nanmin(values)), float(np.nanmax(values))
        floor[name] = max(0.5 * _FLOOR * (highest - lowest), _ROUNDING * max(abs(lowest), abs(highest)))
    return floor


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
