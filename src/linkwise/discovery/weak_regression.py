"""Weak equations of several masses in several records as one quadratic model of their coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import normal_blocks, residual_power
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import SlopeStatistics, score_blocks

#: For each record, the patches to regress and the equations that they belong to.
RecordPatches = Sequence[tuple[Sequence[Patch], WeakEquations]]
Weights = tuple[tuple[Floats, ...], ...]

_REWEIGHTINGS = 2  # rounds of weighting the masses by their residuals
_RIDGE = 1e-10  # of the unit diagonal: just above rounding
_OVERLAP = 2.0  # windows overlap, so that sums of squares count every sample about twice


@dataclass(frozen=True, eq=False)
class WeakRegression:
    """The equations in `patches`, in which each mass is weighted by `weights`.

    `names` (p,) are the coefficients in the equations and `numbers` (p,) their numbers in the structure; `scatter` (p, p) is
    the covariance of the right-hand side of the normal equations due to noise.
    """

    patches: RecordPatches
    weights: Weights
    names: tuple[str, ...]
    numbers: Indices
    scatter: Floats

    @classmethod
    def of(cls, patches: RecordPatches) -> WeakRegression:
        """The equations weighted by the residuals of a fit of all coefficients.

        That fit leaves the noise bias in, so that its normal matrix is always positive definite.
        """
        parameters = patches[0][1].parameters
        numbers = np.unique(
            np.concatenate([patch.layout.free_parameters for some, _ in patches for patch in some])
        )
        weights: Weights = tuple(tuple(1.0 / patch.largest() for patch in some) for some, _ in patches)
        for _ in range(_REWEIGHTINGS):
            values = np.zeros(len(parameters))
            values[numbers] = _solve_with_ridge(*_normal_equations(patches, weights, numbers, 1.0))
            weights = tuple(
                tuple(1.0 / residual_power(patch, values) for patch in some) for some, _ in patches
            )
        names = tuple(parameters[number] for number in numbers)
        return cls(patches, weights, names, numbers, _scatter(patches, weights, numbers, values))

    def quadratic(self, bias: float) -> QuadraticModel:
        """The normal equations with the part `bias` of the noise bias left in; z scores by the noise."""
        h, g = _normal_equations(self.patches, self.weights, self.numbers, bias)
        return QuadraticModel(self.names, h, g, self.scatter)

    def squares(self) -> QuadraticModel:
        """The sum of squared residuals on about the scale of -2 log likelihood, to compare subsets."""
        h, g = _normal_equations(self.patches, self.weights, self.numbers, 0.0)
        overlap = _OVERLAP * max(equations.motion.density for _, equations in self.patches)
        return QuadraticModel(self.names, h / overlap, g / overlap)

    @property
    def rows(self) -> int:
        """The number of equations."""
        return int(sum(len(patch.masses) * patch.windows for some, _ in self.patches for patch in some))


def _normal_equations(
    patches: RecordPatches, weights: Sequence[Sequence[Floats]], numbers: Indices, bias: float
) -> tuple[Floats, Floats]:
    h, g = np.zeros((len(numbers), len(numbers))), np.zeros(len(numbers))
    for (some, equations), weight in zip(patches, weights, strict=True):
        blocks, right = normal_blocks(some, weight, len(equations.parameters), bias=bias)
        for which, block in blocks:
            _add(h, np.searchsorted(numbers, which), block)
        g += right[numbers]
    return h, g


def _scatter(
    patches: RecordPatches, weights: Sequence[Sequence[Floats]], numbers: Indices, values: Floats
) -> Floats:
    total = np.zeros((len(numbers), len(numbers)))
    for (some, equations), weight in zip(patches, weights, strict=True):
        slopes = [(patch, SlopeStatistics.along(patch, equations, values)) for patch in some]
        for which, block in score_blocks(slopes, weight, equations):
            _add(total, np.searchsorted(numbers, which), equations.motion.density * block[0])
    return total


def _add(total: Floats, which: Indices, block: Floats) -> None:
    """Add a block to the rows and columns `which` of a matrix, of which some may be repeated."""
    order = np.argsort(which, kind="stable")
    rows, starts = np.unique(which[order], return_index=True)
    if len(rows) < len(which):
        block = np.add.reduceat(block[order], starts, axis=0)
        block = np.add.reduceat(block[:, order], starts, axis=1)
        which = rows
    total[np.ix_(which, which)] += block


def _solve_with_ridge(h: Floats, g: Floats) -> Floats:
    """The solution of normal equations, scaled to unit diagonal, with the smallest ridge that rounding requires."""
    scale = 1.0 / np.sqrt(np.maximum(h.diagonal(), np.finfo(float).tiny))
    scaled = h * np.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(g)), scale * g))
