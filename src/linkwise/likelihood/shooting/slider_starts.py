"""Where the sliders of links were when a record began: within their largest sizes, which records hardly tell.

Sliders side by side stick until the motion turns far enough, and until then their forces add up to one. How the states of
several share it at the start of a record shows in their corners alone: the equations were singular along such shares, and
searches crept. A slider is never beyond its largest size, and its state passes through all of its range: at the start it is
taken as normal around zero with the root mean square of its size along the motion.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.segments import Scales, Segments
from linkwise.likelihood.shooting.system import MANY

_SIZE = 10.0  # times the scale of a state that no channel shows: its root mean square


def cost_of_starts(segments: Segments, nodes: Floats, scales: Scales) -> float:
    """What the states of sliders at the starts of chains of segments add to the cost.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    nodes : array of shape (2n + S, K)
        The states at the nodes.
    scales : Scales
        Units of the unknowns.

    Returns
    -------
    float
        The sum of squares over those of their sizes; 0 of many masses, among which neighbours tell of each other.
    """
    rows, firsts = _places(segments)
    if not len(rows):
        return 0.0
    return float(np.sum((nodes[rows][:, firsts] / (_SIZE * scales.state[rows, None])) ** 2))


def add_starts(state: Floats, right: Floats, segments: Segments, nodes: Floats, scales: Scales) -> None:
    """Add that cost to normal equations.

    Parameters
    ----------
    state, right : array of shape (K, m, m) and (K, m, p + 1)
        Diagonal blocks of the nodes, and their right-hand sides, the last column of which is the negative gradient.
    segments, nodes, scales
        As of `cost_of_starts`.
    """
    rows, firsts = _places(segments)
    if not len(rows):
        return
    state[firsts[:, None], rows, rows] += _SIZE**-2.0
    right[firsts[:, None], rows, -1] -= (nodes[rows][:, firsts] / scales.state[rows, None]).T / _SIZE**2


def _places(segments: Segments) -> tuple[Indices, Indices]:
    """Rows of the states, and the first segments of chains; no rows of many masses."""
    rows = segments.system.slider_states
    few = len(segments.system.incidence) < MANY
    return rows[: len(rows) if few else 0], np.flatnonzero(np.append(True, ~segments.linked))
