"""Flow of the equations of motion over all segments at once, and its sensitivities by a cheaper scheme.

The accuracy of the flow limits that of the estimate, so it is integrated with order 8 to well below the noise. Sensitivities
only set search directions and standard errors: order 4, in single precision, along the states of the flow. Velocities are
carried as u = h v and accelerations as h^2 a, so that no stage is multiplied by h.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.system import NumericSystem
from linkwise.likelihood.tableau import (
    CLOSING,
    MIDDLE,
    STAGE_POINT,
    STAGE_ROWS,
    STAGES,
    TANGENT_CLOSING,
    TANGENT_END,
    TANGENT_MIDDLE,
)

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Applied forces and motion of the base at the five POINTS of every step.

    Attributes
    ----------
    force : array of shape (J, 5, n, K) or None
        Forces on the masses in N.
    base : array of shape (J, 5, 2, K) or None
        Displacement in m and velocity in m/s of the base.
    frame : array of shape (J, 5, K) or None
        Acceleration in m/s^2 of the coordinates, of which `force` has the forces of inertia.
    """

    force: Floats | None = None
    base: Floats | None = None
    frame: Floats | None = None

    def part(self, segments: slice | Indices) -> Inputs:
        """The inputs of some segments."""
        return Inputs(*(None if a is None else a[..., segments] for a in (self.force, self.base, self.frame)))


