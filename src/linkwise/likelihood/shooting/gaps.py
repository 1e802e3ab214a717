"""Long gaps in records: where the chain of segments is interrupted, and the start inside gaps.

Over a long gap chaotic motion has many continuations, and a search cannot choose among them from poor starting values. The
state after the gap is therefore free at first, as at the start of a record; once the laws are known, the two sides are
joined.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools
from linkwise.likelihood.shooting.flow import flow
from linkwise.likelihood.shooting.segments import Iterate, Segments

_BRIDGED = 2  # segments without a sample of a mass that a rough start may bridge


def split_at_gaps(segments: Segments) -> Segments:
    """Interrupt the chain of segments at long gaps.

    No segment inside a gap of all sensors is linked to another. In a gap of the sensors of one mass, the laws continue its
    motion from the near side, and the chain is interrupted at the far side.

    Parameters
    ----------
    segments : Segments
        The segments.

    Returns
    -------
    Segments
        The same with fewer linked pairs.
    """
    linked = segments.linked.copy()
    for first, last in _gaps(segments.informed):
        linked[max(first - 1, 0) : last] = False
    sensors = segments.sensors
    for mass in np.unique(sensors.mass[sensors.of_masses]):
        for _, last in _gaps(segments.informed[:, sensors.of_masses & (sensors.mass == mass)]):
            linked[last - 1 : last] = False
    return replace(segments, linked=linked)


def _gaps(observed: Bools) -> list[tuple[int, int]]:
    """First segment of every long gap in the channels (M, C, K) and the first after it."""
    unobserved = np.concatenate([[False], ~observed.any(axis=(0, 1)), [False]])
    turns = np.flatnonzero(np.diff(unobserved)).reshape(-1, 2)
    return [(int(first), int(last)) for first, last in turns if last - first > _BRIDGED]


def carry_through_gaps(segments: Segments, point: Iterate) -> Iterate:
    """Start inside gaps by integration of the laws instead of interpolation.

    Parameters
    ----------
    segments : Segments
        The segments.
    point : Iterate
        The start.

    Returns
    -------
    Iterate
        The start with new nodes in gaps.
    """
    n, sensors = len(segments.system.incidence), segments.sensors
    unobserved = np.zeros((len(point.nodes), segments.count), dtype=bool)
    for mass in np.unique(sensors.mass[sensors.of_masses & (sensors.mass < n)]):
        shows = sensors.of_masses & (sensors.mass == mass)
        unobserved[[mass, n + mass]] = ~segments.informed[:, shows].any(axis=(0, 1))
    unobserved[:, 0] = False
    unobserved[:, 1:] &= segments.linked
    depth = np.zeros(segments.count, dtype=int)
    for k in np.flatnonzero(unobserved.any(axis=0)):
        depth[k] = depth[k - 1] + 1
    nodes, mechanics = point.nodes.copy(), segments.system.at(point.theta)
    for reached in range(1, int(depth.max(initial=0)) + 1):
        segment = np.flatnonzero(depth == reached)
        before, step = segment - 1, segments.step[segment - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            orbit = flow(mechanics, nodes[..., before], step, segments.steps, segments.inputs.part(before))
        end = orbit.ends(step)
        replaced = unobserved[:, segment] & np.isfinite(end).all(axis=0)
        nodes[..., segment] = np.where(replaced, end, nodes[..., segment])
    return replace(point, nodes=nodes)
