"""Readings of sensors that were overloaded, as bounds: the likelihood of a censored normal variable.

With u the distance in standard deviations by which the motion is beyond the end of the range, a reading there has the
probability Phi(u), the normal distribution. Its score h = phi(u) / Phi(u) and curvature h (h + u) are those of an observation
1 / (h + u) beyond the motion with this curvature as weight. Samples that noise alone held inside are exact: were they left
out and the others not, noise would have chosen which samples count.

References
----------
J. Tobin, Econometrica 26, 24 (1958).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.special
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.records.record import Record

_FARTHEST = 1e5  # standard deviations inside the range, from which a bound is an observation to rounding


@dataclass(frozen=True, eq=False)
class ClippedMisfit:
    """What clipped readings say of a motion.

    Attributes
    ----------
    residuals, roots : array of shape (M, C, K)
        Residuals of the observations that stand for them, in standard deviations, and the roots of their weights; else 0.
    shown : array of shape (M, C, K)
        What the sensors would show there, in standard deviations; else 0.
    cost : float
        Twice the negative log likelihood, up to a constant.
    """

    residuals: Floats
    roots: Floats
    shown: Floats
    cost: float

    def mapped(self, function: Callable[[Floats], Floats]) -> ClippedMisfit:
        """The same after a change of the segments."""
        return ClippedMisfit(function(self.residuals), function(self.roots), function(self.shown), self.cost)


@dataclass(frozen=True, eq=False)
class ClippedReadings:
    """Clipped readings in segments.

    Attributes
    ----------
    present : array of bool, shape (M, C, K)
        Where one is.
    readings, sides : array of shape (M, C, K)
        As of `ClippedSamples`; 0 where there is none.
    """

    present: Bools
    readings: Floats
    sides: Floats

    @classmethod
    def of(
        cls, records: Sequence[Record], channels: Sequence[str], cut: Callable[[Floats], Floats]
    ) -> ClippedReadings | None:
        """Those of the `channels` of records, each `cut` into segments; None without any."""
        parts = []
        for record in records:
            both = np.full((2, len(record), len(channels)), np.nan)
            for number, name in enumerate(channels):
                own = record.clipped.get(name)
                if own is not None and (own := own.of(record.channel(name))) is not None:
                    both[0, :, number], both[1, :, number] = own.readings, own.sides
            parts.append(np.stack([cut(values) for values in both]))
        readings, sides = np.concatenate(parts, axis=3)
        present = np.isfinite(readings)
        if not present.any():
            return None
        return cls(present, np.where(present, readings, 0.0), np.where(present, sides, 0.0))

    def chosen(self, which: Indices) -> ClippedReadings:
        """Those of some segments."""
        return self.mapped(lambda values: values[..., which])

    def mapped(self, function: Callable[[NDArray[Any]], NDArray[Any]]) -> ClippedReadings:
        """Those after a change of the segments."""
        return ClippedReadings(function(self.present), function(self.readings), function(self.sides))

    def misfit(self, residuals: Floats, unit: Floats) -> ClippedMisfit:
        """What they say of a motion.

        Parameters
        ----------
        residuals : array of shape (M, C, K)
            Of samples, which are 0 here, in standard deviations of the noise.
        unit : array to broadcast against those
            The standard deviations, in the units of the channels.

        Returns
        -------
        ClippedMisfit
            Residuals and cost; not finite where the motion diverges.
        """
        shown = np.where(self.present, -residuals, 0.0)
        left = np.where(self.present, self.readings / unit - shown, 0.0)
        bounded = self.sides != 0.0
        beyond = np.maximum(-self.sides[bounded] * left[bounded], -_FARTHEST)
        score, curvature = _score_and_curvature(beyond)
        roots = self.present.astype(float)
        roots[bounded] = np.sqrt(curvature)
        cost = float(np.vdot(left[~bounded], left[~bounded]) - 2.0 * np.sum(scipy.special.log_ndtr(beyond)))
        left[bounded] = self.sides[bounded] / (score + beyond)
        return ClippedMisfit(left, roots, shown, cost)


def with_bounds_for(loss: Loss, records: Sequence[Record]) -> list[Record]:
    """Records with clipped readings where the likelihood of bounds is that of the loss: of a normal variable.

    Parameters
    ----------
    loss : Loss
        Loss of a residual.
    records : sequence of Record
        The records.

    Returns
    -------
    list of Record
        With a robust loss without them, so that these samples are missing everywhere.
    """
    if isinstance(loss, Gaussian):
        return list(records)
    return [replace(record, clipped={}) for record in records]


def _score_and_curvature(beyond: Floats) -> tuple[Floats, Floats]:
    """Slope of the log likelihood of bounds that the motion is `beyond`, in standard deviations, and its curvature."""
    score = np.sqrt(2.0 / np.pi) / scipy.special.erfcx(-beyond / np.sqrt(2.0))
    return score, score * (score + beyond)
