"""Structures of many masses: the parts that an influence reaches within a segment, and Jacobian and products by parts.

Neighbouring masses form clusters. Their states and the coefficients of their links are columns of sensitivities that differ
from zero only near them: how near follows from the sensitivities of some segments, computed for the whole structure. Rows of
the Jacobian are computed group by group of columns, and products only of groups that meet in a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.residuals import Loss, Misfit, SensorErrors
from linkwise.likelihood.shooting.segments import A, F, S, Scales, Segments, V, X, as_slice
from linkwise.likelihood.shooting.system import MANY as MANY
from linkwise.likelihood.shooting.system import NumericSystem, System
from linkwise.likelihood.shooting.tangents import (
    CandidateForces,
    Single,
    TangentForces,
    Transfer,
    march,
    tangent_forces,
    units_of_states,
)

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

    @property
    def moving_border(self) -> Indices:
        """Columns of the border that act on the motion."""
        return self.border[: self.moving - len(self.states)]


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
    forces = tangent_forces(mechanics, orbit, step, unit, inputs=inputs)
    masses, links, memory = map(np.arange, (n, system.incidence.shape[1], len(system.states)))
    columns = np.arange(len(scales.state))
    transfer = Transfer.of(mechanics.incidence, mechanics.gain)
    largest = np.zeros((len(columns), n))
    for tangent in march(
        transfer,
        forces.within(masses, links, memory, columns),
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


@dataclass(frozen=True, eq=False)
class GroupRows:
    """Of k segments and a group of P columns: whitened `data` (k, C, M, P) of the group's channels, and `ends` (k, r, P'), the
    sensitivities of the group's rows at the segments' ends to the moving columns, both in scaled unknowns.
    """

    data: Single
    ends: Single


@dataclass(frozen=True, eq=False)
class LocalRows:
    """The Jacobian at a point, in `groups` of columns.

    The border's columns are parameters, amplitudes of `candidates`, sizes of `errors`, and offsets; `groups` have as moving
    ones the first two.
    """

    segments: Segments
    misfit: Misfit
    scales: Scales
    loss: Loss
    groups: Sequence[Neighbourhood]
    candidates: CandidateForces | None = None
    errors: SensorErrors | None = None

    @property
    def moving(self) -> int:
        """Columns of the border that act on the motion, which come first."""
        forces = 0 if self.candidates is None else len(self.candidates.first)
        return self.segments.system.parameters.size + forces

    @property
    def fixed(self) -> int:
        """Columns before those of offsets."""
        return self.moving + (0 if self.errors is None else len(self.errors.channel))

    def part(self, part: slice) -> tuple[list[GroupRows], Floats]:
        """The rows of some segments by group, and the whitened residuals (k, C, M)."""
        segments, misfit = self.segments, self.misfit
        root = misfit.roots(segments, self.loss, part)
        whiten = (root / segments.deviations(self.scales, part)).astype(np.float32)
        mechanics = segments.system.at(misfit.point.theta)
        step = segments.step[part] * segments.flow_steps_per_tangent
        orbit = misfit.trajectories.part(part).thinned(segments.flow_steps_per_tangent)
        candidates = None if self.candidates is None else self.candidates.part(part)
        unit = self.scales.theta[: segments.system.parameters.size]
        inputs = segments.inputs.part(part)
        forces = tangent_forces(mechanics, orbit, step, unit, candidates, inputs=inputs)
        rows = [self._of_group(group, mechanics, forces, part, step, whiten) for group in self.groups]
        return rows, (root * misfit.pulling[..., part]).transpose(2, 1, 0)

    def _of_group(
        self,
        group: Neighbourhood,
        mechanics: NumericSystem,
        forces: TangentForces,
        part: slice,
        step: Floats,
        whiten: Single,
    ) -> GroupRows:
        segments, m = self.segments, len(self.scales.state)
        width = group.moving
        columns = np.concatenate([group.states, m + group.border])[:width]
        M = len(segments.samples)
        data: NDArray[Any] = np.zeros((len(step), len(group.channels), M, group.size), np.float32)
        ends: NDArray[Any] = np.zeros((len(step), len(group.rows), width), np.float32)
        if width:
            own = forces.within(group.masses, group.links, group.memory, columns)
            inside = np.ix_(group.masses, group.links)
            transfer = Transfer.of(mechanics.incidence[inside], mechanics.gain[inside])
            steps = march(transfer, own, *self._units(group, step, width))
            shown = self._shown_by(group, step)
            for number, tangent in enumerate(steps):
                sample, between = divmod(number, segments.tangent_refine)
                if tangent.acceleration is None or between:
                    continue
                motions = tangent.shown()
                for kind, places, channels, rate in shown:
                    factor = (whiten[sample, group.channels[channels]] * rate).astype(np.float32)
                    data[:, channels, sample, :width] = (motions[kind][places] * factor[:, None]).transpose(
                        2, 0, 1
                    )
            r, rate = len(group.masses), (1.0 / step).astype(np.float32)
            ends[:, :r] = tangent.state[0].transpose(2, 0, 1)
            ends[:, r : 2 * r] = (tangent.state[1] * rate).transpose(2, 0, 1)
            ends[:, 2 * r :] = tangent.memory.transpose(2, 0, 1)
            ends /= self.scales.state[group.rows, None].astype(np.float32)
        self._add_errors(data, group, part, whiten)
        return GroupRows(data, ends)

    def _shown_by(
        self, group: Neighbourhood, step: Floats
    ) -> list[tuple[int, Indices | slice, Indices | slice, Floats]]:
        """By kind of sensor, the places that those of a group show, their places among its channels, and the factor (k,)."""
        sensors = self.segments.sensors
        kinds, numbers = sensors.kind[group.channels], sensors.mass[group.channels]
        rates = {X: np.ones_like(step), V: 1.0 / step, A: step**-2.0, F: step**-2.0, S: np.ones_like(step)}
        among = {F: group.links, S: group.memory}
        return [
            (
                kind,
                as_slice(np.searchsorted(among.get(kind, group.masses), numbers[own])),
                as_slice(own),
                rate,
            )
            for kind, rate in rates.items()
            if len(own := np.flatnonzero(kinds == kind))
        ]

    def _units(self, group: Neighbourhood, step: Floats, width: int) -> tuple[Single, Single]:
        """Sensitivities of a group at the nodes: of each of its states to itself, in its unit."""
        n, scale = len(self.segments.system.incidence), self.scales.state
        state = np.zeros((2, len(group.masses), width, len(step)), np.float32)
        inner = np.zeros((len(group.memory), width, len(step)), np.float32)
        for column, number in enumerate(group.states.tolist()):
            kind, place = divmod(number, n)
            if kind < 2:
                unit = scale[number] if kind == 0 else scale[number] * step
                state[kind, np.searchsorted(group.masses, place), column] = unit
            else:
                inner[np.searchsorted(group.memory, number - 2 * n), column] = scale[number]
        return state, inner

    def _add_errors(self, data: NDArray[Any], group: Neighbourhood, part: slice, whiten: Single) -> None:
        """The columns of errors and offsets of sensors, which act on one channel each or, offsets, on several."""
        first = len(group.states)
        for place, number in enumerate(group.border.tolist()):
            if self.errors is not None and self.moving <= number < self.fixed:
                channel = int(self.errors.channel[number - self.moving])
                values = self.errors.values[:, number - self.moving, part]
                own = int(np.searchsorted(group.channels, channel))
                data[:, own, :, first + place] = (whiten[:, channel] * values).T
            elif number >= self.fixed:
                offset = number - self.fixed
                unit = self.scales.theta[self.segments.system.parameters.size + offset]
                for channel in np.flatnonzero(self.segments.sensors.offset == offset).tolist():
                    own = int(np.searchsorted(group.channels, channel))
                    data[:, own, :, first + place] = whiten[:, channel].T * unit
