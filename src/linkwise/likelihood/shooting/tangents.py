"""Sensitivities of the flow, and of what sensors show, by a scheme cheaper than its own.

They only set search directions and standard errors: order 4, in single precision, along the states of the flow.
`TangentForces` are what sensitivities of the motion do to the forces of links and what unknown coefficients, masses, shapes
of hosts and candidate forces add; `march` carries them from the nodes on.

`whitened_jacobian` has the rows of some segments: sensitivities to the states of their nodes, to parameters and candidate
forces, and to errors of sensors and inputs, which touch the rows of one channel each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas
from scipy.sparse import csr_array

from linkwise.arrays import Floats, Indices
from linkwise.likelihood.shooting.flow import (
    TANGENT_CLOSING,
    TANGENT_END,
    TANGENT_MIDDLE,
    Inputs,
    Trajectories,
    input_along,
)
from linkwise.likelihood.shooting.residuals import Misfit, estimated_errors
from linkwise.likelihood.shooting.segments import A, Iterate, Segments, SensorErrors, Sensors, V
from linkwise.likelihood.shooting.system import NumericSystem, ShapeParameters
from linkwise.model.structure import FIRST_POINT

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CandidateForces:
    """c forces of unknown size between masses, which the laws lack: sensitivities to their sizes are those of a score test.

    Attributes
    ----------
    first, second : array of int, shape (c,)
        The masses on which the force acts, negative on the first; -1 and -2 for none, points of hosts from -3 down, and below
        these moving coordinates, whose acceleration in m/s^2 acts on all masses.
    along : sequence of c arrays of shape (2 J + 1, K)
        Forces of unit size in N at the ends of J steps and in their middles, in turn.
    """

    first: Indices
    second: Indices
    along: Sequence[Floats | Single]

    def part(self, segments: slice) -> CandidateForces:
        """The forces in some segments."""
        return CandidateForces(self.first, self.second, [one[:, segments] for one in self.along])

    def joined(self, others: CandidateForces) -> CandidateForces:
        """These forces and, after them, `others`."""
        return CandidateForces(
            np.append(self.first, others.first),
            np.append(self.second, others.second),
            [*self.along, *others.along],
        )


Added: TypeAlias = tuple[Indices, Indices, Single]
"""Rows and columns of sensitivities, no pair of which occurs twice, and what is added there along steps (2 J + 1, k, K)."""


class TangentForces:
    """Tangent link forces h^2 df, and the change of acceleration by an unknown mass, at ends and middles of steps in turn.

    They are those of the `masses`, `links` and `states` of links in a part of the structure, by some `columns`: states, the
    parameters and candidate forces.
    """

    def __init__(
        self,
        mechanics: NumericSystem,
        orbit: Trajectories,
        step: Floats,
        unit: Floats,
        candidates: CandidateForces | None = None,
        *,
        inputs: Inputs,
    ) -> None:
        system, step2, first = mechanics.system, step * step, mechanics.system.dimension
        links, memory = orbit.half_links, orbit.half_memory
        slopes = mechanics.partials(links[:, 0], links[:, 1], memory)
        self.mechanics, self.step = mechanics, step
        width = first + len(unit) + (0 if candidates is None else len(candidates.first))
        sizes = (*mechanics.gain.shape, len(system.states), width)
        self.masses, self.links, self.states, self.columns = map(np.arange, sizes)
        self.into_links, self.gain = _matrix(mechanics.incidence.T), _matrix(mechanics.gain)
        self.by_d = (slopes.by_d * step2).astype(np.float32)
        self.by_v = (slopes.by_v * step).astype(np.float32)
        rows, columns = np.array([pair[:2] for pair in system.interactions], dtype=int).reshape(-1, 2).T
        by_parameter = (slopes.by_parameter * (unit[columns, None] * step2)).astype(np.float32)
        self.on_links: list[Added] = [(rows, first + columns, by_parameter)]
        self.on_masses: list[Added] = []
        masses, columns = np.nonzero(system.parameters.mass_map)
        if len(masses):
            factors = -system.parameters.mass_map[masses, columns] * unit[columns] / mechanics.masses[masses]
            inertia = inputs.accelerations(orbit)[:, masses] * (factors[:, None] * step2)
            self.on_masses.append((masses, first + columns, inertia.astype(np.float32)))
        self._by_rate: Single = np.empty((0, 0, 0), np.float32)  # room for a part of the forces
        self.owners = system.state_links
        self.by_state = (slopes.by_state * step2).astype(np.float32)
        self.rate_by_d = (slopes.rate_by_d * step).astype(np.float32)
        self.rate_by_v = slopes.rate_by_v.astype(np.float32)
        self.rate_by_state = [
            (to, of, (slope * step).astype(np.float32)) for to, of, slope in slopes.rate_by_state
        ]
        self.rate_by_parameter = [
            (to, first + column, (slope * (unit[column] * step)).astype(np.float32))
            for to, column, slope in slopes.rate_by_parameter
        ]
        if candidates is not None:
            self._add_candidates(candidates)
        if system.shapes is not None:
            self._add_shapes(system.shapes, orbit, inputs, unit)

    @property
    def steps(self) -> int:
        """Number of steps along the orbit."""
        return len(self.by_d) // 2

    def within(self, masses: Indices, links: Indices, states: Indices, columns: Indices) -> TangentForces:
        """Those of some `columns` in a part of the structure, the rest of which stays where it is."""
        own = copy(self)
        own.masses, own.links, own.states, own.columns = parts = masses, links, states, columns
        wholes = (self.masses, self.links, self.states, self.columns)
        at_mass, at_link, at_state, at_column = map(_places, parts, map(len, wholes))
        inside = np.ix_(masses, links)
        own.into_links = _matrix(self.mechanics.incidence[inside].T)
        own.gain = _matrix(self.mechanics.gain[inside])
        own.by_d, own.by_v = self.by_d[:, links], self.by_v[:, links]
        own.on_links = _within(self.on_links, at_link, at_column)
        own.on_masses = _within(self.on_masses, at_mass, at_column)
        own.owners, own.by_state = at_link[self.owners[states]], self.by_state[:, states]
        own.rate_by_d, own.rate_by_v = self.rate_by_d[:, states], self.rate_by_v[:, states]
        own.rate_by_state, own.rate_by_parameter = (
            [
                (int(at_state[to]), int(places[of]), slope)
                for to, of, slope in slopes
                if at_state[to] >= 0 and places[of] >= 0
            ]
            for slopes, places in ((self.rate_by_state, at_state), (self.rate_by_parameter, at_column))
        )
        return own

    def _add_candidates(self, candidates: CandidateForces) -> None:
        """Count forces that no link exerts yet; they are the last columns."""
        first, masses = len(self.columns) - len(candidates.first), self.mechanics.masses
        for ends, sign in ((candidates.first, -1.0), (candidates.second, 1.0)):
            on_mass = np.flatnonzero(ends >= 0)
            moved = [(ends[on_mass], on_mass, 1.0)]
            for number, shape in enumerate([*self.mechanics.points, -masses]):
                at_point = np.flatnonzero(ends == FIRST_POINT - number)
                modes = np.flatnonzero(shape) if len(at_point) else np.empty(0, int)
                moved += [(np.full(len(at_point), mode), at_point, shape[mode]) for mode in modes]
            for moving, which, weight in moved:
                if not len(which):
                    continue
                factor = ((sign * weight / masses[moving])[:, None] * self.step**2).astype(np.float32)
                change: Floats = np.stack([candidates.along[number] for number in which.tolist()], axis=1)
                change *= factor
                self.on_masses.append((moving, first + which, change.astype(np.float32, copy=False)))

    def _add_shapes(
        self, shapes: ShapeParameters, orbit: Trajectories, inputs: Inputs, units: Floats
    ) -> None:
        """Count shapes that are parameters: they stretch links at the point, and pass its forces on to the mode."""
        states, links, memory = orbit.half_states(self.step), orbit.half_links, orbit.half_memory
        unit, points, modes = units[shapes.columns], shapes.points, shapes.modes
        force = np.empty_like(links[:, 0])
        self.mechanics.force(links[:, 0], links[:, 1], memory, force, np.empty_like(memory))
        acting = -(shapes.sides @ force)
        if inputs.points is not None:
            acting += input_along(inputs.points, orbit.flow_steps(inputs.points))
        factor = (unit / self.mechanics.masses[modes])[:, None] * self.step**2
        columns = self.mechanics.system.dimension + shapes.columns
        self.on_masses.append((modes, columns, (acting[:, points] * factor).astype(np.float32)))
        which, link = np.nonzero(shapes.sides[points])
        weight = (shapes.sides[points[which], link] * unit[which])[:, None]
        x, u = (states[:, kind][:, modes[which]] for kind in (0, 1))
        change = weight * (self.by_d[:, link] * x + self.by_v[:, link] * u)
        self.on_links.append((link, columns[which], change.astype(np.float32)))
        for state, owner in enumerate(self.owners.tolist()):
            for pair in np.flatnonzero(link == owner):
                slope = self.rate_by_d[:, state] * x[:, pair] + self.rate_by_v[:, state] * u[:, pair]
                change = (slope * weight[pair]).astype(np.float32)
                self.rate_by_parameter.append((state, columns[which[pair]], change))

    def at_nodes(self, scale: Floats) -> tuple[Single, Single]:
        """Sensitivities (2, n, P, K) of masses and (S, P, K) of states of links at nodes: to themselves, in their units."""
        n, shape = len(self.mechanics.masses), (len(self.columns), len(self.step))
        state = np.zeros((2, len(self.masses), *shape), np.float32)
        inner = np.zeros((len(self.states), *shape), np.float32)
        for column, number in enumerate(self.columns[self.columns < len(scale)].tolist()):
            kind, mass = divmod(number, n)
            if kind < 2:
                state[kind, np.searchsorted(self.masses, mass), column] = scale[number] * (
                    self.step if kind else 1.0
                )
            else:
                inner[np.searchsorted(self.states, number - 2 * n), column] = scale[number]
        return state, inner

    def __call__(self, j: int, motion: Single, inner: Single, out: Single, rates: Single) -> None:
        """Tangent forces (L, P, K) to `out` and tangent rates of states, times the step, (S, P, K) to `rates`."""
        np.multiply(self.by_d[j][:, None], motion[0], out=out)
        if self._by_rate.shape != out.shape:
            self._by_rate = np.empty_like(out)
        out += np.multiply(self.by_v[j][:, None], motion[1], out=self._by_rate)
        for links, columns, change in self.on_links:
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
        for masses, columns, change in self.on_masses:
            out[masses, columns] += change[j]


def _places(which: Indices, size: int) -> Indices:
    """(size,) place of each number in `which`, -1 for those that are not in it."""
    places = np.full(size, -1)
    places[which] = np.arange(len(which))
    return places


def _within(added: Sequence[Added], rows: Indices, columns: Indices) -> list[Added]:
    """What of it is in rows and columns that have places, there."""
    inside = []
    for own_rows, own_columns, change in added:
        some = np.flatnonzero((rows[own_rows] >= 0) & (columns[own_columns] >= 0))
        if len(some):
            inside.append((rows[own_rows[some]], columns[own_columns[some]], change[:, some]))
    return inside


_WIDE = 20  # columns of a matrix from which sparse products may be faster
_FULL = 0.2  # of its entries


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

    def ends(self, rate: Floats | Single) -> NDArray[Any]:
        """(2n + S, P, K) those of displacements, velocities and states of links, `rate` (K,) being one over the steps in s."""
        return np.concatenate([self.state[0], self.state[1] * rate, self.memory])


def tangents(
    mechanics: NumericSystem,
    orbit: Trajectories,
    step: Floats,
    scale: Floats,
    unit: Floats,
    candidates: CandidateForces | None = None,
    *,
    inputs: Inputs,
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
    inputs : Inputs
        What acts along the orbit.

    Yields
    ------
    TangentStep
        Sensitivities at the start of a step, and at last at the end; overwritten by the next step.
    """
    return march(TangentForces(mechanics, orbit, step, unit, candidates, inputs=inputs), scale)


