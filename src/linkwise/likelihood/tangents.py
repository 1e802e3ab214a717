"""Sensitivities of the flow by a scheme cheaper than its own.

They only set search directions and standard errors: order 4, in single precision, along the states of the flow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.flow import Inputs, Trajectories, at_ends_and_middles
from linkwise.likelihood.system import NumericSystem
from linkwise.likelihood.tableau import TANGENT_CLOSING, TANGENT_END, TANGENT_MIDDLE
from linkwise.model.topology import FIRST_POINT

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class TangentStep:
    """Sensitivities at the start of a step, or at the end of the last, to P unknowns in K segments.

    Attributes
    ----------
    state : array of shape (2, n, P, K)
        Those of x and u = h v.
    memory : array of shape (S, P, K)
        Those of states of links.
    acceleration : array of shape (n, P, K) or None
        Those of h^2 a; None at the end.
    forces : array of shape (L, P, K) or None
        Those of h^2 f; None at the end.
    """

    state: Single
    memory: Single
    acceleration: Single | None
    forces: Single | None

    def shown(self) -> tuple[Single, Single, Single, Single, Single]:
        """What sensors of each kind show at the start of a step: of masses, masses, masses, links and states."""
        assert self.acceleration is not None and self.forces is not None
        return self.state[0], self.state[1], self.acceleration, self.forces, self.memory


@dataclass(frozen=True, eq=False)
class CandidateForces:
    """c forces of unknown size between masses, which the laws lack: sensitivities to their sizes are those of a score test.

    Attributes
    ----------
    first, second : array of int, shape (c,)
        The masses on which the force acts, negative on the first; -1 and -2 for none, and points of hosts from -3 down.
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

    def joined(self, others: CandidateForces) -> CandidateForces:
        """These forces and, after them, `others`."""
        return CandidateForces(
            np.append(self.first, others.first),
            np.append(self.second, others.second),
            np.concatenate([self.starts, others.starts], axis=1),
            np.concatenate([self.middles, others.middles], axis=1),
        )


def tangents(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    scale: Floats,
    unit: Floats,
    candidates: CandidateForces | None = None,
    inputs: Inputs | None = None,
) -> Iterator[TangentStep]:
    """Sensitivities along an orbit, by Nystroem's method of order 4.

    There are P = 2 n + S + p + c columns: the state at the node, the parameters and the sizes of candidate forces. States of
    links follow by Kutta's method of order 3, which has the same stages.

    Parameters
    ----------
    mechanics : NumericSystem
        The system.
    orbit : Trajectories
        The orbit.
    step : array of shape (K,)
        Steps in s.
    scale : array of shape (2 n + S,)
        Units of the states.
    unit : array of shape (p,)
        Units of the parameters.
    candidates : CandidateForces, optional
        Candidate forces.
    inputs : Inputs, optional
        What acts along the orbit; needed where it acts on points of hosts whose shapes are parameters.

    Yields
    ------
    TangentStep
        Sensitivities at the start of a step, and at last at the end; overwritten by the next step.
    """
    n, L = mechanics.gain.shape
    steps, K = len(orbit.middle_links), orbit.links.shape[-1]
    S = orbit.memory.shape[1]
    P = 2 * n + S + len(unit) + (0 if candidates is None else len(candidates.first))
    starts, middles = _forces(mechanics, orbit, step, unit, candidates, inputs)
    into_links, gain, link_gain = (
        np.ascontiguousarray(a, np.float32)
        for a in (mechanics.incidence.T, mechanics.gain, mechanics.link_gain)
    )
    state, inner = _units(scale, step, n, P)
    stack, pulls = np.empty((4, L, P, K), np.float32), np.empty((3, L, P, K), np.float32)
    motion, moved, acceleration = (
        np.empty((2, L, P, K), np.float32),
        np.empty_like(state),
        np.empty_like(state[0]),
    )
    rates, between = np.empty((3, S, P, K), np.float32), np.empty_like(inner)
    for j in range(steps):
        _times(into_links, state, stack[:2])
        starts(j, stack[:2], inner, pulls[0], rates[0])
        _times(gain, pulls[0], acceleration)
        starts.inertia(j, acceleration)
        yield TangentStep(state, inner, acceleration, pulls[0])
        _times(link_gain, pulls[0], stack[2])
        starts.inertia(j, stack[2], into_links)
        _combine(TANGENT_MIDDLE, stack[:3], motion)
        if S:
            np.add(inner, np.float32(0.5) * rates[0], out=between)
        middles(j, motion, between, pulls[1], rates[1])
        _times(link_gain, pulls[1], stack[3])
        middles.inertia(j, stack[3], into_links)
        _combine(TANGENT_END, stack, motion)
        if S:
            np.add(inner, np.float32(2.0) * rates[1] - rates[0], out=between)
        starts(j + 1, motion, between, pulls[2], rates[2])
        if S:
            inner += (rates[0] + np.float32(4.0) * rates[1] + rates[2]) / np.float32(6.0)
        state[0] += state[1]
        _combine(TANGENT_CLOSING, pulls, motion)
        _times(gain, motion, moved)
        for row, (first, second, third) in zip(moved, TANGENT_CLOSING, strict=False):
            starts.inertia(j, row, weight=first)
            middles.inertia(j, row, weight=second)
            starts.inertia(j + 1, row, weight=third)
        state += moved
    yield TangentStep(state, inner, None, None)


