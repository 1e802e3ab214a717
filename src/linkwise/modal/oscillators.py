"""Motion of modes of unit modal mass under sampled forces, to the order of a quintic spline through the samples.

With s = -zeta w + i w_d the mode q'' + 2 zeta w q' + w^2 q = f is q = Im(z) / w_d, z' = s z + f: one complex recursion. Its
derivative by s obeys the same recursion with z in place of f.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

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

    @cached_property
    def _acts(self) -> bool:
        return bool(self.samples.any())

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
        if not self._acts:
            return np.zeros((3, len(self.samples)))
        s = _pole(frequency, damping)
        z = self.recursion(s)
        motion: Floats = np.array([z.imag, (s * z).imag, (s * s * z).imag]) / s.imag
        motion[2] += self.samples
        return motion

    def derivatives(self, frequency: float, damping: float) -> Floats:
        """Derivatives of the motion by the logarithms of frequency and damping.

        Parameters
        ----------
        frequency : float
            Frequency of the mode in Hz.
        damping : float
            Its damping as a part of the critical one, below 1.

        Returns
        -------
        array of shape (2, 3, N)
            Those of displacement, velocity and acceleration.
        """
        if not self._acts:
            return np.zeros((2, 3, len(self.samples)))
        s = _pole(frequency, damping)
        z = self.recursion(s)
        by_pole = self.derivative_by_pole(s, z)
        motion = np.array([z, s * z, s * s * z])
        slopes = np.array([by_pole, z + s * by_pole, s * (2.0 * z + s * by_pole)])
        return np.array(
            [
                (slopes * change).imag / s.imag - motion.imag * (change.imag / s.imag**2)
                for change in _pole_changes(frequency, damping)
            ]
        )

    def recursion(self, s: complex) -> NDArray[np.complex128]:
        """A complex mode from rest.

        Parameters
        ----------
        s : complex
            Its pole in 1/s.

        Returns
        -------
        array of complex, shape (N,)
            z, with z' = s z + the force.
        """
        if not self._acts:
            return np.zeros(len(self.samples), dtype=complex)
        return self._filtered(s, self._gained(s, np.ones_like(_NODES)))

    def derivative_by_pole(self, s: complex, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Derivative of a complex mode by its pole.

        Parameters
        ----------
        s : complex
            The pole in 1/s.
        z : array of complex, shape (N,)
            The mode, as `recursion` gives it.

        Returns
        -------
        array of complex, shape (N,)
            The derivative.
        """
        if not self._acts:
            return np.zeros(len(self.samples), dtype=complex)
        late = self._gained(s, 0.5 * self.step * (1.0 - _NODES))
        return self._filtered(s, late + self.step * np.exp(s * self.step) * z[:-1])

    def _gained(self, s: complex, factor: Floats) -> NDArray[np.complex128]:
        """(N - 1,) what the force adds to z in each step, weighted by a `factor` at the nodes of the quadrature."""
        nodes = 0.5 * self.step * (_NODES + 1.0)
        kernel = np.exp(s * (self.step - nodes)) * (0.5 * self.step * _WEIGHTS * factor)
        of_powers = nodes[None, :] ** np.arange(_DEGREE, -1, -1)[:, None] @ kernel
        return np.asarray(of_powers.real @ self._pieces + 1j * (of_powers.imag @ self._pieces))

    def _filtered(self, s: complex, gained: NDArray[np.complex128]) -> NDArray[np.complex128]:
        filtered = scipy.signal.lfilter([1.0], [1.0, -np.exp(s * self.step)], gained)
        return np.concatenate([[0.0], filtered])


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


def free_motion_derivatives(frequency: float, damping: float, step: float, count: int) -> Floats:
    """Derivatives of the two free decays by the logarithms of frequency and damping.

    Parameters
    ----------
    frequency : float
        Frequency of the mode in Hz.
    damping : float
        Its damping as a part of the critical one, below 1.
    step : float
        Time between samples in s.
    count : int
        Number N of samples.

    Returns
    -------
    array of shape (2, 2, 3, N)
        By each logarithm, of each decay, those of displacement, velocity and acceleration.
    """
    s = _pole(frequency, damping)
    time = step * np.arange(count)
    decay = np.exp(s * time)
    by_pole = np.array([(time - 2.0 / s) * decay / s**2, (time - 1.0 / s) * decay / s, time * decay])
    changes = [by_pole * change for change in _pole_changes(frequency, damping)]
    return np.array([[change.real, change.imag] for change in changes])


def _pole(frequency: float, damping: float) -> complex:
    w = 2.0 * np.pi * frequency
    return complex(-damping * w, w * np.sqrt(1.0 - damping**2))


def _pole_changes(frequency: float, damping: float) -> tuple[complex, complex]:
    """Derivatives of the pole by the logarithms of frequency and damping."""
    w = 2.0 * np.pi * frequency
    return _pole(frequency, damping), -damping * w * complex(1.0, damping / np.sqrt(1.0 - damping**2))
