"""Parts of a structure of many masses that an influence reaches within a segment.

Neighbouring masses form clusters. Their states and the coefficients of their links are columns of sensitivities that differ
from zero only near them: how near follows from the sensitivities of some segments, computed for the whole structure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Bools, Indices
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, F, S, Scales, Segments
from linkwise.likelihood.shooting.system import MANY as MANY
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.shooting.tangents import Transfer, march, tangent_forces, units_of_states

TOLERANCE = 1e-3
"""Of the largest sensitivity to an unknown, all in units of the noise and of the defects: the largest that is left out."""
_CLUSTER = 6  # masses at most
_EVENLY, _STEEPEST = 8, 16  # segments whose sensitivities are computed for the whole structure


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """A group of columns and what they reach.

    Attributes
    ----------
    states : array of int, shape (a,)
        States among the columns: displacements, velocities, states of links.
    border : array of int, shape (q,)
        Columns of the border: parameters, candidate forces, errors, offsets.
    masses, links, memory : array of int
        Masses that they reach, links at these, and states of these links.
    rows : array of int, shape (r,)
        Displacements and velocities of `masses`, and `memory`, by their numbers among the states.
    channels : array of int, shape (C,)
        Sensors that show them.
    moving : int
        Number of columns that act on the motion: states, and the first of the border; errors of sensors do not.
    """

    states: Indices
    border: Indices
    masses: Indices
    links: Indices
    memory: Indices
    rows: Indices
    channels: Indices
    moving: int

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.states) + len(self.border)

    def places_of(self, border: Indices) -> Indices:
        """The places among the group's columns of the border of those that are in `border`, in order."""
        return np.flatnonzero(np.isin(self.border, border))

    def within(self, border: Indices) -> Neighbourhood:
        """The group of these columns of the border alone, which are numbered by their places in `border` then."""
        places, a = self.places_of(border), len(self.states)
        return replace(
            self,
            border=np.searchsorted(border, self.border[places]),
            moving=a + int(np.count_nonzero(places < self.moving - a)),
        )


def clusters(system: System) -> list[Indices]:
    """The masses in groups of neighbours, by halving the structure along the second eigenvector of its graph.

    Parameters
    ----------
    system : System
        The structure.

    Returns
    -------
    list of array of int
        The groups, each of a few masses, in order.

    References
    ----------
    M. Fiedler, Czechoslovak Math. J. 25, 619 (1975).
    """
    adjacent = adjacency(system)

    def halved(masses: Indices) -> list[Indices]:
        if len(masses) <= _CLUSTER:
            return [np.sort(masses)]
        inside = adjacent[np.ix_(masses, masses)].astype(float)
        laplacian = np.diag(inside.sum(axis=1)) - inside
        _, vectors = np.linalg.eigh(laplacian)
        order = masses[np.argsort(vectors[:, 1], kind="stable")]
        half = len(order) // 2
        return halved(order[:half]) + halved(order[half:])

    return halved(np.arange(len(system.incidence)))


def adjacency(system: System) -> Bools:
    """(n, n) whether two masses share a link; every mass is its own neighbour."""
    touches = (system.incidence != 0.0).astype(float)
    return np.asarray(touches @ touches.T > 0.0) | np.eye(len(touches), dtype=bool)


def reach(segments: Segments, misfit: Misfit, scales: Scales) -> Bools:
    """Which masses an influence reaches within a segment.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    misfit : Misfit
        The orbit.
    scales : Scales
        Units of the unknowns.

    Returns
    -------
    array of bool, shape (n, n)
        Whether a mass (column) moves another (row) by more than `TOLERANCE` within some segment, of those where the links
        are steepest and of some others.
    """
    system, n = segments.system, len(segments.system.incidence)
    mechanics, thinned = system.at(misfit.point.theta), segments.flow_steps_per_tangent
    some = _sampled(segments, misfit)
    step = segments.step[some] * thinned
    orbit = misfit.trajectories.part(some).thinned(thinned)
    unit, inputs = scales.theta[: system.parameters.size], segments.inputs.part(some)
    starts, middles = tangent_forces(mechanics, orbit, step, unit, inputs=inputs)
    masses, links, memory = map(np.arange, (n, system.incidence.shape[1], len(system.states)))
    columns = np.arange(len(scales.state))
    transfer = Transfer.of(mechanics.incidence, mechanics.gain)
    largest = np.zeros((len(columns), n))
    for tangent in march(
        transfer,
        starts.within(masses, links, memory, columns),
        middles.within(masses, links, memory, columns),
        *units_of_states(scales.state, step, n, len(columns)),
    ):
        for motion, unit in (
            (tangent.state[0], scales.state[:n, None]),
            (tangent.state[1], scales.state[n : 2 * n, None] * step),
        ):
            np.maximum(largest, np.max(np.abs(motion) / unit[:, None], axis=2).T, out=largest)
    relative = largest / np.maximum(largest.max(axis=1, keepdims=True), np.finfo(float).tiny)
    reached = ~(np.maximum(relative[:n], relative[n : 2 * n]).T < TOLERANCE)
    if np.isin(segments.sensors.kind, (A, F, S)).any():  # they show forces, which act on neighbours at once
        reached = (adjacency(system).astype(float) @ reached) > 0.0
    return np.asarray(reached | np.eye(n, dtype=bool))


