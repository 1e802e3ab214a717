"""All steady motions at one level: starts of every kind, followed to curves, each curve once.

Starts are rest in every well, states at random and the motions at the level before, at several frequencies. From each a
simulation runs until it repeats; Newton's method makes a periodic motion of its end, or of the start itself, and the
curve through that motion is followed both ways. What does not repeat is chaotic or quasi-periodic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.response.continuation import Point, Steps, between, follow, solve, turned, with_located
from linkwise.response.result import FOLD
from linkwise.response.shooting import Shooting, monodromy

DOUBLING, TORUS, BRANCHING = "period doubling", "Neimark-Sacker", "branch point"
_LONGEST = 0.08  # step along a curve
_BLOCK, _BLOCKS = 40, 12  # turns between two looks whether a motion repeats, and how often
_PERIODS = (1, 2, 3, 4)  # turns of a period that are looked for
_REPEATS = 0.02  # of its size: a motion that comes back so near repeats, or will
_SAME = 1e-5  # of its size: two motions so near are one
_ON_CURVE = 1e-3  # of its size: a curve passes so near through a motion that is on it
_WILD = 100.0  # multiplier from which a motion is one of the endless unstable ones of a chaotic structure
_MOST_CURVES, _MOST_POINTS = 24, 600  # at a level, and of a curve each way
_PEAK_STEPS, _PEAK = 4, 1e-6  # parabolas to a peak, and the part of a step that a further one must move it
_EXPONENT_TURNS = 200
_REGULAR = 3e-3  # growth in a turn: a motion whose neighbours come nearer faster is still settling
_CHAOTIC = 1e-2  # the same of one whose neighbours part


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of periodic motions: its points, each with the name of a bifurcation or "", and whether it is closed."""

    shooting: Shooting
    points: tuple[tuple[Point, str], ...]
    closed: bool

    def contains(self, motion: Point, shooting: Shooting) -> bool:
        """Whether a motion is on the curve, begun at any turn of its period."""
        if shooting.turns != self.shooting.turns:
            return False
        starts = [motion.unknowns[:-1]]
        if shooting.turns > 1:
            starts += list(shooting.after(motion.unknowns[:-1], motion.parameter, shooting.turns - 1))
        return any(self._passes(np.append(start, motion.parameter), motion.sizes) for start in starts)

    def at(self, omega: float) -> Iterator[Floats]:
        """Unknowns (N + 1,) near the points of the curve at omega, one for each time that it passes there."""
        for (first, _), (last, _) in pairwise(self.points):
            change = last.parameter - first.parameter
            part = (omega - first.parameter) / change if change else -1.0
            if 0.0 <= part < 1.0:
                yield np.append((1.0 - part) * first.unknowns[:-1] + part * last.unknowns[:-1], omega)

    def _passes(self, unknowns: Floats, sizes: Floats) -> bool:
        """Whether the curve passes through unknowns: through them goes the plane on which the curve is solved for."""
        for (first, _), (last, _) in pairwise(self.points):
            chord, way = (
                (last.unknowns - first.unknowns) / first.sizes,
                (unknowns - first.unknowns) / first.sizes,
            )
            length, part = chord @ first.tangent, way @ first.tangent
            if length == 0.0 or not -0.01 <= part / length <= 1.01:
                continue
            guess = first.unknowns + part / length * (last.unknowns - first.unknowns)
            if np.linalg.norm((guess - unknowns) / first.sizes) > 3.0 * _LONGEST:
                continue
            on_curve = solve(self.shooting, guess, first.tangent)
            if on_curve is not None and np.abs((on_curve.unknowns - unknowns) / sizes).max() < _ON_CURVE:
                return True
        return False


@dataclass(frozen=True, eq=False)
class IrregularMotion:
    """A motion that does not repeat: omega in rad/s, its `exponent` in 1/s, and states (M, N) over its last turns."""

    omega: float
    exponent: float
    states: Floats
    phases: Floats
    chaotic: bool


