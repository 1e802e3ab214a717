"""Smoothed displacements and rates at every sample, also at the ends of a record."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from linkwise.arrays import Floats
from linkwise.weak.window import Window

_DEGREE = 6  # of the polynomials, as of `Window.slope`


def smoothed_motion(displacements: Floats, window: Window) -> tuple[Floats, Floats]:
    """Displacements and rates from polynomials of degree six that are fitted to the samples around each one.

    Samples have the weight phi; at the ends, nearer than half a window, the polynomial of the first or last window is taken.

    Parameters
    ----------
    displacements : array of shape (k, N)
        Displacements in m, of at least one window.
    window : Window
        The window.

    Returns
    -------
    displacements, rates : array of shape (k, N)
        In m and m/s.
    """
    inner, edge = _filters(window)
    length, half = window.length, window.half
    every = Window(half, 1, window.step).filter(displacements, inner)
    smooth = np.empty((2, *displacements.shape))
    smooth[:, :, half : displacements.shape[1] - half] = every
    smooth[:, :, :half] = displacements[:, :length] @ edge[:, :half].transpose(0, 2, 1)
    smooth[:, :, -half:] = displacements[:, -length:] @ edge[:, -half:].transpose(0, 2, 1)
    return smooth[0], smooth[1]


@lru_cache(maxsize=64)
def _filters(window: Window) -> tuple[Floats, Floats]:
    """(2, T) taps of value and rate at the centre; (2, T, T) those at every sample of a window, with equal weights."""
    u = np.arange(-window.half, window.half + 1) / window.half
    powers = np.arange(_DEGREE + 1)
    values = u[:, None] ** powers
    rates = powers * u[:, None] ** np.maximum(powers - 1, 0) / (window.half * window.step)
    weight = np.sqrt(np.maximum(window.kernels[window.smooth], 0.0))
    weighted, equal = np.linalg.pinv(weight[:, None] * values) * weight, np.linalg.pinv(values)
    centre = np.stack([values[window.half], rates[window.half]])
    return centre @ weighted, np.stack([values @ equal, rates @ equal])
