"""The recorded motion of a rig as a smoothing spline: values between samples, and what its noise does to them.

States of a link along a motion that is known, by the trapezoidal rule, with their derivatives.

All steps are solved together by Newton's method: the equations of neighbouring nodes form a banded matrix, which also gives
the sensitivities of the states (one solve each) and, transposed, those to the motion.

The forces of links along recorded motions: residuals of the load cells and their derivatives by the unknowns.

What records of a rig must hold: the displacement of the base, and the force in each link that has unknowns.

Least squares for the unknowns of links on a rig, from starts that a regression along the motion finds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy
from scipy.linalg import lapack

from linkwise.arrays import Floats, bridged
from linkwise.errors import IdentificationError
from linkwise.expression import Program, differentiate
from linkwise.likelihood.starts.memory import MemorySearch, Start
from linkwise.model.law import Law
from linkwise.model.named_laws import smooth_rates
from linkwise.model.parameters import Parameter
from linkwise.model.structure import BASE, Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.records.sample_checks import require_complete
from linkwise.signals.noise import channel_noise, noise_sigma
from linkwise.signals.states import SmoothingSpline, smoothing_spline


@dataclass(frozen=True, eq=False)
class PrescribedMotion:
    """The motion at the nodes (J): the samples, and `substeps` - 1 between each two.

    `sigma` is the noise of the displacement sensor in m.
    """

    spline: SmoothingSpline
    substeps: int
    sigma: float

    @cached_property
    def _basis(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """(J, N + 4) what the coefficients of the quintic B-splines make of the displacement and the velocity at the nodes."""
        count = len(self.spline.coefficients)
        knots = np.arange(-5.0, count + 1.0)
        nodes = np.arange((count - 5) * self.substeps + 1) / self.substeps
        lagged = scipy.sparse.eye_array(count - 1, count, k=1) - scipy.sparse.eye_array(count - 1, count)
        values, slopes = (
            scipy.interpolate.BSpline.design_matrix(
                nodes, knots[5 - degree : len(knots) - 5 + degree], degree
            )
            for degree in (5, 4)
        )
        return values, self.spline.rate * (slopes @ lagged)

    @cached_property
    def d(self) -> Floats:
        """(J,) displacement in m."""
        return np.asarray(self._basis[0] @ self.spline.coefficients[:, 0])

    @cached_property
    def v(self) -> Floats:
        """(J,) velocity in m/s."""
        return np.asarray(self._basis[1] @ self.spline.coefficients[:, 0])

    @property
    def step(self) -> float:
        """Time between nodes in s."""
        return 1.0 / (self.spline.rate * self.substeps)

    @property
    def period(self) -> int:
        """Samples in a period of the motion, by the ratio of displacement and velocity."""
        speed = float(np.std(self.v)) or 1.0
        return max(int(2.0 * np.pi * float(np.std(self.d)) / speed * self.spline.rate), 1)

    def liveliest(self, count: int) -> int:
        """First of the `count` samples in a row that move most."""
        power = np.concatenate([[0.0], np.cumsum(self.v[:: self.substeps] ** 2)])
        return int(np.argmax(power[count:] - power[:-count]))

    def noise_draws(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """(J, count) what draws of the sensor's noise do to d and v at the nodes."""
        noise = self.sigma * rng.standard_normal((len(self.spline.coefficients) - 4, count))
        drawn = self.spline.smoothed(noise).coefficients
        return self._basis[0] @ drawn, self._basis[1] @ drawn

    def noise_of(self, by_d: Floats, by_v: Floats) -> Floats:
        """(N, q) by how much sums with derivatives (J, q) by d and v at the nodes change with the noise of each sample."""
        by_coefficient = self._basis[0].T @ by_d + self._basis[1].T @ by_v
        return self.spline.transposed(by_coefficient) * self.sigma


_NEWTON = 40  # iterations, at most
_TOLERANCE = 1e-9  # of the size of the states
_LARGEST = 1e12  # a state that gets larger has run away