@dataclass(eq=False)
class LevelSearch:
    """The curves and irregular motions that were found at the level of a `shooting`, and looks for more."""

    shooting: Shooting
    curves: list[Curve] = field(default_factory=list)
    irregular: list[IrregularMotion] = field(default_factory=list)

    def take(self, unknowns: Floats, turns: int = 1) -> Point | None:
        """The periodic motion near unknowns, whose curve is followed unless it is known; None where there is none."""
        shooting = self.shooting.with_turns(turns)
        motion = solve(shooting, unknowns)
        if motion is None or np.abs(multipliers(motion)).max() > _WILD:
            return None
        if turns > 1 and self._repeats_sooner(motion, turns):
            return self.take(motion.unknowns, 1)
        if len(self.curves) < _MOST_CURVES and not any(
            curve.contains(motion, shooting) for curve in self.curves
        ):
            self.curves.append(whole_curve(shooting, motion))
        return motion

    def _repeats_sooner(self, motion: Point, turns: int) -> bool:
        states = self.shooting.after(motion.unknowns[:-1], motion.parameter, turns - 1)
        return bool((np.abs((states - motion.unknowns[:-1]) / motion.sizes[:-1]).max(axis=1) < _SAME).any())

    def settle(self, start: Floats, omega: float) -> None:
        """Simulate from a start (N,) until the motion repeats; follow the curve it is on, or keep what does not repeat."""
        state = start
        for _ in range(_BLOCKS):
            states = self.shooting.after(state, omega, _BLOCK)
            if not np.isfinite(states).all():
                return
            state = states[-1]
            if (turns := self._period(states, omega)) and self._attracts(state, omega, turns):
                return
        motion = irregular_motion(self.shooting, state, omega)
        if motion is not None:
            self.irregular.append(motion)

    def _period(self, states: Floats, omega: float) -> int:
        """The turns after which a motion comes back near to itself; 0 if it does not."""
        sizes = self.shooting.sizes(np.append(states[-1], omega))[:-1]
        for turns in _PERIODS:
            apart = np.abs((states[turns:] - states[:-turns]) / sizes).max(axis=1)
            if apart[-2 * max(_PERIODS) :].max() < _REPEATS:
                return turns
        return 0

    def _attracts(self, state: Floats, omega: float, turns: int) -> bool:
        """Whether there is a stable periodic motion near a state."""
        motion = self.take(np.append(state, omega), turns)
        return motion is not None and bool(np.abs(multipliers(motion)).max() < 1.0)


def whole_curve(shooting: Shooting, start: Point) -> Curve:
    """The curve through a motion, followed both ways, with its bifurcations."""
    steps = Steps(shooting.bounds, longest=_LONGEST, most=_MOST_POINTS, stop=_is_wild)
    rising = np.eye(len(start.unknowns))[-1]
    forward, closed = follow(shooting, turned(start, rising), steps)
    backward: list[Point] = []
    if not closed:
        backward, _ = follow(shooting, turned(start, -rising), steps)
    back = [point._replace(tangent=-point.tangent) for point in reversed(backward)]
    points = [*back, turned(start, rising), *forward]
    marked = with_located(shooting, points, _TESTS)
    return Curve(shooting, tuple(_confirmed(marked)), closed)


def with_peak(curve: Curve, amplitude: Callable[[Point], float]) -> Curve:
    """The curve with points at the largest of a smooth `amplitude`, where that is inside, by parabolas."""
    points = list(curve.points)
    values = [amplitude(point) for point, _ in points]
    for _ in range(_PEAK_STEPS):
        top = int(np.argmax(values))
        if not 0 < top < len(points) - 1:
            break
        three = [point for point, _ in points[top - 1 : top + 2]]
        lengths = [
            float(np.linalg.norm((b.unknowns - a.unknowns) / three[1].sizes)) for a, b in pairwise(three)
        ]
        way = _vertex(lengths, values[top - 1 : top + 2])
        first = top - 1 if way < 0.0 else top
        part = 1.0 + way / lengths[0] if way < 0.0 else way / lengths[1]
        if not _PEAK < part < 1.0 - _PEAK:
            break
        found = between(curve.shooting, points[first][0], points[first + 1][0], part)
        if found is None:
            break
        points.insert(first + 1, (found, ""))
        values.insert(first + 1, amplitude(found))
    return replace(curve, points=tuple(points))


