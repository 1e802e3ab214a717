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

from linkwise.arrays import Floats
from linkwise.response.continuation import (
    Point,
    between,
    follow,
    solve,
    turned,
    with_located,
)
from linkwise.response.result import FOLD
from linkwise.response.shooting import PeriodicEquations, Shooting

DOUBLING, TORUS, BRANCHING = "period doubling", "Neimark-Sacker", "branch point"
_LONGEST = 0.08  # step along a curve
_BLOCK, _BLOCKS = 40, 12  # turns between two looks whether a motion repeats, and how often
_PERIODS = (1, 2, 3, 4)  # turns of a period that are looked for
_REPEATS = 0.02  # of its size: a motion that comes back so near repeats, or will
_SAME = 1e-5  # of its size: two motions so near are one
_ON_CURVE = 1e-3  # of its size: a curve passes so near through a motion that is on it
_ASIDE = 0.01  # of its size: a simulation so far from an unstable motion leaves it
_WILD = 100.0  # multiplier from which a motion is one of the endless unstable ones of a chaotic structure
_BRANCH_STEPS = (_LONGEST, _LONGEST / 4, _LONGEST / 16)  # onto another curve
_MOST_CURVES = 24  # at a level
_PEAK_STEPS, _PEAK = 4, 1e-6  # parabolas to a peak, and the part of a step that a further one must move it
_SHARP = 1.01  # amplitude beside a minimum over that there: of an antiresonance, which steps along the curve pass over
_EXPONENT_TURNS = 200
_REGULAR = 3e-3  # growth in a turn: a motion whose neighbours come nearer faster is still settling
_CHAOTIC = 1e-2  # the same of one whose neighbours part


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve of periodic motions: its points, each with the name of a bifurcation or ""."""

    equations: PeriodicEquations
    points: tuple[tuple[Point, str], ...]

    def contains(self, motion: Point) -> bool:
        """Whether a motion is on the curve, begun at any turn of its period."""
        starts, equations = [motion.unknowns[:-1]], self.equations
        if isinstance(equations, Shooting) and equations.turns > 1:
            starts += list(equations.after(starts[0], motion.parameter, equations.turns - 1))
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
            chord, way = ((end - first.unknowns) / first.sizes for end in (last.unknowns, unknowns))
            length, part = chord @ first.tangent, way @ first.tangent
            if length == 0.0 or not -0.01 <= part / length <= 1.01:
                continue
            guess = first.unknowns + part / length * (last.unknowns - first.unknowns)
            if np.linalg.norm((guess - unknowns) / first.sizes) > 3.0 * _LONGEST:
                continue
            on_curve = solve(self.equations, guess, first.tangent)
            if on_curve is not None and np.abs((on_curve.unknowns - unknowns) / sizes).max() < _ON_CURVE:
                return True
        return False


@dataclass(frozen=True, eq=False)
class IrregularMotion:
    """A motion that does not repeat: omega in rad/s, its `exponent` in 1/s, and states (M, N) over its last turns."""

    omega: float
    exponent: float
    states: Floats
    chaotic: bool


@dataclass(eq=False)
class LevelSearch:
    """The curves and irregular motions that were found at one level, and looks for more."""

    equations: PeriodicEquations
    curves: list[Curve] = field(default_factory=list)
    irregular: list[IrregularMotion] = field(default_factory=list)

    def take(self, unknowns: Floats, turns: int = 1) -> Point | None:
        """The periodic motion near unknowns, whose curve is followed unless it is known; None where there is none."""
        equations = self.equations
        if isinstance(equations, Shooting):
            equations = equations.with_turns(turns)
        motion = solve(equations, unknowns)
        if motion is None or np.abs(equations.multipliers(motion)).max() > _WILD:
            return None
        if repeats_sooner(equations, motion):
            return self.take(motion.unknowns)
        self._follow(equations, motion)
        return motion

    def _follow(self, equations: PeriodicEquations, motion: Point) -> None:
        """Follow the curve through a motion unless it is known, and those that branch off it."""
        alike = [curve for curve in self.curves if curve.equations.turns == equations.turns]
        if len(self.curves) >= _MOST_CURVES or any(curve.contains(motion) for curve in alike):
            return
        curve = whole_curve(equations, motion)
        self.curves.append(curve)
        if isinstance(equations, Shooting):
            for doubled, other in list(_branching_off(equations, curve)):
                self._follow(doubled, other)

    def settle(self, shooting: Shooting, start: Floats, omega: float) -> None:
        """Simulate from a start (N,) until the motion repeats; follow the curve it is on, or keep what does not repeat."""
        state = start
        for _ in range(_BLOCKS):
            states = shooting.after(state, omega, _BLOCK)
            if not np.isfinite(states).all():
                return
            state = states[-1]
            turns = _turns_to_repeat(states, shooting.sizes(np.append(state, omega))[:-1])
            if turns and self._attracts(shooting.with_turns(turns), state, omega):
                return
        if motion := irregular_motion(shooting, state, omega):
            self.irregular.append(motion)

    def settle_between_tori(self, shooting: Shooting) -> None:
        """Simulate from the middle of unstable stretches between Neimark-Sacker bifurcations, unless their motion is known."""
        for curve in list(self.curves):
            marks = [number for number, (_, name) in enumerate(curve.points) if name == TORUS]
            for first, last in pairwise(marks):
                point = curve.points[(first + last) // 2][0]
                low, high = sorted(curve.points[mark][0].parameter for mark in (first, last))
                known = any(low <= motion.omega <= high for motion in self.irregular)
                if not known and np.abs(curve.equations.multipliers(point)).max() > 1.0:
                    self.settle(shooting, point.unknowns[:-1] + _ASIDE * point.sizes[:-1], point.parameter)

    def _attracts(self, shooting: Shooting, state: Floats, omega: float) -> bool:
        """Whether there is a stable periodic motion near a state."""
        motion = self.take(np.append(state, omega), shooting.turns)
        return motion is not None and bool(np.abs(shooting.multipliers(motion)).max() < 1.0)


def _turns_to_repeat(states: Floats, sizes: Floats) -> int:
    """The turns after which a motion with `states` (M, N) after each comes back near to itself; 0 if it does not."""
    for turns in _PERIODS:
        apart = np.abs((states[turns:] - states[:-turns]) / sizes).max(axis=1)
        if apart[-2 * max(_PERIODS) :].max() < _REPEATS:
            return turns
    return 0


def repeats_sooner(shooting: PeriodicEquations, motion: Point, near: float = _SAME) -> bool:
    """Whether a motion of several turns comes back to within this part of its size before its period is over."""
    if not isinstance(shooting, Shooting) or shooting.turns == 1:
        return False
    states = shooting.after(motion.unknowns[:-1], motion.parameter, shooting.turns - 1)
    return bool((np.abs((states - motion.unknowns[:-1]) / motion.sizes[:-1]).max(axis=1) < near).any())


def whole_curve(equations: PeriodicEquations, start: Point) -> Curve:
    """The curve through a motion, followed both ways, with its bifurcations."""

    def is_wild(point: Point) -> bool:
        return bool(np.abs(equations.multipliers(point)).max() > _WILD**2)

    rising = np.eye(len(start.unknowns))[-1]
    forward, closed = follow(equations, turned(start, rising), equations.bounds, is_wild)
    backward = [] if closed else follow(equations, turned(start, -rising), equations.bounds, is_wild)[0]
    back = [point._replace(tangent=-point.tangent) for point in reversed(backward)]
    points = [*back, turned(start, rising), *forward]
    marked = with_located(equations, points, _bifurcation_tests(equations))
    return Curve(equations, tuple(_confirmed_bifurcations(equations, marked)))


def with_extremes(curve: Curve, amplitude: Callable[[Point], float]) -> Curve:
    """The curve with points at the largest of a smooth `amplitude`, where that is inside, and at its antiresonances."""
    points = list(curve.points)
    values = [amplitude(point) for point, _ in points]
    top = int(np.argmax(values))
    sharp = [
        number
        for number, (before, here, after) in enumerate(zip(values, values[1:], values[2:], strict=False), 1)
        if here < min(before, after) and _SHARP * here < max(before, after)
    ]
    for number in sorted([top, *sharp], reverse=True):  # points that are added do not move those before them
        # about an antiresonance the square of an amplitude is a parabola
        height = amplitude if number == top else lambda point: -(amplitude(point) ** 2)
        _add_vertex(curve.equations, points, number, height)
    return replace(curve, points=tuple(points))


def _add_vertex(
    equations: PeriodicEquations, points: list[tuple[Point, str]], top: int, height: Callable[[Point], float]
) -> None:
    """Add points of a curve beside the highest one, `top`, by parabolas, until they move it no further."""
    for _ in range(_PEAK_STEPS):
        if not 0 < top < len(points) - 1:
            return
        three = [point for point, _ in points[top - 1 : top + 2]]
        lengths = [
            float(np.linalg.norm((b.unknowns - a.unknowns) / three[1].sizes)) for a, b in pairwise(three)
        ]
        if min(lengths) == 0.0:
            return
        way = _parabola_vertex(lengths, [height(point) for point in three])
        first = top - 1 if way < 0.0 else top
        part = 1.0 + way / lengths[0] if way < 0.0 else way / lengths[1]
        ends = points[first][0], points[first + 1][0]
        if not _PEAK < part < 1.0 - _PEAK or (found := between(equations, *ends, part)) is None:
            return
        points.insert(first + 1, (found, ""))
        if height(found) > height(three[1]):
            top = first + 1
        elif way < 0.0:
            top += 1


def _parabola_vertex(lengths: Sequence[float], values: Sequence[float]) -> float:
    """Where the parabola through three points has its vertex, as a way from the middle one."""
    (left, right), (before, here, after) = lengths, values
    rise, fall = (here - before) / left, (after - here) / right
    bend = (fall - rise) / (left + right)
    return -0.5 * (rise * right + fall * left) / (left + right) / bend if bend < 0.0 else 0.0


def _branching_off(equations: Shooting, curve: Curve) -> Iterator[tuple[Shooting, Point]]:
    """Motions on the other curves through the points where motion loses its symmetry or doubles its period.

    There the null space of the Jacobian, over the period of the other curve, holds the tangents of both. Curves that
    branch off unstable motion begin unstable, and are left out; so are further doublings on the way to chaos, which
    simulations tell.
    """
    for before, (point, name), after in zip(curve.points, curve.points[1:], curve.points[2:], strict=False):
        turns = equations.turns * (2 if name == DOUBLING else 1)
        unstable = (np.abs(equations.multipliers(beside)).max() > 1.0 for beside, _ in (before, after))
        if name not in (DOUBLING, BRANCHING) or turns > 2 or all(unstable):
            continue
        longer = equations.with_turns(turns)
        first, second = np.linalg.svd(longer(point.unknowns)[1] * point.sizes)[2][-2:]
        across = (first @ point.tangent) * second - (second @ point.tangent) * first
        across /= np.linalg.norm(across)
        for step in _BRANCH_STEPS:
            branching = solve(longer, point.unknowns + step * across * point.sizes, across)
            if branching is not None and not repeats_sooner(longer, branching):
                yield longer, branching
                break


def _bifurcation_tests(equations: PeriodicEquations) -> list[tuple[str, Callable[[Point], float]]]:
    """Functions of a motion that vanish at bifurcations, by name."""

    def at_doubling(point: Point) -> float:
        return float(np.prod(equations.multipliers(point) + 1.0).real)

    def at_torus(point: Point) -> float:
        values = equations.multipliers(point)
        pairs = np.triu_indices(len(values), 1)
        return float(np.prod(values[pairs[0]] * values[pairs[1]] - 1.0).real)

    def at_branching(point: Point) -> float:
        """Zero with a multiplier of 1 that is no fold's."""
        return float(np.prod(equations.multipliers(point) - 1.0).real / (point.tangent[-1] or np.nan))

    tests = [(FOLD, lambda point: float(point.tangent[-1])), (DOUBLING, at_doubling), (TORUS, at_torus)]
    # near a fold the multipliers of harmonic balance are not exact enough to tell
    return [*tests, (BRANCHING, at_branching)] if isinstance(equations, Shooting) else tests