def _forces(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    unit: Floats,
    candidates: CandidateForces | None,
    inputs: Inputs | None,
) -> tuple[_TangentForces, _TangentForces]:
    """Tangent forces at the ends of the steps and in their middles; arguments as of `tangents`."""
    starts = _TangentForces(mechanics, orbit.links, orbit.memory, orbit.accelerations, step, unit)
    middles = _TangentForces(
        mechanics, orbit.middle_links, orbit.middle_memory, orbit.middle_accelerations, step, unit
    )
    if candidates is not None:
        starts.add_candidates(candidates, candidates.starts, step)
        middles.add_candidates(candidates, candidates.middles, step)
    if mechanics.system.shapes is not None:
        applied = None if inputs is None else inputs.points
        stride = 1 if applied is None else len(applied) // len(orbit.middle_links)
        at_ends, between = (None, None) if applied is None else at_ends_and_middles(applied, stride)
        starts.add_shapes(orbit.states, orbit.links, orbit.memory, at_ends, step)
        middles.add_shapes(orbit.middles(step), orbit.middle_links, orbit.middle_memory, between, step)
    return starts, middles


def _units(scale: Floats, step: Floats, n: int, P: int) -> tuple[Single, Single]:
    """Sensitivities (2, n, P, K) and (S, P, K) at the nodes: of each state to itself, in its unit."""
    S, K = len(scale) - 2 * n, len(step)
    state, inner = np.zeros((2, n, P, K), np.float32), np.zeros((S, P, K), np.float32)
    for i in range(n):
        state[0, i, i] = scale[i]
        state[1, i, n + i] = scale[n + i] * step
    for i in range(S):
        inner[i, 2 * n + i] = scale[2 * n + i]
    return state, inner


