"""Long gaps in records: where the chain of segments is broken at first, and what a start looks like inside.

Over a long gap a chaotic motion has many ways to the other side, between which no search decides from afar. So the state
behind it is free at first, as at the start of a record; once all laws are known, the two sides can be joined.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Bools
from linkwise.likelihood.flow import flow
from linkwise.likelihood.segments import Iterate, Segments

_BRIDGED = 2  # segments without a sample of a mass over which a rough start leads from one side to the other


def split_at_gaps(segments: Segments) -> Segments:
    """The same segments without links where a mass is seen again after a long gap.

    Where all sensors are silent no segment of the gap is linked to another; where those of one mass are, the laws carry it
    through the gap from its near side.
    """
    linked = segments.linked.copy()
    for first, last in _gaps(segments.observed):
        linked[max(first - 1, 0) : last] = False
    for mass in np.unique(segments.sensors.mass):
        for _, last in _gaps(segments.observed[:, segments.sensors.mass == mass]):
            linked[last - 1 : last] = False
    return replace(segments, linked=linked)


def _gaps(seen: Bools) -> list[tuple[int, int]]:
    """First segment of every long gap in the channels (M, C, K) and the first after it."""
    silent = np.concatenate([[False], ~seen.any(axis=(0, 1)), [False]])
    turns = np.flatnonzero(np.diff(silent)).reshape(-1, 2)
    return [(int(first), int(last)) for first, last in turns if last - first > _BRIDGED]


def carry_through_gaps(segments: Segments, point: Iterate) -> Iterate:
    """The start with masses carried on by the laws where their sensors are silent, instead of along a straight line."""
    n = point.nodes.shape[1]
    silent = np.zeros((n, segments.count), dtype=bool)
    for mass in np.unique(segments.sensors.mass):
        silent[mass] = ~segments.observed[:, segments.sensors.mass == mass].any(axis=(0, 1))
    silent[:, 0] = False
    silent[:, 1:] &= segments.linked
    depth = np.zeros(segments.count, dtype=int)
    for k in np.flatnonzero(silent.any(axis=0)):
        depth[k] = depth[k - 1] + 1
    nodes, mechanics = point.nodes.copy(), segments.system.at(point.theta)
    for reached in range(1, int(depth.max(initial=0)) + 1):
        here = np.flatnonzero(depth == reached)
        before, step = here - 1, segments.step[here - 1]
        with np.errstate(over="ignore", invalid="ignore"):
            orbit = flow(mechanics, nodes[..., before], step, segments.steps, segments.inputs.part(before))
        end = orbit.states[-1]
        end[1] /= step
        wanted = silent[:, here] & np.isfinite(end).all(axis=0)
        nodes[..., here] = np.where(wanted, end, nodes[..., here])
    return replace(point, nodes=nodes)