def _confirmed_bifurcations(
    equations: PeriodicEquations, marked: Sequence[tuple[Point, str]]
) -> Iterator[tuple[Point, str]]:
    """The points, those without a name where nothing gains or loses stability, though a test vanishes.

    A fold beside a branch point is where the curve branches off another one, of half its period if it repeats sooner.
    """
    counts = [int((np.abs(equations.multipliers(point)) > 1.0).sum()) for point, _ in marked]
    for number, (point, name) in enumerate(marked):
        splits = {FOLD, BRANCHING} <= {other for _, other in marked[max(number - 1, 0) : number + 2]}
        changes = counts[number - 1] != counts[min(number + 1, len(marked) - 1)]
        if name == FOLD and splits:
            name = DOUBLING if repeats_sooner(equations, point, _ON_CURVE) else BRANCHING
        elif (name == BRANCHING and splits) or (name != FOLD and not changes):
            name = ""
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
    states = shooting.with_turns(60).motion(np.append(state, omega), 64)
    return IrregularMotion(omega, rate * omega / (2.0 * np.pi), states, rate > _CHAOTIC)


def random_starts(
    centres: Floats, reach: float, omega: float, states: int, rng: np.random.Generator, count: int
) -> Iterator[Floats]:
    """States (N,) about rest positions `centres` (W, n), displacements to within some `reach` in m."""
    for _ in range(count):
        centre = centres[rng.integers(len(centres))]
        x = centre + reach * rng.standard_normal(len(centre))
        yield np.concatenate([x, reach * omega * rng.standard_normal(len(centre)), np.zeros(states)])
