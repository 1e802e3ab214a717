"""Zeros of a restoring force: the wells and maxima of the potential of a law, the barrier between them, and the kind of
law that they make it.

For alpha*d + beta*d**3 with alpha < 0 < beta: wells at +-sqrt(-alpha/beta), barrier alpha**2/(4 beta) (METHODS section
7).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from linkwise.arrays import Floats, sign_changes
from linkwise.errors import StructureError, expect, located
from linkwise.expression import differentiate, symbols
from linkwise.model.link import Link

Function = Callable[[Floats], Floats]

_PER_DECADE = 64  # grid points per decade; extrema between them are found by the slope of the force
_DECADES = (-12, 6)  # elongations in m, as powers of ten
_LINEAR = 1024  # evenly spaced grid points in a given range
_MOST_ZEROS = 64  # with more zeros and no range the law counts as periodic


@dataclass(frozen=True)
class RestPoint:
    """An elongation `d` in m at which the force at rest vanishes, its `stiffness` there in N/m, and whether the potential
    has a minimum there: a `well`, rather than a maximum or an inflection point.
    """

    d: float
    stiffness: float
    well: bool


def wells(link: Link, lo: float | None = None, hi: float | None = None) -> tuple[float, ...]:
    """Elongations at which the potential of a link has a minimum.

    Parameters
    ----------
    link : Link
        A link whose coefficients have values.
    lo, hi : float, optional
        Range of elongations in m; by default unlimited.

    Returns
    -------
    tuple of float
        Elongations in m, ascending.

    Raises
    ------
    StructureError
        If a coefficient has no value, the range is empty, or a periodic law has no range.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.analysis.wells(lw.bnes_chain(2).link("nes1"))
    (-0.01, 0.01)
    """
    expect("wells(link): link", link, Link)
    return tuple(point.d for point in link_rest_points(link, lo, hi) if point.well)


def barrier(link: Link, lo: float | None = None, hi: float | None = None) -> float | None:
    """Energy that carries a link from its deepest well to a neighbouring one.

    Parameters
    ----------
    link : Link
        The link.
    lo, hi : float, optional
        The range of elongations in m, as of `wells`.

    Returns
    -------
    float or None
        Energy in J; None with fewer than two wells.

    Raises
    ------
    StructureError
        As of `wells`.

    Examples
    --------
    >>> import linkwise as lw
    >>> round(lw.analysis.barrier(lw.bnes_chain(2).link("nes1")), 12)
    0.0025
    """
    escape = lowest_escape(link, lo, hi)
    return None if escape is None else escape_energy(escape, link)


def escape_energy(ends: tuple[float, float], link: Link) -> float:
    """Energy in J from a well to a maximum; their displacement has no effect to first order."""
    low, high = link.potential(np.array(ends))
    return float(high - low)


def lowest_escape(link: Link, lo: float | None = None, hi: float | None = None) -> tuple[float, float] | None:
    """Elongations in m of the deepest well and of the lowest maximum next to it; None with fewer than two wells."""
    points = link_rest_points(link, lo, hi)
    places = np.array([point.d for point in points])
    minima = np.flatnonzero([point.well for point in points])
    if minima.size < 2:
        return None
    energy = link.potential(places)
    deepest = int(minima[np.argmin(energy[minima])])
    beside = [slice(first, last + 1) for first, last in pairwise(minima.tolist()) if deepest in (first, last)]
    maxima = [between.start + int(np.argmax(energy[between])) for between in beside]
    return float(places[deepest]), float(places[min(maxima, key=lambda place: float(energy[place]))])


def rest_points(
    force: Function, slope: Function, lo: float | None = None, hi: float | None = None
) -> tuple[RestPoint, ...]:
    """All zeros of `force` (N) with derivative `slope` (N/m), ascending, from `lo` to `hi` in m or, without them, anywhere.

    An interval of zeros (a clearance) counts once, at its middle; a jump through zero counts, a pole does not; a force that is
    zero everywhere has no zeros. Raises StructureError for an empty range, and for too many zeros without a range.
    """
    # laws may overflow or leave their domain at large d; such points are dropped
    with np.errstate(all="ignore"):
        grid = _grid(lo, hi)
        grid = np.unique(np.concatenate([grid, sign_changes(slope, grid)]))
        values = force(grid)
        finite = np.isfinite(values)
        grid, signs = grid[finite], np.sign(values[finite])
        filled = np.flatnonzero(signs)
        left, right = filled[:-1], filled[1:]
        around = (right - left > 1) | (signs[left] != signs[right])
        left, right = left[around], right[around]
        places = 0.5 * (grid[left + 1] + grid[right - 1])  # of a stretch of zeros
        places[right - left == 1] = sign_changes(force, grid)
        rising = (signs[left] < 0) & (signs[right] > 0)
        limits = np.maximum(np.abs(force(grid[left])), np.abs(force(grid[right])))
        is_zero = np.abs(force(places)) <= 10.0 * limits  # at a pole the force grows without end instead
        ends = [(0, 1), (-1, -2)] if grid.size > 1 else []
        # isolated zeros exactly on the first or last grid point
        edges = np.array([grid[end] for end, inner in ends if signs[end] == 0 and signs[inner] != 0])
        places = np.concatenate([places[is_zero], edges])
        stiffness = slope(places)
    up = [*rising[is_zero], *(stiffness[len(places) - len(edges) :] > 0.0)]
    points = [
        RestPoint(float(d), float(k), bool(well)) for d, k, well in zip(places, stiffness, up, strict=True)
    ]
    if len(points) > _MOST_ZEROS and (lo is None or hi is None):
        raise StructureError(f"the force vanishes at more than {_MOST_ZEROS} elongations; give a range of d")
    return tuple(sorted(points, key=lambda point: point.d))


def link_rest_points(link: Link, lo: float | None = None, hi: float | None = None) -> tuple[RestPoint, ...]:
    """The rest points of a link at states and signals of 0; StructureError as of `rest_points`, with its name."""
    link.values  # raises StructureError for a coefficient without a value  # noqa: B018
    with located(f'link "{link.name}"'):
        return rest_points(partial(link.force, states=link.zero_states), link.stiffness, lo, hi)


def _grid(lo: float | None, hi: float | None) -> Floats:
    """Grid of elongations: logarithmic on both sides of zero, and linear in a given range."""
    if lo is not None and hi is not None and not lo < hi:
        raise StructureError(f"the range of d from {lo!r} to {hi!r} is empty")
    if any(end is not None and not np.isfinite(end) for end in (lo, hi)):
        raise StructureError(f"lo and hi must be finite elongations in m, got {lo!r} and {hi!r}")
    first, last = _DECADES
    side = np.logspace(first, last, (last - first) * _PER_DECADE + 1)
    grid = np.concatenate([-side[::-1], [0.0], side])
    low, high = grid[0] if lo is None else lo, grid[-1] if hi is None else hi
    inner = grid[(grid >= low) & (grid <= high)]
    across = np.empty(0) if lo is None or hi is None else np.linspace(low, high, _LINEAR)
    return np.unique(np.concatenate([inner, across, [low, high]]))


_DAMPER = "damper only"
_GRID = 65
# of the largest force: smaller forces, and smaller deviations from a straight line, count as zero
_NEGLIGIBLE = 1e-9


def law_kind(link: Link, reach: float) -> str:
    """The kind of a law with known coefficients, at rest and for elongations from -`reach` to `reach` in m.

    "constant force" where it depends on nothing; "damper only" without an elastic part; "bistable" with two wells ("3 wells"
    and so on with more); "linear"; "hardening" or "softening" where the force on both sides is larger or smaller than that of
    the stiffness at 0; "one-sided" where there is no force on one side; "uneven" where one side hardens and the other softens;
    "negative stiffness" without a well. Of a law with states the kind is that of its force at states of 0, as in "linear with
    memory", or "memory" where that is no spring.
    """
    kind = _kind_at_rest(link, reach)
    if not link.law.states:
        return kind
    return "memory" if kind == _DAMPER else f"{kind} with memory"


def _kind_at_rest(link: Link, reach: float) -> str:
    """The kind of the force at v = 0 and states of 0."""
    slope = differentiate(link.law.elastic, "d")
    if "d" not in symbols(link.law.elastic):
        constant = not link.law.states and "v" not in symbols(link.law.expression)
        return "constant force" if constant and link.force(0.0, 0.0) != 0.0 else _DAMPER
    count = 0
    with suppress(StructureError):  # of a force that vanishes everywhere
        count = len(wells(link, -reach, reach))
    if count >= 2:
        return "bistable" if count == 2 else f"{count} wells"
    at_rest = float(link.stiffness(0.0))
    d = np.linspace(0.0, reach, _GRID)[1:]
    still = link.zero_states
    right, left = link.force(d, 0.0, still), -link.force(-d, 0.0, still)
    sizes = float(np.abs(right).max()), float(np.abs(left).max())
    deviation = max(float(np.abs(side - at_rest * d).max()) for side in (right, left))
    if "d" not in symbols(slope) or deviation <= _NEGLIGIBLE * max(sizes):
        return "linear" if at_rest >= 0.0 else "negative stiffness"
    if min(sizes) <= _NEGLIGIBLE * max(sizes):
        return "one-sided"
    hardens = [float(side[-1]) / reach > at_rest for side in (right, left)]
    if count == 0 and at_rest < 0.0:
        return "negative stiffness"
    if all(hardens):
        return "hardening"
    return "uneven" if any(hardens) else "softening"