def march(forces: TangentForces, scale: Floats) -> Iterator[TangentStep]:
    """Carry sensitivities from the nodes on, of states in units `scale` (2n + S,); yields as `tangents` does."""
    into_links, gain, system = forces.into_links, forces.gain, forces.mechanics.system
    # by the error of the recorded displacement of the base
    stretched = -system.base[:, None, None].astype(np.float32)
    state, inner = forces.at_nodes(scale)
    L, (S, P, K) = into_links.shape[0], inner.shape
    stack, working = (np.empty((count, L, P, K), np.float32) for count in (4, 3))
    pull, motion = working[0], working[1:]
    accelerations = np.empty((3, *state.shape[1:]), np.float32)
    itself, by_stage = state.reshape(2, -1).T, accelerations.reshape(3, -1).T  # as BLAS adds to them in place
    rates, between = np.empty((3, S, P, K), np.float32), np.empty_like(inner)
    for start in range(0, 2 * forces.steps, 2):
        product(into_links, state, stack[:2])
        if system.base_error is not None:
            stack[0] += stretched * inner[system.base_error]
        forces(start, stack[:2], inner, pull, rates[0])
        product(gain, pull, accelerations[0])
        forces.inertia(start, accelerations[0])
        yield TangentStep(state, inner, accelerations[0], pull)
        product(into_links, accelerations[0], stack[2])
        combine(TANGENT_MIDDLE, stack[:3], motion)
        if S:
            np.add(inner, np.float32(0.5) * rates[0], out=between)
        forces(start + 1, motion, between, pull, rates[1])
        product(gain, pull, accelerations[1])
        forces.inertia(start + 1, accelerations[1])
        product(into_links, accelerations[1], stack[3])
        combine(TANGENT_END, stack, motion)
        if S:
            np.add(inner, np.float32(2.0) * rates[1] - rates[0], out=between)
        forces(start + 2, motion, between, pull, rates[2])
        if S:
            inner += (rates[0] + np.float32(4.0) * rates[1] + rates[2]) / np.float32(6.0)
        product(gain, pull, accelerations[2])
        forces.inertia(start + 2, accelerations[2])
        state[0] += state[1]
        blas.sgemm(1.0, by_stage, TANGENT_CLOSING.T, 1.0, itself, overwrite_c=1)
    yield TangentStep(state, inner, None, None)


