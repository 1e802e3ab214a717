"""The samples that all sensors have of a record whose sensors were sampled at different rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools
from linkwise.records.channel import Channel
from linkwise.records.record import Record

_MOTION = ("x", "v", "a")
_REGULAR = (
    0.9  # of the distances, multiples of that of most samples: a few samples more or less make no other rate
)


def common_samples(record: Record) -> Record | None:
    """A record at the lowest of the rates at which the motion of its masses was sampled.

    Parameters
    ----------
    record : Record
        The record.

    Returns
    -------
    Record or None
        The record at every so-manyth of its samples, without a filter; None where most samples that all displacements,
        velocities and accelerations have follow one another.
    """
    moving = [name for name in record.responses if Channel.parse(name).kind in _MOTION]
    complete = np.asarray(np.isfinite(record.select(moving).values).all(axis=1))
    every = sampled_every(complete)
    if every < 2:
        return None
    first = int(np.argmax(complete))
    return replace(
        record,
        start=record.start + first / record.rate,
        rate=record.rate / every,
        values=record.values[first::every],
        simulated=None,
    )


def sampled_every(present: Bools) -> int:
    """Samples from most of those that are `present` (N,) to the next one.

    1 with less than two of them, and where the distances of many are no multiples of that, as where samples are missing at
    random.
    """
    distances = np.diff(np.flatnonzero(present))
    if not len(distances):
        return 1
    every = int(np.median(distances))
    return every if np.mean(distances % every == 0) > _REGULAR else 1
