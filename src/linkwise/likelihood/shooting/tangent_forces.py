"""Tangent link forces along an orbit: what sensitivities of the motion do to the forces, and unknown coefficients add."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.model.topology import FIRST_POINT

Single = NDArray[np.float32]


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
    starts: Floats | Single
    middles: Floats | Single

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
            np.concatenate([self.starts, others.starts], axis=1, dtype=np.float32),
            np.concatenate([self.middles, others.middles], axis=1, dtype=np.float32),
        )


class TangentForces:
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
        self._by_rate: Single = np.empty((0, 0, 0), np.float32)  # room for a part of the forces
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

    @property
    def steps(self) -> int:
        """Number of points along the orbit at which there are forces."""
        return len(self.by_d)

    def within(self, masses: Indices, links: Indices, states: Indices, columns: Indices) -> TangentForces:
        """Those of some `columns` in a part of the structure, the rest of which stays where it is.

        Shapes of hosts must not be among the parameters.
        """
        own = copy(self)
        at_mass, at_link, at_state, at_column = (
            _places(which, size)
            for which, size in (
                (masses, len(self.mass_values)),
                (links, self.by_d.shape[1]),
                (states, len(self.owners)),
                (columns, self.width + sum(len(candidate[1]) for candidate in self.candidates)),
            )
        )
        own.by_d, own.by_v = self.by_d[:, links], self.by_v[:, links]
        retained = (at_link[self.rows] >= 0) & (at_column[self.columns] >= 0)
        own.rows, own.columns = at_link[self.rows[retained]], at_column[self.columns[retained]]
        own.by_parameter = self.by_parameter[:, retained]
        own.masses = [
            (int(at_mass[i]), int(at_column[column]), change)
            for i, column, change in self.masses
            if at_mass[i] >= 0 and at_column[column] >= 0
        ]
        own.candidates = []
        for ends, numbers, change in self.candidates:
            some = np.flatnonzero((at_mass[ends] >= 0) & (at_column[numbers] >= 0))
            if len(some):
                own.candidates.append((at_mass[ends[some]], at_column[numbers[some]], change[:, some]))
        own.owners, own.by_state = at_link[self.owners[states]], self.by_state[:, states]
        own.rate_by_d, own.rate_by_v = self.rate_by_d[:, states], self.rate_by_v[:, states]
        own.rate_by_state = [
            (int(at_state[to]), int(at_state[of]), slope)
            for to, of, slope in self.rate_by_state
            if at_state[to] >= 0 and at_state[of] >= 0
        ]
        own.rate_by_parameter = [
            (int(at_state[to]), int(at_column[column]), slope)
            for to, column, slope in self.rate_by_parameter
            if at_state[to] >= 0 and at_column[column] >= 0
        ]
        return own

    def without(self, links: Indices, gain: Floats) -> TangentForces:
        """Those of the other links. What coefficients of `links` add is put on the masses, by the gain (n, L)."""
        own = copy(self)
        others = np.setdiff1d(np.arange(self.by_d.shape[1]), links)
        at_link = _places(others, self.by_d.shape[1])
        retained = at_link[self.rows] >= 0
        own.by_d, own.by_v = self.by_d[:, others], self.by_v[:, others]
        own.rows, own.columns = at_link[self.rows[retained]], self.columns[retained]
        own.by_parameter = self.by_parameter[:, retained]
        own.owners = at_link[self.owners]
        if self.by_shape is not None:
            own.by_shape = at_link[self.by_shape[0]], *self.by_shape[1:]
        apart = np.flatnonzero(~retained)
        masses, which = np.nonzero(gain[:, self.rows[apart]])
        places, at_place = np.unique([masses, self.columns[apart[which]]], axis=1, return_inverse=True)
        weights = csr_array(
            (gain[masses, self.rows[apart[which]]].astype(np.float32), (at_place.ravel(), which)),
            shape=(places.shape[1], len(apart)),
        )
        J, _, K = self.by_parameter.shape
        change = weights @ self.by_parameter[:, apart].swapaxes(0, 1).reshape(len(apart), J * K)
        added = np.ascontiguousarray(change.reshape(-1, J, K).swapaxes(0, 1))
        own.candidates = [*self.candidates, (places[0], places[1], added)]
        return own

    def add_candidates(self, candidates: CandidateForces, force: Floats | Single, step: Floats) -> None:
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
        for state, owner in enumerate(self.owners.tolist()):
            for pair in np.flatnonzero(link == owner):
                slope = self.rate_by_d[:, state] * x[:, pair] + self.rate_by_v[:, state] * u[:, pair]
                change = (slope * weight[pair]).astype(np.float32)
                self.rate_by_parameter.append((state, columns[which[pair]], change))

    def _push(
        self, masses: Indices, which: Indices, weights: Floats, force: Floats | Single, step: Floats
    ) -> None:
        """Count the forces `which` (k,) of `force`, weighted, on masses (k,), none of which occurs twice for a force."""
        factor = ((weights / self.mass_values[masses])[:, None] * step**2).astype(np.float32)
        change = (force[:, which] * factor).astype(np.float32, copy=False)
        self.candidates.append((masses, self.width + which, change))

    def __call__(self, j: int, motion: Single, inner: Single, out: Single, rates: Single) -> None:
        """Tangent forces (L, P, K) to `out` and tangent rates of states, times the step, (S, P, K) to `rates`."""
        np.multiply(self.by_d[j][:, None], motion[0], out=out)
        if self._by_rate.shape != out.shape:
            self._by_rate = np.empty_like(out)
        out += np.multiply(self.by_v[j][:, None], motion[1], out=self._by_rate)
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

    def inertia(self, j: int, out: Single) -> None:
        """Add h^2 da of unknown masses and of candidates to masses (n, P, K)."""
        for ends, columns, change in self.candidates:
            out[ends, columns] += change[j]
        for i, column, change in self.masses:
            out[i, column] += change[j]


def _places(which: Indices, size: int) -> Indices:
    """(size,) place of each number in `which`, -1 for those that are not in it."""
    places = np.full(size, -1)
    places[which] = np.arange(len(which))
    return places
