"""Sensitivities by transitions over half steps: for many columns of few masses, a product of matrices a step.

The motion after half a step follows linearly from that before it, by a matrix that Nystroem's method of order 4 gives from as
many columns as there are states. All other columns are carried on by these matrices; what acts on them does so as jumps of
velocity at the ends of half steps. That is the trapezoidal rule, whose error of order 2 is that of the first and the last
slope of what is summed (Euler and Maclaurin); without it the order is 4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.flow import Trajectories
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tableau import TANGENT_CLOSING, TANGENT_END, TANGENT_MIDDLE
from linkwise.likelihood.shooting.tangent_forces import Single, TangentForces
from linkwise.likelihood.shooting.tangents import combine, product

_AT_ONCE = 60_000  # numbers of one kind in the columns that are marched together
_JUMP = 0.5  # of h^2 a of a whole step: the change of h v over half of it
_HALF = np.float32(0.5)
_LACKING = 1.0 / 48.0  # of h^2 a of a whole step: what the trapezoidal rule lacks, a twelfth for half of it


def carried(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    scale: Floats,
    forces: tuple[TangentForces, TangentForces],
    columns: int,
) -> Iterator[Single]:
    """Sensitivities along an orbit without states of links.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    orbit : Trajectories
        The orbit in half steps, of which there are 2 J.
    step : array of shape (K,)
        Whole steps in s.
    scale : array of shape (2 n,)
        Units of the states.
    forces : tuple of TangentForces
        Tangent forces at the ends of the J whole steps and in their middles.
    columns : int
        The number P of columns: the states at the node, the parameters and the sizes of candidate forces.

    Yields
    ------
    array of shape (K, n, P)
        Sensitivities of x at the start of each step, and at last those of x and u = h v (K, 2 n, P) at the end; overwritten.
    """
    n, K, P = len(mechanics.gain), len(step), columns
    steps = _with_jumps(*transitions(mechanics, orbit, step, forces))
    ends, middles = (_Accelerations.of(force, mechanics.gain, P) for force in forces)
    before, after = np.zeros((2, K, 3 * n, P), np.float32)
    motion = before[:, : 2 * n]
    for i in range(n):
        motion[:, i, i], motion[:, n + i, n + i] = scale[i], scale[n + i] * step
    damping = _Damping(mechanics, forces[0].by_v)
    motion -= damping.lacking(0, ends, ends.slope(middles), P)
    shown = np.empty((K, n, P), np.float32)
    ends.add(0, motion, 0.5 * _JUMP)
    for j in range(len(steps)):
        shown[:] = motion[:, :n]
        ends.add(j, shown, _LACKING)
        yield shown
        middles.put(j, before, _JUMP)
        motion = np.matmul(steps[j], before, out=after[:, : 2 * n])
        ends.add(j + 1, motion, _JUMP if j + 1 < len(steps) else 0.5 * _JUMP)
        before, after = after, before
    motion += damping.lacking(len(steps), ends, -ends.reversed().slope(middles.reversed()), P)
    yield motion


def _with_jumps(first: Single, second: Single) -> Single:
    """(J, K, 2 n, 3 n) how x and u after a step follow from those before it, and from a jump of u in its middle."""
    return np.concatenate([second @ first, second[..., second.shape[-1] // 2 :]], axis=-1)


def transitions(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    forces: tuple[TangentForces, TangentForces],
) -> tuple[Single, Single]:
    """How x and u = h v after half a step follow from those before it.

    Parameters
    ----------
    mechanics, orbit, step, forces
        As of `carried`.

    Returns
    -------
    first, second : array of shape (J, K, 2 n, 2 n)
        Those of the first and of the second half of each step.
    """
    n, K, steps = len(mechanics.gain), len(step), len(orbit.middle_links)
    slopes, middles = _slopes_at_ends(*forces), _slopes_between(mechanics, orbit, 0.5 * step)
    into_links, gain = mechanics.incidence.T.astype(np.float32), mechanics.gain.astype(np.float32)
    out = np.empty((steps * K, 2, n, 2 * n), np.float32)
    size = max(_AT_ONCE // (2 * n * n), 1)
    for begin in range(0, steps * K, size):
        own = slice(begin, min(begin + size, steps * K))
        at_end = slice(own.start + K, own.stop + K)
        moved = _after_a_step(into_links, gain, slopes[..., own], middles[..., own], slopes[..., at_end])
        out[own] = moved.transpose(3, 0, 1, 2)
    out[:, 1] *= np.float32(2.0)
    halves = out.reshape(steps // 2, 2, K, 2 * n, 2 * n)
    return halves[:, 0], halves[:, 1]


def _slopes_at_ends(starts: TangentForces, middles: TangentForces) -> Single:
    """(2, L, (2 J + 1) K) slopes of h^2 f by d and h v at the ends of half steps, one place after the other."""
    places, L, K = starts.steps + middles.steps, *starts.by_d.shape[1:]
    out = np.empty((2, L, places, K), np.float32)
    for own, force in ((out[:, :, ::2], starts), (out[:, :, 1::2], middles)):
        np.multiply(force.by_d.transpose(1, 0, 2), np.float32(0.25), out=own[0])
        np.multiply(force.by_v.transpose(1, 0, 2), np.float32(0.5), out=own[1])
    return out.reshape(2, L, places * K)


def _slopes_between(mechanics: NumericSystem, orbit: Trajectories, step: Floats) -> Single:
    """(2, L, 2 J K) the same in the middles of half steps (K,) in s."""
    partials = mechanics.partials(orbit.middle_links[:, 0], orbit.middle_links[:, 1], orbit.middle_memory)
    out = np.empty((2, orbit.middle_links.shape[2], len(orbit.middle_links), len(step)), np.float32)
    np.multiply(partials.by_d.transpose(1, 0, 2), step**2, out=out[0], casting="same_kind")
    np.multiply(partials.by_v.transpose(1, 0, 2), step, out=out[1], casting="same_kind")
    return out.reshape(*out.shape[:2], -1)


def _after_a_step(into_links: Single, gain: Single, before: Single, middle: Single, after: Single) -> Single:
    """(2, n, 2 n, k) x and u = h v after k steps by Nystroem's method, from one of each x and a half of each u.

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
    np.multiply(pulls_between, TANGENT_END[0, 3], out=d)
    d[:, :n] += whole
    d[:, n:] += half
    np.multiply(pulls_between, TANGENT_END[1, 3], out=hv)
    hv -= pulls
    hv[:, n:] += half
    accelerate(after, accelerations[2])
    combine(TANGENT_CLOSING, accelerations, moved)
    for i in range(n):
        moved[0, i, i] += np.float32(1.0)
        moved[:, i, n + i] += _HALF
    return moved


