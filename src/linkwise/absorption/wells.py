"""Wells of links along the motion of many structures of one shape: energies, barriers, crossings and rest positions.

A crossing is a passage over the top of the barrier between two wells. Elongation and rate are known at the integrator's
own steps: the cubic between two steps shows every crossing, and Newton's method on the dense output refines it. Stored
energy is counted from the lowest well, so that it is never negative. For laws that are polynomials in d, rest points are
eigenvalues of companion matrices, for all sets of coefficients at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from linkwise.absorption.sinks import delivered_energy, have_equal_shapes, moving_alike, place_motion
from linkwise.analysis.potential_wells import RestPoint, rest_points
from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Expression, Number, Program, polynomial
from linkwise.model.law import Law
from linkwise.model.structure import Structure
from linkwise.simulation.batch import SimulatedMotion, can_batch, run_batch
from linkwise.simulation.energy import LinkForces
from linkwise.simulation.run import RunLog, RunOptions, RunSchedule, integrate, room

_HIGHEST_ORDER = 12  # of a polynomial law whose rest points are found by companion matrices
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
    polynomial_points = _rest_points_of_polynomial(law, rows)
    points, wells = _rest_points_of_any_law(law, rows) if polynomial_points is None else polynomial_points
    distinct = _between_wells(law, rows, points, wells)
    inverse = inverse.reshape(-1)
    return Barriers(distinct.tops[inverse], distinct.floor[inverse])


def _between_wells(law: Law, rows: Floats, points: Floats, wells: Bools) -> Barriers:
    """The highest rest point between each two wells.

    From rest points `points` (R, K) m, ascending with NaN at the end, and which of them are `wells` (R, K).
    """
    runs = len(rows)
    present = np.isfinite(points)
    named = {name: rows[:, k, None] for k, name in enumerate(law.coefficients)}
    energy = np.where(present, law.potential(np.where(present, points, 0.0), named), -np.inf)
    passed_well = np.zeros(runs, dtype=bool)
    highest, position = np.full(runs, -np.inf), np.full(runs, np.nan)
    tops = []
    for k in range(points.shape[1]):
        well = wells[:, k]
        tops.append(np.where(well & passed_well, position, np.nan))
        higher = ~well & present[:, k] & (energy[:, k] > highest)
        position = np.where(higher, points[:, k], position)
        highest = np.where(well, -np.inf, np.where(higher, energy[:, k], highest))
        passed_well |= well
    table = np.sort(np.stack(tops, axis=1), axis=1) if tops else np.zeros((runs, 0))
    floor = np.where(wells, energy, np.inf).min(axis=1, initial=np.inf)
    most = int(np.isfinite(table).sum(axis=1).max(initial=0))
    return Barriers(table[:, :most], np.where(np.isfinite(floor), floor, 0.0))


def _rest_points_of_any_law(law: Law, rows: Floats) -> tuple[Floats, Bools]:
    """Rest points (R, K) m and which of them are wells (R, K), one set of coefficients after the other."""
    sets = [_rest_points(law, dict(zip(law.coefficients, row.tolist(), strict=True))) for row in rows]
    width = max((len(some) for some in sets), default=0)
    points, wells = np.full((len(rows), width), np.nan), np.zeros((len(rows), width), dtype=bool)
    for number, some in enumerate(sets):
        points[number, : len(some)] = [point.d for point in some]
        wells[number, : len(some)] = [point.well for point in some]
    return points, wells


def _rest_points(law: Law, values: Mapping[str, float]) -> tuple[RestPoint, ...]:
    still = dict.fromkeys(law.states, 0.0)

    def force(d: Floats) -> Floats:
        return np.broadcast_to(law.force(d, 0.0, {**values, **still}), np.shape(d))

    def slope(d: Floats) -> Floats:
        return np.broadcast_to(law.partials(d, 0.0, {**values, **still}).by_d, np.shape(d))

    try:
        return rest_points(force, slope)
    except StructureError:
        return ()


def _rest_points_of_polynomial(law: Law, rows: Floats) -> tuple[Floats, Bools] | None:
    """The same for a law that is a polynomial in d; None for another law.

    A root is a well if the force changes from negative to positive there, which the middles between roots show.
    """
    terms = polynomial(law.elastic, ("d",))
    if terms is None or not terms or max(power for (power,) in terms) > _HIGHEST_ORDER:
        return None
    order = max(power for (power,) in terms)
    program = Program([terms.get((k,), Number(0.0)) for k in range(order + 1)], law.coefficients)
    columns = program(*(rows[:, k] for k in range(rows.shape[1])))
    table = np.stack([np.broadcast_to(column, len(rows)) for column in columns], axis=1)
    points = np.sort(_real_roots(table), axis=1)
    largest = np.nanmax(np.abs(np.where(np.isnan(points), 0.0, points)), axis=1, initial=0.0)
    beyond = np.where(largest > 0.0, 2.0 * largest, 1.0)[:, None]
    edges = np.concatenate([-beyond, np.where(np.isnan(points), beyond, points), beyond], axis=1)
    edges[:, 1:-1][np.isnan(points)] = np.repeat(beyond, points.shape[1], axis=1)[np.isnan(points)]
    middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
    force = np.zeros(middle.shape)
    for k in range(order, -1, -1):
        force = force * middle + table[:, k, None]
    return points, np.isfinite(points) & (force[:, :-1] < 0.0) & (force[:, 1:] > 0.0)


def _real_roots(table: Floats) -> Floats:
    """(R, K) distinct real roots of polynomials (R, K + 1), lowest power first; NaN for those that are missing."""
    runs, width = table.shape[0], table.shape[1] - 1
    roots = np.full((runs, width), np.nan)
    degree = np.where(table != 0.0, np.arange(width + 1), 0).max(axis=1)
    for order in np.unique(degree[degree > 0]):
        rows = np.flatnonzero(degree == order)
        powers = order - np.arange(order)
        monic = table[rows, :order] / table[rows, order, None]
        size = (np.abs(monic) ** (1.0 / powers)).max(axis=1)
        size[size == 0.0] = 1.0
        companion = np.zeros((len(rows), order, order))
        companion[:, np.arange(1, order), np.arange(order - 1)] = 1.0
        companion[:, :, -1] = -monic / size[:, None] ** powers
        eigenvalues = np.linalg.eigvals(companion)
        real = np.sort(np.where(np.abs(eigenvalues.imag) <= _REAL, eigenvalues.real, np.nan), axis=1)
        real[:, 1:][np.diff(real, axis=1) <= _REAL] = np.nan
        roots[rows, :order] = real * size[:, None]
    return roots


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
    order = np.argsort(times, kind="stable")
    links, levels, times = links[order], levels[order], times[order]
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
    links: list[int] = []
    levels: list[float] = []
    times: list[float] = []
    step = np.diff(edges)
    for link, some in enumerate(tops):
        first, last = d[:-1, link], d[1:, link]
        inner = first + step * rate[:-1, link] / 3.0, last - step * rate[1:, link] / 3.0
        bernstein = np.stack([first, *inner, last])  # the cubic lies within the hull of its coefficients
        for top in some.tolist():
            enclosed = (bernstein.min(axis=0) <= top) & (bernstein.max(axis=0) >= top)
            for interval in np.flatnonzero(enclosed):
                for root in _roots(bernstein[:, interval] - top):
                    links.append(link)
                    levels.append(top)
                    times.append(float(edges[interval] + root * step[interval]))
    return np.array(links, dtype=np.intp), np.array(levels), np.array(times)


def _roots(bernstein: Floats) -> Floats:
    """The real roots in [0, 1] of a cubic given by its Bernstein coefficients (4,)."""
    b0, b1, b2, b3 = bernstein
    roots = np.roots([b3 - 3.0 * b2 + 3.0 * b1 - b0, 3.0 * (b2 - 2.0 * b1 + b0), 3.0 * (b1 - b0), b0])
    real = roots.real[np.abs(roots.imag) <= 1e-9]
    inside: Floats = real[(real >= 0.0) & (real <= 1.0)]
    return inside


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

    def of_runs(self, runs: Indices) -> Runs:
        """Some of the runs."""
        return Runs(
            self.time,
            self.x[..., runs],
            self.v[..., runs],
            self.dissipated[..., runs],
            self.supplied[..., runs],
            tuple(self.crossings[run] for run in runs),
            {link: energy[runs] for link, energy in self.delivered.items()},
        )


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
) -> tuple[Runs, Bools]:
    """Runs of schedules that differ in numbers only, and (W,) which of them came to their end.

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
    crossed = []
    for run, of_run in enumerate(batch.crossings):
        columns = zip(of_run, d[:, run].T, potentials.tops(run), strict=True)
        apart = ((distinct(times, schedule.end), own, tops) for times, own, tops in columns)
        crossed.append(tuple(after_onset(times, batch.time, own, tops) for times, own, tops in apart))
    runs = Runs(batch.time, batch.x, batch.v, batch.dissipated, batch.work + energy, tuple(crossed))
    return runs, batch.completed


