"""The response of coupled modes in the channels of a test, and its derivatives, as sums over complex modes.

In each channel the response is the real part of a weighted sum of signals that all channels share: of each complex mode the
motion under each force, and a free decay. Derivatives are sums of these and of their derivatives by the pole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.modal.measured import MeasuredRun, ModalMeasurement
from linkwise.modal.oscillators import Complex, ComplexModes

_ACCELERATION = 2  # among the kinds of responses


@dataclass(frozen=True, eq=False)
class CoupledResponse:
    """The response of `modes` with `shapes` (n, m) at the points, from displacements and velocities `first` (n, 2)."""

    measured: ModalMeasurement
    modes: ComplexModes
    shapes: Floats
    first: Floats

    @cached_property
    def _at_points(self) -> Complex:
        """(n, m) complex shapes."""
        return np.asarray(self.modes.vectors @ self.shapes)

    @cached_property
    def _at_start(self) -> Complex:
        """(n,) complex modes at the start."""
        q, v = self.first.T
        vectors = self.modes.vectors
        return np.asarray(vectors @ (self.modes.damping @ q + v) + self.modes.poles * (vectors @ q))

    @cached_property
    def _participation(self) -> Complex:
        """(n, P + 1) how each force, and the start, enter each complex mode."""
        return np.concatenate([self._at_points[:, self.measured.forced], self._at_start[:, None]], axis=1)

    def of(self, run: MeasuredRun) -> Floats:
        """(C, N) without offsets, in a record."""
        signals, _ = _signals(self.modes.poles, run, derivatives=False)
        at, kinds = self._at_points[:, self.measured.sensed], self.measured.kinds
        weights = 2.0 * (self.modes.poles[:, None] ** kinds * at).T[:, :, None] * self._participation
        response = _real_sum(weights, signals)
        direct = self.shapes[:, self.measured.sensed].T @ self.shapes[:, self.measured.forced]
        forces = np.array([force.samples for force in run.forces]).reshape(-1, run.count)
        response[kinds == _ACCELERATION] += direct[kinds == _ACCELERATION] @ forces
        return response

    def derivatives(self, run: MeasuredRun) -> Iterator[Floats]:
        """(K, N) of each channel: by what complex modes change with, by shapes mode by mode, and by the start mode by mode."""
        poles, count = self.modes.poles, len(self.shapes)
        signals, by_pole = _signals(poles, run, derivatives=True)
        both = np.concatenate([signals, by_pole], axis=1)
        forces = np.array([force.samples for force in run.forces]).reshape(-1, run.count)
        moved, turned, entering = self._changes
        for kind, point in zip(self.measured.kinds.tolist(), self.measured.sensed.tolist(), strict=True):
            power = 2.0 * poles**kind
            slope = 2.0 * kind * poles ** max(kind - 1, 0)
            at, participation = self._at_points[:, point], self._participation
            scaled = slope * moved * at + power * turned[:, :, point]
            weights = scaled[:, :, None] * participation + (power * at)[:, None] * entering
            of_poles = (power * moved * at)[:, :, None] * participation
            rows = _real_sum(np.concatenate([weights, of_poles], axis=2), both)
            if kind == _ACCELERATION:
                shapes = rows[-count * (len(self.measured.points) + 2) : -2 * count]
                of_shapes = shapes.reshape(count, len(self.measured.points), -1)
                for number, force in enumerate(self.measured.forced.tolist()):
                    of_shapes[:, point] += self.shapes[:, force, None] * forces[number]
                    of_shapes[:, force] += self.shapes[:, point, None] * forces[number]
            yield rows

    @cached_property
    def _changes(self) -> tuple[Complex, Complex, Complex]:
        """Derivatives of poles (K, n), complex shapes (K, n, m) and the participation (K, n, P + 1) by all parameters."""
        modes, (n, m) = self.modes, self.shapes.shape
        poles, vectors = modes.poles, modes.vectors
        of_poles, of_vectors = modes.changes
        own, free = len(of_poles), n * m
        moved = np.zeros((own + free + 2 * n, n), dtype=complex)
        moved[:own] = of_poles
        turned = np.zeros((len(moved), n, m), dtype=complex)
        turned[:own] = of_vectors @ self.shapes
        for mode in range(n):
            for point in range(m):
                turned[own + mode * m + point, :, point] = vectors[:, mode]
        q, v = self.first.T
        at_start = np.zeros((len(moved), n), dtype=complex)
        at_start[:own] = (
            of_vectors @ (modes.damping @ q + v)
            + (modes.damping_changes @ q) @ vectors.T
            + of_poles * (vectors @ q)
            + poles * (of_vectors @ q)
        )
        at_start[own + free :: 2] = (vectors @ modes.damping + poles[:, None] * vectors).T
        at_start[own + free + 1 :: 2] = vectors.T
        entering = np.concatenate([turned[:, :, self.measured.forced], at_start[:, :, None]], axis=2)
        return moved, turned, entering


def _signals(poles: Complex, run: MeasuredRun, *, derivatives: bool) -> tuple[Complex, Complex]:
    """(n, P + 1, N) complex modes under each force of unit participation and in a free decay, and derivatives by the pole."""
    time = run.step * np.arange(run.count)
    decays = np.exp(poles[:, None] * time)[:, None]
    shape = (len(poles), len(run.forces), run.count)
    forced = np.array([[force.recursion(pole) for force in run.forces] for pole in poles.tolist()]).reshape(
        shape
    )
    signals = np.concatenate([forced, decays], axis=1)
    if not derivatives:
        return signals, np.empty_like(signals[:, :0])
    by_pole = np.empty_like(forced)
    for mode, force in np.ndindex(forced.shape[:2]):
        by_pole[mode, force] = run.forces[force].derivative_by_pole(complex(poles[mode]), forced[mode, force])
    return signals, np.concatenate([by_pole, time * decays], axis=1)


def _real_sum(weights: Complex, signals: Complex) -> Floats:
    """(K, N) real parts of the sums of signals (n, p, N) with weights (K, n, p)."""
    by_row = weights.reshape(len(weights), -1)
    flat = signals.reshape(by_row.shape[1], -1)
    return np.asarray(by_row.real @ flat.real - by_row.imag @ flat.imag)
