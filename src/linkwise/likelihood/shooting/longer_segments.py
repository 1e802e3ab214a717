"""Segments joined to longer ones: fewer nodes for a motion that is already that of the laws.

Short segments let a search start far from the laws. Where the motion is nearly continuous, the same samples in segments
several times as long have the same optimum, and elimination, whose cost is that of the nodes, takes a fraction of the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.flow import Trajectories
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import Iterate, Segments

_JOINED = 2  # short segments in a longer one: in more of them the influence of a mass reaches too far
_JOINED_OF_FEW = 4  # the same where it reaches most of the structure anyway
_FEW = 24  # masses


@dataclass(frozen=True, eq=False)
class LongerSegments:
    """`segments` of several shorter ones each, whose numbers are `parts` (K', f); the last of a chain may be repeated."""

    segments: Segments
    parts: Indices

    @classmethod
    def of(cls, shorter: Segments, joined: int | None = None) -> LongerSegments | None:
        """The segments of each chain joined, a few or as many as `joined` to one.

        None with random forces, which are constant in a segment, and late bases.
        """
        if shorter.random is not None or shorter.late_base is not None:
            return None
        parts = _parts(shorter, joined)
        last = parts[:-1, -1]
        heads = parts[:, 0]
        inputs, waveforms = shorter.inputs, shorter.waveforms
        together = replace(
            shorter,
            samples=_end_to_end(shorter.samples, parts),
            observed=_end_to_end(shorter.observed, parts, _once(parts)),
            step=shorter.step[heads],
            linked=shorter.linked[last],
            inputs=inputs.mapped(
                lambda signal: _end_to_end(signal, parts),
                None if inputs.uncertain is None else inputs.uncertain.unit[heads],
            ),
            relative_noise=None if shorter.relative_noise is None else shorter.relative_noise[:, heads],
            carried=None
            if shorter.carried is None
            else np.stack([_end_to_end(signal, parts) for signal in shorter.carried]),
            waveforms=None
            if waveforms is None
            else replace(waveforms, values=_end_to_end(waveforms.values, parts)),
            clipped=None
            if shorter.clipped is None
            else shorter.clipped.mapped(lambda values: _end_to_end(values, parts, _once(parts))),
        )
        return cls(together, parts)

    def point(self, point: Iterate) -> Iterate:
        """A point with the nodes of the longer segments."""
        return replace(point, nodes=point.nodes[:, self.parts[:, 0]])

    def misfit(self, shorter: Misfit) -> Misfit:
        """The misfit of the shorter segments as one of the longer ones: the same motion, whose defects inside them count for
        nothing.
        """
        parts, orbit = self.parts, shorter.trajectories
        defects = shorter.defects[:, parts[:-1, -1]]
        return replace(
            shorter,
            point=self.point(shorter.point),
            trajectories=orbit.end_to_end(parts),
            residuals=_end_to_end(shorter.residuals, parts, _once(parts)),
            clipped=None
            if shorter.clipped is None
            else shorter.clipped.mapped(lambda values: _end_to_end(values, parts, _once(parts))),
            defects=defects,
            continuity=float(np.vdot(defects, defects)),
        )

    def short_nodes(self, orbit: Trajectories) -> Floats:
        """(2n + S, K) states at the nodes of the shorter segments, along an orbit of the longer ones."""
        segments = self.segments
        every = segments.steps // self.parts.shape[1]
        x, u = (orbit.states[:-1:every, kind] for kind in (0, 1))
        states = np.concatenate([x, u / segments.step, orbit.memory[:-1:every]], axis=1)
        nodes = np.empty((states.shape[1], int(self.parts.max()) + 1))
        for number in reversed(range(len(states))):  # where one is repeated, its first place counts
            nodes[:, self.parts[:, number]] = states[number]
        return nodes


def _parts(segments: Segments, joined: int | None) -> Indices:
    """(K', f) the short segments in each longer one, which no end of a chain interrupts."""
    if joined is None:
        joined = _JOINED_OF_FEW if len(segments.system.incidence) <= _FEW else _JOINED
    edges = [0, *(np.flatnonzero(~segments.linked) + 1).tolist(), segments.count]
    rows = [
        np.minimum(np.arange(first, last, joined)[:, None] + np.arange(joined), last - 1)
        for first, last in pairwise(edges)
    ]
    return np.concatenate(rows)


def _once(parts: Indices) -> Bools:
    """(K', f) which parts are not repeated."""
    which = np.ones(parts.shape, dtype=bool)
    np.not_equal(parts[:, 1:], parts[:, :-1], out=which[:, 1:])
    return which


def _end_to_end(values: NDArray[Any], parts: Indices, which: Bools | None = None) -> NDArray[Any]:
    """(f J, ..., K') of values (J, ..., K) in short segments; zero where not `which` (K', f)."""
    pieces = np.moveaxis(values[..., parts], -1, 0)
    if which is not None:
        pieces = pieces * which.T.reshape(len(pieces), *[1] * (values.ndim - 1), -1)
    return np.ascontiguousarray(pieces.reshape(-1, *pieces.shape[2:]))
