"""Losses of residuals in standard deviations of the noise, and what else the cost counts.

Beside the Gaussian, Huber's and Student's losses these are priors of the unknowns, random forces on masses (states that are
constant in a segment of one sample, and independent of those around), and readings of overloaded sensors, as bounds.

With u the distance in standard deviations by which the motion is beyond the end of the range, a clipped reading has the
probability Phi(u), the normal distribution. Its score h = phi(u) / Phi(u) and curvature h (h + u) are those of an observation
1 / (h + u) beyond the motion with this curvature as weight. Samples that noise alone held inside are exact: were they left
out and the others not, noise would have chosen which samples count.

References
----------
J. Tobin, Econometrica 26, 24 (1958).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.records.record import Record

_REACH, _POINTS = 10.0, 4001  # standard deviations and points of the quadrature for an expectation


class Loss(ABC):
    """A loss: twice the negative log likelihood of residuals in standard deviations of the noise.

    See Also
    --------
    Gaussian, Huber, Student : The losses to choose from.

    Examples
    --------
    >>> import linkwise as lw
    >>> method = lw.MaximumLikelihood(loss=lw.likelihood.Huber())
    >>> isinstance(method.loss, lw.likelihood.Loss)
    True
    """

    @abstractmethod
    def costs(self, residuals: Floats) -> Floats:
        """Cost of each residual.

        Parameters
        ----------
        residuals : array
            Residuals in standard deviations.

        Returns
        -------
        array of the same shape
            Twice the negative log likelihood, up to a constant.
        """

    @abstractmethod
    def weight(self, residuals: Floats) -> Floats:
        """Weights for iteratively reweighted least squares.

        Parameters
        ----------
        residuals : array
            Residuals r in standard deviations.

        Returns
        -------
        array of the same shape
            Derivative of the cost over 2 r.
        """

    def total(self, residuals: Floats) -> float:
        """Sum of the costs.

        Parameters
        ----------
        residuals : array
            Residuals in standard deviations.

        Returns
        -------
        float
            The sum.
        """
        return float(self.costs(residuals).sum())

    @property
    def expected(self) -> float:
        """Mean cost of a standard normal residual, which normalises chi-square."""
        z, step = np.linspace(-_REACH, _REACH, _POINTS, retstep=True)
        return float(np.sum(self.costs(z) * np.exp(-0.5 * z**2)) * step / np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class Gaussian(Loss):
    """Squared residuals: maximum likelihood for normal noise.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Gaussian().weight(np.array([0.0, 10.0]))
    array([1., 1.])
    """

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray(residuals**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.ones_like(residuals)

    def total(self, residuals: Floats) -> float:
        return float(np.vdot(residuals, residuals))

    @property
    def expected(self) -> float:
        """Mean cost of a standard normal residual, 1."""
        return 1.0


def _check_positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise IdentificationError(f"{name} must be positive and finite, got {value}")


@dataclass(frozen=True)
class Huber(Loss):
    """Huber's loss, quadratic for small and linear for large residuals: robust against single outliers.

    Parameters
    ----------
    corner : float, optional
        Residual in standard deviations from which the loss is linear. 1.345 has 95 % efficiency for normal noise.

    Raises
    ------
    IdentificationError
        If the corner is not positive and finite.

    References
    ----------
    P. J. Huber, Ann. Math. Statist. 35, 73 (1964).

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Huber().weight(np.array([0.0, 10.0]))
    array([1.    , 0.1345])
    """

    corner: float = 1.345

    def __post_init__(self) -> None:
        _check_positive("corner", self.corner)

    def costs(self, residuals: Floats) -> Floats:
        size = np.abs(residuals)
        return np.where(size < self.corner, size**2, 2 * self.corner * size - self.corner**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray(self.corner / np.maximum(np.abs(residuals), self.corner))


@dataclass(frozen=True)
class Student(Loss):
    """Negative log likelihood of Student's t distribution: robust where outliers are many or large.

    Parameters
    ----------
    freedom : float, optional
        Degrees of freedom; fewer tolerate larger outliers.

    Raises
    ------
    IdentificationError
        If they are not positive and finite.

    References
    ----------
    K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881 (1989).

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> lw.likelihood.Student().weight(np.array([0.0, 10.0])).round(3)
    array([1.25 , 0.048])
    """

    freedom: float = 4.0

    def __post_init__(self) -> None:
        _check_positive("freedom", self.freedom)

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) * np.log1p(residuals**2 / self.freedom))

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) / (self.freedom + residuals**2))


LOSSES = {"huber": Huber(), "student": Student()}
"""Robust losses by name, as `identify` takes them."""


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
