"""Losses of residuals, which are in standard deviations of the noise: Gaussian, Huber and Student."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError

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