@lru_cache(maxsize=256)
def _programs(law: Law, free: tuple[str, ...]) -> tuple[Program, Program]:
    """Rates and their derivatives by states; then the derivatives of force and rates by d, v, states and coefficients."""
    rates = smooth_rates(law)
    names = (*law.variables, *law.coefficients)
    newton = [*rates, *(differentiate(rate, state) for rate in rates for state in law.states)]
    by = ("d", "v", *law.states, *free)
    slopes = [differentiate(tree, name) for tree in (law.expression, *rates) for name in by]
    return Program(newton, names, wide=law.variables), Program(slopes, names, wide=law.variables)


@dataclass(frozen=True, eq=False)
class StateEquations:
    """Factorised linearised equations of the states (S) at the nodes (J), the first of which is given."""

    factors: Floats
    pivots: Floats
    count: int

    @classmethod
    def of(cls, slopes: Floats, step: float) -> StateEquations:
        """Of the derivatives (J, S, S) of the rates by states."""
        nodes, count, _ = slopes.shape
        half = 0.5 * step * slopes
        lower, upper = 2 * count - 1, count - 1
        bands = np.zeros((2 * lower + upper + 1, (nodes - 1) * count))
        unit = np.eye(count)
        for row in range(count):
            for column in range(count):
                ahead = unit[row, column] - half[1:, row, column]
                behind = -unit[row, column] - half[1:-1, row, column]
                bands[lower + upper + row - column, column::count] = ahead
                bands[lower + upper + row - column + count, column:-count:count] = behind
        factors, pivots, _ = lapack.dgbtrf(bands, lower, upper, overwrite_ab=1)
        return cls(factors, pivots, count)

    def solve(self, right: Floats, *, transposed: bool = False) -> Floats:
        """Solution for right-hand sides (J - 1, S, q)."""
        lower, upper = 2 * self.count - 1, self.count - 1
        flat = right.reshape(-1, right.shape[-1])
        solved, _ = lapack.dgbtrs(self.factors, lower, upper, flat, self.pivots, trans=int(transposed))
        return np.asarray(solved).reshape(right.shape)


@dataclass(frozen=True, eq=False)
class LinkPath:
    """A link along a motion: `states` (J, S), behind them the signals that its law names, `converged` if they are found."""

    law: Law
    values: tuple[float, ...]
    d: Floats
    v: Floats
    step: float
    states: Floats
    converged: bool

    @classmethod
    @np.errstate(all="ignore")  # states may run away; then the path has not converged
    def of(
        cls, law: Law, values: dict[str, float], d: Floats, v: Floats, step: float,
        initial: Floats, guess: Floats | None = None,
    ) -> LinkPath:  # fmt: skip
        ordered = tuple(values[name] for name in law.coefficients)
        program, _ = _programs(law, ())
        count = len(law.states)
        states, converged = np.zeros((len(d), count)) if guess is None else guess.copy(), not count
        states[0] = initial
        for _ in range(_NEWTON if count else 0):
            rates_and_slopes = program(d, v, *states.T, *ordered)
            rates = np.stack(rates_and_slopes[:count], axis=1)
            slopes = np.stack(rates_and_slopes[count:], axis=1).reshape(-1, count, count)
            missed = np.diff(states, axis=0) - 0.5 * step * (rates[1:] + rates[:-1])
            if not (np.isfinite(missed).all() and np.isfinite(slopes).all()):
                break
            change = StateEquations.of(slopes, step).solve(missed[..., None])[..., 0]
            states[1:] -= change
            size = np.abs(states).max()
            converged = bool(np.abs(change).max() <= _TOLERANCE * (size + 1e-300) and size < _LARGEST)
            if converged or not size < _LARGEST:
                break
        return cls(law, ordered, d, v, step, states, converged)

    def force(self) -> Floats:
        """Force (J,) in N at the nodes."""
        named = dict(zip(self.law.coefficients, self.values, strict=True))
        named |= dict(zip((*self.law.states, *self.law.signals), self.states.T, strict=True))
        return self.law.force(self.d, self.v, named)

    def tangents(self, free: Sequence[str]) -> LinkTangents:
        """Derivatives along the motion, by the coefficients `free`."""
        _, program = _programs(self.law, tuple(free))
        slopes = program(self.d, self.v, *self.states.T, *self.values)
        count, width = len(self.law.states), 2 + len(self.law.states) + len(free)
        rows = np.stack(slopes, axis=1).reshape(len(self.d), 1 + count, width)
        by_state = rows[:, 1:, 2 : 2 + count]
        equations = StateEquations.of(by_state, self.step) if count else None
        return LinkTangents(rows, self.step, count, equations)


