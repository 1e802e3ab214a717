"""What acts on sensitivities along an orbit of displacements and velocities alone, for their transitions over half steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.flow import Inputs, Trajectories
from linkwise.likelihood.shooting.system import NumericSystem
from linkwise.likelihood.shooting.tangents import CandidateForces, Single
from linkwise.model.topology import FIRST_POINT

_MOST = 0.5  # of all pairs of a mass and an unknown


@dataclass(frozen=True, eq=False)
class Accelerations:
    """What unknowns accelerate themselves, at points along an orbit in K segments, by e pairs of a mass and an unknown.

    Attributes
    ----------
    forces : array of shape (I, K, s)
        The forces of s sources, or accelerations where a mass is the unknown, at I points.
    sources : array of int, shape (e,)
        The source of each pair.
    weights : array of shape (K, e)
        Half of h^2 a per unit of the source.
    places : array of int, shape (u,)
        Places of the pairs among (n, P) sensitivities, in order, each once.
    firsts : array of int, shape (u,), or None
        The first pair of each place; None where no two have the same.
    """

    forces: Single
    sources: Indices
    weights: Single
    places: Indices
    firsts: Indices | None

    @classmethod
    def of(
        cls,
        forces: Single,
        pairs: tuple[Indices, Indices],
        sources: Indices,
        weights: Floats,
        shape: tuple[int, int],
    ) -> Accelerations:
        """Those of `pairs` of a mass and an unknown each, among sensitivities of a `shape` (n, P).

        Where the pairs are most of all, the others have a weight of zero: what follows in memory is added in less time.
        """
        places = np.ravel_multi_index(pairs, shape)
        order = np.argsort(places, kind="stable")
        unique, firsts = np.unique(places[order], return_index=True)
        if len(unique) < len(places):  # as of a coefficient that links on both sides of a mass share
            return cls(forces, sources[order], weights[:, order].astype(np.float32), unique, firsts)
        n, P = shape
        if len(places) < _MOST * n * P:
            return cls(forces, sources[order], weights[:, order].astype(np.float32), unique, None)
        every, whole = np.zeros(n * P, dtype=int), np.zeros((len(weights), n * P), np.float32)
        every[places], whole[:, places] = sources, weights
        return cls(forces, every, whole, np.arange(n * P), None)

    def at(self, point: int) -> Single:
        """(K, u) half of h^2 a at a point, negative numbers counting from the last one."""
        out = np.take(self.forces[point], self.sources, axis=1)
        out *= self.weights
        return out if self.firsts is None else np.add.reduceat(out, self.firsts, axis=1)


@dataclass(frozen=True, eq=False)
class ActingForces:
    """Slopes of link forces, and accelerations by unknowns, along the J whole steps of h of an orbit in K segments.

    Attributes
    ----------
    at_ends : array of shape (2, L, (2 J + 1) K)
        Slopes of (h/2)^2 f by d and by h/2 v at the ends of half steps, one after the other.
    between : array of shape (2, L, 2 J K)
        The same in the middles of half steps.
    by_v : array of shape (2, L, K)
        Slopes of h^2 f by h v at the start of the first step and at the end of the last one.
    accelerations : Accelerations
        Those by unknowns at the 2 J + 1 ends of half steps.
    """

    at_ends: Single
    between: Single
    by_v: Single
    accelerations: Accelerations

    @property
    def steps(self) -> int:
        """Number of whole steps."""
        return len(self.accelerations.forces) // 2

    @classmethod
    def along(
        cls,
        mechanics: NumericSystem,
        orbit: Trajectories,
        step: Floats,
        unit: Floats,
        candidates: CandidateForces | None = None,
        *,
        inputs: Inputs,
    ) -> ActingForces:
        """Those of an orbit without states of links.

        Parameters
        ----------
        mechanics : NumericSystem
            The system.
        orbit : Trajectories
            The orbit in half steps.
        step : array of shape (K,)
            Whole steps in s.
        unit : array of shape (p,)
            Units of the parameters.
        candidates : CandidateForces, optional
            Candidate forces at the ends of whole steps and in their middles.
        inputs : Inputs
            What acts along the orbit.
        """
        half = 0.5 * step
        partials = mechanics.partials(orbit.links[:, 0], orbit.links[:, 1], orbit.memory)
        between = mechanics.slopes(orbit.middle_links[:, 0], orbit.middle_links[:, 1], orbit.middle_memory)
        at_ends = _scaled((partials.by_d, partials.by_v), half)
        last = at_ends.shape[2] - len(step)
        by_v = np.stack([at_ends[1, :, : len(step)], at_ends[1, :, last:]])
        masses = np.nonzero(mechanics.system.parameters.mass_map)[0]
        moved = inputs.accelerations(orbit)[0][:, masses] if len(masses) else None
        return cls(
            at_ends,
            _scaled(between, half),
            np.float32(2.0) * by_v,
            _accelerations(mechanics, partials.by_parameter, moved, candidates, unit, half * step),
        )


def _scaled(slopes: tuple[Floats, Floats], step: Floats) -> Single:
    """(2, L, I K) slopes of h^2 f by d and h v at I points, from those (I, L, K) of f by d and v; steps h (K,)."""
    points, L, K = slopes[0].shape
    out = np.empty((2, L, points, K), np.float32)
    for own, values, scale in zip(out, slopes, (step * step, step), strict=True):
        np.multiply(values.transpose(1, 0, 2), scale, out=own, casting="same_kind")
    return out.reshape(2, L, points * K)


def _accelerations(
    mechanics: NumericSystem,
    by_parameter: Floats,
    moved: Floats | None,
    candidates: CandidateForces | None,
    unit: Floats,
    half: Floats,
) -> Accelerations:
    """Those of parameters, by slopes (I, E, K) of forces, of masses, by their accelerations (I, u, K), and of candidates.

    `half` (K,) is h^2 / 2.
    """
    system, first = mechanics.system, mechanics.system.dimension
    E, c = by_parameter.shape[1], 0 if candidates is None else len(candidates.first)
    u = 0 if moved is None else moved.shape[1]
    forces = np.empty((len(by_parameter), len(half), E + c + u), np.float32)
    forces[:, :, :E] = by_parameter.transpose(0, 2, 1)
    links, of_links = (
        np.array([(link, own) for link, own, _ in system.interactions], dtype=int).reshape(-1, 2).T
    )
    pushed, which = np.nonzero(mechanics.gain[:, links])
    weights = mechanics.gain[pushed, links[which]] * unit[of_links[which]]
    pairs = [(pushed, first + of_links[which], which, weights)]
    if candidates is not None:
        forces[::2, :, E : E + c] = candidates.starts.transpose(0, 2, 1)
        forces[1::2, :, E : E + c] = candidates.middles.transpose(0, 2, 1)
        pushed, which, weights = _pushed(mechanics, candidates)
        pairs.append((pushed, first + len(unit) + which, E + which, weights))
    if moved is not None:
        forces[:, :, E + c :] = moved.transpose(0, 2, 1)
        pushed, which = np.nonzero(system.parameters.mass_map)
        weights = -system.parameters.mass_map[pushed, which] * unit[which] / mechanics.masses[pushed]
        pairs.append((pushed, first + which, E + c + np.arange(u), weights))
    masses, columns, sources, weights = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    shape = len(mechanics.masses), first + len(unit) + c
    return Accelerations.of(forces, (masses, columns), sources, half[:, None] * weights, shape)


def _pushed(mechanics: NumericSystem, candidates: CandidateForces) -> tuple[Indices, Indices, Floats]:
    """Masses that candidates accelerate, the numbers of these candidates, and the accelerations by a unit of force."""
    numbers = np.arange(len(candidates.first))
    weights = np.zeros((len(mechanics.masses), len(numbers)))
    for ends, sign in ((candidates.first, -1.0), (candidates.second, 1.0)):
        on_mass = np.flatnonzero(ends >= 0)
        weights[ends[on_mass], on_mass] += sign
        for number, shape in enumerate(mechanics.points):
            weights[:, ends == FIRST_POINT - number] += sign * shape[:, None]
    masses, which = np.nonzero(weights)
    return masses, which, weights[masses, which] / mechanics.masses[masses]