def _sampled(segments: Segments, misfit: Misfit) -> Indices:
    """The segments whose sensitivities decide."""
    mechanics, orbit = segments.system.at(misfit.point.theta), misfit.trajectories
    slopes = mechanics.partials(orbit.links[0, 0], orbit.links[0, 1], orbit.memory[0])
    strength = np.abs(mechanics.link_gain.diagonal()[:, None] * slopes.by_d)
    strength /= np.maximum(strength.max(axis=1, keepdims=True), np.finfo(float).tiny)
    steepest = np.argsort(-strength.sum(axis=0), kind="stable")[:_STEEPEST]
    evenly = np.linspace(0, segments.count - 1, _EVENLY).astype(int)
    return np.unique(np.concatenate([steepest, evenly]))


def neighbourhoods(
    segments: Segments,
    reached: Bools,
    groups: Sequence[Indices],
    origins: Sequence[Indices],
    moving: int,
) -> list[Neighbourhood]:
    """The columns in groups, with what each group reaches.

    Parameters
    ----------
    segments : Segments
        The records in segments.
    reached : array of bool, shape (n, n)
        What an influence of each mass (column) reaches.
    groups : sequence of array of int
        The masses in clusters; their states are the columns of the first groups.
    origins : sequence of array of int
        Of each column of the border the masses on which the unknown acts, or whose sensors it changes.
    moving : int
        How many columns of the border act on the motion; they come first.

    Returns
    -------
    list of Neighbourhood
        The groups. Unknowns that act in places far from each other form groups of their own.
    """
    system = segments.system
    cluster = np.empty(len(system.incidence), dtype=int)
    for number, masses in enumerate(groups):
        cluster[masses] = number
    touched = system.incidence != 0.0
    owners = [np.flatnonzero(touched[:, link]) for link in system.state_links]
    of_states = np.array([cluster[masses[0]] for masses in owners], dtype=int)
    columns: dict[tuple[int, ...], list[int]] = {(number,): [] for number in range(len(groups))}
    nearby = [reached[:, masses].any(axis=1) for masses in groups]
    for column, masses in enumerate(origins):
        of = tuple(sorted(set(cluster[masses].tolist())))
        key = next(((number,) for number in of if nearby[number][masses].all()), of)
        columns.setdefault(key, []).append(column)
    by_group = []
    for key, border in columns.items():
        own = groups[key[0]] if len(key) == 1 else np.empty(0, dtype=int)
        inner = np.flatnonzero(of_states == key[0]) if len(key) == 1 else np.empty(0, dtype=int)
        sources = np.unique(np.concatenate([own, *(owners[s] for s in inner), *(origins[c] for c in border)]))
        masses = np.flatnonzero(reached[:, sources.astype(int)].any(axis=1))
        by_group.append(_neighbourhood(segments, (own, inner), np.array(border, dtype=int), masses, moving))
    return by_group


def _neighbourhood(
    segments: Segments, owners: tuple[Indices, Indices], border: Indices, masses: Indices, moving: int
) -> Neighbourhood:
    """The group of the states of some masses, some states of links (`owners`) and of `border`, which reaches `masses`."""
    own, inner = owners
    system, sensors, n = segments.system, segments.sensors, len(segments.system.incidence)
    inside = np.zeros(n, dtype=bool)
    inside[masses] = True
    links = np.flatnonzero((system.incidence[inside] != 0.0).any(axis=0))
    memory = np.flatnonzero(np.isin(system.state_links, links))
    shown = np.where(
        sensors.kind == F,
        np.isin(sensors.mass, links),
        np.where(sensors.kind == S, np.isin(sensors.mass, memory), np.isin(sensors.mass, masses)),
    )
    states = np.concatenate([own, n + own, 2 * n + inner])
    return Neighbourhood(
        states=states,
        border=border,
        masses=masses,
        links=links,
        memory=memory,
        rows=np.concatenate([masses, n + masses, 2 * n + memory]),
        channels=np.flatnonzero(shown),
        moving=len(states) + int(np.sum(border < moving)),
    )