@dataclass(frozen=True, eq=False)
class LinkTangents:
    """Derivatives (J, 1 + S, 2 + S + c) of the force and the rates of the states of a link along a motion by d, v, the states
    and c coefficients.
    """

    rows: Floats
    step: float
    count: int
    equations: StateEquations | None

    def by_unknowns(self) -> Floats:
        """(J, c + S) by coefficients and initial states, and by d (one column more), held for the whole motion."""
        count, own = self.count, self.rows[:, :, 2 + self.count :]
        of_states = np.zeros((*self.rows.shape[:2], count))
        pushed = np.concatenate([own, of_states, self.rows[:, :, :1]], axis=2)
        return self._followed(pushed, np.eye(count, pushed.shape[2], k=own.shape[2]))

    def by_motion(self, change_d: Floats, change_v: Floats) -> Floats:
        """Changes (J, q) of the force with changes (J, q) of d and v along the motion."""
        of_d, of_v = self.rows[:, :, 0, None], self.rows[:, :, 1, None]
        pushed = of_d * change_d[:, None] + of_v * change_v[:, None]
        return self._followed(pushed, np.zeros((self.count, change_d.shape[1])))

    def _followed(self, pushed: Floats, first: Floats) -> Floats:
        """Changes (J, q) of the force where it and the rates are `pushed` (J, 1 + S, q), and the states at first (S, q)."""
        if self.equations is None:
            return pushed[:, 0]
        half, by_state = 0.5 * self.step, self.rows[:, :, 2 : 2 + self.count]
        right = half * (pushed[1:, 1:] + pushed[:-1, 1:])
        right[0] += first + half * by_state[0, 1:] @ first
        states = np.concatenate([first[None], self.equations.solve(right)])
        return np.asarray(pushed[:, 0] + np.einsum("js,jsq->jq", by_state[:, 0], states))

    def to_motion(self, weights: Floats) -> tuple[Floats, Floats]:
        """Derivatives (J, q) of sums of forces, weighted with (J, q), by d and by v at every node."""
        count, rows = self.count, self.rows
        by_motion = [weights * rows[:, 0, column, None] for column in (0, 1)]
        if self.equations is None:
            return by_motion[0], by_motion[1]
        sources = rows[:, 0, 2 : 2 + count, None] * weights[:, None, :]
        pulled = self.equations.solve(sources[1:], transposed=True)
        both = np.zeros((len(rows), *pulled.shape[1:]))
        both[1:] += pulled
        both[:-1] += pulled
        for column in (0, 1):
            by_motion[column] += 0.5 * self.step * np.einsum("js,jsq->jq", rows[:, 1:, column], both)
        return by_motion[0], by_motion[1]


BASE_CHANNEL = Channel("x", BASE)


@dataclass(frozen=True, eq=False)
class Cell:
    """A load cell in a record: the numbers of the record and of its link, its channel, the places of the initial states of the
    link among the unknowns, the motion, the elongation per displacement of the base, and the samples (N,), NaN where missing.
    """

    record: int
    link: int
    channel: Channel
    places: slice
    motion: PrescribedMotion
    sign: float
    measured: Floats


