"""Runs of a structure with sinks or without: wells and barriers of its links, energies, crossings and rest positions, and
the vibration of the primary masses about these, its largest excursion still to come, settling and decay.

A crossing is a passage over the top of the barrier between two wells. Elongation and rate are known at the integrator's
own steps: the cubic between two steps shows every crossing, and Newton's method on the dense output refines it. Stored
energy is counted from the lowest well, so that it is never negative. For laws that are polynomials in d, rest points are
their roots.

Between samples the displacement is the cubic Hermite interpolant of displacements and velocities, so that peaks are those
of the motion, not of the samples. Time is on axis 0 of all arrays; runs or masses may follow on further axes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from linkwise.absorption.sinks import delivered_energy, dissipators
from linkwise.analysis.potential_wells import link_rest_points
from linkwise.analysis.rest_positions import equilibria
from linkwise.arrays import Floats, Indices
from linkwise.errors import SimulationError, StructureError
from linkwise.expression import Expression, Number, Program, polynomial
from linkwise.model.coefficient import index_of
from linkwise.model.law import Law
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.simulation.batch import can_batch, run_batch
from linkwise.simulation.energy import LinkForces, kinetic_energy
from linkwise.simulation.run import RunLog, RunOptions, RunSchedule, integrate, room
from linkwise.simulation.simulate import SimulatedMotion

_HIGHEST_ORDER = 12  # of a polynomial law whose rest points are its roots
_REAL = 1e-7  # of the largest root: a smaller imaginary part is the rounding error of a double root


class Barriers(NamedTuple):
    """The barriers of a link: `tops` (K,) m are the elongations, each between two wells, at which the potential is largest,
    and `floor` J is the potential in the lowest well relative to d = 0; 0 if there is no well.
    """

    tops: Floats
    floor: float


def barriers(link: Link) -> Barriers:
    """The barriers of a link.

    A law with too many rest points to count, such as a periodic one, has no barriers here, and its energy is counted from
    d = 0.
    """
    return _of_numbers(link.law, tuple(link.values.values()))


@lru_cache(maxsize=4096)
def _of_numbers(law: Law, values: tuple[float, ...]) -> Barriers:
    """The barriers of links with a law and these values of its coefficients."""
    link = Link("link", ("first", "second"), law, dict(zip(law.coefficients, values, strict=True)))
    points = _rest_points(link)
    places = [d for d, _ in points]
    energy = link.potential(np.array(places))
    wells = [number for number, (_, well) in enumerate(points) if well]
    between = [range(first + 1, last) for first, last in pairwise(wells) if last > first + 1]
    tops = [places[max(hills, key=energy.__getitem__)] for hills in between]
    return Barriers(np.array(tops), min(energy[wells].tolist(), default=0.0))


def _rest_points(link: Link) -> list[tuple[float, bool]]:
    """The rest points of a link in m, ascending, and whether they are wells."""
    powers = _elastic_powers(link.law)
    if powers is not None:
        return _of_polynomial(np.array(powers(*link.values.values())))
    with suppress(StructureError):
        return [(point.d, point.well) for point in link_rest_points(link)]
    return []


@lru_cache(maxsize=256)
def _elastic_powers(law: Law) -> Program | None:
    """What gives the factors of the powers of d in the elastic force from the coefficients, the highest first; None for a law
    that is no polynomial, or one of too high an order.
    """
    terms = polynomial(law.elastic, ("d",))
    order = max((power for (power,) in terms), default=0) if terms else 0
    if not terms or order > _HIGHEST_ORDER:
        return None
    return Program([terms.get((k,), Number(0.0)) for k in range(order, -1, -1)], law.coefficients)


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
    if not any(len(link_tops) for link_tops in tops):
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
    rows = []
    for link, link_tops in enumerate(tops):
        cubics = scipy.interpolate.CubicHermiteSpline(edges, d[:, link], rate[:, link])
        for top in link_tops.tolist():
            times = cubics.solve(top, extrapolate=False)
            rows += [(link, top, time) for time in times[np.isfinite(times)].tolist()]
    links, levels, roots = np.array(rows).reshape(-1, 3).T
    return links.astype(np.intp), levels, roots


def place_motion(structure: Structure, x: Floats, places: Sequence[str]) -> Floats:
    """(N, P) m: motion of P masses or points of a structure, from that (N, n) of its masses and modes."""
    moved = np.zeros((len(x), len(places)))
    for column, place in enumerate(places):
        for number, part in structure.topology.weights(structure.topology.index[place]):
            moved[:, column] += part * x[:, number]
    return moved


def stored_energy(structure: Structure, d: Floats, v: Floats) -> Floats:
    """(N,) J above the lowest wells, at elongations `d` (N, L) m and velocities `v` (N, n) m/s."""
    links = zip(structure.links, d.T, strict=True)
    return sum(
        (link.potential(own) - barriers(link).floor for link, own in links), kinetic_energy(structure, v)
    )


def rest_positions(structure: Structure, primaries: Sequence[str]) -> Floats:
    """Displacements (E, P) m of the masses `primaries` in the stable equilibria of a structure.

    Zero if all links have their only well at zero elongation; otherwise equilibria are searched. Zero, too, for a structure
    without a stable equilibrium, or with too many equilibria to count.
    """
    at_zero = np.zeros((1, len(primaries)))
    if all(map(_rests_at_zero, structure.links)):
        return at_zero
    stable: list[Floats] = []
    with suppress(StructureError):
        stable = [point.x for point in equilibria(structure).stable]
    return np.unique(place_motion(structure, np.array(stable), primaries), axis=0) if stable else at_zero


def _rests_at_zero(link: Link) -> bool:
    own = barriers(link)
    return own.floor == 0.0 and not len(own.tops) and float(link.force(0.0, states=link.zero_states)) == 0.0


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

    @property
    def rms(self) -> Floats:
        """(...) m: the root mean square excursion."""
        return np.sqrt(self.mean_square)

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
class AbsorptionRun:
    """One of the two runs, with N samples of n masses, P primary masses and L links.

    Energy is counted from the lowest wells of all links, so that supplied = stored + sum of dissipated.

    Attributes
    ----------
    primaries : tuple of str
        The primary masses and points.
    positions : (E, P) ndarray
        Displacements in m at which they may come to rest.
    x, v : (N, n) ndarray
        Displacements in m and velocities in m/s of all masses; of a mode its coordinate.
    d : (N, L) ndarray
        Elongations in m of all links.
    dissipated : (N, L) ndarray
        Energy in J that each link has dissipated.
    supplied : (N,) ndarray
        Energy in J at the start and work done on the structure since.
    crossings : tuple of ndarray
        For each link the times in s at which it went from one well to another.
    delivered : mapping of str to float
        Energy in J that harvesters given by an expression took, by link.
    horizon : float or None
        Time in s past which a chaotic motion cannot be predicted; None if it can throughout, or was not asked for.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> run = result.with_sinks
    >>> run.closure < 1e-9
    True
    >>> round(float(run.dissipated[-1].sum() / run.total + run.remaining[-1]), 9)
    1.0
    """

    _schedule: RunSchedule
    primaries: tuple[str, ...]
    positions: Floats
    x: Floats
    v: Floats
    d: Floats
    dissipated: Floats
    supplied: Floats
    crossings: tuple[Floats, ...]
    delivered: Mapping[str, float] = field(default_factory=dict)
    horizon: float | None = None

    @property
    def structure(self) -> Structure:
        """The structure that was run."""
        return self._schedule.structure

    @cached_property
    def rest(self) -> Floats:
        """(P,) m: where the primary masses come to rest, of the `positions` the one nearest to their end."""
        last = place_motion(self.structure, self.x[-1:], self.primaries)
        return np.asarray(self.positions[np.square(self.positions - last).sum(axis=1).argmin()])

    @property
    def envelope(self) -> Floats:
        """(N, P) m: the largest excursion of the primary masses and points from each sample on."""
        return decay_of(self).envelope

    @cached_property
    def stored(self) -> Floats:
        """(N,) J: kinetic and potential energy."""
        return stored_energy(self.structure, self.d, self.v)

    @property
    def total(self) -> float:
        """Energy in J supplied by the end."""
        return float(self.supplied[-1])

    @property
    def remaining(self) -> Floats:
        """(N,) part of `total` that is still stored."""
        return self.stored / self.total

    @property
    def closure(self) -> float:
        """The largest error of the energy balance, as a part of the largest energy supplied."""
        error = self.supplied - self.stored - self.dissipated.sum(axis=1)
        return float(np.abs(error).max() / np.abs(self.supplied).max())

    @cached_property
    def dissipated_by(self) -> dict[str, Floats]:
        """(N,) energy in J that each host, by all its modes, and each other link has dissipated."""
        by = dissipators(self.structure)
        return {name: self.dissipated[:, numbers].sum(axis=1) for name, numbers in by.items()}

    def share(self, link: str) -> float:
        """The part of the energy supplied that a link or a host has dissipated by the end.

        Parameters
        ----------
        link : str
            Name of the link or the host.

        Returns
        -------
        float
            The part of `total`, from 0 to 1.

        Raises
        ------
        ValueError
            If there is no such link.
        """
        if link in self.dissipated_by:
            return float(self.dissipated_by[link][-1] / self.total)
        names = [link.name for link in self.structure.links]
        return float(self.dissipated[-1, names.index(link)] / self.total)

    def displacement(self, place: str) -> Floats:
        """Displacement of a mass or of a point of a host.

        Parameters
        ----------
        place : str
            Its name.

        Returns
        -------
        (N,) ndarray
            Displacement in m.
        """
        return place_motion(self.structure, self.x, [place])[:, 0]

    def host_energy(self, host: str) -> Floats:
        """Kinetic and potential energy of the modes of a host.

        Parameters
        ----------
        host : str
            Name of the host.

        Returns
        -------
        (N,) ndarray
            Energy in J.

        Raises
        ------
        StructureError
            If there is no such host.
        """
        hosts, energy = {host.name: host for host in self.structure.hosts}, np.zeros(len(self.x))
        for mode in index_of(hosts, host, "host", "hosts").coordinates:
            number, link = self.structure.mass_names.index(mode), self.structure.link(mode)
            energy += 0.5 * self.v[:, number] ** 2 + link.potential(self.x[:, number])
        return energy


def decay_of(run: AbsorptionRun) -> Decay:
    """The excursions (N, P) of the primary masses of a run from where they come to rest."""
    x, v = (place_motion(run.structure, motion, run.primaries) for motion in (run.x, run.v))
    return Decay(run._schedule.times, x - run.rest, v)


def single_run(
    motion: SimulatedMotion, primaries: tuple[str, ...], positions: Floats, powers: Mapping[str, Expression]
) -> AbsorptionRun:
    """One motion in full precision and with the kinks of its laws; `powers` are those that links deliver, in W."""
    energy, schedule, x = motion.energy, motion.schedule, motion.displacement
    d, own = _elongation(schedule, x), [barriers(link) for link in schedule.structure.links]
    crossed = _since_onset(schedule, d, crossings(schedule, motion.run, [tops for tops, _ in own]))
    supplied, delivered = energy.supplied - sum(floor for _, floor in own), delivered_energy(motion, powers)
    moved = x, motion.velocity, d, energy.dissipated, supplied
    return AbsorptionRun(schedule, primaries, positions, *moved, crossed, delivered)


def runs_of(
    schedules: Sequence[RunSchedule],
    primaries: tuple[str, ...],
    positions: Sequence[Floats],
    powers: Mapping[str, Expression],
) -> list[AbsorptionRun | None]:
    """The runs of schedules that differ in numbers only; None for one that did not come to its end.

    `powers` are those that links deliver, in W. The runs are made side by side in double precision, or one by one if links
    deliver some, a law is not smooth or has memory, or shapes of hosts differ.
    """
    first, runs = schedules[0], list[AbsorptionRun | None]([None] * len(schedules))
    shapes = [[mode.shape for host in own.structure.hosts for mode in host.modes] for own in schedules]
    memory = any(link.law.states for link in first.structure.links)
    if memory or powers or shapes.count(shapes[0]) < len(shapes) or not can_batch(first):
        for number, (schedule, rests) in enumerate(zip(schedules, positions, strict=True)):
            with suppress(SimulationError):
                runs[number] = single_run(SimulatedMotion.of(schedule), primaries, rests, powers)
        return runs
    levels = [[barriers(link).tops for link in schedule.structure.links] for schedule in schedules]
    for number, own in enumerate(run_batch(schedules, levels)):
        if own is not None:
            schedule = schedules[number]
            d, v = _elongation(schedule, own.x), schedule.start[None, schedule.structure.size :]
            supplied = own.work + stored_energy(schedule.structure, d[:1], v)
            crossed = _since_onset(schedule, d, [distinct(times, schedule.end) for times in own.crossings])
            moved = own.x, own.v, d, own.dissipated, supplied
            runs[number] = AbsorptionRun(schedule, primaries, positions[number], *moved, crossed)
    return runs


def _elongation(schedule: RunSchedule, x: Floats) -> Floats:
    """(N, L) m of all links."""
    return schedule.structure.elongations(x, schedule.excitation.base_at(schedule.times))


def _since_onset(schedule: RunSchedule, d: Floats, crossed: Sequence[Floats]) -> tuple[Floats, ...]:
    """The times at which each link `crossed` a barrier without those before it begins to move."""
    links = zip(crossed, d.T, schedule.structure.links, strict=True)
    return tuple(after_onset(times, schedule.times, own, barriers(link).tops) for times, own, link in links)


def reduction(with_sinks: Floats | float, without: Floats | float) -> Floats:
    """The relative reduction by the sinks; NaN if there is nothing to reduce."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.greater(without, 0.0), 1.0 - np.divide(with_sinks, without), np.nan)


def comparable(without: Floats, units: Collection[str]) -> Floats:
    """(P,) factors by which displacements of P masses may be added: 1, but over those `without` sinks in several `units`.

    Metres and radians have no sum, parts of what a mass would do without sinks have one. Masses at rest count for nothing.
    """
    if len(set(units)) <= 1:
        return np.ones_like(without)
    return np.divide(1.0, without, out=np.zeros_like(without), where=without > 0.0)
