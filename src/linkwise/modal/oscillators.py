"""Motion of modes of unit modal mass under sampled forces, to the order of a quintic spline through the samples.

With s = -zeta w + i w_d the mode q'' + 2 zeta w q' + w^2 q = f is q = Im(z) / w_d, z' = s z + f: one complex recursion.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy

from linkwise.arrays import Floats

_DEGREE = 5
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)  # for half a period in a step at most


class SampledForce:
    """A force between its samples.

    Parameters
    ----------
    samples : array of shape (N,)
        The force in N.
    step : float
        Time between samples in s.
    """

    def __init__(self, samples: Floats, step: float) -> None:
        self.samples, self.step = samples, step

    @cached_property
    def _pieces(self) -> Floats:
        """(6, N - 1) coefficients of the powers of the time in each step, the highest first."""
        time = self.step * np.arange(len(self.samples))
        spline = scipy.interpolate.make_interp_spline(time, self.samples, _DEGREE)
        orders = range(_DEGREE, -1, -1)
        return np.array([spline(time[:-1], order) / math.factorial(order) for order in orders])

    def motion(self, frequency: float, damping: float) -> Floats:
        """Displacement, velocity and acceleration of a mode that starts at rest.

        Parameters
        ----------
        frequency : float
            Its frequency in Hz.
        damping : float
            Its damping as a part of the critical one, below 1.

        Returns
        -------
        array of shape (3, N)
            The motion of its coordinate, in sqrt(kg) m, m/s and m/s2.
        """
        if not self.samples.any():
            return np.zeros((3, len(self.samples)))
        s = _pole(frequency, damping)
        nodes = 0.5 * self.step * (_NODES + 1.0)
        kernel = np.exp(s * (self.step - nodes)) * 0.5 * self.step * _WEIGHTS
        of_powers = nodes[None, :] ** np.arange(_DEGREE, -1, -1)[:, None] @ kernel
        gained = of_powers @ self._pieces
        z = np.append(0.0, scipy.signal.lfilter([1.0], [1.0, -np.exp(s * self.step)], gained))
        motion: Floats = np.array([z.imag, (s * z).imag, (s * s * z).imag]) / s.imag
        motion[2] += self.samples
        return motion


def free_motion(frequency: float, damping: float, step: float, count: int) -> Floats:
    """Two free decays of a mode, a quarter of a period apart.

    Parameters
    ----------
    frequency : float
        Its frequency in Hz.
    damping : float
        Its damping as a part of the critical one, below 1.
    step : float
        Time between samples in s.
    count : int
        Number N of samples.

    Returns
    -------
    array of shape (2, 3, N)
        Displacement, velocity and acceleration of each, the acceleration starting at 1 m/s2 or a quarter of a period earlier.
    """
    s = _pole(frequency, damping)
    decay = np.exp(s * step * np.arange(count))
    parts = np.array([decay / s**2, decay / s, decay])
    return np.array([parts.real, parts.imag])


def _pole(frequency: float, damping: float) -> complex:
    w = 2.0 * np.pi * frequency
    return complex(-damping * w, w * np.sqrt(1.0 - damping**2))