@dataclass(frozen=True, eq=False)
class RigProblem:
    """Motions of the base in records, and the forces (N,) in links by their number, NaN where samples miss.

    Unknowns: the p parameters, `offsets` of sensors, initial states.
    """

    structure: Structure
    motions: tuple[PrescribedMotion, ...]
    forces: tuple[Mapping[int, Floats], ...]
    offsets: tuple[Channel, ...] = ()

    @classmethod
    def of(cls, records: Sequence[Record], structure: Structure) -> RigProblem:
        """That of records; IdentificationError where one does not hold motion and forces."""
        motions, forces = zip(*(_motion_and_forces(record, structure) for record in records), strict=True)
        return cls(structure, motions, forces)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.structure.parameters

    @cached_property
    def certainty(self) -> Floats:
        """(u,) one over the standard deviations to which unknowns are known beforehand."""
        known = np.zeros(self.size)
        known[: len(self.parameters)] = 1.0 / np.array([p.sigma for p in self.parameters])
        return known

    def with_substeps(self, substeps: int) -> RigProblem:
        """The problem with other steps between samples."""
        return replace(self, motions=tuple(replace(motion, substeps=substeps) for motion in self.motions))

    @cached_property
    def links(self) -> tuple[int, ...]:
        """Numbers of the links with a load cell."""
        return tuple(sorted(self.forces[0]))

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """The channels of load cells, and that of the displacement."""
        return (*(cell_name(self.structure, link) for link in self.links), BASE_CHANNEL)

    @cached_property
    def cells(self) -> tuple[Cell, ...]:
        """Those of all records; their initial states follow the other unknowns."""
        cells, first = [], len(self.parameters) + len(self.offsets)
        for number, (motion, forces) in enumerate(zip(self.motions, self.forces, strict=True)):
            for link, channel in zip(self.links, self.sensors, strict=False):
                places = slice(first, first + len(self.structure.links[link].law.states))
                sign = float(self.structure.base_incidence[link])
                cells.append(Cell(number, link, channel, places, motion, sign, forces[link]))
                first = places.stop
        return tuple(cells)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.cells[-1].places.stop)

    def values(self, link: int, unknowns: Floats) -> dict[str, float]:
        """Values of the coefficients of a link."""
        known = {k: c.value or 0.0 for k, c in self.structure.links[link].coefficients.items()}
        for value, parameter in zip(unknowns, self.parameters, strict=False):
            known |= {key: float(value) for index, key in parameter.members if index == link}
        return known

    def paths(self, unknowns: Floats, before: Sequence[LinkPath] | None = None) -> tuple[LinkPath, ...]:
        """The links along the motions; states are sought near those `before`, or from rest where that fails."""
        shift = self.offset(BASE_CHANNEL, unknowns)
        paths = tuple(
            LinkPath.of(
                self.structure.links[cell.link].law, self.values(cell.link, unknowns),
                cell.sign * (cell.motion.d - shift), cell.sign * cell.motion.v, cell.motion.step, unknowns[cell.places],
                None if before is None or not before[number].converged else before[number].states,
            )
            for number, cell in enumerate(self.cells)
        )  # fmt: skip
        settled = before is None or all(path.converged for path in paths)
        return paths if settled else self.paths(unknowns)

    def free(self, link: int) -> tuple[str, ...]:
        """Coefficients of a link that are unknown."""
        unknown = {key for p in self.parameters for index, key in p.members if index == link}
        return tuple(key for key in self.structure.links[link].law.coefficients if key in unknown)

    @cached_property
    def measured(self) -> Floats:
        """(R,) samples of all load cells."""
        return np.concatenate([cell.measured for cell in self.cells])

    def offset(self, channel: Channel, unknowns: Floats) -> float:
        """Zero error of a sensor, 0 where it is not unknown."""
        if channel not in self.offsets:
            return 0.0
        return float(unknowns[len(self.parameters) + self.offsets.index(channel)])

    def residuals(self, unknowns: Floats, paths: Sequence[LinkPath]) -> Floats:
        """Measured less modelled forces (R,) in N, 0 where a sample is missing and NaN where a law is not finite."""
        rows = []
        for cell, path in zip(self.cells, paths, strict=True):
            force = path.force()[:: cell.motion.substeps]
            measured = cell.measured - self.offset(cell.channel, unknowns)
            left = np.where(np.isfinite(force), measured - force, np.nan)
            rows.append(np.where(np.isfinite(measured), left, 0.0))
        return np.concatenate(rows)

    def jacobian(self, paths: Sequence[LinkPath]) -> Floats:
        """(R, u) derivatives of the modelled forces by the unknowns."""
        blocks = []
        for cell, path in zip(self.cells, paths, strict=True):
            free = self.free(cell.link)
            slopes = path.tangents(free).by_unknowns()[:: cell.motion.substeps]
            block = np.zeros((len(slopes), self.size))
            for column, parameter in enumerate(self.parameters):
                for index, key in parameter.members:
                    if index == cell.link:
                        block[:, column] += slopes[:, free.index(key)]
            for column, channel in enumerate(self.offsets, start=len(self.parameters)):
                of_motion = channel == BASE_CHANNEL
                block[:, column] = -cell.sign * slopes[:, -1] if of_motion else channel == cell.channel
            block[:, cell.places] = slopes[:, len(free) : -1]
            block[~np.isfinite(cell.measured)] = 0.0
            blocks.append(block)
        return np.concatenate(blocks)

    def noise_of_motion(self, paths: Sequence[LinkPath], weights: Floats) -> Floats:
        """(M, q) how sums of modelled forces with weights (R, q) change with the noise of each displacement sample."""
        by_record: dict[int, Floats] = {}
        for cell, path, own in zip(self.cells, paths, self.split(weights), strict=True):
            spread = np.zeros((len(path.d), weights.shape[1]))
            spread[:: cell.motion.substeps] = own
            by_motion = path.tangents(self.free(cell.link)).to_motion(spread)
            part = cell.sign * cell.motion.noise_of(*by_motion)
            by_record[cell.record] = by_record.get(cell.record, 0.0) + part
        return np.concatenate([by_record[record] for record in sorted(by_record)])

    def split(self, rows: Floats) -> list[Floats]:
        """Rows (R, q), one of each sample of each load cell, by paths."""
        return np.split(rows, np.cumsum([len(cell.measured) for cell in self.cells])[:-1])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Bounds (u,) of the unknowns."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[: len(self.parameters)] = [p.lower for p in self.parameters]
        high[: len(self.parameters)] = [p.upper for p in self.parameters]
        return low, high


