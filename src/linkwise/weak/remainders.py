"""What regression on the columns of the laws leaves of the columns of other terms, and how large their scores can be by it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs

from linkwise.arrays import Bools, Floats

_SINGULAR = 1e-12  # part of the largest singular value that those of collinear columns do not exceed
_WELL_POSED = 1e-8  # reciprocal condition far above that, so that no direction is left out


@dataclass(frozen=True, eq=False)
class Remainders:
    """What is left of terms beside the coefficients of the laws, each in units of the root of its moment.

    Attributes
    ----------
    score, bias : array of shape (t,)
        Scores, and what noise would add to them.
    left, diagonal : array of shape (t,)
        Moments beside the coefficients of the laws and without these.
    unit : array of shape (t,)
        The units.
    tested : array of bool, shape (t,)
        False for terms that the laws have, and for those that do not stand above the noise.
    """

    score: Floats
    bias: Floats
    left: Floats
    diagonal: Floats
    unit: Floats
    tested: Bools

    def squares(self, excess: float, uncertain: float, scatter: Floats) -> Floats:
        """What the squares of scores cannot exceed.

        Parameters
        ----------
        excess : float
            Power of the residuals over that expected from noise.
        uncertain : float
            Relative error of the power of the noise.
        scatter : array of shape (t,)
            What the variances of the normal equations of the terms due to noise are at least.

        Returns
        -------
        array of shape (t,)
            The squares; 0 for terms that are not tested.
        """
        scatter = self.unit**2 * np.maximum(scatter, 0.0)
        white = np.where(self.tested, self.left * scatter / np.where(self.tested, self.diagonal, 1.0), 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance = max(excess, 1.0) * white + (uncertain * self.bias) ** 2
            return np.where(self.tested, self.score**2 / variance, 0.0)


def diagonal_beside(diagonal: Floats, coupled: Floats, normal: Floats, beside: Floats) -> Floats:
    """The diagonal of the products of columns less multiples of others.

    Parameters
    ----------
    diagonal : array of shape (t,)
        That of the products of the columns.
    coupled : array of shape (p, t)
        Their products with the others.
    normal : array of shape (p, p)
        Products of these.
    beside : array of shape (p, t)
        The multiples.

    Returns
    -------
    array of shape (t,)
        The diagonal.
    """
    return np.asarray(diagonal + np.einsum("ij,ij->j", beside, normal @ beside - 2.0 * coupled))


def regression(normal: Floats, coupled: Floats) -> Floats:
    """What columns are of others in least squares, without directions in which these are collinear.

    Parameters
    ----------
    normal : array of shape (p, p)
        Products of these others, of order 1.
    coupled : array of shape (p, t)
        Products of them with the columns.

    Returns
    -------
    array of shape (p, t)
        The multiples.
    """
    factor, failed = dpotrf(normal)
    if len(normal) and not failed and dpocon(factor, np.abs(normal).sum(axis=0).max())[0] > _WELL_POSED:
        return np.asarray(dpotrs(factor, coupled)[0])
    return np.asarray(np.linalg.lstsq(normal, coupled, rcond=_SINGULAR)[0], dtype=float)
