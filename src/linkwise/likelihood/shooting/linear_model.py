"""The linearised problem at a point: of the whole record, in pieces of it, or by parts of a structure of many masses.

`eliminated_rows` has the rows of the samples with the states eliminated: sums over them are what samples say of the unknowns.

Long records, and structures of very many masses, are tested in pieces (`tested_in_pieces`): a piece is a run of segments,
which are linearised when the elimination of nodes has come to them. The columns of what is tested never all stand at once.

Where masses are many, the parts are those that an influence reaches within a segment. Neighbouring masses form clusters. Their
states and the coefficients of their links are columns of sensitivities that differ from zero only near them: how near follows
from the sensitivities of some segments, computed for the whole structure. Rows of the Jacobian are computed group by group of
columns, and products only of groups that meet in a row (`local_linearization`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Bools, Floats, Indices
from linkwise.likelihood.shooting.bordered_system import BorderedFactor, BorderedSystem, Nodes
from linkwise.likelihood.shooting.normal_equations import (
    Linearization,
    Sums,
    add_prior,
    chunks,
    empty_model,
    filled,
    followed_states,
    linearise,
    summed,
)
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.segments import A, F, S, Segments, SensorErrors, V, X, as_slice
from linkwise.likelihood.shooting.system import MANY, System
from linkwise.likelihood.shooting.tangents import (
    CandidateForces,
    Single,
    TangentForces,
    extra_columns,
    march,
    whitened_jacobian,
)
from linkwise.runtime import processors

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


def reach(misfit: Misfit) -> Bools:
    """Which masses an influence reaches within a segment.

    Parameters
    ----------
    misfit : Misfit
        That along the orbit.

    Returns
    -------
    array of bool, shape (n, n)
        Whether a mass (column) moves another (row) by more than `TOLERANCE` within some segment, of those where the links
        are steepest and of some others.
    """
    segments, scales = misfit.segments, misfit.scales
    system, n = segments.system, len(segments.system.incidence)
    orbit, step, inputs = misfit.along_tangents(_sampled(misfit))
    unit, columns = scales.theta[: system.parameters.size], np.arange(len(scales.state))
    forces = TangentForces(misfit.mechanics, orbit, step, unit, inputs=inputs)
    largest = np.zeros((len(columns), n))
    for tangent in march(forces.within(forces.masses, forces.links, forces.states, columns), scales.state):
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


def _sampled(misfit: Misfit) -> Indices:
    """The segments whose sensitivities decide."""
    segments = misfit.segments
    mechanics, orbit = misfit.mechanics, misfit.trajectories
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


GroupRows: TypeAlias = tuple[Single, Single]
"""Of k segments and a group of P columns: whitened data (k, C, M, P) of the group's channels, and ends (k, r, P'), the
sensitivities of the group's rows at the segments' ends to the moving columns, both in scaled unknowns.
"""


@dataclass(frozen=True, eq=False)
class LocalRows:
    """The Jacobian at a point, in `groups` of columns.

    The border's columns are parameters, amplitudes of `candidates`, sizes of `errors`, and offsets; `groups` have as moving
    ones the first two.
    """

    misfit: Misfit
    groups: Sequence[Neighbourhood]
    candidates: CandidateForces | None = None
    errors: SensorErrors | None = None

    @property
    def moving(self) -> int:
        """Columns of the border that act on the motion, which come first."""
        return self.misfit.segments.system.parameters.size + extra_columns(self.candidates, None)[0]

    @property
    def fixed(self) -> int:
        """Columns before those of offsets."""
        return self.moving + extra_columns(None, self.errors)[1]

    def part(self, part: slice) -> tuple[list[GroupRows], Floats]:
        """The rows of some segments by group, and the whitened residuals (k, C, M)."""
        misfit, segments = self.misfit, self.misfit.segments
        root, whiten = misfit.weights(part)
        orbit, step, inputs = misfit.along_tangents(part)
        candidates = None if self.candidates is None else self.candidates.part(part)
        unit = misfit.scales.theta[: segments.system.parameters.size]
        forces = TangentForces(misfit.mechanics, orbit, step, unit, candidates, inputs=inputs)
        rows = [self._of_group(group, forces, part, whiten) for group in self.groups]
        return rows, (root * misfit.pulling[..., part]).transpose(2, 1, 0)

    def _of_group(
        self, group: Neighbourhood, forces: TangentForces, part: slice, whiten: Single
    ) -> GroupRows:
        segments, scale, step = self.misfit.segments, self.misfit.scales.state, forces.step
        width = group.moving
        columns = np.concatenate([group.states, len(scale) + group.border])[:width]
        M = len(segments.samples)
        data: NDArray[Any] = np.zeros((len(step), len(group.channels), M, group.size), np.float32)
        ends: NDArray[Any] = np.zeros((len(step), len(group.rows), width), np.float32)
        if width:
            own = forces.within(group.masses, group.links, group.memory, columns)
            shown = self._shown_by(group, step)
            for number, tangent in enumerate(march(own, scale)):
                sample, between = divmod(number, segments.tangent_refine)
                if tangent.acceleration is None or between:
                    continue
                motions = tangent.shown()
                for kind, places, channels, rate in shown:
                    factor = (whiten[sample, group.channels[channels]] * rate).astype(np.float32)
                    data[:, channels, sample, :width] = (motions[kind][places] * factor[:, None]).transpose(
                        2, 0, 1
                    )
            ends[:] = tangent.ends((1.0 / step).astype(np.float32)).transpose(2, 0, 1)
            ends /= scale[group.rows, None].astype(np.float32)
        self._add_errors(data, group, part, whiten)
        return data, ends

    def _shown_by(
        self, group: Neighbourhood, step: Floats
    ) -> list[tuple[int, Indices | slice, Indices | slice, Floats]]:
        """By kind of sensor, the places that those of a group show, their places among its channels, and the factor (k,)."""
        sensors = self.misfit.segments.sensors
        kinds, numbers = sensors.kind[group.channels], sensors.mass[group.channels]
        rates = {X: np.ones_like(step), V: 1.0 / step, A: step**-2.0, F: step**-2.0, S: np.ones_like(step)}
        among = {F: group.links, S: group.memory}
        shown = []
        for kind, rate in rates.items():
            own = np.flatnonzero(kinds == kind)
            places = np.searchsorted(among.get(kind, group.masses), numbers[own])
            if len(own):
                shown.append((kind, as_slice(places), as_slice(own), rate))
        return shown

    def _add_errors(self, data: NDArray[Any], group: Neighbourhood, part: slice, whiten: Single) -> None:
        """The columns of errors that are tested, and of those among the unknowns."""
        tested, among = self.errors or SensorErrors(), self.misfit.segments.errors
        channels, values = np.append(tested.channel, among.channel), [*tested.values, *among.values]
        p = len(self.misfit.point.theta)
        units = np.append(np.ones(len(tested.values)), self.misfit.scales.theta[p:])
        for column, number in enumerate((group.border - self.moving).tolist(), start=len(group.states)):
            if number >= 0:
                added = units[number] * values[number][:, part]
                own = int(np.searchsorted(group.channels, channels[number]))
                data[:, own, :, column] = (whiten[:, channels[number]] * added).T


_AT_ONCE = 400_000  # numbers in the sensitivities of a group in a chunk
_HELD = 8_000_000  # numbers in the rows of all groups in a chunk


def local_linearization(rows: LocalRows, executor: Executor | None = None, blocks: int = 1) -> Linearization:
    """Gauss-Newton model at a point, chunk by chunk of segments, in single precision.

    Parameters
    ----------
    rows : LocalRows
        The Jacobian.
    executor : Executor, optional
        Threads.
    blocks : int, optional
        Consecutive blocks of segments by which the corner is summed.

    Returns
    -------
    Linearization
        The model.
    """
    segments, groups = rows.misfit.segments, rows.groups
    pairs, p = _pairs(groups), sum(len(group.border) for group in groups)
    model = empty_model(rows.misfit, p, blocks, np.float32)
    estimated = np.ones(p, dtype=bool)
    if rows.errors is not None:  # what is tested beside these is asked for in no blocks
        estimated[segments.system.parameters.size : rows.fixed] = False

    def work(part: slice, pieces: list[slice]) -> list[Sums]:
        by_group, residuals = rows.part(part)
        ends, sums = [], list[Sums]()
        for group, (own_data, own_ends) in zip(groups, by_group, strict=True):
            a = len(group.states)
            moved = own_ends * model.joined[part][:, group.rows, None].astype(np.float32)
            model.state_ends[part, group.rows[:, None], group.states] = moved[..., :a]
            model.right_ends[part, group.rows[:, None], group.moving_border] = moved[..., a:]
            ends.append(moved.astype(float))
            by_data = _gradient(own_data, residuals[:, group.channels].astype(np.float32))
            by_ends = _gradient(ends[-1], model.right_ends[part, :, p][:, group.rows])
            model.right[part, group.states, p] = by_data[:, :a]
            for corners, columns, own_sums in (
                (model.of_data, group.border, by_data),
                (model.of_defects, group.moving_border, by_ends),
            ):
                slopes = [own_sums[piece, a:].sum(axis=0, dtype=float) for piece in pieces]
                sums.append((corners.gradients, (slice(None), columns), np.stack(slopes)))
        for numbers, channels, rows_at_ends in pairs:
            shown = _common_rows([by_group[number][0] for number in numbers], channels)
            moving = _common_rows([ends[number] for number in numbers], rows_at_ends)
            first, second = (groups[number] for number in numbers)
            _put(model, part, (first, second), shown)
            states = len(first.states), len(second.states)
            for corners, both in ((model.of_data, shown), (model.of_defects, moving)):
                (a, b), (own_rows, other_rows) = states, both
                corner = np.stack([summed(own_rows[at, :, a:], other_rows[at, :, b:]) for at in pieces])
                own_columns, others = first.border[: corner.shape[1]], second.border[: corner.shape[2]]
                by_blocks = _by_blocks(corner, estimated[own_columns], estimated[others])
                for at, own_places, other_places, added in by_blocks:
                    places = (at, own_columns[own_places, None], others[other_places])
                    sums.append((corners.matrices, places, added))
                    if first is not second:
                        places = (at, others[other_places, None], own_columns[own_places])
                        sums.append((corners.matrices, places, added.transpose(0, 2, 1)))
        return sums

    parts = _chunks(groups, segments.count, len(segments.samples))
    return filled(model, parts, work, executor, rows.misfit)


def _by_blocks(
    corner: Floats, first: Bools, second: Bools
) -> Iterator[tuple[slice, Indices, Indices, Floats]]:
    """The blocks to which a corner (b, q, q') adds, the places of its rows and columns, and what: to the first block of a part
    all that is not estimated, `first` (q,) and `second` (q',), on both sides.
    """
    elsewhere = np.where(np.outer(first, second), 0.0, corner[1:].sum(axis=0))
    yield slice(0, 1), np.arange(len(first)), np.arange(len(second)), corner[:1] + elsewhere
    rows, columns = np.flatnonzero(first), np.flatnonzero(second)
    yield slice(1, None), rows, columns, corner[1:, rows[:, None], columns]


def _put(
    model: Linearization,
    part: slice,
    groups: tuple[Neighbourhood, Neighbourhood],
    rows: tuple[NDArray[Any], NDArray[Any]],
) -> None:
    """Put the products of common `rows` (k, r, P) and (k, r, P') of two groups into a model."""
    (first, second), (own, others) = groups, rows
    a, b = len(first.states), len(second.states)
    states = own[:, :, :a].transpose(0, 2, 1) @ others
    model.state[part, first.states[:, None], second.states] = states[..., :b]
    model.right[part, first.states[:, None], second.border] = states[..., b:]
    if first is not second:
        model.state[part, second.states[:, None], first.states] = states[..., :b].transpose(0, 2, 1)
        border = others[:, :, :b].transpose(0, 2, 1) @ own[:, :, a:]
        model.right[part, second.states[:, None], first.border] = border


def _pairs(
    groups: Sequence[Neighbourhood],
) -> list[tuple[tuple[int, int], tuple[Indices, Indices], tuple[Indices, Indices]]]:
    """The numbers of each two groups whose columns meet in some rows, and the places of their common channels and of their
    common rows at the segments' ends in each of them.
    """
    pairs = []
    for first, second in combinations_with_replacement(range(len(groups)), 2):
        own, other = groups[first], groups[second]
        _, *channels = np.intersect1d(own.channels, other.channels, return_indices=True)
        _, *rows = np.intersect1d(own.rows, other.rows, return_indices=True)
        if len(channels[0]) or len(rows[0]):
            pairs.append(((first, second), (channels[0], channels[1]), (rows[0], rows[1])))
    return pairs


def _chunks(groups: Sequence[Neighbourhood], K: int, samples: int) -> list[slice]:
    """The segments in an even number of parts of about equal length, for two threads.

    The sensitivities of the largest group stay in a core's cache, and the rows of all groups, of so many `samples` of a
    segment, do not take more memory where there are more masses.
    """
    largest = max(2 * len(group.masses) * group.size for group in groups)
    numbers = sum((samples * len(group.channels) + len(group.rows)) * group.size for group in groups)
    pairs = max(1, -(-K * largest // (2 * _AT_ONCE)), -(-K * numbers // (2 * _HELD)))
    size = max(16, -(-K // (2 * pairs * 16)) * 16)
    return [slice(first, min(first + size, K)) for first in range(0, K, size)]


def _gradient(rows: NDArray[Any], missed: NDArray[Any]) -> NDArray[Any]:
    """(k, P) products of rows (k, ..., P) with what they leave (k, ...)."""
    k, size = len(rows), rows.shape[-1]
    return np.asarray((missed.reshape(k, 1, -1) @ rows.reshape(k, -1, size))[:, 0])


def _common_rows(
    rows: Sequence[NDArray[Any]], common: tuple[Indices, Indices]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Rows (k, r, P) and (k, r, P') of two groups: those (k, r, ..., P) that they have in `common`."""
    first, second = (
        block[:, own] if isinstance(own := as_slice(which), slice) else np.take(block, own, axis=1)
        for block, which in zip(rows, common, strict=True)
    )
    k, r = len(first), int(np.prod(first.shape[1:-1]))
    return first.reshape(k, r, first.shape[-1]), second.reshape(k, r, second.shape[-1])


_WORTHWHILE = 0.9  # of the sensitivities of the whole: what groups may have of them


def linear_model(
    misfit: Misfit,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
    blocks: int = 1,
) -> Linearization:
    """Gauss-Newton model at a point, in as many threads as there are processors; by groups of columns where there are any.

    Parameters
    ----------
    misfit, candidates, errors, blocks
        As of `linearise`.

    Returns
    -------
    Linearization
        The model.
    """
    groups = groups_at(misfit, candidates, errors)
    with ThreadPoolExecutor(processors()) as threads:
        if groups:
            return local_linearization(LocalRows(misfit, groups, candidates, errors), threads, blocks)
        return linearise(misfit, threads, candidates, errors, blocks)


def groups_at(
    misfit: Misfit, candidates: CandidateForces | None = None, errors: SensorErrors | None = None
) -> list[Neighbourhood]:
    """The groups of columns by which to linearise at a point: none where influences reach most of the structure.

    Parameters
    ----------
    misfit, candidates, errors
        As of `linearise`.

    Returns
    -------
    list of Neighbourhood
        The groups; where coefficients change little, what they reach does not.
    """
    segments = misfit.segments
    if not _separable(segments):
        return []
    reached = reach(misfit)
    origins = column_origins(segments, candidates, errors)
    moving = segments.system.parameters.size + extra_columns(candidates, None)[0]
    groups = neighbourhoods(segments, reached, clusters(segments.system), origins, moving)
    m, n = segments.system.dimension, len(segments.system.incidence)
    handled = sum(len(group.masses) * group.size for group in groups)
    return groups if handled < _WORTHWHILE * n * (m + len(origins)) else []


def _separable(segments: Segments) -> bool:
    """Whether there are many masses, and nothing that acts on all of them at once."""
    sensors = segments.sensors
    hosts = len(segments.system.points) > 0 or sensors.shapes is not None
    return (
        len(segments.system.incidence) >= MANY
        and segments.random is None
        and not hosts
        and not sensors.gains
        and not sensors.delays
    )


def column_origins(
    segments: Segments, candidates: CandidateForces | None, errors: SensorErrors | None
) -> list[Indices]:
    """Of each column of the border the masses on which the unknown acts, or whose sensors it changes.

    Parameters
    ----------
    segments, candidates, errors
        As of `linear_model`.

    Returns
    -------
    list of array of int
        The masses.
    """
    system, sensors = segments.system, segments.sensors
    touched = [np.flatnonzero(column) for column in system.incidence.T]
    masses: list[set[int]] = [set() for _ in range(system.parameters.size)]
    for link, column, _ in system.interactions:
        masses[column] |= set(touched[link].tolist())
    for mass, column in np.argwhere(system.parameters.mass_map).tolist():
        masses[column].add(mass)

    def of_channel(channel: int) -> set[int]:
        place = int(sensors.mass[channel])
        if sensors.kind[channel] not in (F, S):
            return {place}
        return set(touched[int(system.state_links[place]) if sensors.kind[channel] == S else place].tolist())

    if candidates is not None:
        ends = zip(candidates.first.tolist(), candidates.second.tolist(), strict=True)
        masses += [{end for end in pair if end >= 0} for pair in ends]
    for own in (errors, segments.errors):
        masses += [] if own is None else map(of_channel, own.channel.tolist())
    return [np.array(sorted(own_masses), dtype=int) for own_masses in masses]


def eliminated_rows(
    misfit: Misfit,
    q: float,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
) -> Floats | None:
    """(K, M C, p) whitened rows of the samples in scaled unknowns (theta, amplitudes of candidates, sizes of errors, offsets,
    gains), which the states follow; None where the equations are singular.
    """
    factor = linearise(misfit, candidates=candidates, errors=errors).equations(q).factor()
    if factor is None:
        return None
    follow, own = followed_states(factor), list[Floats]()
    _, m, p = follow.shape
    for part in chunks(misfit.segments, p):
        rows, _ = whitened_jacobian(misfit, part, candidates, errors)
        own.append(rows[..., m:-1] - rows[..., :m] @ follow[part])
    return np.concatenate(own)


# segments in a piece: in shorter ones threads wait for each other, longer ones leave the caches
_PIECE = 4000
# numbers in the border of a piece of many masses: 0.1 GB in single precision, beside which each is marched at once
_NUMBERS = 25_000_000


class _Pieces:
    """The equations with what is tested in the border, linearised piece by piece as their nodes are asked for, in order.

    A piece is `size` segments and the node behind them. What the last segment leaves there joins the next piece, and the
    border of all is summed in `corner` and `gradient`.
    """

    def __init__(
        self,
        misfit: Misfit,
        q: float,
        candidates: CandidateForces,
        errors: SensorErrors | None,
        executor: Executor,
    ) -> None:
        segments, (forces, sizes) = misfit.segments, extra_columns(candidates, errors)
        p = segments.parameters + forces + sizes
        self.misfit, self.q, self.candidates, self.errors = misfit, q, candidates, errors
        self.executor, self.groups = executor, groups_at(misfit, candidates, errors)
        self.shape = segments.count, segments.system.dimension, p + 1
        self.size = min(_PIECE, max(1, _NUMBERS // (2 * self.shape[1] * (p + 1))))
        self.corner, self.gradient = np.zeros((p, p)), np.zeros(p)
        self.first, self.linear, self.own = 0, *self._linearised(0)
        add_prior(self.corner, self.gradient, misfit)

    def put(self, some: slice, room: Nodes) -> None:
        """As of `BorderedSystem`."""
        before = None
        if some.start == self.first + self.size:
            before, self.first = self.linear, some.start
            self.linear, self.own = self._linearised(some.start)
        self.own.put(slice(some.start - self.first, some.stop - self.first), room)
        if before is not None:
            joined = before.joined[-1] / self.q**2
            room[0][0, range(len(joined)), range(len(joined))] += joined * before.joined[-1]
            room[2][0] -= joined[:, None] * before.right_ends[-1]

    def _linearised(self, first: int) -> tuple[Linearization, BorderedSystem]:
        """The piece that begins with a node, and its equations, whose border joins that of all."""
        part = slice(first, min(first + self.size + 1, self.shape[0]))
        segments = replace(self.misfit.segments.chosen(np.arange(part.start, part.stop)), prior=None)
        if (
            part.stop < self.shape[0] or part.stop - part.start > self.size
        ):  # the samples there belong to the next
            observed = segments.observed.copy()
            observed[..., -1] = False
            segments = replace(segments, observed=observed)
        misfit, candidates = self.misfit.part(part, segments), self.candidates.part(part)
        errors = self.errors and replace(self.errors, values=[one[:, part] for one in self.errors.values])
        if self.groups:
            linear = local_linearization(LocalRows(misfit, self.groups, candidates, errors), self.executor)
        else:
            linear = linearise(misfit, self.executor, candidates, errors)
        equations = linear.equations(self.q)
        self.corner += equations.corner
        self.gradient += equations.corner_gradient
        return linear, equations


def tested_in_pieces(
    misfit: Misfit,
    q: float,
    candidates: CandidateForces,
    errors: SensorErrors | None,
    kept: Indices,
) -> BorderedFactor | None:
    """The factor of the equations with what is tested in the border.

    Parameters
    ----------
    misfit, candidates, errors
        As of `linearise`.
    q : float
        Relaxation.
    kept : array of int
        As of `BorderedSystem.factor`.

    Returns
    -------
    BorderedFactor or None
        The factor; None where the equations are not positive definite.
    """
    with ThreadPoolExecutor(processors()) as executor:
        pieces = _Pieces(misfit, q, candidates, errors, executor)
        equations = BorderedSystem(
            pieces.shape, pieces.put, pieces.corner, pieces.gradient, piece=pieces.size
        )
        return equations.factor(kept=kept)
