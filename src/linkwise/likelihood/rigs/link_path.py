"""States of a link along a motion that is known, by the trapezoidal rule, with their derivatives.

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


def _solved(slopes: Floats, step: float, right: Floats, *, transposed: bool = False) -> Floats:
    """What the linearised equations of the states (S) at the nodes (J), the first of which is given, make of right-hand sides
    (J - 1, S, q), by the derivatives (J, S, S) of the rates by states.

    Transposed they run backwards in time.
    """
    half, unit, count = 0.5 * step * slopes, np.eye(slopes.shape[1]), slopes.shape[1]
    ahead, behind = unit - half[1:], -unit - half[1:-1]
    if transposed:
        ahead, behind = ahead[::-1].swapaxes(1, 2), behind[::-1].swapaxes(1, 2)
    lower, upper = 2 * count - 1, count - 1
    bands = np.zeros((2 * lower + upper + 1, len(ahead) * count))
    for row, column in np.ndindex(count, count):
        place = lower + upper + row - column
        bands[place, column::count] = ahead[:, row, column]
        bands[place + count, column:-count:count] = behind[:, row, column]
    ordered = right[::-1] if transposed else right
    flat = ordered.reshape(-1, right.shape[-1])
    *_, solved, singular = lapack.dgbsv(lower, upper, bands, flat, overwrite_ab=1)
    solved = np.full(right.shape, np.nan) if singular else solved.reshape(right.shape)
    return np.asarray(solved[::-1] if transposed else solved)


@dataclass(frozen=True, eq=False)
class LinkPath:
    """A link along a motion: `states` (J, S), behind them the signals that its law names, `converged` if they are found."""

    law: Law
    values: tuple[float, ...]
    d: Floats
    v: Floats
    step: float
    states: Floats
    converged: bool

    @classmethod
    @np.errstate(all="ignore")  # states may run away; then the path has not converged
    def of(
        cls, law: Law, values: dict[str, float], d: Floats, v: Floats, step: float,
        initial: Floats, guess: Floats | None = None,
    ) -> LinkPath:  # fmt: skip
        ordered = tuple(values[name] for name in law.coefficients)
        program, _ = _programs(law, ())
        count = len(law.states)
        states, converged = np.zeros((len(d), count)) if guess is None else guess.copy(), not count
        states[0] = initial
        for _ in range(_NEWTON if count else 0):
            rates_and_slopes = program(d, v, *states.T, *ordered)
            rates = np.stack(rates_and_slopes[:count], axis=1)
            slopes = np.stack(rates_and_slopes[count:], axis=1).reshape(-1, count, count)
            missed = np.diff(states, axis=0) - 0.5 * step * (rates[1:] + rates[:-1])
            if not (np.isfinite(missed).all() and np.isfinite(slopes).all()):
                break
            change = _solved(slopes, step, missed[..., None])[..., 0]
            states[1:] -= change
            size = np.abs(states).max()
            converged = bool(np.abs(change).max() <= _TOLERANCE * (size + 1e-300) and size < _LARGEST)
            if converged or not size < _LARGEST:
                break
        return cls(law, ordered, d, v, step, states, converged)

    def force(self) -> Floats:
        """Force (J,) in N at the nodes."""
        named = dict(zip(self.law.coefficients, self.values, strict=True))
        named |= dict(zip((*self.law.states, *self.law.signals), self.states.T, strict=True))
        return self.law.force(self.d, self.v, named)

    def slopes(self, free: Sequence[str] = ()) -> Floats:
        """(J, 1 + S, 2 + S + c) derivatives of the force and the rates of states by d, v, the states and c coefficients."""
        _, program = _programs(self.law, tuple(free))
        rows = np.stack(program(self.d, self.v, *self.states.T, *self.values), axis=1)
        return rows.reshape(len(rows), 1 + len(self.law.states), -1)

    def by_unknowns(self, free: Sequence[str]) -> Floats:
        """Derivatives (J, c + S + 1) of the force by the coefficients `free`, by initial states, and by d, held for the whole
        motion.
        """
        slopes, count = self.slopes(free), len(self.law.states)
        of_states = np.zeros((*slopes.shape[:2], count))
        pushed = np.concatenate([slopes[:, :, 2 + count :], of_states, slopes[:, :, :1]], axis=2)
        return self._followed(slopes, pushed, np.eye(count, pushed.shape[2], k=len(free)))

    def by_motion(self, changes: Floats) -> Floats:
        """Changes (J, q) of the force with changes (2, J, q) of d and v along the motion."""
        slopes = self.slopes()
        pushed = np.einsum("jrm,mjq->jrq", slopes[:, :, :2], changes)
        return self._followed(slopes, pushed, np.zeros((len(self.law.states), pushed.shape[2])))

    def _followed(self, slopes: Floats, pushed: Floats, first: Floats) -> Floats:
        """Changes (J, q) of the force where it and the rates are `pushed` (J, 1 + S, q), and the states at first (S, q)."""
        if not len(first):
            return pushed[:, 0]
        half, by_state = 0.5 * self.step, slopes[:, :, 2 : 2 + len(first)]
        right = half * (pushed[1:, 1:] + pushed[:-1, 1:])
        right[0] += first + half * by_state[0, 1:] @ first
        states = np.concatenate([first[None], _solved(by_state[:, 1:], self.step, right)])
        return np.asarray(pushed[:, 0] + np.einsum("js,jsq->jq", by_state[:, 0], states))

    def to_motion(self, weights: Floats) -> Floats:
        """Derivatives (2, J, q) of sums of forces, weighted with (J, q), by d and v at every node."""
        slopes, count = self.slopes(), len(self.law.states)
        pulls = np.concatenate([weights[:, None], np.zeros((len(weights), count, weights.shape[1]))], axis=1)
        if count:
            by_state = slopes[:, :, 2 : 2 + count]
            sources = by_state[1:, 0, :, None] * weights[1:, None]
            pulled = 0.5 * self.step * _solved(by_state[:, 1:], self.step, sources, transposed=True)
            pulls[1:, 1:] += pulled
            pulls[:-1, 1:] += pulled
        return np.asarray(np.einsum("jrm,jrq->mjq", slopes[:, :, :2], pulls))