@dataclass(frozen=True, eq=False)
class _Accelerations:
    """What acts at I points along the orbit: `values` (I, K, e) of h^2 a at e `places` among (n, P) sensitivities."""

    places: Indices
    values: Single
    size: int

    @classmethod
    def of(cls, forces: TangentForces, gain: Floats, columns: int) -> _Accelerations:
        """Those of unknown coefficients and masses, and of candidate forces."""
        masses, which = np.nonzero(gain[:, forces.rows])
        weights = gain[masses, forces.rows[which]].astype(np.float32)[:, None]
        parts = [(masses, forces.columns[which], forces.by_parameter[:, which] * weights)]
        parts += forces.candidates
        parts += [
            (np.array([mass]), np.array([column]), change[:, None]) for mass, column, change in forces.masses
        ]
        rows, of_columns, values = zip(*parts, strict=True)
        places = np.concatenate(rows) * columns + np.concatenate(of_columns)
        order = np.argsort(places, kind="stable")
        together = np.concatenate(values, axis=1)[:, order].transpose(0, 2, 1)
        unique, firsts = np.unique(places[order], return_index=True)
        if len(unique) < len(places):  # as of a coefficient that links on both sides of a mass share
            together = np.add.reduceat(together, firsts, axis=2)
        return cls(unique, np.ascontiguousarray(together), len(gain) * columns)

    def add(self, j: int, motion: Single, weight: float) -> None:
        """Add those at a point, weighted, to the last n rows of sensitivities (K, n or 2 n, P)."""
        _add(motion, self, np.float32(weight) * self.values[j])

    def put(self, j: int, motion: Single, weight: float) -> None:
        """Put those at a point, weighted, into the last n rows of sensitivities and jumps (K, 3 n, P), the rest of them 0."""
        flat = motion.reshape(len(motion), -1)
        flat[:, self.places + (flat.shape[1] - self.size)] = np.float32(weight) * self.values[j]

    def reversed(self) -> _Accelerations:
        """Those along the orbit from its end on."""
        return replace(self, values=self.values[::-1])

    def slope(self, middles: _Accelerations) -> Single:
        """(K, e) the slope over a step at the first point, to the second order, from those between the points as well."""
        three = np.float32(3.0) * self.values[0], np.float32(4.0) * middles.values[0], self.values[1]
        return np.asarray(three[1] - three[0] - three[2])


def _add(motion: Single, which: _Accelerations, values: Single) -> None:
    """Add values (K, e) at the places of accelerations among the last n rows of sensitivities."""
    flat = motion.reshape(len(motion), -1)
    flat[:, which.places + (flat.shape[1] - which.size)] += values


@dataclass(frozen=True, eq=False)
class _Damping:
    """Accelerations h^2 a by u = h v, with the slopes `by_v` (I, L, K) of the forces in links."""

    mechanics: NumericSystem
    by_v: Single

    def lacking(self, j: int, ends: _Accelerations, slope: Single, columns: int) -> Single:
        """(K, 2 n, P) what the rule lacks of the sensitivities at a point where the accelerations have this slope."""
        n, K = len(self.mechanics.gain), self.by_v.shape[2]
        lacking = np.zeros((K, 2 * n, columns), np.float32)
        ends.add(j, lacking[:, :n], _LACKING)
        into_links, gain = (
            matrix.astype(np.float32) for matrix in (self.mechanics.incidence.T, self.mechanics.gain)
        )
        lacking[:, n:] = gain @ (self.by_v[j].T[:, :, None] * (into_links @ lacking[:, :n]))
        _add(lacking, ends, np.float32(-_LACKING) * slope)
        return lacking
