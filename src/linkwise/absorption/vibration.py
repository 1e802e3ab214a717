"""How the primary masses of one run or of many vibrate about the places where they come to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.absorption.decay import Decay
from linkwise.absorption.rest_positions import RestPositions
from linkwise.absorption.runs import Runs
from linkwise.arrays import Floats


@dataclass(frozen=True, eq=False)
class Vibration:
    """The primary masses of W runs, `columns` of their motions, about those of their resting places they end nearest to."""

    runs: Runs
    columns: Sequence[int]
    resting: Sequence[RestPositions]

    @cached_property
    def rest(self) -> Floats:
        """(P, W) m."""
        last = self.runs.x[-1, list(self.columns)]
        return np.stack([each.nearest(last[:, run]) for run, each in enumerate(self.resting)], axis=1)

    @cached_property
    def decay(self) -> Decay:
        """Excursions (N, P, W)."""
        columns = list(self.columns)
        return Decay(self.runs.time, self.runs.x[:, columns] - self.rest, self.runs.v[:, columns])

    @property
    def peak(self) -> Floats:
        """(P, W) m."""
        return self.decay.peak

    @cached_property
    def rms(self) -> Floats:
        """(P, W) m."""
        return np.sqrt(self.decay.mean_square)

    def settled(self, level: Floats) -> Floats:
        """(P, W) s; NaN where a mass does not settle below `level` (P, W)."""
        return self.decay.settled(level)


def reduction(with_sinks: Floats, without: Floats) -> Floats:
    """By what part something is smaller with sinks than without; NaN where there is nothing without."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(without > 0.0, 1.0 - with_sinks / without, np.nan))


def together(values: Floats) -> Floats:
    """(W,) root of the sum of squares over the masses of (P, W)."""
    return np.asarray(np.sqrt(np.square(values).sum(axis=0)))