def _matrix(values: Floats) -> Single | csr_array:
    """In single precision; sparse where that makes products faster."""
    single = np.ascontiguousarray(values, np.float32)
    sparse = values.shape[1] >= _WIDE and np.count_nonzero(values) < _FULL * values.size
    return csr_array(single) if sparse else single


def product(matrix: Single | csr_array, block: Single, out: Single) -> None:
    """Multiply by a matrix over the third last axis.

    Parameters
    ----------
    matrix : array or sparse array of shape (a, b)
        The matrix.
    block : array of shape (..., b, P, K)
        What it multiplies.
    out : array of shape (..., a, P, K)
        Where the products are put.
    """
    size = block.shape[-2] * block.shape[-1]
    flat, result = block.reshape(*block.shape[:-2], size), out.reshape(*out.shape[:-2], size)
    if isinstance(matrix, np.ndarray):
        np.matmul(matrix, flat, out=result)
    elif block.ndim == 3:
        result[:] = matrix @ flat
    else:
        for own, of_own in zip(result, flat, strict=True):
            own[:] = matrix @ of_own


def combine(weights: Single, blocks: Single, out: Single) -> None:
    """Put weighted sums of blocks.

    Parameters
    ----------
    weights : array of shape (a, b)
        The weights.
    blocks : array of shape (b, ...)
        The blocks.
    out : array of shape (a, ...)
        Where the sums are put.
    """
    np.matmul(weights, blocks.reshape(len(blocks), -1), out=out.reshape(len(out), -1))


