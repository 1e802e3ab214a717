"""What a residual costs: Gaussian, Huber, Student. Residuals are in standard deviations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats

_REACH, _POINTS = 10.0, 4001  # standard deviations and points of the sum that stands for an expectation


class Loss(ABC):
    """What residuals cost, each a number of standard deviations."""

    @abstractmethod
    def costs(self, residuals: Floats) -> Floats:
        """Twice the negative log likelihood of each, up to a constant."""

    @abstractmethod
    def weight(self, residuals: Floats) -> Floats:
        """Weights of iteratively reweighted least squares: derivative of the loss over 2 r."""

    def total(self, residuals: Floats) -> float:
        """Over all residuals."""
        return float(self.costs(residuals).sum())

    @property
    def expected(self) -> float:
        """Mean cost of a residual that is noise of a normal distribution: what chi-square is measured by."""
        z, step = np.linspace(-_REACH, _REACH, _POINTS, retstep=True)
        return float(np.sum(self.costs(z) * np.exp(-0.5 * z**2)) * step / np.sqrt(2.0 * np.pi))


@dataclass(frozen=True)
class Gaussian(Loss):
    """Squares."""

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray(residuals**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.ones_like(residuals)

    def total(self, residuals: Floats) -> float:
        return float(np.vdot(residuals, residuals))

    @property
    def expected(self) -> float:
        return 1.0


@dataclass(frozen=True)
class Huber(Loss):
    """Quadratic up to `corner`, linear beyond (Huber 1964)."""

    corner: float = 1.345

    def costs(self, residuals: Floats) -> Floats:
        size = np.abs(residuals)
        return np.where(size < self.corner, size**2, 2 * self.corner * size - self.corner**2)

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray(self.corner / np.maximum(np.abs(residuals), self.corner))


@dataclass(frozen=True)
class Student(Loss):
    """Student's t with `freedom` degrees (Lange, Little, Taylor 1989)."""

    freedom: float = 4.0

    def costs(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) * np.log1p(residuals**2 / self.freedom))

    def weight(self, residuals: Floats) -> Floats:
        return np.asarray((self.freedom + 1) / (self.freedom + residuals**2))