_FEWEST = 32  # samples
_FLOOR = 1e-12  # of the largest displacement: smaller noise is below rounding
_SUBSTEPS = 2  # between samples, at first


def cell_name(structure: Structure, link: int) -> Channel:
    """The channel of the load cell of a link, by its number."""
    return Channel("f", structure.links[link].name)


def _motion_and_forces(record: Record, structure: Structure) -> tuple[PrescribedMotion, dict[int, Floats]]:
    """Motion and forces of a record; IdentificationError where it does not hold them."""
    name = BASE_CHANNEL
    if name not in record.channels:
        raise IdentificationError(
            f"a link alone on a rig is identified from the displacement of its base, {name}, but the record holds "
            f"{', '.join(record.channels)}; where one end is fixed, call the other end the base"
        )
    values = record.channel(name)
    require_complete(name, values, record.start, record.rate)
    if len(values) < _FEWEST:
        raise IdentificationError(
            f"{len(values)} samples are too few for links on a rig, which need {_FEWEST}"
        )
    if not np.ptp(values) > 0.0:
        raise IdentificationError(
            f"{name} does not change: the force in a link that does not move says nothing about its law"
        )
    cells = {
        number: record.channel(cell_name(structure, number))
        for number in range(len(structure.links))
        if cell_name(structure, number) in record.channels
    }
    for number, force in cells.items():
        if not np.isfinite(force).any():
            raise IdentificationError(
                f"channel {cell_name(structure, number)} has no sample that is a number"
            )
    for parameter in structure.parameters:
        unseen = [index for index, _ in parameter.members if index not in cells]
        if len(unseen) == len(parameter.members):
            raise IdentificationError(
                f"{parameter.name} is unknown, but the record has no load cell of its link: give channel "
                f"{cell_name(structure, unseen[0])}, the force in it"
            )
    return prescribed_motion(record), cells


def prescribed_motion(record: Record) -> PrescribedMotion:
    """The motion of the base of a record, smoothed at the level of its noise."""
    values = record.channel(BASE_CHANNEL)
    spline = smoothing_spline(values, record.rate)
    return PrescribedMotion(spline, _SUBSTEPS, _sensor_noise(record, values, spline.value()[:, 0]))