def shown_tangents(
    sensors: Sensors,
    tangent: TangentStep,
    mechanics: NumericSystem,
    orbit: Trajectories,
    number: int,
    scales: tuple[Floats, Floats],
) -> list[Single]:
    """Sensitivities of what sensors of each kind show, with points of hosts behind the masses.

    Parameters
    ----------
    sensors : Sensors
        The sensors, with the shapes that `mechanics` has.
    tangent : TangentStep
        Sensitivities at the start of a step.
    mechanics : NumericSystem
        The system.
    orbit : Trajectories
        The orbit of the tangents.
    number : int
        The step.
    scales : tuple of array
        Steps (K,) in s, and units (p,) of the parameters.

    Returns
    -------
    list of array
        Those of x, h v, h^2 a, h^2 f and states of links, (places, P, K) each.
    """
    motions = sensors.shown(tangent.shown(), 0)
    shapes = mechanics.system.shapes
    if shapes is None or sensors.shapes is None:
        return motions
    step, unit = scales
    first, n = mechanics.system.dimension, len(mechanics.masses)
    x, u = orbit.states[number]
    for row, point in enumerate(sensors.points.tolist()):
        own = np.flatnonzero(shapes.points == point)
        modes, columns = shapes.modes[own], first + shapes.columns[own]
        size = unit[shapes.columns[own], None]
        of_modes = (x[modes], u[modes], orbit.accelerations[number, modes] * step**2)
        for kind, motion in enumerate(of_modes):
            motions[kind][n + row, columns] += (size * motion).astype(np.float32)
    return motions


