"""Least-squares problems with known answers, as the quadratic models that discovery works on."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from linkwise.discovery.criterion import Penalty, QuadraticModel


@dataclass(frozen=True, eq=False)
class Regression:
    """y (N,) = columns (N, p) c + noise of deviation 1."""

    columns: np.ndarray
    y: np.ndarray

    @classmethod
    def drawn(cls, seed: int, size: int = 7, samples: int = 60) -> Self:
        """Columns of sizes over six decades that lean on each other."""
        random = np.random.default_rng(seed)
        columns = random.normal(size=(samples, size)) @ (
            np.eye(size) + 0.4 * random.normal(size=(size, size))
        )
        true = random.normal(size=size)
        y = columns @ true + random.normal(size=samples)
        return cls(columns * 10.0 ** random.uniform(-3.0, 3.0, size), y)

    @property
    def quadratic(self) -> QuadraticModel:
        names = tuple(f"c{number}" for number in range(self.columns.shape[1]))
        free = Penalty(0.0, 0.0, np.full(len(names), -1), frozenset())
        return QuadraticModel(names, self.columns.T @ self.columns, self.columns.T @ self.y, free)

    def least_squares(self, chosen: list[int]) -> tuple[np.ndarray, np.ndarray, float]:
        """Values, z, and the squares that are left less those of y itself."""
        part = self.columns[:, chosen]
        values, *_ = np.linalg.lstsq(part, self.y)
        deviation = np.sqrt(np.linalg.inv(part.T @ part).diagonal())
        left = self.y - part @ values
        return values, values / deviation, float(left @ left - self.y @ self.y)