class _TangentForces:
    """Tangent link forces h^2 df, and the change of acceleration by an unknown mass."""

    def __init__(
        self,
        mechanics: NumericSystem,
        links: Floats,
        memory: Floats,
        accelerations: Floats,
        step: Floats,
        unit: Floats,
    ) -> None:
        system, step2 = mechanics.system, step * step
        first = system.dimension
        slopes = mechanics.partials(links[:, 0], links[:, 1], memory)
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
        self.mechanics, self.unit = mechanics, unit
        self.mass_values = mechanics.masses
        self.points = mechanics.points
        self.by_shape: tuple[Indices, Indices, Single] | None = None
        inner = slopes.memory
        self.owners = system.state_links
        self.by_state = (inner.force * step2).astype(np.float32)
        self.rate_by_d = (inner.by_d * step).astype(np.float32)
        self.rate_by_v = inner.by_v.astype(np.float32)
        self.rate_by_state = [(to, of, (slope * step).astype(np.float32)) for to, of, slope in inner.by_state]
        self.rate_by_parameter = [
            (to, first + column, (slope * (unit[column] * step)).astype(np.float32))
            for to, column, slope in inner.by_parameter
        ]

    def add_candidates(self, candidates: CandidateForces, force: Floats, step: Floats) -> None:
        """Count `force` (..., c, K), of unit amplitude, of candidates that no link exerts yet."""
        for ends, sign in ((candidates.first, -1.0), (candidates.second, 1.0)):
            on_mass = np.flatnonzero(ends >= 0)
            self._push(ends[on_mass], on_mass, np.full(len(on_mass), sign), force, step)
            for number, shape in enumerate(self.points):
                at_point = np.flatnonzero(ends == FIRST_POINT - number)
                for mode in np.flatnonzero(shape) if len(at_point) else ():
                    weights = np.full(len(at_point), sign * shape[mode])
                    self._push(np.full(len(at_point), mode), at_point, weights, force, step)

    def add_shapes(
        self, states: Floats, links: Floats, memory: Floats, applied: Floats | None, step: Floats
    ) -> None:
        """Count shapes that are parameters: they stretch links at the point, and pass its forces on to the mode.

        `states` (..., 2, n, K) are x and u, `applied` (..., k, K) the forces on the points.
        """
        shapes = self.mechanics.system.shapes
        assert shapes is not None
        unit, points, modes = self.unit[shapes.columns], shapes.points, shapes.modes
        force = np.empty_like(links[:, 0])
        self.mechanics.force(links[:, 0], links[:, 1], memory, force, np.empty_like(memory))
        acting = -(shapes.sides @ force)
        if applied is not None:
            acting += applied
        factor = (unit / self.mass_values[modes])[:, None] * step**2
        columns = self.width - len(self.unit) + shapes.columns
        self.candidates.append((modes, columns, (acting[:, points] * factor).astype(np.float32)))
        which, link = np.nonzero(shapes.sides[points])
        weight = (shapes.sides[points[which], link] * unit[which])[:, None]
        x, u = (states[:, kind][:, modes[which]] for kind in (0, 1))
        change = weight * (self.by_d[:, link] * x + self.by_v[:, link] * u)
        self.by_shape = link, columns[which], change.astype(np.float32)

    def _push(self, masses: Indices, which: Indices, weights: Floats, force: Floats, step: Floats) -> None:
        """Count the forces `which` (k,) of `force`, weighted, on masses (k,), none of which occurs twice for a force."""
        factor = (weights / self.mass_values[masses])[:, None] * step**2
        change = (force[:, which] * factor).astype(np.float32)
        self.candidates.append((masses, self.width + which, change))

    def __call__(self, j: int, motion: Single, inner: Single, out: Single, rates: Single) -> None:
        """Tangent forces (L, P, K) to `out` and tangent rates of states, times the step, (S, P, K) to `rates`."""
        np.multiply(self.by_d[j][:, None], motion[0], out=out)
        out += self.by_v[j][:, None] * motion[1]
        out[self.rows, self.columns] += self.by_parameter[j]
        if self.by_shape is not None:
            links, columns, change = self.by_shape
            out[links, columns] += change[j]
        for state, owner in enumerate(self.owners.tolist()):
            out[owner] += self.by_state[j, state] * inner[state]
            np.multiply(self.rate_by_d[j, state], motion[0, owner], out=rates[state])
            rates[state] += self.rate_by_v[j, state] * motion[1, owner]
        for to, of, slope in self.rate_by_state:
            rates[to] += slope[j] * inner[of]
        for to, column, slope in self.rate_by_parameter:
            rates[to, column] += slope[j]

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
