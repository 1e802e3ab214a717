"""Motion of modes of unit modal mass under sampled forces, to the order of a quintic spline through the samples.

With s = -zeta w + i w_d the mode q'' + 2 zeta w q' + w^2 q = f is q = Im(z) / w_d, z' = s z + f: one complex recursion.
Its derivative by s obeys the same recursion with z in place of f.

Coordinates that damping couples have unit mass, stiffness w_r^2 and a symmetric damping matrix C. With the eigenvectors
psi_k of (l^2 + l C + w^2) psi = 0, scaled to psi'(2 l_k + C) psi = 1, a force phi_p u gives the sum of 2 Re(psi_k (psi_k'
phi_p) z_k), z_k' = l_k z_k + u, over the n poles l_k above the real axis (R. L. Fox and M. P. Kapoor, AIAA J. 6, 2426
(1968); S. Adhikari, Structural Dynamic Analysis with Generalized Damping Models (2014)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from linkwise.arrays import Floats

_DEGREE = 5
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)  # for half a period in a step at most


class SampledForce:
    """A force in N between its samples (N,), a `step` in s apart."""

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

    def recursion(self, s: complex) -> NDArray[np.complex128]:
        """The complex mode z (N,) from rest with z' = s z + the force, by its pole s in 1/s."""
        if not self._acts:
            return np.zeros(len(self.samples), dtype=complex)
        return self._filtered(s, self._gained(s, np.ones_like(_NODES)))

    def derivative_by_pole(self, s: complex, z: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Derivative (N,) of a complex mode z, as `recursion` gives it, by its pole."""
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


def pole(frequency: float, damping: float) -> complex:
    """The pole above the real axis in 1/s of a mode, by its frequency in Hz and its damping ratio."""
    w = 2.0 * np.pi * frequency
    return complex(-damping * w, w * np.sqrt(1.0 - damping**2))


def pole_changes(frequency: float, damping: float) -> tuple[complex, complex]:
    """Derivatives of the pole by the logarithms of frequency and damping."""
    w = 2.0 * np.pi * frequency
    return pole(frequency, damping), -damping * w * complex(1.0, damping / np.sqrt(1.0 - damping**2))


Complex = NDArray[np.complex128]
_SAME = 1e-9  # of a pole: two that lie closer are one, whose vectors do not turn


@dataclass(frozen=True, eq=False)
class ComplexModes:
    """Complex modes of n coordinates, from their frequencies in Hz and damping ratios (n,), and the entries in N s/m of
    the damping matrix `between` pairs of them.
    """

    frequencies: Floats
    ratios: Floats
    pairs: Sequence[tuple[int, int]]
    between: Floats

    @cached_property
    def damping(self) -> Floats:
        """The damping matrix, (n, n)."""
        damping = np.diag(4.0 * np.pi * self.ratios * self.frequencies)
        for (r, s), entry in zip(self.pairs, self.between.tolist(), strict=True):
            damping[r, s] = damping[s, r] = entry
        return damping

    @cached_property
    def _poles_and_vectors(self) -> tuple[Complex, Complex]:
        n = len(self.frequencies)
        rates = np.zeros((2 * n, 2 * n))
        rates[:n, n:] = np.eye(n)
        rates[n:, :n], rates[n:, n:] = -np.diag((2.0 * np.pi * self.frequencies) ** 2), -self.damping
        values, columns = np.linalg.eig(rates)
        above = np.flatnonzero(values.imag > 0.0)
        if len(above) != n:
            raise np.linalg.LinAlgError("a mode does not vibrate")
        poles, vectors = values[above], columns[:n, above].T
        scale = np.einsum("kr,kr->k", vectors, 2.0 * poles[:, None] * vectors + vectors @ self.damping)
        return poles, vectors / np.sqrt(scale)[:, None]

    @property
    def poles(self) -> Complex:
        """The poles above the real axis in 1/s, (n,). Raises numpy.linalg.LinAlgError where one is real."""
        return self._poles_and_vectors[0]

    @property
    def vectors(self) -> Complex:
        """The scaled eigenvectors, one a row, (n, n)."""
        return self._poles_and_vectors[1]

    @cached_property
    def damping_changes(self) -> Floats:
        """(I, n, n) derivatives of the damping matrix by frequency and ratio of each coordinate in turn, then by `between`."""
        n = len(self.frequencies)
        diagonal = np.arange(n)
        changes = np.zeros((2 * n + len(self.pairs), n, n))
        changes[2 * diagonal, diagonal, diagonal] = 4.0 * np.pi * self.ratios
        changes[2 * diagonal + 1, diagonal, diagonal] = 4.0 * np.pi * self.frequencies
        for number, (r, s) in enumerate(self.pairs, start=2 * n):
            changes[number, r, s] = changes[number, s, r] = 1.0
        return changes

    @cached_property
    def changes(self) -> tuple[Complex, Complex]:
        """Derivatives of the poles (I, n) and of the vectors (I, n, n) by the same."""
        poles, vectors, diagonal = self.poles, self.vectors, np.arange(len(self.frequencies))
        every, all_poles = np.concatenate([vectors, vectors.conj()]), np.concatenate([poles, poles.conj()])
        damped = every @ (self.damping_changes @ vectors.T)  # psi_j' dC psi_k
        moved = -damped * poles
        stiffer = 8.0 * np.pi**2 * self.frequencies  # of the squares of the frequencies
        moved[2 * diagonal] -= np.einsum("jr,r,kr->rjk", every, stiffer, vectors)
        apart = poles - all_poles[:, None]
        coincide = np.abs(apart) < _SAME * np.abs(poles)
        turned = np.where(coincide, 0.0, moved / np.where(coincide, 1.0, apart))
        turned[:, diagonal, diagonal] = -0.5 * damped[:, diagonal, diagonal]
        return moved[:, diagonal, diagonal], turned.transpose(0, 2, 1) @ every
