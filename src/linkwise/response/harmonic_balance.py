"""Periodic motion by harmonic balance with alternation between frequency and time, where laws have kinks or memory.

Unknowns are Fourier coefficients of displacements and of states of links; laws are evaluated at samples of a period
(Cameron and Griffin 1989). A kink costs order, not existence: coefficients of a force with a kink fall as the square of
their number. Multipliers are those of the equations linearised along the motion, integrated by the midpoint rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.expression import Call, walk
from linkwise.model.law import partials_program
from linkwise.response.continuation import Point, solve
from linkwise.response.options import FORCE
from linkwise.response.shooting import SAMPLES, PeriodicEquations, frequency_size

_OVERSAMPLED = 8  # samples for each harmonic
_GROWING = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7)  # of the size of the excitation
_HELD = 1e-9  # singular value, relative to the largest, of what is held
_STABILITY = 512  # steps of the midpoint rule
_LEAST = 1e-12  # m: a motion that is smaller has this size


class _Tree(NamedTuple):
    """The force of a link, or the rate of a `state`, at samples of a motion: values (M,) and derivatives (M,), those by the
    states of the link from number `first` on.
    """

    link: int
    first: int
    state: int | None
    values: Floats
    by_d: Floats
    by_v: Floats
    by_states: tuple[Floats, ...]


@lru_cache(maxsize=32)
def _harmonics_at(harmonics: int, samples: int, first: float = 0.0) -> tuple[Floats, Floats, Floats]:
    """Phases (M,) of samples of a turn, from `first` of a step on, the harmonics there (M, 2H + 1) and their derivatives."""
    phases: Floats = 2.0 * np.pi * (np.arange(samples) + first) / samples
    orders = np.arange(1, harmonics + 1)
    angles = phases[:, None] * orders
    basis, slopes = np.ones((2, samples, 2 * harmonics + 1))
    slopes[:, 0] = 0.0
    basis[:, 1::2], basis[:, 2::2] = np.cos(angles), np.sin(angles)
    slopes[:, 1::2], slopes[:, 2::2] = -orders * np.sin(angles), orders * np.cos(angles)
    return phases, basis, slopes


@dataclass(frozen=True, eq=False)
class HarmonicBalance(PeriodicEquations):
    """The same by a balance of so many harmonics.

    Unknowns are the coefficients of 1, cos, sin, cos 2, ... of the n displacements, then of the S states, and omega.
    """

    harmonics: int
    _known: dict[bytes, NDArray[np.complex128]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        for link in self.structure.links:
            calls = (node for tree in link.law.trees for node in walk(tree) if isinstance(node, Call))
            if any(call.function == "sign" for call in calls):
                raise StructureError(
                    f"the law {link.law.text} jumps (sign); steady motion needs a steep slope in its place, such as "
                    "F*tanh(v/s) with a small s for F*sign(v)",
                    f'link "{link.name}"',
                )

    @cached_property
    def _samples(self) -> int:
        return _OVERSAMPLED * self.harmonics

    @cached_property
    def _grid(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Phases (M,), harmonics and derivatives there (M, 2H + 1), and what makes coefficients of samples (2H + 1, M)."""
        phases, basis, slopes = _harmonics_at(self.harmonics, self._samples)
        weights = basis.T * (2.0 / self._samples)
        weights[0] *= 0.5
        return phases, basis, slopes, weights

    def _coefficients(self, unknowns: Floats) -> Floats:
        return unknowns[:-1].reshape(self.structure.size + self._states, -1)

    @property
    def _states(self) -> int:
        return len(self.structure.topology.states)

    @cached_property
    def _incidence(self) -> Floats:
        return np.asarray(self.structure.incidence.toarray())

    def _trees(self, d: Floats, v: Floats, states: Floats) -> Iterator[_Tree]:
        """Forces of the links and rates of their states from elongations and rates (M, L) and states (M, S)."""
        first = 0
        for number, link in enumerate(self.structure.links):
            names = link.law.states
            numbers = range(first, first + len(names))
            arguments: list[Any] = [*states[:, numbers].T, *map(link.values.get, link.law.coefficients)]
            for state, tree in zip((None, *numbers), link.law.trees, strict=True):
                program = partials_program(tree, (*names, *link.law.coefficients), names)
                values, by_d, by_v, *by_states = program(d[:, number], v[:, number], *arguments)
                yield _Tree(number, first, state, values, by_d, by_v, tuple(by_states))
            first += len(names)

    def _motion_by(self, unknowns: Floats, basis: Floats, slopes: Floats) -> tuple[Floats, Floats, Floats]:
        """Displacements, velocities (M, n) and states (M, S) where harmonics and their derivatives are these."""
        coefficients, count = self._coefficients(unknowns), self.structure.size
        x, v = basis @ coefficients[:count].T, unknowns[-1] * slopes @ coefficients[:count].T
        return x, v, basis @ coefficients[count:].T

    def __call__(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """What the balance of each harmonic lacks, and its Jacobian."""
        phases, basis, slopes, weights = self._grid
        structure, omega, count = self.structure, float(unknowns[-1]), self.structure.size
        x, v, states = self._motion_by(unknowns, basis, slopes)
        base, speed = self.base(omega, phases)
        order = self.drive.order
        d, rate = structure.elongations(x, base), structure.elongations(v, speed)
        on_base = structure.base_incidence
        by_omega_d = -order * np.outer(base, on_base) / omega
        by_omega_v = v @ self._incidence / omega + (1 - order) * np.outer(speed, on_base) / omega
        total, width = count + self._states, basis.shape[1]
        residual, jacobian = np.zeros((total, width)), np.zeros((total, width, total, width))
        by_omega = np.zeros((total, width))
        derive = weights @ slopes
        coefficients = self._coefficients(unknowns)
        for mass, value in enumerate(structure.mass_values):
            residual[mass] += omega**2 * value * (derive @ derive @ coefficients[mass])
            by_omega[mass] += 2.0 * omega * value * (derive @ derive @ coefficients[mass])
            jacobian[mass, :, mass] += omega**2 * value * derive @ derive
        for state in range(count, total):
            residual[state] += omega * derive @ coefficients[state]
            by_omega[state] += derive @ coefficients[state]
            jacobian[state, :, state] += omega * derive
        for tree in self._trees(d, rate, states):
            link = tree.link
            moving = np.flatnonzero(self._incidence[:, link]).tolist()
            rows: list[tuple[int, float]] = [(mass, self._incidence[mass, link]) for mass in moving]
            if tree.state is not None:
                rows = [(count + tree.state, -1.0)]
            balance = weights @ tree.values
            by_motion = (weights * tree.by_d) @ basis + omega * (weights * tree.by_v) @ slopes
            changes = weights @ (tree.by_d * by_omega_d[:, link] + tree.by_v * by_omega_v[:, link])
            for row, sign in rows:
                residual[row] += sign * balance
                by_omega[row] += sign * changes
                for mass in moving:
                    jacobian[row, :, mass] += sign * self._incidence[mass, link] * by_motion
                for number, slope in enumerate(tree.by_states):
                    jacobian[row, :, count + tree.first + number] += sign * (weights * slope) @ basis
        if self.drive.kind == FORCE:
            residual[:count, 1] -= self.size * structure.topology.row(self.drive.place)
        flat = jacobian.reshape(total * width, total * width)
        return residual.ravel(), np.column_stack([flat, by_omega.ravel()])

    def sizes(self, unknowns: Floats) -> Floats:
        """The largest amplitude for the coefficients of displacements, that of each state, and that of omega."""
        count, width = self.structure.size, 2 * self.harmonics + 1
        half = 0.5 * np.ptp(self.motion(unknowns, 32), axis=0)
        sizes = np.maximum(half[2 * count :], _LEAST).repeat(width)
        of_x = np.full(count * width, max(half[:count].max(), _LEAST))
        return np.concatenate([of_x, sizes, [frequency_size(unknowns[-1], self.bounds)]])

    def motion(self, unknowns: Floats, samples: int = SAMPLES) -> Floats:
        """(samples + 1, N) the motion over a period, its end included."""
        _, basis, slopes = _harmonics_at(self.harmonics, samples)
        motion = np.hstack(self._motion_by(unknowns, basis, slopes))
        return np.concatenate([motion, motion[:1]])

    def at_rest(self, x: Floats, omega: float) -> Floats:
        """The unknowns of rest at displacements (n,) in m."""
        coefficients = np.zeros((len(x) + self._states, 2 * self.harmonics + 1))
        coefficients[: len(x), 0] = x
        return np.append(coefficients.ravel(), omega)

    def grown(self, x: Floats, omega: float) -> Floats:
        """The unknowns of a motion about displacements (n,) in m, followed from a small excitation to that of this size."""
        unknowns, before = self.at_rest(x, omega), _GROWING[0]
        residual, jacobian = replace(self, size=before * self.size)(unknowns)
        # the least step: at rest nothing holds the mean of a state that only follows the motion, as that of friction
        unknowns[:-1] -= np.linalg.lstsq(jacobian[:, :-1], residual, rcond=_HELD)[0]
        for part in _GROWING:
            guess = unknowns.copy()
            guess[:-1].reshape(-1, 2 * self.harmonics + 1)[:, 1:] *= part / before
            point = solve(replace(self, size=part * self.size), guess)
            if point is not None:
                unknowns, before = point.unknowns, part
        return unknowns

    def multipliers(self, point: Point) -> NDArray[np.complex128]:
        """The Floquet multipliers (N,) of a motion."""
        key = point.unknowns.tobytes()
        if key not in self._known:
            self._known[key] = np.asarray(np.linalg.eigvals(self._monodromy(point.unknowns)), dtype=complex)
        return self._known[key]

    def _monodromy(self, unknowns: Floats) -> Floats:
        phases, basis, slopes = _harmonics_at(self.harmonics, _STABILITY, 0.5)
        structure, omega, count = self.structure, float(unknowns[-1]), self.structure.size
        x, v, states = self._motion_by(unknowns, basis, slopes)
        base, speed = self.base(omega, phases)
        size = 2 * count + self._states
        change = np.zeros((_STABILITY, size, size))
        change[:, np.arange(count), count + np.arange(count)] = 1.0
        for tree in self._trees(structure.elongations(x, base), structure.elongations(v, speed), states):
            link, column = tree.link, np.zeros(size)
            if tree.state is None:
                column[count : 2 * count] = -self._incidence[:, link] / structure.mass_values
            else:
                column[2 * count + tree.state] = 1.0
            slope = np.zeros((_STABILITY, size))
            slope[:, :count] = np.outer(tree.by_d, self._incidence[:, link])
            slope[:, count : 2 * count] = np.outer(tree.by_v, self._incidence[:, link])
            for number, by_state in enumerate(tree.by_states):
                slope[:, 2 * count + tree.first + number] = by_state
            change += column[:, None] * slope[:, None, :]
        half = change * (np.pi / (_STABILITY * omega))
        steps = np.linalg.solve(np.eye(size) - half, np.eye(size) + half)
        whole = np.eye(size)
        for step in steps:
            whole = step @ whole
        return whole