@dataclass(frozen=True, eq=False)
class Trajectories:
    """J steps from the nodes of K segments; SI units except u = h v.

    Attributes
    ----------
    states : array of shape (J + 1, 2, n, K)
        x and u at the ends of the steps.
    links : array of shape (J + 1, 2, L, K)
        d and v there.
    accelerations : array of shape (J + 1, n, K)
        Accelerations there.
    middle_links : array of shape (J, 2, L, K)
        d and v in the middles of the steps.
    middle_accelerations : array of shape (J, n, K)
        Accelerations there.
    """

    states: Floats  # (J + 1, 2, n, K) x and u at the steps' ends
    links: Floats  # (J + 1, 2, L, K) d and v there
    accelerations: Floats  # (J + 1, n, K) there
    middle_links: Floats  # (J, 2, L, K) d and v in the middles of the steps
    middle_accelerations: Floats  # (J, n, K)

    def part(self, segments: slice) -> Trajectories:
        """The trajectories of some segments."""
        return Trajectories(
            *(
                a[..., segments]
                for a in (
                    self.states,
                    self.links,
                    self.accelerations,
                    self.middle_links,
                    self.middle_accelerations,
                )
            )
        )

    def thinned(self, refine: int) -> Trajectories:
        """The same orbit in longer steps: ends of old steps become middles of new ones.

        Parameters
        ----------
        refine : int
            Factor on the step, 1 or even.

        Returns
        -------
        Trajectories
            The orbit.
        """
        if refine == 1:
            return self
        half = slice(refine // 2, None, refine)
        states = self.states[::refine].copy()
        states[:, 1] *= refine
        return Trajectories(
            states,
            self.links[::refine],
            self.accelerations[::refine],
            self.links[half],
            self.accelerations[half],
        )


@dataclass(frozen=True, eq=False)
class CandidateForces:
    """c forces of unknown size between masses, which the laws lack: sensitivities to their sizes are those of a score test.

    Attributes
    ----------
    first, second : array of int, shape (c,)
        The masses on which the force acts, negative on the first; below 0 for none.
    starts : array of shape (J + 1, c, K)
        Forces of unit size in N at the ends of the steps.
    middles : array of shape (J, c, K)
        The same in the middles of the steps.
    """

    first: Indices
    second: Indices
    starts: Floats
    middles: Floats

    def part(self, segments: slice) -> CandidateForces:
        """The forces in some segments."""
        return CandidateForces(
            self.first, self.second, self.starts[..., segments], self.middles[..., segments]
        )


def flow(mechanics: NumericSystem, start: Floats, step: Floats, steps: int, inputs: Inputs) -> Trajectories:
    """Integrate the equations of motion.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    start : array of shape (2, n, K)
        Displacements in m and velocities in m/s at the nodes.
    step : array of shape (K,)
        Steps in s.
    steps : int
        Number of steps J.
    inputs : Inputs
        Applied forces and motion of the base.

    Returns
    -------
    Trajectories
        The motion; not finite where it diverges.

    References
    ----------
    G. J. Cooper and J. H. Verner, SIAM J. Numer. Anal. 9, 389 (1972).
    """
    _, n, K = start.shape
    L = mechanics.gain.shape[1]
    orbit = Trajectories(
        np.empty((steps + 1, 2, n, K)),
        np.empty((steps + 1, 2, L, K)),
        np.empty((steps + 1, n, K)),
        np.empty((steps, 2, L, K)),
        np.empty((steps, n, K)),
    )
    states, step2, rate = orbit.states, step * step, 1.0 / step
    into_links = mechanics.system.incidence.T
    states[0, 0] = start[0]
    np.multiply(start[1], step, out=states[0, 1])
    forces = np.empty((STAGES, L, K))
    stack = np.empty((2 + STAGES, L, K))
    flat = stack.reshape(2 + STAGES, L * K)
    for j in range(steps):
        np.matmul(into_links, states[j], out=stack[:2])
        applied = None if inputs.force is None else inputs.force[j] / mechanics.masses[:, None]
        for i in range(STAGES):
            motion = (STAGE_ROWS[i, :, : 2 + i] @ flat[: 2 + i]).reshape(2, L, K)
            motion[1] *= rate
            _add_base(mechanics, motion, inputs, j, STAGE_POINT[i])
            if i == 0:
                orbit.links[j] = motion
            elif i == MIDDLE:
                orbit.middle_links[j] = motion
            mechanics.force(motion[0], motion[1], forces[i])
            np.matmul(mechanics.link_gain, forces[i], out=stack[2 + i])
            if applied is not None:
                stack[2 + i] += into_links @ applied[STAGE_POINT[i]]
            stack[2 + i] *= step2
        np.matmul(
            mechanics.gain, (CLOSING @ forces.reshape(STAGES, L * K)).reshape(2, L, K), out=states[j + 1]
        )
        np.matmul(mechanics.gain, forces[0], out=orbit.accelerations[j])
        np.matmul(mechanics.gain, forces[MIDDLE], out=orbit.middle_accelerations[j])
        if applied is not None:
            for i in map(int, np.flatnonzero(CLOSING[1])):
                states[j + 1] += CLOSING[:, i, None, None] * applied[STAGE_POINT[i]]
            orbit.accelerations[j] += applied[0]
            orbit.middle_accelerations[j] += applied[2]
        states[j + 1] *= step2
        states[j + 1] += states[j]
        states[j + 1, 0] += states[j, 1]
    motion = into_links @ states[steps]
    motion[1] *= rate
    _add_base(mechanics, motion, inputs, steps - 1, 4)
    orbit.links[steps] = motion
    mechanics.force(motion[0], motion[1], forces[0])
    np.matmul(mechanics.gain, forces[0], out=orbit.accelerations[steps])
    if inputs.force is not None:
        orbit.accelerations[steps] += inputs.force[steps - 1, 4] / mechanics.masses[:, None]
    return orbit


def _add_base(mechanics: NumericSystem, motion: Floats, inputs: Inputs, j: int, point: int) -> None:
    if inputs.base is not None:
        motion += mechanics.system.base[:, None] * inputs.base[j, point, :, None]


def tangents(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    scale: Floats,
    unit: Floats,
    candidates: CandidateForces | None = None,
) -> Iterator[tuple[Single, Single | None]]:
    """Sensitivities along an orbit, by Nystroem's method of order 4.

    There are P = 2 n + p + c columns: the state at the node, the parameters and the sizes of candidate forces.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    orbit : Trajectories
        The orbit.
    step : array of shape (K,)
        Steps in s.
    scale : array of shape (2 n,)
        Units of the states in m or m/s.
    unit : array of shape (p,)
        Units of the parameters.
    candidates : CandidateForces, optional
        Candidate forces.

    Yields
    ------
    state : array of shape (2, n, P, K)
        Sensitivities of x and u at the start of a step, and at last at the end; overwritten by the next step.
    acceleration : array of shape (n, P, K) or None
        Those of h^2 a; None at the end.
    """
    n, L = mechanics.gain.shape
    steps, K = len(orbit.middle_links), orbit.links.shape[-1]
    P = 2 * n + len(unit) + (0 if candidates is None else len(candidates.first))
    starts = _TangentForces(mechanics, orbit.links, orbit.accelerations, step, unit)
    middles = _TangentForces(mechanics, orbit.middle_links, orbit.middle_accelerations, step, unit)
    if candidates is not None:
        starts.add_candidates(candidates, candidates.starts, step)
        middles.add_candidates(candidates, candidates.middles, step)
    into_links, gain, link_gain = (
        np.ascontiguousarray(a, np.float32)
        for a in (mechanics.system.incidence.T, mechanics.gain, mechanics.link_gain)
    )
    state = np.zeros((2, n, P, K), np.float32)
    for i in range(n):
        state[0, i, i] = scale[i]
        state[1, i, n + i] = scale[n + i] * step
    stack, pulls = np.empty((4, L, P, K), np.float32), np.empty((3, L, P, K), np.float32)
    motion, moved, acceleration = (
        np.empty((2, L, P, K), np.float32),
        np.empty_like(state),
        np.empty_like(state[0]),
    )
    for j in range(steps):
        _times(into_links, state, stack[:2])
        starts(j, stack[:2], pulls[0])
        _times(gain, pulls[0], acceleration)
        starts.inertia(j, acceleration)
        yield state, acceleration
        _times(link_gain, pulls[0], stack[2])
        starts.inertia(j, stack[2], into_links)
        _combine(TANGENT_MIDDLE, stack[:3], motion)
        middles(j, motion, pulls[1])
        _times(link_gain, pulls[1], stack[3])
        middles.inertia(j, stack[3], into_links)
        _combine(TANGENT_END, stack, motion)
        starts(j + 1, motion, pulls[2])
        state[0] += state[1]
        _combine(TANGENT_CLOSING, pulls, motion)
        _times(gain, motion, moved)
        for row, weights in zip(moved, TANGENT_CLOSING, strict=False):
            for pull, index, weight in (
                (starts, j, weights[0]),
                (middles, j, weights[1]),
                (starts, j + 1, weights[2]),
            ):
                pull.inertia(index, row, weight=weight)
        state += moved
    yield state, None


class _TangentForces:
    """Tangent link forces h^2 df, and the change of acceleration by an unknown mass."""

    def __init__(
        self, mechanics: NumericSystem, links: Floats, accelerations: Floats, step: Floats, unit: Floats
    ) -> None:
        system, step2, first = mechanics.system, step * step, 2 * len(mechanics.masses)
        slopes = mechanics.partials(links[:, 0], links[:, 1])
        units = np.array([unit[column] for _, column, _ in system.interactions])[:, None]
        self.by_d = (slopes.by_d * step2).astype(np.float32)
        self.by_v = (slopes.by_v * step).astype(np.float32)
        self.by_parameter = (slopes.by_parameter * (units * step2)).astype(np.float32)
        self.rows = np.array([link for link, _, _ in system.interactions], dtype=int)
        self.columns = np.array([first + column for _, column, _ in system.interactions], dtype=int)
        self.width = first + len(unit)
        self.candidates: list[tuple[Indices, Indices, Single]] = []
        self.masses = []
        for i, column in np.argwhere(system.parameters.mass_map):
            factor = -system.parameters.mass_map[i, column] * unit[column] / mechanics.masses[i]
            self.masses.append(
                (i, first + column, (accelerations[:, i] * (factor * step2)).astype(np.float32))
            )
        self.mass_values = mechanics.masses

    def add_candidates(self, candidates: CandidateForces, force: Floats, step: Floats) -> None:
        """Count `force` (..., c, K), of unit amplitude, of candidates that no link exerts yet."""
        for ends, sign in ((candidates.first, -1.0), (candidates.second, 1.0)):
            on_mass = np.flatnonzero(ends >= 0)
            factor = (sign / self.mass_values[ends[on_mass]])[:, None] * step**2
            change = (force[:, on_mass] * factor).astype(np.float32)
            self.candidates.append((ends[on_mass], self.width + on_mass, change))

    def __call__(self, j: int, motion: Single, out: Single) -> None:
        np.multiply(self.by_d[j][:, None], motion[0], out=out)
        out += self.by_v[j][:, None] * motion[1]
        out[self.rows, self.columns] += self.by_parameter[j]

    def inertia(self, j: int, out: Single, into_links: Single | None = None, weight: float = 1.0) -> None:
        """Add h^2 da of unknown masses and of candidates to masses (n, P, K) or through `into_links` to links (L, P, K)."""
        for ends, columns, change in self.candidates:
            if into_links is None:
                out[ends, columns] += np.float32(weight) * change[j]
            else:
                out[:, columns] += into_links[:, ends, None] * change[j]
        for i, column, change in self.masses:
            if into_links is None:
                out[i, column] += np.float32(weight) * change[j]
            else:
                out[:, column] += into_links[:, i, None] * change[j]


def _times(matrix: Single, block: Single, out: Single) -> None:
    """matrix @ block over the third last axis, the last two being P and K."""
    flat = (-1, block.shape[-2] * block.shape[-1])
    np.matmul(matrix, block.reshape(*block.shape[:-2], flat[1]), out=out.reshape(*out.shape[:-2], flat[1]))


def _combine(weights: Single, blocks: Single, out: Single) -> None:
    np.matmul(weights, blocks.reshape(len(blocks), -1), out=out.reshape(len(out), -1))
