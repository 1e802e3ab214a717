"""What links and masses of many structures of one shape do along a run: wells of links, energies, barriers, crossings and rest
positions, and the vibration of the primary masses about these, its largest excursion still to come, settling and decay.

A crossing is a passage over the top of the barrier between two wells. Elongation and rate are known at the integrator's
own steps: the cubic between two steps shows every crossing, and Newton's method on the dense output refines it. Stored
energy is counted from the lowest well, so that it is never negative. For laws that are polynomials in d, rest points are
their roots.

Between samples the displacement is the cubic Hermite interpolant of displacements and velocities, so that peaks are those
of the motion, not of the samples. Time is on axis 0 of all arrays; runs or masses may follow on further axes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy

from linkwise.absorption.sinks import delivered_energy, have_equal_shapes, moving_alike, place_motion
from linkwise.analysis.potential_wells import rest_points
from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Expression, Number, Program, polynomial
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.simulation.batch import can_batch, run_batch
from linkwise.simulation.energy import LinkForces
from linkwise.simulation.run import RunLog, RunOptions, RunSchedule, integrate, room
from linkwise.simulation.simulate import SimulatedMotion

_HIGHEST_ORDER = 12  # of a polynomial law whose rest points are its roots
_REAL = 1e-7  # of the largest root: a smaller imaginary part is the rounding error of a double root


class Barriers(NamedTuple):
    """The barriers of one link for R sets of coefficients.

    `tops` (R, K) m are the elongations, each between two wells, at which the potential is largest; NaN if there are fewer than
    K. `floor` (R,) J is the potential in the lowest well relative to d = 0; 0 if there is no well.
    """

    tops: Floats
    floor: Floats


def barriers(law: Law, values: Mapping[str, Floats], runs: int) -> Barriers:
    """The barriers of a law for `runs` (R) sets of coefficients, each of `values` (R,).

    A law with too many rest points to count, such as a periodic one, has no barriers here, and its energy is counted from
    d = 0.
    """
    columns = [np.asarray(values[name], dtype=float) for name in law.coefficients]
    table = np.stack(columns, axis=1) if columns else np.zeros((runs, 0))
    rows, inverse = np.unique(table, axis=0, return_inverse=True)
    pairs = zip(rows.tolist(), _rest_points(law, rows), strict=True)
    found = [
        _between_wells(law, dict(zip(law.coefficients, row, strict=True)), points) for row, points in pairs
    ]
    tops = np.full((len(rows), max((len(own) for own, _ in found), default=0)), np.nan)
    for number, (own, _) in enumerate(found):
        tops[number, : len(own)] = own
    inverse = inverse.reshape(-1)
    return Barriers(tops[inverse], np.array([floor for _, floor in found])[inverse])


def _between_wells(
    law: Law, values: Mapping[str, float], points: Sequence[tuple[float, bool]]
) -> tuple[list[float], float]:
    """The highest rest point between each two wells, and the energy of the lowest well; no point and 0 without wells."""
    places = [d for d, _ in points]
    energy = np.broadcast_to(law.potential(np.array(places), values), len(points))
    wells = [number for number, (_, well) in enumerate(points) if well]
    between = [range(first + 1, last) for first, last in pairwise(wells) if last > first + 1]
    tops = [places[max(hills, key=energy.__getitem__)] for hills in between]
    return tops, min(energy[wells].tolist(), default=0.0)


def _rest_points(law: Law, rows: Floats) -> list[list[tuple[float, bool]]]:
    """The rest points in m of each set of coefficients (R, C), ascending, and whether they are wells."""
    terms = polynomial(law.elastic, ("d",))
    order = max((power for (power,) in terms), default=_HIGHEST_ORDER + 1) if terms else _HIGHEST_ORDER + 1
    if not terms or order > _HIGHEST_ORDER:
        return [_of_any_law(law, dict(zip(law.coefficients, row.tolist(), strict=True))) for row in rows]
    program = Program([terms.get((k,), Number(0.0)) for k in range(order, -1, -1)], law.coefficients)
    return [_of_polynomial(np.array(program(*row))) for row in rows]


def _of_any_law(law: Law, values: Mapping[str, float]) -> list[tuple[float, bool]]:
    still = dict.fromkeys(law.states, 0.0)

    def force(d: Floats) -> Floats:
        return np.broadcast_to(law.force(d, 0.0, {**values, **still}), np.shape(d))

    def slope(d: Floats) -> Floats:
        return np.broadcast_to(law.partials(d, 0.0, {**values, **still}).by_d, np.shape(d))

    try:
        return [(point.d, point.well) for point in rest_points(force, slope)]
    except StructureError:
        return []


def _of_polynomial(coefficients: Floats) -> list[tuple[float, bool]]:
    """Those of a force with these coefficients, highest power first: roots, and wells where the force rises through them."""
    roots = np.roots(coefficients)
    largest = float(np.abs(roots).max(initial=0.0))
    points = np.sort(roots.real[np.abs(roots.imag) <= _REAL * largest])
    points = points[np.append(True, np.diff(points) > _REAL * largest)] if len(points) else points
    beyond = 2.0 * largest or 1.0
    edges = np.concatenate([[-beyond], points, [beyond]])
    force = np.polyval(coefficients, 0.5 * (edges[1:] + edges[:-1]))
    return list(zip(points.tolist(), ((force[:-1] < 0.0) & (force[1:] > 0.0)).tolist(), strict=True))


_NEWTON_STEPS = 5  # at most; two reduce the cubic's error of 1e-6 of a step to rounding
_CONVERGED = 1e-6  # of a step: the last Newton step of a root that was found
_ONSET = 1e-9  # of the largest distance from a top: a link that stays nearer has not begun to move
_DISTINCT = 1e-9  # of the run: crossings closer than this are one, and one this close to the start is none


def crossings(schedule: RunSchedule, run: RunLog, tops: Sequence[Floats]) -> tuple[Floats, ...]:
    """Times in s at which each link passes one of its `tops`, (K,) m for each link, in a run of `schedule` logged as `run`.

    A link that starts on a top does not cross it by leaving it.
    """
    if not any(len(some) for some in tops):
        return tuple(np.empty(0) for _ in tops)
    steps: list[float] = []
    integrate(schedule, schedule.times[-1:], options=RunOptions(repeated=run, log=steps))
    edges = np.unique(np.concatenate([[0.0], schedule.stops, steps]))
    edges = edges[np.append(np.diff(edges) > _DISTINCT * 1e-3 * schedule.end, True)]
    d, rate = _elongations(schedule, run, edges)
    links, levels, times = _roots_of_cubics(edges, d, rate, tops)
    step = schedule.end / max(run.steps, 1)
    correction = np.full(len(times), np.inf)
    for _ in range(_NEWTON_STEPS):
        if not np.any(np.abs(correction) > _CONVERGED * step):
            break
        unique, inverse = np.unique(times, return_inverse=True)
        d, rate = _elongations(schedule, run, unique)
        with np.errstate(all="ignore"):
            correction = (d[inverse, links] - levels) / rate[inverse, links]
        times = np.clip(np.where(np.abs(correction) < step, times - correction, times), 0.0, schedule.end)
    # a cubic may have a root where a motion that sets in gently has none
    converged = np.abs(correction) <= _CONVERGED * step
    links, times = links[converged], times[converged]
    return tuple(distinct(times[links == number], schedule.end) for number in range(len(tops)))


def after_onset(crossed: Floats, time: Floats, d: Floats, tops: Floats) -> Floats:
    """The times `crossed` without those before a link with elongation `d` (N,) m at `time` (N,) s begins to move.

    Rounding moves a sink that rests on its top back and forth until the first wave arrives.
    """
    if not (len(crossed) and len(tops)):
        return crossed
    distance = np.abs(d[:, None] - tops).min(axis=1)
    first = int(np.argmax(distance > _ONSET * distance.max()))
    later: Floats = crossed[crossed >= time[max(first - 1, 0)]]
    return later


def distinct(times: Floats, end: float) -> Floats:
    """`times` in order, without those at the start of a run that ends at `end`, coinciding ones once."""
    times = np.sort(times)
    times = times[times > _DISTINCT * end]
    apart: Floats = times[np.append(True, np.diff(times) > _DISTINCT * end)] if len(times) else times
    return apart


def _elongations(schedule: RunSchedule, run: RunLog, times: Floats) -> tuple[Floats, Floats]:
    """(M, L) elongations in m and rates in m/s of all links at `times` (M,)."""
    structure = schedule.structure
    x, v, _ = motion = room(structure, len(times))
    integrate(schedule, times, options=RunOptions(repeated=run, into=motion))
    return LinkForces(structure, schedule.excitation).elongations(times, x, v)


def _roots_of_cubics(
    edges: Floats, d: Floats, rate: Floats, tops: Sequence[Floats]
) -> tuple[Indices, Floats, Floats]:
    """Link, top in m and time in s of every root of the cubics through `d` and `rate` at the `edges`."""
    found = []
    for link, some in enumerate(tops):
        cubics = scipy.interpolate.CubicHermiteSpline(edges, d[:, link], rate[:, link])
        for top in some.tolist():
            times = cubics.solve(top, extrapolate=False)
            found += [(link, top, time) for time in times[np.isfinite(times)].tolist()]
    links, levels, roots = np.array(found).reshape(-1, 3).T
    return links.astype(np.intp), levels, roots


@dataclass(frozen=True, eq=False)
class Potentials:
    """The potentials of L links in W `structures` of one shape.

    `values` (W,) of each coefficient by link, `masses` (n, W) kg, and the `barriers` of each link, (W, K) m and (W,) J.
    """

    structures: tuple[Structure, ...]
    values: tuple[dict[str, Floats], ...]
    masses: Floats
    barriers: tuple[Barriers, ...]

    @classmethod
    def of(cls, structures: Sequence[Structure]) -> Potentials:
        """The potentials of structures of one shape."""
        first = structures[0]
        values, of_links = [], []
        for number, link in enumerate(first.links):
            own = [structure.links[number].values for structure in structures]
            values.append({name: np.array([each[name] for each in own]) for name in link.coefficients})
            of_links.append(barriers(link.law, values[-1], len(structures)))
        masses = np.stack([structure.mass_values for structure in structures], axis=1)
        return cls(tuple(structures), tuple(values), masses, tuple(of_links))

    @property
    def floor(self) -> Floats:
        """(W,) J: the potential energy with all links in their lowest wells."""
        return np.asarray(np.sum([link.floor for link in self.barriers], axis=0))

    def tops(self, run: int) -> list[Floats]:
        """(K,) m: the tops of the barriers of each link in one structure."""
        return [link.tops[run][np.isfinite(link.tops[run])] for link in self.barriers]

    def of_runs(self, runs: Indices) -> Potentials:
        """The potentials of some of the structures."""
        return Potentials(
            tuple(self.structures[run] for run in runs),
            tuple({name: value[runs] for name, value in values.items()} for values in self.values),
            self.masses[:, runs],
            tuple(Barriers(link.tops[runs], link.floor[runs]) for link in self.barriers),
        )

    def stored(self, x: Floats, x_base: Floats | None) -> Floats:
        """(N, W) J above the lowest wells at displacements `x` (N, n, W) m; `x_base` (N,) m, None if the base rests."""
        d = elongations(self.structures, x, x_base)
        energy = np.zeros((x.shape[0], x.shape[2]))
        for number, (link, values) in enumerate(zip(self.structures[0].links, self.values, strict=True)):
            energy += link.law.potential(d[..., number], values)
        return energy - self.floor

    def kinetic(self, v: Floats) -> Floats:
        """(N, W) J at velocities `v` (N, n, W) m/s."""
        return np.asarray(0.5 * np.einsum("tiw,iw->tw", v * v, self.masses))


def elongations(structures: Sequence[Structure], x: Floats, x_base: Floats | None) -> Floats:
    """(N, W, L) m: elongations of all links in W structures at displacements `x` (N, n, W) m; `x_base` (N,) m of the base."""
    parts = []
    for structure, alike in moving_alike(structures):
        samples, size, runs = x[..., alike].shape
        repeated = None if x_base is None else np.repeat(x_base, runs)
        flat = structure.elongations(x[..., alike].transpose(0, 2, 1).reshape(-1, size), repeated)
        parts.append(flat.reshape(samples, runs, -1))
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)


def rest_positions(structures: Sequence[Structure], primaries: Sequence[str]) -> list[Floats]:
    """Displacements (E, P) m of the masses `primaries` in the stable equilibria of each of several structures of one shape.

    Zero if all links have their only well at zero elongation; otherwise equilibria are searched. Zero, too, for a structure
    without a stable equilibrium, or with too many equilibria to count.
    """
    potentials = Potentials.of(structures)
    at_zero = np.ones(len(structures), dtype=bool)
    for number, barriers in enumerate(potentials.barriers):
        alike = [structure.links[number] for structure in structures]
        at_zero &= (barriers.floor == 0.0) & ~np.isfinite(barriers.tops).any(axis=1)
        at_zero &= np.array([float(link.force(0.0, states=link.zero_states)) == 0.0 for link in alike])
    zero, pairs = np.zeros((1, len(primaries))), zip(structures, at_zero, strict=True)
    return [zero if simple else _stable(structure, primaries) for structure, simple in pairs]


def _stable(structure: Structure, primaries: Sequence[str]) -> Floats:
    try:
        stable = [point.x[None, :, None] for point in equilibria(structure).stable]
    except StructureError:
        stable = []
    places = [place_motion([structure], x, primaries)[0, :, 0] for x in stable]
    return np.unique(np.array(places), axis=0) if places else np.zeros((1, len(primaries)))


@dataclass(frozen=True, eq=False)
class Runs:
    """W runs at `time` (N,) s: `x` (N, n, W) m and `v` (N, n, W) m/s.

    `dissipated` (N, L, W) J is the energy that each link has dissipated, `supplied` (N, W) J the energy at the start, with
    potentials relative to d = 0, and all work done since. `crossings` holds, by run and link, the times in s at which the link
    went from one well to another; `delivered` the energy (W,) J that harvesters given by an expression took, by link.
    """

    time: Floats
    x: Floats
    v: Floats
    dissipated: Floats
    supplied: Floats
    crossings: tuple[tuple[Floats, ...], ...]
    delivered: Mapping[str, Floats] = field(default_factory=dict)


_BY_RUN = ("x", "v", "dissipated", "supplied")  # arrays of `Runs` whose last axis is that of the runs


def _joined(runs: Sequence[Runs]) -> Runs:
    """Several runs as one object."""
    first = runs[0]
    arrays = {name: np.concatenate([getattr(own, name) for own in runs], axis=-1) for name in _BY_RUN}
    crossings = tuple(of_run for own in runs for of_run in own.crossings)
    delivered = {link: np.concatenate([own.delivered[link] for own in runs]) for link in first.delivered}
    return Runs(time=first.time, crossings=crossings, delivered=delivered, **arrays)


def single_run(motion: SimulatedMotion, tops: list[Floats], powers: Mapping[str, Expression]) -> Runs:
    """One motion in full precision and with the kinks of its laws.

    `tops` (K,) m are those of the barriers of each link, `powers` those that links deliver, in W.
    """
    energy, schedule = motion.energy, motion.schedule
    d = schedule.structure.elongations(motion.displacement, schedule.excitation.base_at(schedule.times))
    times = crossings(schedule, motion.run, tops)
    return Runs(
        time=schedule.times,
        x=motion.displacement[..., None],
        v=motion.velocity[..., None],
        dissipated=energy.dissipated[..., None],
        supplied=energy.supplied[..., None],
        crossings=(tuple(after_onset(times[k], schedule.times, d[:, k], tops[k]) for k in range(len(tops))),),
        delivered={link: np.array([energy]) for link, energy in delivered_energy(motion, powers).items()},
    )


def batch_runs(
    schedules: Sequence[RunSchedule],
    potentials: Potentials,
    powers: Mapping[str, Expression],
    *,
    one_by_one: bool = False,
) -> tuple[Runs | None, Bools]:
    """Of schedules that differ in numbers only, the runs that came to their end, None without any, and (W,) which did.

    `potentials` are those of their structures, `powers` those that their links deliver, in W. The runs are made side by side
    in double precision, or `one_by_one`, as they are if a law is not smooth or has memory, or shapes of hosts differ.
    """
    memory = any(link.law.states for link in schedules[0].structure.links)
    alike = have_equal_shapes(potentials.structures)
    if one_by_one or memory or powers or not (alike and can_batch(schedules[0])):
        return _one_by_one(schedules, potentials, powers)
    schedule = schedules[0]
    batch = run_batch(schedules, [link.tops for link in potentials.barriers])
    base_at = schedule.excitation.base_at
    start = np.stack([schedule.start for schedule in schedules], axis=1)[None]
    size = schedule.structure.size
    stored = potentials.stored(start[:, :size], base_at(np.zeros(1)))
    energy = potentials.kinetic(start[:, size:]) + stored + potentials.floor
    d = elongations(potentials.structures, batch.x, base_at(schedule.times))
    kept, crossed = np.flatnonzero(batch.completed), []
    for run in kept.tolist():
        columns = zip(batch.crossings[run], d[:, run].T, potentials.tops(run), strict=True)
        apart = ((distinct(times, schedule.end), own, tops) for times, own, tops in columns)
        crossed.append(tuple(after_onset(times, batch.time, own, tops) for times, own, tops in apart))
    arrays = {"x": batch.x, "v": batch.v, "dissipated": batch.dissipated, "supplied": batch.work + energy}
    own: dict[str, Any] = {name: array[..., kept] for name, array in arrays.items()}
    return Runs(batch.time, **own, crossings=tuple(crossed)) if len(kept) else None, batch.completed


def _one_by_one(
    schedules: Sequence[RunSchedule], potentials: Potentials, powers: Mapping[str, Expression]
) -> tuple[Runs | None, Bools]:
    runs, completed = [], np.ones(len(schedules), dtype=bool)
    for number, schedule in enumerate(schedules):
        try:
            runs.append(single_run(SimulatedMotion.of(schedule), potentials.tops(number), powers))
        except SimulationError:
            completed[number] = False
    return _joined(runs) if runs else None, completed


#: Indices of intervals between samples, axis by axis.
Intervals = tuple[Indices, ...]

TAIL = 0.05  # of the run: a mass that leaves its band so late has not settled within it
_BISECTIONS = 48
_LEAST_PEAKS = 3  # that a rate of decay needs


@dataclass(frozen=True, eq=False)
class Decay:
    """Excursions `x` (N, ...) m of masses from where they rest, and velocities `v` (N, ...) m/s, at `time` (N,) s."""

    time: Floats
    x: Floats
    v: Floats

    @cached_property
    def _step(self) -> float:
        return float(self.time[1] - self.time[0])

    def _cubic(self, intervals: Intervals) -> tuple[Floats, Floats, Floats, Floats]:
        """Coefficients of 1, s, s^2 and s^3 in the `intervals`, s = 0..1."""
        after = (intervals[0] + 1, *intervals[1:])
        start, rise = self.x[intervals], self.x[after] - self.x[intervals]
        first, last = self._step * self.v[intervals], self._step * self.v[after]
        return start, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise

    @cached_property
    def _turning_points(self) -> tuple[Intervals, Floats, Floats]:
        """The intervals (T,) with a turning point, its position 0..1 in each, and the excursion there in m."""
        intervals = np.nonzero(self.v[:-1] * self.v[1:] < 0.0)
        start, a, b, c = self._cubic(intervals)
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0)), b))
            first, second = q / (3.0 * c), a / q
        position = np.clip(np.where((first > 0.0) & (first < 1.0), first, second), 0.0, 1.0)
        return intervals, position, np.abs(start + position * (a + position * (b + position * c)))

    @cached_property
    def _largest(self) -> Floats:
        """(N - 1, ...) m: the largest excursion within each interval."""
        size = np.abs(self.x)
        largest: Floats = np.maximum(size[:-1], size[1:])
        intervals, _, turned = self._turning_points
        largest[intervals] = np.maximum(largest[intervals], turned)
        return largest

    @cached_property
    def envelope(self) -> Floats:
        """(N, ...) m: the largest excursion from each sample on."""
        padded = np.concatenate([self._largest, np.abs(self.x[-1:])])
        return np.maximum.accumulate(padded[::-1], axis=0)[::-1]

    @cached_property
    def peak(self) -> Floats:
        """(...) m: the largest excursion of all."""
        return np.asarray(self._largest.max(axis=0))

    @cached_property
    def mean_square(self) -> Floats:
        """(...) m^2: the mean squared excursion, by the trapezoidal rule with its end correction."""
        square, slope = self.x**2, 2.0 * self.x * self.v
        step = self._step
        total = step * (square.sum(axis=0) - 0.5 * (square[0] + square[-1]))
        total -= step**2 / 12.0 * (slope[-1] - slope[0])
        return np.asarray(total / (self.time[-1] - self.time[0]))

    def settled(self, level: Floats) -> Floats:
        """(...) s: the time after which each excursion stays below `level` (...) m; NaN if it does not.

        A mass that exceeds its level within the last `TAIL` of the run has not settled.
        """
        shape = self.x.shape[1:]
        level = np.broadcast_to(level, shape)
        beyond = self._largest > level
        ever = beyond.any(axis=0)
        last = len(beyond) - 1 - np.argmax(beyond[::-1], axis=0)
        intervals = (last, *np.indices(shape))
        x, a, b, c = self._cubic(intervals)
        turns = np.zeros(self._largest.shape)
        turns[self._turning_points[0]] = self._turning_points[1]
        start, end = np.where(np.abs(x) > level, 0.0, turns[intervals]), np.ones(shape)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            outside = np.abs(x + middle * (a + middle * (b + middle * c))) > level
            start, end = np.where(outside, middle, start), np.where(outside, end, middle)
        times = np.where(ever, self.time[last] + end * self._step, self.time[0])
        late = times > self.time[-1] - TAIL * (self.time[-1] - self.time[0])
        return np.where(late | np.isnan(level), np.nan, times)

    def of_run(self, run: int) -> Decay:
        """The masses (N, masses) of one of several runs."""
        return Decay(self.time, self.x[..., run], self.v[..., run])

    def rate(self, level: Floats) -> Floats:
        """(masses,) 1/s: the rate of an exponential through the peaks above `level` (masses,) m that no later peak exceeds.

        NaN if there are fewer than three such peaks. `x` is (N, masses).
        """
        (intervals, columns), position, turned = self._turning_points
        is_peak = (turned >= self.envelope[intervals + 1, columns]) & (turned >= level[columns])
        is_peak &= turned >= self._largest[intervals, columns]
        rates = np.full(self.x.shape[1], np.nan)
        for column in range(self.x.shape[1]):
            peaks = np.flatnonzero(is_peak & (columns == column))
            if len(peaks) >= _LEAST_PEAKS:
                times = self.time[intervals[peaks]] + self._step * position[peaks]
                rates[column] = -np.polyfit(times, np.log(turned[peaks]), 1)[0]
        return rates


@dataclass(frozen=True, eq=False)
class Vibration:
    """The P primary masses and points, `places`, of W runs of `structures`, about the rest positions nearest to their ends."""

    runs: Runs
    structures: Sequence[Structure]
    places: Sequence[str]
    positions: Sequence[Floats]

    @cached_property
    def rest(self) -> Floats:
        """(P, W) m: where the masses come to rest."""
        last = place_motion(self.structures, self.runs.x[-1:], self.places)[0]
        ends = zip(self.positions, last.T, strict=True)
        return np.stack([at[np.square(at - end).sum(axis=1).argmin()] for at, end in ends], axis=1)

    @cached_property
    def decay(self) -> Decay:
        """The excursions (N, P, W) from there."""
        x = place_motion(self.structures, self.runs.x, self.places)
        v = place_motion(self.structures, self.runs.v, self.places)
        return Decay(self.runs.time, x - self.rest, v)

    @cached_property
    def rms(self) -> Floats:
        """(P, W) m: the root mean square excursion."""
        return np.sqrt(self.decay.mean_square)


def reduction(with_sinks: Floats | float, without: Floats | float) -> Floats:
    """The relative reduction by the sinks; NaN if there is nothing to reduce."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.greater(without, 0.0), 1.0 - np.divide(with_sinks, without), np.nan)


def comparable(without: Floats, units: Collection[str]) -> Floats:
    """(P, ...) factors by which displacements of P masses may be added: 1, but over those `without` sinks in several `units`.

    Metres and radians have no sum, parts of what a mass would do without sinks have one. Masses at rest count for nothing.
    """
    if len(set(units)) <= 1:
        return np.ones_like(without)
    return np.divide(1.0, without, out=np.zeros_like(without), where=without > 0.0)


def root_sum_square(values: Floats) -> Floats:
    """(W,) of `values` (P, W), over the masses."""
    return np.asarray(np.sqrt(np.square(values).sum(axis=0)))
