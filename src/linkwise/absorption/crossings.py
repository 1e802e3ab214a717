"""When a link passes the top between two of its wells, on the very orbit that was simulated.

Elongation and rate are known at the integrator's own steps, whose Taylor series reach seven times as far; the cubic between
two steps shows every passage, and Newton's method on the dense output puts it where it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.simulation.run import RunLog, RunOptions, integrate
from linkwise.simulation.schedule import RunSchedule

_NEWTON = 5  # runs after the cubic at most; two make its error of 1e-6 of a step one of rounding
_AGREED = 1e-6  # of a step: the last move of a root that was found
_TREMBLE = 1e-9  # of the farthest from a top: a link that near has not begun to move
_SAME = 1e-9  # of the run: passages closer than that are one, and one so close to the start is the start


def crossings(schedule: RunSchedule, run: RunLog, tops: Sequence[Floats]) -> tuple[Floats, ...]:
    """Times in s at which each link passes one of its `tops`, (K,) m a link, on the schedule that went as `run`.

    A link that starts on a top does not pass it by leaving it.
    """
    if not any(len(each) for each in tops):
        return tuple(np.empty(0) for _ in tops)
    steps: list[float] = []
    integrate(schedule, schedule.times[-1:], lambda first, states: None, RunOptions(repeated=run, log=steps))
    edges = np.unique(np.concatenate([[0.0], schedule.stops, steps]))
    edges = edges[np.append(np.diff(edges) > _SAME * 1e-3 * schedule.end, True)]
    d, rate = _motion(schedule, run, edges)
    links, levels, times = _guesses(edges, d, rate, tops)
    order = np.argsort(times, kind="stable")
    links, levels, times = links[order], levels[order], times[order]
    step = schedule.end / max(run.steps, 1)
    move = np.full(len(times), np.inf)
    for _ in range(_NEWTON):
        if not np.any(np.abs(move) > _AGREED * step):
            break
        unique, back = np.unique(times, return_inverse=True)
        d, rate = _motion(schedule, run, unique)
        with np.errstate(all="ignore"):
            move = (d[back, links] - levels) / rate[back, links]
        times = np.clip(np.where(np.abs(move) < step, times - move, times), 0.0, schedule.end)
    passed = np.abs(move) <= _AGREED * step  # a cubic may bend where a motion that sets in gently does not
    links, times = links[passed], times[passed]
    return tuple(distinct(times[links == number], schedule.end) for number in range(len(tops)))


def after_onset(times: Floats, time: Floats, d: Floats, tops: Floats) -> Floats:
    """Passages at `times` of a link with elongation `d` (N,) at samples `time` (N,), without those before it moves.

    A sink that rests on its top until the first wave arrives trembles there by rounding, from one side to the other.
    """
    if not (len(times) and len(tops)):
        return times
    away = np.abs(d[:, None] - tops).min(axis=1)
    first = int(np.argmax(away > _TREMBLE * away.max()))
    later: Floats = times[times >= time[max(first - 1, 0)]]
    return later


def distinct(times: Floats, end: float) -> Floats:
    """`times` in order without those at the start of a run that ends at `end`, near ones once."""
    times = np.sort(times)
    times = times[times > _SAME * end]
    apart: Floats = times[np.append(True, np.diff(times) > _SAME * end)] if len(times) else times
    return apart


def _motion(schedule: RunSchedule, run: RunLog, times: Floats) -> tuple[Floats, Floats]:
    """(M, L) elongations and rates of all links at `times`."""
    size, base = schedule.structure.size, schedule.excitation.base
    states = np.empty((len(times), 2 * size))

    def receive(first: int, block: Floats) -> None:
        states[first : first + len(block)] = block

    integrate(schedule, times, receive, RunOptions(repeated=run))
    where = None if base is None else base.value(times)
    moving = None if base is None else base.derivative(times)
    structure = schedule.structure
    return structure.elongations(states[:, :size], where), structure.elongations(states[:, size:], moving)


def _guesses(
    edges: Floats, d: Floats, rate: Floats, tops: Sequence[Floats]
) -> tuple[Indices, Floats, Floats]:
    """Link, level and time of every root of the cubics through `d` and `rate` at the `edges`."""
    links: list[int] = []
    levels: list[float] = []
    times: list[float] = []
    step = np.diff(edges)
    for number, heights in enumerate(tops):
        first, last = d[:-1, number], d[1:, number]
        inner = first + step * rate[:-1, number] / 3.0, last - step * rate[1:, number] / 3.0
        corners = np.stack([first, *inner, last])  # the cubic stays within the hull of these (Bernstein)
        for height in heights.tolist():
            for row in np.flatnonzero((corners.min(axis=0) <= height) & (corners.max(axis=0) >= height)):
                for place in _roots(corners[:, row] - height):
                    links.append(number)
                    levels.append(height)
                    times.append(float(edges[row] + place * step[row]))
    return np.array(links, dtype=np.intp), np.array(levels), np.array(times)


def _roots(corners: Floats) -> Floats:
    """Real roots in 0..1 of a cubic given by its Bernstein coefficients."""
    b0, b1, b2, b3 = corners
    roots = np.roots([b3 - 3.0 * b2 + 3.0 * b1 - b0, 3.0 * (b2 - 2.0 * b1 + b0), 3.0 * (b1 - b0), b0])
    real = roots.real[np.abs(roots.imag) <= 1e-9]
    found: Floats = real[(real >= 0.0) & (real <= 1.0)]
    return found