def _one_by_one(
    schedules: Sequence[RunSchedule], potentials: Potentials, powers: Mapping[str, Expression]
) -> tuple[Runs, Bools]:
    samples, structure = len(schedules[0].times), schedules[0].structure
    size, links, count = structure.size, len(structure.links), len(schedules)
    x, v = np.full((samples, size, count), np.nan), np.full((samples, size, count), np.nan)
    dissipated, supplied = np.full((samples, links, count), np.nan), np.full((samples, count), np.nan)
    delivered = {link: np.full(count, np.nan) for link in powers}
    crossed: list[tuple[Floats, ...]] = []
    completed = np.ones(count, dtype=bool)
    for number, schedule in enumerate(schedules):
        try:
            run = single_run(SimulatedMotion.of(schedule), potentials.tops(number), powers)
        except SimulationError:
            completed[number] = False
            crossed.append(tuple(np.empty(0) for _ in range(links)))
            continue
        x[..., number], v[..., number] = run.x[..., 0], run.v[..., 0]
        dissipated[..., number], supplied[:, number] = run.dissipated[..., 0], run.supplied[:, 0]
        crossed += run.crossings
        for link, energy in run.delivered.items():
            delivered[link][number] = energy[0]
    return Runs(schedules[0].times, x, v, dissipated, supplied, tuple(crossed), delivered), completed
