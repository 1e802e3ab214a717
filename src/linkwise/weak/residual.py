"""Residuals of the weak equations of motion."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.weak.equations import WeakEquations
from linkwise.weak.weak_form import PHI


def weak_residual(equations: WeakEquations, values: Floats) -> Floats:
    """Residuals of the weak equations as forces.

    Parameters
    ----------
    equations : WeakEquations
        The equations.
    values : array of shape (p,)
        The parameters.

    Returns
    -------
    array of shape (R, n)
        Residuals in N; NaN for masses without an equation and windows with missing samples.
    """
    residual = np.full(equations.acceleration.T.shape, np.nan)
    area = np.abs(equations.window.kernels[PHI]).sum()
    for patch in equations.patches:
        total = np.where(patch.valid > 0.0, patch.residual(values) / area, np.nan)
        residual[:, patch.masses] = total.T
    return residual
