"""Weak equations of some masses in all records as parabolas in their coefficients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from linkwise.arrays import Floats, Indices
from linkwise.discovery.quadratic_model import QuadraticModel
from linkwise.weak.equations import WeakEquations
from linkwise.weak.fit import assemble_blocks, normal_equations, residual_power
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import SlopeStatistics, score_blocks

Pieces = Sequence[tuple[Sequence[Patch], WeakEquations]]

_ROUNDS = 2  # of weighting the masses by what they leave
_RIDGE = 1e-10
_OVERLAP = 2.0  # windows share samples, so that sums of squares count everything about twice


@dataclass(frozen=True, eq=False)
class WeakRegression:
    """The equations in `pieces`, patches of one record each, whose masses are weighted by `weights`.

    `names` (p,) are the parameters that they hold, `numbers` (p,) theirs in the structure; `scatter` (p, p) is the covariance
    that noise gives the sums which are solved.
    """

    pieces: Pieces
    weights: tuple[tuple[Floats, ...], ...]
    names: tuple[str, ...]
    numbers: Indices
    scatter: Floats

    @classmethod
    def of(cls, pieces: Pieces) -> WeakRegression:
        """Weighted by what a least squares on everything leaves, the noise bias left in: it is always positive."""
        parameters = pieces[0][1].parameters
        numbers = np.unique(
            np.concatenate([patch.layout.parameter for patches, _ in pieces for patch in patches])
        )
        weights = tuple(tuple(1.0 / patch.largest() for patch in patches) for patches, _ in pieces)
        for _ in range(_ROUNDS):
            values = np.zeros(len(parameters))
            values[numbers] = _ridged(*_normal(pieces, weights, numbers, 1.0))
            weights = tuple(
                tuple(1.0 / residual_power(patch, values) for patch in patches) for patches, _ in pieces
            )
        names = tuple(parameters[number] for number in numbers)
        return cls(pieces, weights, names, numbers, _scatter(pieces, weights, numbers, values))

    def quadratic(self, bias: float) -> QuadraticModel:
        """The sums of products with this share of the noise bias left in; z by the noise."""
        h, g = _normal(self.pieces, self.weights, self.numbers, bias)
        return QuadraticModel(self.names, h, g, self.scatter)

    def squares(self) -> QuadraticModel:
        """The sum of squared residuals, about as a likelihood has it: one cost by which choices can be compared."""
        h, g = _normal(self.pieces, self.weights, self.numbers, 0.0)
        return QuadraticModel(self.names, h / _OVERLAP, g / _OVERLAP)

    @property
    def rows(self) -> int:
        """How many equations there are."""
        return int(sum(len(patch.masses) * patch.windows for patches, _ in self.pieces for patch in patches))


def _normal(
    pieces: Pieces, weights: Sequence[Sequence[Floats]], here: Indices, bias: float
) -> tuple[Floats, Floats]:
    h, g = np.zeros((len(here), len(here))), np.zeros(len(here))
    for (patches, equations), weight in zip(pieces, weights, strict=True):
        one, right = normal_equations(patches, weight, len(equations.parameters), bias=bias)
        h += _dense(one, here)
        g += right[here]
    return h, g


def _scatter(pieces: Pieces, weights: Sequence[Sequence[Floats]], here: Indices, values: Floats) -> Floats:
    total = np.zeros((len(here), len(here)))
    for (patches, equations), weight in zip(pieces, weights, strict=True):
        noisy = [(patch, SlopeStatistics.along(patch, equations, values)) for patch in patches]
        total += _dense(assemble_blocks(score_blocks(noisy, weight, equations), len(values)), here)
    return total


def _dense(matrix: Floats | csc_array, here: Indices) -> Floats:
    """The rows and columns `here`."""
    if isinstance(matrix, np.ndarray):
        return np.asarray(matrix[np.ix_(here, here)])
    return np.asarray(matrix[here][:, here].toarray())


def _ridged(h: Floats, g: Floats) -> Floats:
    """Least squares with the smallest ridge that rounding asks for."""
    scale = 1.0 / np.sqrt(np.maximum(h.diagonal(), np.finfo(float).tiny))
    scaled = h * np.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled + _RIDGE * np.eye(len(g)), scale * g))
