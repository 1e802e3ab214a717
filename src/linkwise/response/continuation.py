"""Curves of solutions of n equations in n + 1 unknowns, followed by pseudo-arclength through folds.

The last unknown is the parameter. Lengths are measured in unknowns over their present size, so that a curve may grow a
thousandfold on its way. (Keller 1977; Allgower and Georg 1990.)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from linkwise.arrays import Floats
from linkwise.model.structure import Structure

_CONVERGED = 1e-8  # of the sizes: a correction after which the next would be rounding, since Newton's method squares it
_MOST_CORRECTIONS = 12
_FEW, _MANY = 3, 6  # corrections after which steps grow or shrink
_GROWTH = 1.6
_BEND, _TURN = 0.96, 0.5  # cosine between tangents at the ends of a step, at least, and about a corner
_CORNER = 1e-2  # step, relative to the longest, from which on a bend is one
_MOST_TRIALS, _LOCATED = 40, 1e-8  # of the place of a bifurcation, and to what part of a step it is located
_SHORTEST = 1e-7  # step, relative to the longest


@dataclass(frozen=True, eq=False)
class Equations(ABC):
    """n equations in n + 1 unknowns, of motions of a `structure`."""

    structure: Structure

    def of(self, structure: Structure) -> Self:
        """Those of another structure of the same shape."""
        return replace(self, structure=structure)

    @abstractmethod
    def __call__(self, unknowns: Floats) -> tuple[Floats, Floats]:
        """The residual (n,) and its Jacobian (n, n + 1); NaN where there is none."""

    @abstractmethod
    def sizes(self, unknowns: Floats) -> Floats:
        """The sizes (n + 1,) in which lengths along the curve are measured near these unknowns."""


class Point(NamedTuple):
    """A point of a curve: unknowns (n + 1,), the Jacobian (n, n + 1) there, and the tangent (n + 1,) in units of `sizes`."""

    unknowns: Floats
    jacobian: Floats
    tangent: Floats
    sizes: Floats
    corrections: int = 0

    @property
    def parameter(self) -> float:
        """The last unknown."""
        return float(self.unknowns[-1])


def solve(equations: Equations, guess: Floats, normal: Floats | None = None) -> Point | None:
    """The point of the curve on the plane through `guess` across `normal` (n + 1,); None where Newton's method fails.

    The normal is in units of the sizes at the guess; by default the parameter is held.
    """
    sizes = equations.sizes(guess)
    normal = np.eye(len(guess))[-1] if normal is None else normal
    unknowns = guess
    for corrections in range(1, _MOST_CORRECTIONS + 1):
        residual, jacobian = equations(unknowns)
        right = np.append(residual, normal @ ((unknowns - guess) / sizes))
        if not (np.isfinite(right).all() and np.isfinite(jacobian).all()):
            return None
        try:
            step = np.linalg.solve(np.vstack([jacobian * sizes, normal]), right)
        except np.linalg.LinAlgError:
            return None
        unknowns = unknowns - step * sizes
        if np.linalg.norm(step) > 1.0 and normal[-1] == 1.0:  # from rest, whose size says nothing
            sizes = equations.sizes(unknowns)
        if np.linalg.norm(step) < _CONVERGED:
            point = Point(unknowns, jacobian, normal, equations.sizes(unknowns), corrections)
            return turned(point, normal) if np.isfinite(point.sizes).all() else None
    return None


def turned(point: Point, along: Floats) -> Point:
    """The point with its unit tangent, in the direction of `along` (n + 1,)."""
    bordered = np.vstack([point.jacobian * point.sizes, along])
    try:
        tangent = np.linalg.solve(bordered, np.eye(len(along))[-1])
    except np.linalg.LinAlgError:  # across `along`
        tangent = np.linalg.svd(bordered[:-1])[2][-1]
    return point._replace(tangent=tangent / np.linalg.norm(tangent))


def follow(
    equations: Equations,
    start: Point,
    bounds: tuple[float, float],
    stop: Callable[[Point], bool],
    *,
    longest: float = 0.08,
    most: int = 600,
) -> tuple[list[Point], bool]:
    """The points of the curve from `start` along its tangent, without the start, and whether they return to it.

    The last point is on the bound, where it is reached.
    """
    points: list[Point] = []
    point, length, travelled = start, 0.3 * longest, 0.0
    while len(points) < most and length > _SHORTEST * longest:
        guess = point.unknowns + length * point.tangent * point.sizes
        after = solve(equations, guess, point.tangent)
        if after is None or not _is_near_enough(point, after, length, corner=length < _CORNER * longest):
            length *= 0.5
            continue
        if not bounds[0] <= after.parameter <= bounds[1]:
            if end := _at_bound(equations, point, after, bounds):
                points.append(end)
            break
        if travelled > 3.0 * length and _closes_curve(start, point, after):
            return [*points, start], True
        points.append(after)
        travelled += length
        if stop(after):
            break
        point = after
        length *= _GROWTH if after.corrections <= _FEW else 0.5 if after.corrections >= _MANY else 1.0
        length = min(length, longest)
    return points, False


def _is_near_enough(point: Point, after: Point, length: float, *, corner: bool) -> bool:
    """Whether a step was short enough for the bend of the curve; one about a `corner`, as kinks make, may bend more."""
    apart = np.linalg.norm((after.unknowns - point.unknowns) / point.sizes)
    scaled = after.tangent * after.sizes / point.sizes
    bend = scaled @ point.tangent / np.linalg.norm(scaled)
    return bool(apart < 1.5 * length and bend > (_TURN if corner else _BEND))


def _at_bound(
    equations: Equations, inside: Point, outside: Point, bounds: tuple[float, float]
) -> Point | None:
    """The point at the bound that a step passed."""
    bound = bounds[0] if outside.parameter < bounds[0] else bounds[1]
    part = (bound - inside.parameter) / (outside.parameter - inside.parameter)
    if part == 0.0:
        return None
    guess = inside.unknowns + part * (outside.unknowns - inside.unknowns)
    guess[-1] = bound
    bounded = solve(equations, guess)
    return None if bounded is None else turned(bounded, inside.tangent)


def _closes_curve(start: Point, point: Point, after: Point) -> bool:
    """Whether the start lies on the step from `point` to `after`."""
    chord = (after.unknowns - point.unknowns) / start.sizes
    way = (start.unknowns - point.unknowns) / start.sizes
    part = way @ chord / (chord @ chord)
    aside = np.linalg.norm(way - part * chord)
    return bool(0.0 < part <= 1.0 and aside < 0.1 * np.linalg.norm(chord) and start.tangent @ chord > 0.0)


def between(equations: Equations, first: Point, last: Point, part: float) -> Point | None:
    """The point of the curve at a part of the way from one point to the next; None where it is not found."""
    guess = (1.0 - part) * first.unknowns + part * last.unknowns
    return solve(equations, guess, first.tangent)


def locate(equations: Equations, first: Point, last: Point, test: Callable[[Point], float]) -> Point | None:
    """The point between two neighbours of a curve where `test` changes its sign; None where it is not found."""
    ends = {0.0: first, 1.0: last}

    def at(part: float) -> float:
        if part not in ends:
            found = between(equations, first, last, part)
            if found is None:
                raise ArithmeticError
            ends[part] = found
        return test(ends[part])

    try:
        return ends[_sign_change(at)]
    except ArithmeticError:
        # beside a branch point, at which the equations are singular: the nearest that was found
        part = min(ends, key=lambda part: abs(test(ends[part])))
        return ends[part] if 0.0 < part < 1.0 else None


def _sign_change(function: Callable[[float], float]) -> float:
    """Where a function that changes its sign from 0 to 1 vanishes (Illinois method)."""
    low, high, at_low, at_high = 0.0, 1.0, function(0.0), function(1.0)
    moved = ""
    for _ in range(_MOST_TRIALS):
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = function(middle)
        near = min(abs(middle - low), abs(middle - high)) < _LOCATED
        if value * at_high > 0.0:
            at_low *= 0.5 if moved == "high" else 1.0
            high, at_high, moved = middle, value, "high"
        else:
            at_high *= 0.5 if moved == "low" else 1.0
            low, at_low, moved = middle, value, "low"
        if near or value == 0.0:
            break
    return middle


def with_located(
    equations: Equations, points: Sequence[Point], tests: Sequence[tuple[str, Callable[[Point], float]]]
) -> list[tuple[Point, str]]:
    """The points of a curve with the zeros of named `tests` among them, each with its name, "" for the others."""
    marked: list[tuple[Point, str]] = [(point, "") for point in points[:1]]
    values = [[test(point) for point in points] for _, test in tests]
    for number, (first, last) in enumerate(pairwise(points)):
        near = ""
        for (name, test), row in zip(tests, values, strict=True):
            if row[number] * row[number + 1] < 0.0:
                located = locate(equations, first, last, test)
                if located is None or np.array_equal(located.unknowns, last.unknowns):
                    near = near or name  # as exactly as it can be told
                else:
                    marked.append((located, name))
        marked.append((last, near))
    return marked
