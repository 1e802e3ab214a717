"""Short gaps of channels, bridged for starting values; the likelihood takes what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.records.record import Record

_SHORT = 6  # samples: longer gaps are left, as a cubic may swing far out in them
_FEWEST = 4  # samples that a cubic needs


def short_gaps_bridged(record: Record) -> Record | None:
    """A record whose responses have their short gaps interpolated.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    Record or None
        The record with a cubic spline in each gap of at most six samples; None where there is no such gap.
    """
    values = record.values.copy()
    for name in record.responses:
        values[:, record.channels.index(name)] = _bridged(record.channel(name))
    if np.array_equal(values, record.values, equal_nan=True):
        return None
    return replace(record, values=values, simulated=None)


def _bridged(samples: Floats) -> Floats:
    """The samples (N,) with short gaps interpolated, except at the ends."""
    present = np.flatnonzero(np.isfinite(samples))
    if len(present) < _FEWEST:
        return samples
    distance = np.repeat(np.diff(present), np.diff(present))  # from the sample before to the one after
    inside = np.arange(present[0], present[-1])
    filled = inside[(distance <= _SHORT + 1) & np.isnan(samples[inside])]
    bridged = samples.copy()
    bridged[filled] = scipy.interpolate.CubicSpline(present, samples[present])(filled)
    return bridged
