"""Short gaps of records, bridged so that modes can be followed as they ring down.

A few samples that are missing change a window of a hundred or more by next to nothing, and what a bridge gets wrong scatters
about the lines from which frequency and damping follow, whose errors count it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.inspection.levels.ring_down import SILENT
from linkwise.records.record import Record

_SHORT = 6  # samples, as in responses


@dataclass(frozen=True)
class BridgedGaps:
    """The short gaps of one channel.

    Attributes
    ----------
    record, channel : str
        Where they are: the label of the level, and the channel.
    samples : int
        How many samples were missing, and are interpolated.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.compare_levels([lw.read_record("soft_tap.csv"), lw.read_record("hard_tap.csv")])
    >>> found.bridged
    ()
    """

    record: str
    channel: str
    samples: int


def forces_bridged(record: Record) -> Record:
    """A record whose forces have their short gaps bridged by lines where none acts on either side."""
    values = record.values.copy()
    for name in record.inputs:
        values[:, record.channels.index(name)] = _silence_bridged(record.channel(name))
    return record if np.array_equal(values, record.values, equal_nan=True) else replace(record, values=values)


def bridged_gaps(
    labels: Sequence[str], records: Sequence[Record], bridged: Sequence[Record]
) -> tuple[BridgedGaps, ...]:
    """What of `records`, each with its label, was missing and is there in those that are `bridged`."""
    gaps: list[BridgedGaps] = []
    for label, record, complete in zip(labels, records, bridged, strict=True):
        counts = np.sum(np.isnan(record.values) & np.isfinite(complete.values), axis=0)
        gaps += [
            BridgedGaps(label, name, int(count))
            for name, count in zip(record.channels, counts.tolist(), strict=True)
            if count
        ]
    return tuple(gaps)


def _silence_bridged(force: Floats) -> Floats:
    """The samples (N,) with lines through short gaps in which nothing acts."""
    missing = np.isnan(force)
    if not missing.any() or missing.all():
        return force
    index = np.arange(len(force))
    lines = np.interp(index, index[~missing], force[~missing])
    silent = np.abs(lines) <= SILENT * np.abs(force[~missing]).max()
    return np.where(_short(missing) & silent, lines, force)


def _short(missing: Bools) -> Bools:
    """Which samples (N,) are in gaps of six or fewer, with samples on both sides."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
    short = np.zeros(len(missing), dtype=bool)
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        short[first:last] = first > 0 and last < len(missing) and last - first <= _SHORT
    return short
