"""Modes of given frequencies and damping fitted to a test, the parameters in which the response is linear eliminated.

Residues, free motions and offsets follow from frequencies and damping by linear least squares (variable projection).
Derivatives of what is left are those of the columns for fixed weights, projected off the columns (Kaufman 1975): exact in the
slope, and in the curvature to the order of what is left.

References
----------
G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 413 (1973).
L. Kaufman, BIT 15, 49 (1975).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.arrays import Floats
from linkwise.modal.least_squares import LinearProblem
from linkwise.modal.measured import MeasuredRun, ModalMeasurement

_RIDGE = 1e-12  # of columns of unit norm: two modes may be the same


class _Basis(NamedTuple):
    """Columns (k, N) of unit norm, 0 where a sample is missing, what they were divided by (k,), and their Cholesky factor."""

    columns: Floats
    norms: Floats
    factor: tuple[Floats, bool]

    @classmethod
    def of(cls, columns: Floats) -> _Basis:
        norms = np.sqrt(np.einsum("ij,ij->i", columns, columns))
        norms = np.where(norms > 0.0, norms, 1.0)
        columns = columns / norms[:, None]
        square = columns @ columns.T
        square[np.diag_indices_from(square)] += _RIDGE
        return cls(columns, norms, scipy.linalg.cho_factor(square))


class _ChannelFit(NamedTuple):
    """Of one channel: its basis, the weights (k,) of its columns, and what they leave (N,), 0 where a sample is missing."""

    basis: _Basis
    weights: Floats
    left: Floats


@dataclass(frozen=True, eq=False)
class Projection:
    """Modes fitted to a test.

    Parameters
    ----------
    measured : ModalMeasurement
        The test.
    logs : array of shape (n, 2)
        Logarithms of frequencies in Hz and of damping as a part of the critical one.
    """

    measured: ModalMeasurement
    logs: Floats

    @cached_property
    def _fits(self) -> tuple[tuple[_ChannelFit, ...], ...]:
        """Of each channel of each record."""
        return tuple(tuple(self._fitted(run)) for run in self.measured.runs)

    def _fitted(self, run: MeasuredRun) -> Iterator[_ChannelFit]:
        columns = np.empty((0, 3, run.count))
        if len(self.logs):
            columns = np.concatenate([run.motions(*np.exp(of_mode)) for of_mode in self.logs])
        complete: dict[int, _Basis] = {}
        for kind, samples in zip(self.measured.kinds.tolist(), run.responses, strict=True):
            known = np.isfinite(samples)
            basis = complete.get(kind)
            if basis is None or not known.all():
                basis = _Basis.of(np.where(known, np.vstack([columns[:, kind], np.ones(run.count)]), 0.0))
            if known.all():
                complete[kind] = basis
            target = np.where(known, samples, 0.0)
            weights = scipy.linalg.cho_solve(basis.factor, basis.columns @ target)
            yield _ChannelFit(basis, weights, target - weights @ basis.columns)

    @property
    def left(self) -> list[Floats]:
        """(C, N) of each record that the modes leave, NaN where a sample is missing."""
        return [
            np.where(np.isfinite(run.responses), [fit.left for fit in fits], np.nan)
            for run, fits in zip(self.measured.runs, self._fits, strict=True)
        ]

    @property
    def levels(self) -> Floats:
        """(C,) root mean squares of what is left."""
        powers, counts = self.power, np.zeros(len(self.measured.kinds))
        for run in self.measured.runs:
            counts += np.isfinite(run.responses).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(powers / np.maximum(counts, 1), np.finfo(float).tiny)))

    @property
    def power(self) -> Floats:
        """(C,) sums of squares of what is left."""
        sums = [[float(fit.left @ fit.left) for fit in fits] for fits in self._fits]
        return np.asarray(np.sum(sums, axis=0))

    def cost(self, levels: Floats) -> float:
        """The sum of squares of what is left, in units of `levels` (C,)."""
        cost = float(np.sum(self.power / levels**2))
        return cost if np.isfinite(cost) else np.inf

    def residues(self, run: int) -> Floats:
        """(n, C, P) residues that a record gives."""
        weights = np.array([(fit.weights / fit.basis.norms)[:-1] for fit in self._fits[run]])
        forces = len(self.measured.forced)
        of_modes = weights.reshape(len(weights), len(self.logs), forces + 2)
        return np.asarray(of_modes[:, :, :forces].transpose(1, 0, 2))

    def free_amplitudes(self, run: int) -> Floats:
        """(n, C) amplitudes of the free motion of each mode at the start of a record, in the unit of each response."""
        forces = len(self.measured.forced)
        speed = 2.0 * np.pi * np.exp(self.logs[:, 0])  # rad/s
        columns = []
        for kind, fit in zip(self.measured.kinds.tolist(), self._fits[run], strict=True):
            weights = (fit.weights / fit.basis.norms)[:-1].reshape(len(self.logs), forces + 2)
            columns.append(np.hypot(*weights[:, forces:].T) * speed ** (kind - 2))
        return np.array(columns).T

    def equations(self, levels: Floats) -> LinearProblem:
        """The sum of squares about `logs`, in units of `levels` (C,)."""
        size = self.logs.size
        slope, curvature = np.zeros(size), np.zeros((size, size))
        for number in range(len(self.measured.runs)):
            for rows, left in self.derivatives(number, levels):
                slope += rows @ left
                curvature += rows @ rows.T
        return LinearProblem(self.cost(levels), slope, curvature)

    def derivatives(self, run: int, levels: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Of each channel of a record, derivatives (2 n, N) of the response by `logs`, and what is left (N,), over levels."""
        record = self.measured.runs[run]
        changes = [record.motion_derivatives(*np.exp(of_mode)) for of_mode in self.logs]
        width = len(self.measured.forced) + 2
        known = np.isfinite(record.responses)
        for channel, (fit, kind) in enumerate(zip(self._fits[run], self.measured.kinds, strict=True)):
            weights = (fit.weights / fit.basis.norms)[:-1].reshape(len(self.logs), width)
            rows = np.concatenate(
                [
                    np.einsum("p,jpt->jt", of_mode, change[:, :, kind])
                    for of_mode, change in zip(weights, changes, strict=True)
                ]
            )
            rows = np.where(known[channel], rows, 0.0)
            products = scipy.linalg.cho_solve(fit.basis.factor, fit.basis.columns @ rows.T)
            yield (rows - products.T @ fit.basis.columns) / levels[channel], fit.left / levels[channel]
