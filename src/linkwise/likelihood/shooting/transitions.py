"""Sensitivities by transitions over half steps: for many columns of few masses, a product of matrices a step.

The motion after half a step follows linearly from that before it, by a matrix that Nystroem's method of order 4 gives from as
many columns as there are states. All other columns are carried on by these matrices; what acts on them does so as jumps of
velocity at the ends of half steps. That is the trapezoidal rule, whose error of order 2 is that of the first and the last
slope of what is summed (Euler and Maclaurin); without it the order is 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.acting_forces import Accelerations, ActingForces
from linkwise.likelihood.shooting.flow import TANGENT_CLOSING, TANGENT_END, TANGENT_MIDDLE
from linkwise.likelihood.shooting.neighbourhoods import as_slice
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangents import Single, combine, product

_AT_ONCE = 60_000  # numbers of one kind in the columns that are marched together
_HALF = np.float32(0.5)
_BEFORE, _BETWEEN = 2, 3  # columns of TANGENT_END of the pulls at the start and in the middle of a step
_DISPLACED = np.float32(
    1.0 / 24.0
)  # of h^2 a / 2: what the trapezoidal rule lacks, a twelfth for half a step
_CLOSING = TANGENT_CLOSING * np.array(
    [[1.0], [2.0]], np.float32
)  # of x, and of u of a whole step over half of it


def carried(
    mechanics: NumericSystem, step: Floats, scale: Floats, acting: ActingForces, columns: int
) -> Iterator[Single]:
    """Sensitivities along an orbit without states of links.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    step : array of shape (K,)
        Whole steps in s.
    scale : array of shape (2 n,)
        Units of the states.
    acting : ActingForces
        What acts along the J whole steps.
    columns : int
        The number P of columns: the states at the node, the parameters and the sizes of candidate forces.

    Yields
    ------
    array of shape (K, n, P)
        Sensitivities of x at the start of each step, and at last those of x and u = h v (K, 2 n, P) at the end; overwritten.
    """
    n, K, P = len(mechanics.gain), len(step), columns
    steps, unknowns = _with_jumps(*transitions(mechanics, acting)), acting.accelerations
    before, after = np.zeros((2, K, 3 * n, P), np.float32)
    motion = before[:, : 2 * n]
    for i in range(n):
        motion[:, i, i], motion[:, n + i, n + i] = scale[i], scale[n + i] * step
    lacking = _Lacking(mechanics, unknowns, P)
    motion -= lacking.at((0, 1, 2), acting.by_v[0])
    shown, own = np.empty((K, n, P), np.float32), unknowns.at(0)
    at_displacements, at_rates, at_jumps = (as_slice(unknowns.places + row * P) for row in (0, n, 2 * n))
    _flat(before)[:, at_rates] += _HALF * own
    for j in range(len(steps)):
        shown[:] = motion[:, :n]
        own *= _DISPLACED
        _flat(shown)[:, at_displacements] += own
        yield shown
        _flat(before)[:, at_jumps] = unknowns.at(2 * j + 1)
        motion, own = np.matmul(steps[j], before, out=after[:, : 2 * n]), unknowns.at(2 * j + 2)
        _flat(after)[:, at_rates] += own
        before, after = after, before
    _flat(before)[:, at_rates] -= _HALF * own
    motion -= lacking.at((-1, -2, -3), acting.by_v[1], backwards=True)
    yield motion


def _flat(sensitivities: Single) -> Single:
    return sensitivities.reshape(len(sensitivities), -1)


def _with_jumps(first: Single, second: Single) -> Single:
    """(J, K, 2 n, 3 n) how x and u after a step follow from those before it, and from a jump of u in its middle."""
    size = second.shape[-1]
    out = np.empty((*second.shape[:-1], size + size // 2), np.float32)
    np.matmul(second, first, out=out[..., :size])
    out[..., size:] = second[..., size // 2 :]
    return out


def transitions(mechanics: NumericSystem, acting: ActingForces) -> tuple[Single, Single]:
    """How x and u = h v after half a step follow from those before it.

    Parameters
    ----------
    mechanics, acting
        As of `carried`.

    Returns
    -------
    first, second : array of shape (J, K, 2 n, 2 n)
        Those of the first and of the second half of each step.
    """
    n, K = len(mechanics.gain), acting.by_v.shape[2]
    into_links, gain = mechanics.incidence.T.astype(np.float32), mechanics.gain.astype(np.float32)
    out = np.empty((2 * acting.steps * K, 2, n, 2 * n), np.float32)
    size = max(_AT_ONCE // (2 * n * n), 1)
    for begin in range(0, len(out), size):
        own = slice(begin, min(begin + size, len(out)))
        at_end = slice(own.start + K, own.stop + K)
        slopes = acting.at_ends[..., own], acting.between[..., own], acting.at_ends[..., at_end]
        out[own] = _after_a_step(into_links, gain, *slopes).transpose(3, 0, 1, 2)
    halves = out.reshape(acting.steps, 2, K, 2 * n, 2 * n)
    return halves[:, 0], halves[:, 1]


def _after_a_step(into_links: Single, gain: Single, before: Single, middle: Single, after: Single) -> Single:
    """(2, n, 2 n, k) x and twice u = h v after k steps by Nystroem's method, from one of each x and a half of each u.

    `into_links` (L, n) and `gain` (n, L) are as of `Transfer`; `before`, `middle` and `after` (2, L, k) are slopes of h^2 f
    by d and h v at the start, in the middle and at the end of each step.
    """
    (L, n), k = into_links.shape, before.shape[2]
    whole, half = into_links[:, :, None], _HALF * into_links[:, :, None]
    d, hv, pulls, pulls_between = np.empty((4, L, 2 * n, k), np.float32)
    accelerations, moved = np.empty((3, n, 2 * n, k), np.float32), np.empty((2, n, 2 * n, k), np.float32)

    def accelerate(slopes: Single, out: Single) -> None:
        np.multiply(slopes[0][:, None], d, out=d)
        np.multiply(slopes[1][:, None], hv, out=hv)
        np.add(d, hv, out=d)
        product(gain, d, out)

    np.multiply(before[0][:, None], whole, out=d[:, :n])
    np.multiply(before[1][:, None], half, out=d[:, n:])
    product(gain, d, accelerations[0])
    product(into_links, accelerations[0], pulls)
    np.multiply(pulls, np.float32(TANGENT_MIDDLE[0, 2]), out=d)
    d[:, :n] += whole
    d[:, n:] += _HALF * half
    np.multiply(pulls, np.float32(TANGENT_MIDDLE[1, 2]), out=hv)
    hv[:, n:] += half
    accelerate(middle, accelerations[1])
    product(into_links, accelerations[1], pulls_between)
    np.multiply(pulls_between, TANGENT_END[0, _BETWEEN], out=d)
    d[:, :n] += whole
    d[:, n:] += half
    np.multiply(pulls_between, TANGENT_END[1, _BETWEEN], out=hv)
    for end, row in ((d, 0), (hv, 1)):
        if weight := TANGENT_END[row, _BEFORE]:
            end += weight * pulls
    hv[:, n:] += half
    accelerate(after, accelerations[2])
    combine(_CLOSING, accelerations, moved)
    for i in range(n):
        moved[0, i, i] += np.float32(1.0)
        moved[0, i, n + i] += _HALF
        moved[1, i, n + i] += np.float32(1.0)
    return moved


@dataclass(frozen=True, eq=False)
class _Lacking:
    """What the trapezoidal rule lacks of P `columns` of sensitivities at either end."""

    mechanics: NumericSystem
    unknowns: Accelerations
    columns: int

    def at(self, points: tuple[int, int, int], by_v: Single, *, backwards: bool = False) -> Single:
        """(K, 2 n, P) at the first of three points that follow each other, with slopes `by_v` (L, K)."""
        n, K = len(self.mechanics.gain), by_v.shape[1]
        lacking = np.zeros((K, 2 * n, self.columns), np.float32)
        flat, places = _flat(lacking), self.unknowns.places
        first, second, third = (self.unknowns.at(point) for point in points)
        sign = np.float32(-1.0 if backwards else 1.0)
        flat[:, places] = sign * _DISPLACED * first
        into_links, gain = (
            matrix.astype(np.float32) for matrix in (self.mechanics.incidence.T, self.mechanics.gain)
        )
        lacking[:, n:] = gain @ (by_v.T[:, :, None] * (into_links @ lacking[:, :n]))
        slope = 4.0 * second - 3.0 * first - third  # over a step from there on, to the second order
        flat[:, places + n * self.columns] -= _DISPLACED * slope
        return lacking
