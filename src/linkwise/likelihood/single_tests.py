"""Score tests of columns one at a time: what each takes off the cost, its size, and how it changes the coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Bools, Floats

_COLLINEAR = 1e-6  # of its own curvature: what is left of a column beside the coefficients of the laws
_ROUNDED = 1e-6
"""Of what is left: variance of its score in coloured noise, below which both are rounding; a pole of 0.95 leaves 2.6 %."""


@dataclass(frozen=True, eq=False)
class SingleTests:
    """Of each of f columns alone, with the p coefficients fitted anew to first order, all scaled.

    Attributes
    ----------
    gains : array of shape (f,)
        What it would take off the cost.
    sizes, deviations : array of shape (f,)
        Its size, and the standard deviation of that.
    changes : array of shape (p, f)
        By how much the coefficients would change.
    """

    gains: Floats
    sizes: Floats
    deviations: Floats
    changes: Floats


def single_tests(curvature: Floats, slope: Floats, scatter: Floats, parameters: int) -> SingleTests:
    """Test the columns that follow the `parameters`.

    `scatter` is the covariance of the slope, which is the curvature where noise is white. A column of which the coefficients,
    or unknowns that were eliminated, leave nothing but rounding gains nothing, nor does one that is not finite.
    """
    finite = finite_columns(curvature, slope, scatter, parameters)
    if not finite.all():
        white = scatter is curvature
        within = np.concatenate([np.ones(parameters, dtype=bool), finite])
        curvature, slope = _without(curvature, within), np.where(within, slope, 0.0)
        scatter = curvature if white else _without(scatter, within)
    scale = np.sqrt(np.maximum(curvature.diagonal(), np.finfo(float).tiny))
    scaled, gradient = curvature / np.outer(scale, scale), slope / scale
    own, added = slice(0, parameters), slice(parameters, None)
    projection = np.linalg.lstsq(
        scaled[own, own], np.column_stack([scaled[own, added], gradient[own]]), rcond=1e-12
    )[0]
    left = scaled[added, added].diagonal() - np.einsum("ij,ij->j", scaled[own, added], projection[:, :-1])
    score = gradient[added] - scaled[added, own] @ projection[:, -1]
    tested = left > _COLLINEAR
    left = np.where(tested, left, 1.0)
    variance = left
    if scatter is not curvature:
        of_slope = scatter / np.outer(scale, scale)
        coupled = np.einsum("ji,ji->i", projection[:, :-1], of_slope[own, added])
        followed = np.einsum("ji,jk,ki->i", projection[:, :-1], of_slope[own, own], projection[:, :-1])
        variance = of_slope[added, added].diagonal() - 2.0 * coupled + followed
        tested &= variance > _ROUNDED * left
        variance = np.where(tested, variance, 1.0)
    gains = np.where(tested, score**2 / variance, 0.0)
    changes = -projection[:, :-1] * (score / left) / scale[own, None]
    return SingleTests(gains, score / left / scale[added], np.sqrt(variance) / left / scale[added], changes)


def finite_columns(curvature: Floats, slope: Floats, scatter: Floats, parameters: int) -> Bools:
    """Which of the f columns after the `parameters` have finite products with these, themselves and the residuals."""
    own, added = slice(0, parameters), slice(parameters, None)
    return np.asarray(
        np.isfinite(slope[added])
        & np.isfinite(curvature[own, added]).all(axis=0)
        & np.isfinite(curvature.diagonal()[added])
        & np.isfinite(scatter[own, added]).all(axis=0)
        & np.isfinite(scatter.diagonal()[added])
    )


def _without(matrix: Floats, within: Bools) -> Floats:
    """The matrix with zeros in the rows and columns that are not `within`."""
    return np.where(within[:, np.newaxis] & within, matrix, 0.0)