def columns_of_forces(segments: Segments) -> Indices:
    """The columns of gains, then of delays, of uncertain forces among those of the errors of sensors."""
    uncertain, sensors = segments.inputs.uncertain, segments.sensors
    if uncertain is None:
        return np.empty(0, dtype=int)
    gains, delays = (numbers[numbers >= 0] for numbers in (uncertain.gains, uncertain.delays))
    return np.concatenate([sensors.offsets + gains, sensors.offsets + sensors.gains + delays])


def changes_of_forces(misfit: Misfit, part: slice) -> CandidateForces | None:
    """The forces on masses, in some segments, per unit of each error of `columns_of_forces`; None without any."""
    segments, point = misfit.segments, misfit.point
    if segments.inputs.uncertain is None:
        return None
    uncertain = segments.inputs.uncertain.part(part)
    force, rate = uncertain.acting(point.gains, point.delays)
    scaled, late = np.flatnonzero(uncertain.gains >= 0), np.flatnonzero(uncertain.delays >= 0)
    gains, delays = uncertain.gains[scaled], uncertain.delays[late]
    units = misfit.scales.theta[len(point.theta) + len(point.offsets) :]
    per_gain = -force[:, :, scaled] * (units[gains] / point.gains[gains])[:, None]
    per_delay = rate[:, :, late] * units[len(point.gains) + delays][:, None]
    changes = np.concatenate([per_gain, per_delay], axis=2)
    ends = uncertain.ends[np.concatenate([scaled, late])]
    along = input_along(changes, segments.flow_steps_per_tangent)
    return CandidateForces(np.full(len(ends), -1), ends, [*along.transpose(1, 0, 2)])


def add_errors_of_sensors(jacobian: Floats, misfit: Misfit, root: Floats, part: slice) -> None:
    """The columns of errors of sensors; the rows of sensors with an unknown gain are scaled by it.

    `root` (M, C, k) is the square root of the samples' weights, 0 where one is missing. What masses that uncertain forces move
    show is in place.
    """
    segments, scales, point = misfit.segments, misfit.scales, misfit.point
    sensors = segments.sensors
    first, units = jacobian.shape[-1] - 1 - sensors.unknowns, scales.theta[len(point.theta) :]
    factors, forces = sensors.factors(point.gains), first + columns_of_forces(segments)
    for channel in sensors.scaled:
        jacobian[:, :, channel, :first] *= np.float32(factors[channel])
        jacobian[:, :, channel, forces] *= np.float32(factors[channel])
    deviations = segments.deviations(scales, part)
    for channel, number, values in estimated_errors(misfit, part):
        column = root[:, channel] * (values * units[number] / deviations[channel])
        jacobian[:, :, channel, first + number] += column.T


def errors_by_channel(
    misfit: Misfit, part: slice, errors: SensorErrors | None
) -> Iterator[tuple[int, Indices, Single]]:
    """Of each channel with errors the numbers of these, and what they add to its samples, whitened (k, M, c)."""
    if errors is None:
        return
    (_, whiten), sensors = misfit.weights(part), misfit.segments.sensors
    factors = sensors.factors(misfit.point.gains)
    for channel in np.unique(errors.channel).tolist():
        numbers = np.flatnonzero(errors.channel == channel)
        factor = factors[channel] if channel in sensors.scaled else 1.0
        values = np.stack([errors.values[number][:, part] for number in numbers.tolist()], axis=1)
        columns = whiten[:, channel, None] * (factor * values)
        yield channel, numbers, np.ascontiguousarray(columns.transpose(2, 0, 1), np.float32)


def whitened_jacobian(
    misfit: Misfit,
    part: slice,
    candidates: CandidateForces | None = None,
    errors: SensorErrors | None = None,
) -> tuple[Floats, Floats]:
    """Whitened Jacobian and residuals (k, M C, P + 1) in single precision; ends' sensitivities (k, 2n + S, P)."""
    segments, scales = misfit.segments, misfit.scales
    M, C, K = segments.samples[..., part].shape
    forces, sizes = extra_columns(candidates, errors)
    moving = segments.system.dimension + segments.system.parameters.size + forces
    width = moving + sizes
    P = width + segments.sensors.unknowns
    root, whiten = misfit.weights(part)
    jacobian: NDArray[Any] = np.zeros((K, M, C, P + 1), np.float32)
    jacobian[..., P] = (root * misfit.pulling[..., part]).transpose(2, 0, 1)
    columns = (moving, (width + columns_of_forces(segments)).tolist())
    ends = _put_marched(jacobian, misfit, part, whiten, candidates, columns)
    random = segments.random
    if random is not None and random.shown is not None:  # by the sensors directly, in segments of one sample
        for channel, number in np.argwhere(random.shown):
            row = random.rows[number]
            unit = np.float32(random.shown[channel, number] * scales.state[row])
            jacobian[:, 0, channel, row] += whiten[0, channel] * unit
    if segments.sensors.unknowns:
        add_errors_of_sensors(jacobian, misfit, root, part)
    for channel, numbers, own in errors_by_channel(misfit, part, errors):
        jacobian[:, :, channel, moving + numbers] = own
    ends /= scales.state[:, None]
    return jacobian.reshape(K, M * C, P + 1), ends


