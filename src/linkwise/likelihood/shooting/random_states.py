"""Random forces on masses as states of the segments: constant in a segment of one sample, independent of those around it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from linkwise.arrays import Bools, Floats, Indices


@dataclass(frozen=True, eq=False)
class RandomStates:
    """Random forces among the states: normal, of mean zero, and without continuity between segments.

    Attributes
    ----------
    rows : array of int, shape (r,)
        Their numbers among the 2n + S states.
    deviation : array of shape (r, K)
        Standard deviations in N.
    found : array of bool, shape (r,)
        Whether the deviations are to be found.
    absent : array of bool, shape (r,), or None
        Those that were looked for and not found: their deviations stand for zero. None for none of them.
    slope : array of shape (P,) or None
        Gradient of the log determinant of the equations by the unknowns that all nodes share: its part of -2 log of the
        marginal likelihood, which is linear around the optimum.
    origin : array of shape (P,) or None
        Where that part is counted as zero.
    shown : array of shape (C, r) or None
        What the sensors show of them directly, besides the motion that follows; None for nothing.
    varying : array of bool, shape (r,), or None
        Those that vary within a segment as white noise does, of which the states are the means. None for none of them.
    weights : array of shape (2n + S, K) or None
        What defects at the ends of the segments weigh, where these forces leave some in displacements. None for 1.
    """

    rows: Indices
    deviation: Floats
    is_estimated: Bools
    absent: Bools | None = None
    slope: Floats | None = None
    origin: Floats | None = None
    shown: Floats | None = None
    varying: Bools | None = None
    weights: Floats | None = None

    def cost(self, nodes: Floats, border: Floats) -> float:
        """What the forces among `nodes` (2n + S, K) and the slope along `border` (P,) add to the cost."""
        tilt = 0.0
        if self.slope is not None and self.origin is not None:
            tilt = float(self.slope @ (border - self.origin))
        return float(np.sum((nodes[self.rows] / self.deviation) ** 2)) + tilt

    def curvature(self, scale: Floats) -> Floats:
        """(r, K) half the second derivatives of the cost by the forces, in units `scale` (2n + S,) of the states."""
        return np.asarray((scale[self.rows, None] / self.deviation) ** 2)

    @property
    def present(self) -> Bools:
        """(r,) those that are not absent."""
        return np.ones(len(self.rows), dtype=bool) if self.absent is None else ~self.absent

    def scaled(self, factors: Floats) -> Self:
        """The same with deviations multiplied by `factors` (r,)."""
        return replace(self, deviation=self.deviation * factors[:, None])

    def chosen(self, segments: Indices) -> Self:
        """The forces in some of the segments."""
        weights = None if self.weights is None else self.weights[:, segments]
        return replace(self, deviation=self.deviation[:, segments], weights=weights)
