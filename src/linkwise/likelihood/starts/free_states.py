"""States of a linear system without random inputs: all follow from the one at the start, which least squares find.

Rows of samples are joined to a triangular factor block by block (Bierman's square-root information form), so that nothing is
squared and nothing is divided by a covariance.

References
----------
G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, Academic Press (1977), chapter V.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.likelihood.starts.linear_model import LinearModel, recursion

_GROWTH = 20.0  # of the logarithm of a motion over the record, at most: a filter holds one that grows further
_BLOCK = 4000  # rows of samples that are joined at a time


@dataclass(frozen=True, eq=False)
class FreeStates:
    """States (N, m), their covariance (m, m) in the middle, whitened errors (N, C) of samples, and their log likelihood."""

    states: Floats
    covariance: Floats
    whitened: Floats
    log_likelihood: float


def determines(model: LinearModel, count: int) -> bool:
    """Whether the state at the start determines all of `count` samples: nothing is random, and no motion runs away."""
    if model.process.any():
        return False
    largest = float(np.abs(np.linalg.eigvals(model.transition)).max(initial=0.0))
    return count * float(np.log(max(largest, 1.0))) < _GROWTH


def fitted(model: LinearModel, samples: Floats, inputs: Floats) -> FreeStates:
    """States by the most likely one at the start.

    Parameters
    ----------
    model : LinearModel
        The system, whose process covariance is zero.
    samples : array of shape (N, C)
        The samples, NaN where missing.
    inputs : array of shape (N, r)
        The known inputs at the samples; between them their mean acts.

    Returns
    -------
    FreeStates
        The states.
    """
    count, channels = samples.shape
    m = len(model.transition)
    noise, size = np.sqrt(model.noise), np.sqrt(model.first.diagonal())
    known = np.isfinite(samples)
    driven = 0.5 * (inputs[1:] + inputs[:-1]) @ model.drive.T
    forced = recursion(model.transition, np.zeros(m), driven)
    left = np.where(known, samples, 0.0) - inputs @ model.direct.T - forced @ model.observation.T
    left = np.where(known, left / noise, 0.0)
    length = max(1, min(count, _BLOCK // max(channels, 1)))
    powers = _powers(model.transition, length)
    rows = np.matmul(model.observation / noise[:, None], powers[:length])  # (length, C, m)
    factor, at = (
        np.eye(m, m + 1),
        np.diag(size),
    )  # of the state at the start in units of `size`, which is its prior
    for first in range(0, count, length):
        part = slice(first, min(first + length, count))
        slopes = (rows[: part.stop - first] @ at) * known[part, :, None]
        joined = np.concatenate([slopes.reshape(-1, m), left[part].reshape(-1, 1)], axis=1)
        factor = np.linalg.qr(np.concatenate([factor, joined]))[1][: m + 1]
        at = powers[length] @ at
    triangle = factor[:m, :m]
    start = size * scipy.linalg.solve_triangular(triangle, factor[:m, m])
    states = forced + recursion(model.transition, start, np.zeros((count - 1, m)))
    root = size[:, None] * np.linalg.inv(triangle)
    root = np.linalg.matrix_power(model.transition, count // 2) @ root
    misfit = float(np.sum(factor[m:, m] ** 2))
    total = -0.5 * misfit - float(np.sum(known @ np.log(noise)))
    total -= float(np.log(np.abs(triangle.diagonal())).sum())
    error = left - np.where(known, (states - forced) @ model.observation.T / noise, 0.0)
    return FreeStates(states, root @ root.T, error, total)


def _powers(matrix: Floats, count: int) -> Floats:
    """(count + 1, m, m) powers 0 to `count` of a matrix, each the product of the one before."""
    powers = np.empty((count + 1, *matrix.shape))
    powers[0] = np.eye(len(matrix))
    for number in range(count):
        np.matmul(matrix, powers[number], out=powers[number + 1])
    return powers
