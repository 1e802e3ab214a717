"""A link along a motion that is known: its states by the trapezoidal rule, its force, and their derivatives.

All steps are solved together by Newton's method: the equations of neighbouring nodes form a banded matrix, which also gives
the sensitivities of the states (one solve each) and, transposed, those to the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack

from linkwise.arrays import Floats
from linkwise.expression import Program, differentiate
from linkwise.model.law import Law
from linkwise.model.named_laws import smooth_rates

_NEWTON = 40  # iterations, at most
_TOLERANCE = 1e-9  # of the size of the states
_LARGEST = 1e12  # a state that gets larger has run away


@lru_cache(maxsize=256)
def _programs(law: Law, free: tuple[str, ...]) -> tuple[Program, Program]:
    """Rates and their derivatives by states; then the derivatives of force and rates by d, v, states and coefficients."""
    rates = smooth_rates(law)
    names = (*law.variables, *law.coefficients)
    newton = [*rates, *(differentiate(rate, state) for rate in rates for state in law.states)]
    by = ("d", "v", *law.states, *free)
    slopes = [differentiate(tree, name) for tree in (law.expression, *rates) for name in by]
    return Program(newton, names, wide=law.variables), Program(slopes, names, wide=law.variables)


@dataclass(frozen=True, eq=False)
class StateEquations:
    """Factorised linearised equations of the states (S) at the nodes (J), the first of which is given."""

    factors: Floats
    pivots: Floats
    count: int

    @classmethod
    def of(cls, slopes: Floats, step: float) -> StateEquations:
        """Of the derivatives (J, S, S) of the rates by states."""
        nodes, count, _ = slopes.shape
        half = 0.5 * step * slopes
        lower, upper = 2 * count - 1, count - 1
        bands = np.zeros((2 * lower + upper + 1, (nodes - 1) * count))
        unit = np.eye(count)
        for row in range(count):
            for column in range(count):
                ahead = unit[row, column] - half[1:, row, column]
                behind = -unit[row, column] - half[1:-1, row, column]
                bands[lower + upper + row - column, column::count] = ahead
                bands[lower + upper + row - column + count, column:-count:count] = behind
        factors, pivots, _ = lapack.dgbtrf(bands, lower, upper, overwrite_ab=1)
        return cls(factors, pivots, count)

    def solve(self, right: Floats, *, transposed: bool = False) -> Floats:
        """Solution for right-hand sides (J - 1, S, q)."""
        lower, upper = 2 * self.count - 1, self.count - 1
        flat = right.reshape(-1, right.shape[-1])
        solved, _ = lapack.dgbtrs(self.factors, lower, upper, flat, self.pivots, trans=int(transposed))
        return np.asarray(solved).reshape(right.shape)


@dataclass(frozen=True, eq=False)
class LinkPath:
    """A link along a motion: `states` (J, S), `converged` if they are found, and the signals (J,) that its law names."""

    law: Law
    values: tuple[float, ...]
    d: Floats
    v: Floats
    step: float
    states: Floats
    converged: bool
    signals: tuple[Floats, ...] = ()

    @classmethod
    @np.errstate(all="ignore")  # states may run away; then the path has not converged
    def of(
        cls, law: Law, values: dict[str, float], d: Floats, v: Floats, step: float,
        initial: Floats, guess: Floats | None = None,
    ) -> LinkPath:  # fmt: skip
        ordered = tuple(values[name] for name in law.coefficients)
        if not law.states:
            return cls(law, ordered, d, v, step, np.zeros((len(d), 0)), True)
        program, _ = _programs(law, ())
        count = len(law.states)
        states = np.zeros((len(d), count)) if guess is None else guess.copy()
        states[0] = initial
        for _ in range(_NEWTON):
            rates_and_slopes = program(d, v, *states.T, *ordered)
            rates = np.stack(rates_and_slopes[:count], axis=1)
            slopes = np.stack(rates_and_slopes[count:], axis=1).reshape(-1, count, count)
            missed = np.diff(states, axis=0) - 0.5 * step * (rates[1:] + rates[:-1])
            if not (np.isfinite(missed).all() and np.isfinite(slopes).all()):
                return cls(law, ordered, d, v, step, states, False)
            change = StateEquations.of(slopes, step).solve(missed[..., None])[..., 0]
            states[1:] -= change
            size = np.abs(states).max()
            if not size < _LARGEST:
                return cls(law, ordered, d, v, step, states, False)
            if np.abs(change).max() <= _TOLERANCE * (size + 1e-300):
                return cls(law, ordered, d, v, step, states, True)
        return cls(law, ordered, d, v, step, states, False)

    def force(self) -> Floats:
        """Force (J,) in N at the nodes."""
        named: dict[str, Floats | float] = dict(zip(self.law.coefficients, self.values, strict=True))
        named |= dict(
            zip((*self.law.states, *self.law.signals), (*self.states.T, *self.signals), strict=True)
        )
        return self.law.force(self.d, self.v, named)

    def tangents(self, free: Sequence[str]) -> LinkTangents:
        """Derivatives along the motion, by the coefficients `free`."""
        _, program = _programs(self.law, tuple(free))
        slopes = program(self.d, self.v, *self.states.T, *self.signals, *self.values)
        count, width = len(self.law.states), 2 + len(self.law.states) + len(free)
        rows = np.stack(slopes, axis=1).reshape(len(self.d), 1 + count, width)
        by_state = rows[:, 1:, 2 : 2 + count]
        equations = StateEquations.of(by_state, self.step) if count else None
        return LinkTangents(rows, self.step, count, equations)


@dataclass(frozen=True, eq=False)
class LinkTangents:
    """Derivatives (J, 1 + S, 2 + S + c) of the force and the rates of the states of a link along a motion by d, v, the states
    and c coefficients.
    """

    rows: Floats
    step: float
    count: int
    equations: StateEquations | None

    def by_unknowns(self) -> Floats:
        """(J, c + S) by coefficients and initial states, and by d (one column more), held for the whole motion."""
        count, rows = self.count, self.rows
        ends = slice(2 + count, None)
        direct = np.concatenate([rows[:, 0, ends], np.zeros((len(rows), count)), rows[:, 0, :1]], axis=1)
        if self.equations is None:
            return direct
        half = 0.5 * self.step
        moved = np.concatenate([rows[:, 1:, ends], rows[:, 1:, :1]], axis=2)
        right = half * (moved[1:] + moved[:-1])
        start = np.zeros((len(right), count, count))
        start[0] = np.eye(count) + half * rows[0, 1:, 2 : 2 + count]
        width = rows.shape[2] - 2 - count
        right = np.concatenate([right[..., :width], start, right[..., width:]], axis=2)
        first = np.concatenate([np.zeros((count, width)), np.eye(count), np.zeros((count, 1))], axis=1)
        states = np.concatenate([first[None], self.equations.solve(right)])
        return np.asarray(direct + np.einsum("js,jsq->jq", rows[:, 0, 2 : 2 + count], states))

    def by_motion(self, change_d: Floats, change_v: Floats) -> Floats:
        """Changes (J, q) of the force with changes (J, q) of d and v along the motion."""
        count, rows = self.count, self.rows
        force = change_d * rows[:, 0, 0, None] + change_v * rows[:, 0, 1, None]
        if self.equations is None:
            return force
        pushed = rows[:, 1:, 0, None] * change_d[:, None] + rows[:, 1:, 1, None] * change_v[:, None]
        states = np.zeros((len(rows), count, change_d.shape[1]))
        states[1:] = self.equations.solve(0.5 * self.step * (pushed[1:] + pushed[:-1]))
        return np.asarray(force + np.einsum("js,jsq->jq", rows[:, 0, 2 : 2 + count], states))

    def to_motion(self, weights: Floats) -> tuple[Floats, Floats]:
        """Derivatives (J, q) of sums of forces, weighted with (J, q), by d and by v at every node."""
        count, rows = self.count, self.rows
        by_motion = [weights * rows[:, 0, column, None] for column in (0, 1)]
        if self.equations is None:
            return by_motion[0], by_motion[1]
        sources = rows[:, 0, 2 : 2 + count, None] * weights[:, None, :]
        pulled = self.equations.solve(sources[1:], transposed=True)
        both = np.zeros((len(rows), *pulled.shape[1:]))
        both[1:] += pulled
        both[:-1] += pulled
        for column in (0, 1):
            by_motion[column] += 0.5 * self.step * np.einsum("js,jsq->jq", rows[:, 1:, column], both)
        return by_motion[0], by_motion[1]
