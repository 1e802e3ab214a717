"""Complex modes of coordinates that damping couples, with their derivatives.

The coordinates have unit mass, stiffness w_r^2 and a symmetric damping matrix C. With the eigenvectors psi_k of
(l^2 + l C + w^2) psi = 0, scaled to psi'(2 l_k + C) psi = 1, a force phi_p u gives the sum of 2 Re(psi_k (psi_k' phi_p) z_k),
z_k' = l_k z_k + u, over the n poles l_k above the real axis.

References
----------
R. L. Fox and M. P. Kapoor, AIAA J. 6, 2426 (1968).
S. Adhikari, Structural Dynamic Analysis with Generalized Damping Models (2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats

Complex = NDArray[np.complex128]
_SAME = 1e-9  # of a pole: two that lie closer are one, whose vectors do not turn


@dataclass(frozen=True, eq=False)
class ComplexModes:
    """Complex modes of n coordinates.

    Parameters
    ----------
    frequencies, ratios : array of shape (n,)
        Frequencies of the coordinates in Hz and their damping as a part of the critical one.
    pairs : sequence of (int, int)
        Pairs of coordinates, counted from 0, that damping couples.
    between : array
        The entries of the damping matrix of these pairs in N s/m.
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
        own = np.arange(n)
        changes = np.zeros((2 * n + len(self.pairs), n, n))
        changes[2 * own, own, own] = 4.0 * np.pi * self.ratios
        changes[2 * own + 1, own, own] = 4.0 * np.pi * self.frequencies
        for number, (r, s) in enumerate(self.pairs, start=2 * n):
            changes[number, r, s] = changes[number, s, r] = 1.0
        return changes

    @cached_property
    def changes(self) -> tuple[Complex, Complex]:
        """Derivatives of the poles (I, n) and of the vectors (I, n, n) by the same."""
        poles, vectors, own = self.poles, self.vectors, np.arange(len(self.frequencies))
        every, all_poles = np.concatenate([vectors, vectors.conj()]), np.concatenate([poles, poles.conj()])
        damped = every @ (self.damping_changes @ vectors.T)  # psi_j' dC psi_k
        moved = -damped * poles
        stiffer = 8.0 * np.pi**2 * self.frequencies  # of the squares of the frequencies
        moved[2 * own] -= np.einsum("jr,r,kr->rjk", every, stiffer, vectors)
        apart = poles - all_poles[:, None]
        coincide = np.abs(apart) < _SAME * np.abs(poles)
        turned = np.where(coincide, 0.0, moved / np.where(coincide, 1.0, apart))
        turned[:, own, own] = -0.5 * damped[:, own, own]
        return moved[:, own, own], turned.transpose(0, 2, 1) @ every