def _put_marched(
    jacobian: NDArray[Any],
    misfit: Misfit,
    part: slice,
    whiten: Single,
    candidates: CandidateForces | None,
    columns: tuple[int, list[int]],
) -> Floats:
    """Put what sensors show of the sensitivities, step by step; gives those at the ends (k, 2 n + S, P)."""
    segments, scales = misfit.segments, misfit.scales
    mechanics, (orbit, step, inputs) = misfit.mechanics, misfit.along_tangents(part)
    sensors = segments.sensors.at(mechanics)
    p = segments.system.parameters.size
    rates = (1.0, 1.0 / step, 1.0 / step**2, 1.0 / step**2, 1.0)
    shown = [
        (
            kind,
            sources,
            _late(sensors, misfit.point, kind),
            channels,
            (whiten[:, channels] * rates[kind]).astype(np.float32),
        )
        for kind, channels, sources in sensors.by_kind
    ]
    forces, changes = candidates and candidates.part(part), changes_of_forces(misfit, part)
    if changes is not None:
        forces = changes if forces is None else forces.joined(changes)
        inputs = inputs.at(misfit.point.gains, misfit.point.delays)
    steps = tangents(mechanics, orbit, step, scales.state, scales.theta[:p], forces, inputs=inputs)
    refine, before = segments.tangent_refine, segments.tangents_before
    for number, tangent in enumerate(steps):
        sample, between = divmod(number - before, refine)
        if tangent.acceleration is None or between:
            continue
        motions: Sequence[Single] = tangent.shown()
        if sensors.shapes is not None:
            motions = shown_tangents(sensors, tangent, mechanics, orbit, number, (step, scales.theta))
        for kind, sources, late, places, factors in shown:
            rows = motions[kind][sources]
            rows = rows.copy() if late else rows
            for channel, delay, mass in late:
                rows[channel] -= (delay * rates[V] * motions[kind + 1][mass]).astype(rows.dtype)
            whitened = (rows * factors[sample, :, None]).transpose(2, 0, 1)
            _put(jacobian, (slice(None), sample, places), whitened, columns)
    ends = np.zeros((len(jacobian), segments.system.dimension, jacobian.shape[-1] - 1))
    _put(ends, (slice(None), slice(None)), tangent.ends(1.0 / step).transpose(2, 0, 1), columns)
    return ends


def _late(sensors: Sensors, point: Iterate, kind: int) -> list[tuple[int, np.floating[Any], int]]:
    """Of the channels of one kind those that are late: the place among them, the delay in s to first order, and the mass."""
    if kind >= A or not len(sensors.delay):
        return []
    channels = np.flatnonzero(sensors.kind == kind)
    late = ((place, int(channel)) for place, channel in enumerate(channels) if sensors.delay[channel] >= 0)
    return [
        (place, point.delays[sensors.delay[channel]], int(sensors.mass[channel])) for place, channel in late
    ]


def _put(
    target: NDArray[Any],
    place: tuple[slice | int | Indices, ...],
    block: NDArray[Any],
    columns: tuple[int, list[int]],
) -> None:
    """Put a block, of as many columns as come first in the target, and then of single ones there, into a place of it."""
    first, single = columns
    target[(*place, slice(first))] = block[..., :first]
    for number, column in enumerate(single, start=first):
        target[(*place, column)] = block[..., number]


def extra_columns(candidates: CandidateForces | None, errors: SensorErrors | None) -> tuple[int, int]:
    """Numbers of columns behind those of the parameters: of amplitudes of candidates, and of sizes of errors."""
    of_candidates = 0 if candidates is None else len(candidates.first)
    return of_candidates, 0 if errors is None else len(errors.channel)