def _sensor_noise(record: Record, values: Floats, smooth: Floats) -> float:
    """Standard deviation in m of the noise of the displacement; that of a coarse resolution is what smoothing takes out."""
    stated = record.noise.get(BASE_CHANNEL)
    if stated is not None:
        return float(stated)
    estimated = float(np.nan_to_num(noise_sigma(values)[0]))
    return max(estimated, float(np.std(values - smooth)), _FLOOR * float(np.abs(values).max()))


def cell_noise(records: Sequence[Record]) -> dict[str, float]:
    """Noise in N by the channels of load cells: of several records the largest."""
    by_record = [channel_noise(record) for record in records]
    return {name: max(noise[name] for noise in by_record) for name in records[0].channels if name.kind == "f"}


_SEARCHED = 4096  # samples of a record in which starts are searched for
_OF_PERIOD = 256  # of them in a period of the motion: more make the search longer, and show no more of a law
_LAST_STEPS = 300
# residual, relative to the forces, of a trial whose states run away or whose laws are not finite
_RUNAWAY = 1e6


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns (u,) at a minimum, `cost` the sum of weighted squares there, the paths, and whether the search ended."""

    unknowns: Floats
    cost: float
    paths: tuple[LinkPath, ...]
    converged: bool


def minimise(problem: RigProblem, start: Floats, weights: Floats, *, steps: int = _LAST_STEPS) -> Minimum:
    """The minimum of the squares of weighted residuals near `start`, within bounds; priors count."""
    low, high = problem.bounds
    last: tuple[LinkPath, ...] | None = None
    prior = np.array([p.start or 0.0 for p in problem.parameters])
    certainty = problem.certainty[: len(prior)]

    @lru_cache(maxsize=1)
    def paths_at(*unknowns: float) -> tuple[LinkPath, ...]:
        """The links along the motions, sought near those asked for before."""
        nonlocal last
        last = problem.paths(np.array(unknowns), last)
        return last

    def residuals(unknowns: Floats) -> Floats:
        paths = paths_at(*unknowns)
        left = np.where(weights > 0.0, problem.residuals(unknowns, paths), 0.0)
        if not (all(path.converged for path in paths) and np.isfinite(left).all()):
            return np.full(len(weights) + len(prior), _RUNAWAY)
        rows = np.clip(weights * left, -_RUNAWAY, _RUNAWAY)
        return np.concatenate([rows, certainty * (prior - unknowns[: len(prior)])])

    def jacobian(unknowns: Floats) -> Floats:
        own = np.zeros((len(prior), problem.size))
        own[:, : len(prior)] = -np.diag(certainty)
        slopes = -weights[:, None] * problem.jacobian(paths_at(*unknowns))
        return np.concatenate([np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0), own])

    inside = np.clip(start, low, high)
    with np.errstate(all="ignore"):
        optimum = scipy.optimize.least_squares(
            residuals,
            inside,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            max_nfev=steps,
            xtol=1e-9,
            ftol=1e-9,
        )
        unknowns = np.asarray(optimum.x)
        end = paths_at(*unknowns)
    return Minimum(
        unknowns, 2.0 * float(optimum.cost), end, bool(optimum.status > 0) and all(p.converged for p in end)
    )


def starts(problem: RigProblem, given: Mapping[str, float]) -> tuple[Start, ...]:
    """Values of the parameters from which little of the forces is left, the best first; `given` starts by name are kept near.

    They are searched for in the liveliest part of the first record, without the means of the forces where a zero is unknown.
    """
    motion, forces = problem.motions[0], problem.forces[0]
    thinned = max(motion.period // _OF_PERIOD, 1)
    count = min(_SEARCHED * thinned, len(next(iter(forces.values()))))
    first = motion.liveliest(count)
    searched = slice(first, first + count, thinned)
    d, v = (
        np.outer(along[:: motion.substeps][searched], problem.structure.base_incidence)
        for along in (motion.d, motion.v)
    )
    shown: dict[str, Floats] = {
        cell_name(problem.structure, link): bridged(force)[searched] for link, force in forces.items()
    }
    slow = int(bool(problem.offsets))
    step = thinned * motion.step * motion.substeps
    return MemorySearch(problem.structure, step, d, v, (), shown, given, {}, slow, sharp=True).minima()
