"""Means of residuals over parts of the range of a motion: where a law lacks something, they leave what noise explains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats

_PARTS = 24
_FEWEST = 20  # samples in a part
_TWO = 2.0  # standard errors of a mean, between which noise leaves 95 % of them


@dataclass(frozen=True, eq=False)
class MeanResiduals:
    """Means in parts of the range with equally many samples.

    Attributes
    ----------
    place : array of shape (P,)
        Mean motion in each part, in its unit.
    mean : array of shape (P,)
        Mean residuals, in standard deviations of the noise.
    by_chance : array of shape (P,)
        What white noise alone leaves in 95 % of the parts, to both sides of zero.
    """

    place: Floats
    mean: Floats
    by_chance: Floats

    @classmethod
    def along(cls, motion: Floats, residuals: Floats) -> MeanResiduals:
        """Those of residuals (N,), NaN where a sample is missing, along a motion (N,); of none there is one part, of NaN."""
        present = np.flatnonzero(~np.isnan(residuals))
        if not len(present):
            return cls(*np.full((3, 1), np.nan))
        order = present[np.argsort(motion[present], kind="stable")]
        parts = np.array_split(order, max(min(_PARTS, len(order) // _FEWEST), 1))
        return cls(
            np.array([motion[part].mean() for part in parts]),
            np.array([residuals[part].mean() for part in parts]),
            np.array([_TWO / np.sqrt(len(part)) for part in parts]),
        )