def _vertex(lengths: Sequence[float], values: Sequence[float]) -> float:
    """Where the parabola through three points has its vertex, as a way from the middle one."""
    (left, right), (before, here, after) = lengths, values
    rise, fall = (here - before) / left, (after - here) / right
    bend = (fall - rise) / (left + right)
    return -0.5 * (rise * right + fall * left) / (left + right) / bend if bend < 0.0 else 0.0


def multipliers(point: Point) -> NDArray[np.complex128]:
    """The Floquet multipliers (N,) of a periodic motion."""
    return np.asarray(np.linalg.eigvals(monodromy(point.jacobian)), dtype=complex)


def _is_wild(point: Point) -> bool:
    return bool(np.abs(multipliers(point)).max() > _WILD**2)


def _at_fold(point: Point) -> float:
    return float(point.tangent[-1])


def _at_doubling(point: Point) -> float:
    return float(np.prod(multipliers(point) + 1.0).real)


def _at_torus(point: Point) -> float:
    values = multipliers(point)
    pairs = np.triu_indices(len(values), 1)
    return float(np.prod(values[pairs[0]] * values[pairs[1]] - 1.0).real)


def _at_branching(point: Point) -> float:
    """Zero with a multiplier of 1 that is no fold's."""
    return float(np.prod(multipliers(point) - 1.0).real / (point.tangent[-1] or np.nan))


_TESTS = ((FOLD, _at_fold), (DOUBLING, _at_doubling), (TORUS, _at_torus), (BRANCHING, _at_branching))


def _confirmed(marked: Sequence[tuple[Point, str]]) -> Iterator[tuple[Point, str]]:
    """The points without those where nothing gains or loses stability, though a test vanishes, as between real multipliers."""
    counts = [int((np.abs(multipliers(point)) > 1.0).sum()) for point, _ in marked]
    for number, (point, name) in enumerate(marked):
        if not name or name == FOLD or counts[number - 1] != counts[min(number + 1, len(marked) - 1)]:
            yield point, name


def irregular_motion(shooting: Shooting, state: Floats, omega: float) -> IrregularMotion | None:
    """What a motion that does not repeat is, by its largest exponent; None where it is only slow to settle."""
    integrator, growth = shooting.integrator, 0.0
    integrator.set_parameters(shooting.parameters)
    direction = sizes = shooting.sizes(np.append(state, omega))[:-1]
    for _ in range(_EXPONENT_TURNS):
        turn = integrator.turn(state, omega, 2.0 * np.pi)
        if not np.isfinite(turn.end).all():
            return None
        direction, before = turn.by_start @ direction, np.linalg.norm(direction / sizes)
        growth += float(np.log(np.linalg.norm(direction / sizes) / before))
        direction, state = direction / np.linalg.norm(direction / sizes), turn.end
    rate = growth / _EXPONENT_TURNS
    if rate < -_REGULAR:
        return None
    long = shooting.with_turns(60)
    states = long.motion(np.append(state, omega), 64)
    phases = np.linspace(0.0, long.period, len(states))
    return IrregularMotion(omega, rate * omega / (2.0 * np.pi), states, phases, rate > _CHAOTIC)


def random_starts(
    centres: Floats, reach: float, omega: float, states: int, rng: np.random.Generator, count: int
) -> Iterator[Floats]:
    """States (N,) about rest positions `centres` (W, n), displacements to within some `reach` in m."""
    for _ in range(count):
        centre = centres[rng.integers(len(centres))]
        x = centre + reach * rng.standard_normal(len(centre))
        yield np.concatenate([x, reach * omega * rng.standard_normal(len(centre)), np.zeros(states)])
