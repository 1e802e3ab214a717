"""What is known of the unknowns beforehand: Gaussian priors of coefficients, masses and sensors' gains and offsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats

_OWN = 1e-3  # of a prior's variance: what the records must take off it to say anything against it


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal distributions of the unknowns that all segments share.

    Attributes
    ----------
    mean : array of shape (P,)
        Most likely values of parameters, offsets and gains.
    deviation : array of shape (P,)
        Their standard deviations; infinite where nothing is known.
    """

    mean: Floats
    deviation: Floats

    @property
    def count(self) -> int:
        """Number of unknowns with a prior; each is one more residual."""
        return int(np.isfinite(self.deviation).sum())

    def cost(self, border: Floats) -> float:
        """-2 log of the density at `border` (P,), without its constant."""
        return float(np.sum(self._standardised(border) ** 2))

    def curvature(self, unit: Floats) -> Floats:
        """(P,) diagonal that the prior adds to normal equations in units of `unit` (P,)."""
        return np.asarray((unit / self.deviation) ** 2)

    def gradient(self, border: Floats, unit: Floats) -> Floats:
        """(P,) that the prior adds to the right-hand side of normal equations in units of `unit` (P,)."""
        return np.asarray(self._standardised(border) * unit / self.deviation)

    def conflicts(self, border: Floats, variance: Floats) -> Floats:
        """(P,) what leaving out each prior would take off the cost, to first order: chi-square with one degree of freedom.

        `border` and `variance` (P,) are the unknowns and their variances with all priors; zero where there is no prior, or
        where it alone says what the unknown is.
        """
        left = 1.0 - np.minimum(variance / self.deviation**2, 1.0)
        determined = np.isfinite(self.deviation) & (left > _OWN)
        return np.where(determined, self._standardised(border) ** 2 / np.where(determined, left, 1.0), 0.0)

    def _standardised(self, border: Floats) -> Floats:
        return np.asarray((self.mean - border) / self.deviation)
