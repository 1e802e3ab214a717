"""What a residual costs: Gaussian, Huber, Student. Residuals are in standard deviations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from linkwise.likelihood.mechanics import Array


class Loss(ABC):
    @abstractmethod
    def total(self, residuals: Array) -> float:
        """Twice the negative log likelihood, up to a constant."""

    @abstractmethod
    def weight(self, residuals: Array) -> Array:
        """Weights of iteratively reweighted least squares: derivative of the loss over 2 r."""


@dataclass(frozen=True)
class Gaussian(Loss):
    def total(self, residuals: Array) -> float:
        return float(np.vdot(residuals, residuals))

    def weight(self, residuals: Array) -> Array:
        return np.ones_like(residuals)


@dataclass(frozen=True)
class Huber(Loss):
    """Quadratic up to `corner`, linear beyond (Huber 1964)."""

    corner: float = 1.345

    def total(self, residuals: Array) -> float:
        size = np.abs(residuals)
        return float(np.where(size < self.corner, size**2, 2 * self.corner * size - self.corner**2).sum())

    def weight(self, residuals: Array) -> Array:
        return self.corner / np.maximum(np.abs(residuals), self.corner)


@dataclass(frozen=True)
class Student(Loss):
    """Student's t with `freedom` degrees (Lange, Little, Taylor 1989)."""

    freedom: float = 4.0

    def total(self, residuals: Array) -> float:
        return float(((self.freedom + 1) * np.log1p(residuals**2 / self.freedom)).sum())

    def weight(self, residuals: Array) -> Array:
        return (self.freedom + 1) / (self.freedom + residuals**2)
