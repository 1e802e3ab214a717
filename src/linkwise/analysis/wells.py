"""Where a restoring force vanishes: the wells and tops of one force law, and the barrier between its wells.

For alpha*d + beta*d**3 with alpha < 0 < beta: wells at +-sqrt(-alpha/beta), barrier alpha**2/(4 beta) (METHODS section 7).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError
from linkwise.model.link import Link

Function = Callable[[Floats], Floats]

_PER_DECADE = 64  # an extremum of the force between two points is looked for by its slope, so this need not resolve zeros
_DECADES = (-12, 6)  # elongations from a picometre to a thousand kilometres
_ACROSS = 1024  # points across a range that is given
_MANY = 64  # more zeros than this on all elongations: the law is periodic, and only a range makes sense
_HALVINGS = 200  # of a bracket; it stops before, when the ends are neighbouring numbers


@dataclass(frozen=True)
class RestPoint:
    """An elongation `d` in m at which the force at rest vanishes, and its `stiffness` there in N/m.

    It is a `well` where the force rises through zero (the potential has a minimum), a top or an inflection otherwise.
    """

    d: float
    stiffness: float
    well: bool


def wells(link: Link, lo: float | None = None, hi: float | None = None) -> tuple[float, ...]:
    """Elongations in m of the minima of the link's potential, ascending, from `lo` to `hi` or, without them, anywhere.

    Raises StructureError where a law without a range has too many (a periodic one), and for a coefficient without a value.
    """
    return tuple(point.d for point in _of_link(link, lo, hi) if point.well)


def barrier(link: Link, lo: float | None = None, hi: float | None = None) -> float | None:
    """Energy in J that carries the link out of its deepest well into a neighbouring one; None with fewer than two wells.

    From `lo` to `hi` or, without them, anywhere. Raises StructureError as `wells` does.
    """
    way = way_out(link, lo, hi)
    if way is None:
        return None
    low, high = link.potential(np.array(way))
    return float(high - low)


def way_out(link: Link, lo: float | None = None, hi: float | None = None) -> tuple[float, float] | None:
    """Elongations in m of the deepest well and of the lowest top that leads from it into a neighbouring one, as `barrier`."""
    points = _of_link(link, lo, hi)
    places = np.array([point.d for point in points])
    minima = np.flatnonzero([point.well for point in points])
    if minima.size < 2:
        return None
    energy = link.potential(places)
    deepest = int(minima[np.argmin(energy[minima])])
    tops = [
        first + int(np.argmax(energy[first : last + 1]))
        for first, last in pairwise(minima.tolist())
        if deepest in (first, last)
    ]
    return float(places[deepest]), float(places[min(tops, key=lambda top: float(energy[top]))])


def rest_points(
    force: Function, slope: Function, lo: float | None = None, hi: float | None = None
) -> tuple[RestPoint, ...]:
    """All zeros of `force`, whose derivative is `slope`, ascending, from `lo` to `hi` or, without them, anywhere.

    An interval of zeros (a clearance) counts once, at its middle; a jump through zero counts, a pole does not; a force that is
    zero everywhere has none. Raises StructureError for a range that is none and for too many zeros without a range.
    """
    with np.errstate(
        all="ignore"
    ):  # laws may overflow or leave their domain far out: such points are left aside
        grid = _grid(lo, hi)
        grid = np.unique(np.concatenate([grid, _crossings(slope, grid)]))
        values = force(grid)
        finite = np.isfinite(values)
        grid, signs = grid[finite], np.sign(values[finite])
        filled = np.flatnonzero(signs)
        left, right = filled[:-1], filled[1:]
        touching = (right - left == 1) & (signs[left] != signs[right])
        crossed = _bisect(force, grid[left[touching]], grid[right[touching]])
        flat = right - left > 1
        middles = 0.5 * (grid[left[flat] + 1] + grid[right[flat] - 1])
        places = np.concatenate([crossed, middles])
        rising = np.concatenate(
            [signs[left[touching]] < 0, (signs[left[flat]] < 0) & (signs[right[flat]] > 0)]
        )
        limits = np.maximum(np.abs(force(grid[left])), np.abs(force(grid[right])))
        limits = np.concatenate([limits[touching], limits[flat]])
        kept = np.abs(force(places)) <= 10.0 * limits  # at a pole the force grows without end instead
        edges = _edge_zeros(grid, signs)
        stiffness = slope(np.concatenate([places, edges]))
    found = [
        RestPoint(float(place), float(k), bool(up))
        for place, k, up, keep in zip(places, stiffness, rising, kept, strict=False)
        if keep
    ]
    found += [
        RestPoint(float(d), float(k), bool(k > 0))
        for d, k in zip(edges, stiffness[places.size :], strict=True)
    ]
    if len(found) > _MANY and (lo is None or hi is None):
        raise StructureError(
            f"the force vanishes at more than {_MANY} elongations; give the range of d that is meant"
        )
    return tuple(sorted(found, key=lambda point: point.d))


def _of_link(link: Link, lo: float | None, hi: float | None) -> tuple[RestPoint, ...]:
    link.values  # noqa: B018  # says which coefficient has no value before anything is computed
    try:
        return rest_points(link.force, link.stiffness, lo, hi)
    except StructureError as error:
        raise StructureError(error.message, f'link "{link.name}"') from None


def _grid(lo: float | None, hi: float | None) -> Floats:
    """Elongations to look between: log-spaced on both sides of zero, and evenly spaced across a range that is given."""
    if lo is not None and hi is not None and not lo < hi:
        raise StructureError(f"the range of d from {lo!r} to {hi!r} is empty")
    first, last = _DECADES
    side = np.logspace(first, last, (last - first) * _PER_DECADE + 1)
    grid = np.concatenate([-side[::-1], [0.0], side])
    low, high = grid[0] if lo is None else lo, grid[-1] if hi is None else hi
    inner = grid[(grid >= low) & (grid <= high)]
    across = np.empty(0) if lo is None or hi is None else np.linspace(low, high, _ACROSS)
    return np.unique(np.concatenate([inner, across, [low, high]]))


def _edge_zeros(grid: Floats, signs: Floats) -> Floats:
    """Single zeros exactly on the first or last point, which lie between no two others."""
    if grid.size < 2:
        return np.empty(0)
    ends = [(0, 1), (-1, -2)]
    return np.array([grid[end] for end, inner in ends if signs[end] == 0 and signs[inner] != 0])


def _crossings(function: Function, grid: Floats) -> Floats:
    """Where `function` changes sign between neighbouring points of the grid."""
    values = function(grid)
    signs = np.sign(np.where(np.isfinite(values), values, 0.0))
    before = np.flatnonzero(signs[:-1] * signs[1:] < 0)
    return _bisect(function, grid[before], grid[before + 1])


def _bisect(function: Function, left: Floats, right: Floats) -> Floats:
    """The sign changes of `function` between `left` and `right` (same shapes), to neighbouring numbers."""
    left, right = left.copy(), right.copy()
    below = np.sign(function(left))
    for _ in range(_HALVINGS):
        middle = 0.5 * (left + right)
        if np.all((middle == left) | (middle == right)):
            break
        sign = np.sign(function(middle))
        same = sign == below
        left = np.where(same | (sign == 0), middle, left)
        right = np.where(same, right, middle)
    better = np.abs(function(right)) < np.abs(function(left))
    return np.where(better, right, left)
