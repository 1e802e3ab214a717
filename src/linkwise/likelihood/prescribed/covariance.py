"""The covariance of what is found of links on a rig.

The scatter of the sums that the minimum sets to zero comes from the noise of the load cells, which is white; from that of the
displacement, which smoothing correlates; and, where the laws are wrong, from what they leave, which follows the motion: its
sums are compared over a period of the motion.
"""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Bools, Floats
from linkwise.likelihood.prescribed.problem import RigProblem
from linkwise.likelihood.prescribed.search import Minimum

_SINGULAR = 1e-13  # relative eigenvalue of the scaled normal matrix below which it is singular


def covariance_of(
    problem: RigProblem,
    minimum: Minimum,
    free: Bools,
    cells: Floats,
    weights: Floats,
    residuals: Floats,
    *,
    inexact: bool,
) -> tuple[Floats, bool]:
    """Covariance (u, u), 0 for what is not `free`, and whether the forces determine the unknowns.

    `cells` (R,) is the noise of load cells in N, `weights` are those of the residuals (R,); with `inexact` laws these scatter
    by more than noise.
    """
    jacobian = problem.jacobian(minimum.paths)[:, free]
    weighted = weights[:, None] * jacobian
    certainty = problem.certainty[free]
    normal = weighted.T @ weighted + np.diag(certainty**2)
    scale = np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    determined = bool(values[0] > _SINGULAR * values[-1])
    inverse = (vectors / np.maximum(values, _SINGULAR * values[-1])) @ vectors.T / np.outer(scale, scale)
    scores = weights[:, None] * weighted
    moved = problem.noise_of_motion(minimum.paths, _spread(problem, scores, free))[:, free]
    scatter = (cells[:, None] * scores).T @ (cells[:, None] * scores) + moved.T @ moved
    if inexact:
        white = (scores / weights[:, None]).T @ (scores / weights[:, None]) + moved.T @ moved
        lagged = newey_west(problem, scores * residuals[:, None])
        ratio = np.sqrt(np.maximum(_errors(inverse, white) / _errors(inverse, lagged), 1.0))
        sandwich = inverse @ lagged @ inverse * np.outer(ratio, ratio)
    else:
        sandwich = inverse @ scatter @ inverse
    sandwich = sandwich + inverse @ np.diag(certainty**2) @ inverse
    covariance = np.zeros((problem.size, problem.size))
    covariance[np.ix_(free, free)] = 0.5 * (sandwich + sandwich.T)
    return covariance, determined


def _errors(inverse: Floats, scatter: Floats) -> Floats:
    return np.asarray(np.maximum(np.einsum("ij,jk,ki->i", inverse, scatter, inverse), 1e-300))


def _spread(problem: RigProblem, scores: Floats, free: Bools) -> Floats:
    spread = np.zeros((len(scores), problem.size))
    spread[:, free] = scores
    return spread


def newey_west(problem: RigProblem, rows: Floats) -> Floats:
    """Covariance (f, f) of the sums of rows (R, f) that are correlated over a period of the motion (Newey and West 1987)."""
    total, first = np.zeros((rows.shape[1], rows.shape[1])), 0
    for number, (record, _, _) in enumerate(problem.states):
        part = rows[first : first + len(problem.cell(number))]
        lags = min(problem.records[record].motion.period, len(part) // 4)
        size = 2 ** int(np.ceil(np.log2(len(part) + lags + 1)))
        spectra = np.fft.rfft(part, size, axis=0)
        taper = np.zeros(size)
        taper[: lags + 1] = 1.0 - np.arange(lags + 1) / (lags + 1)
        taper[size - lags :] = taper[1 : lags + 1][::-1]
        smoothed = np.fft.irfft(spectra * np.fft.rfft(taper).real[:, None], size, axis=0)[: len(part)]
        total += part.T @ smoothed
        first += len(part)
    return np.asarray(0.5 * (total + total.T))
