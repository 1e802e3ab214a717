"""The times at which a link crosses the barrier between two of its wells, on the simulated orbit itself.

Elongation and rate are known at the integrator's own steps, whose Taylor series converge over seven times their length. The
cubic between two steps shows every crossing, and Newton's method on the dense output refines it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.simulation.run import RunLog, RunOptions, integrate
from linkwise.simulation.schedule import RunSchedule

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
    integrate(schedule, schedule.times[-1:], lambda first, states: None, RunOptions(repeated=run, log=steps))
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
    size, base = schedule.structure.size, schedule.excitation.base
    states = np.empty((len(times), 2 * size))

    def receive(first: int, block: Floats) -> None:
        states[first : first + len(block)] = block[:, : 2 * size]

    integrate(schedule, times, receive, RunOptions(repeated=run))
    x_base = None if base is None else base.value(times)
    v_base = None if base is None else base.derivative(times)
    structure = schedule.structure
    return structure.elongations(states[:, :size], x_base), structure.elongations(states[:, size:], v_base)


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
