"""Least squares on weak equations: coefficients, their covariance, and whether noise explains what is left.

The sums of products carry no noise bias (`noisebias`), so the estimate is right on average at any noise level that leaves
them positive definite. Its covariance is H^-1 J H^-1, H the sums of products and J what noise does to the equations that are
solved (`weaknoise`), scaled by what the residuals say of that noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.structure import Structure
from linkwise.weak.equations import WeakEquations
from linkwise.weak.layout import StructureLayout
from linkwise.weak.patch import Patch
from linkwise.weak.sandwich import sandwich
from linkwise.weak.scatter import FLOOR, SlopeStatistics, residual_excess, score_blocks

_DENSE = 300  # parameters up to which matrices are dense
_ROUNDS = 3  # of weighting the masses: the second changes weights by per cents, the third by next to nothing
_SINGULAR = 1e-13  # scaled pivot below which columns move together
_NAMED = 6  # parameters that a message lists


@dataclass(frozen=True, eq=False)
class WeakFit:
    """`values` (p,) of the parameters, `covariance` (p, p) (for large structures within links only), `free` (p,) False where a
    parameter was stopped by its bound.

    `excess` is the power of the residuals over what noise explains, 1 for a law that fits.
    """

    values: Floats
    covariance: Floats | csc_array
    free: Bools
    excess: float


def weak_fit(system: WeakEquations, structure: Structure) -> WeakFit:
    """The parameters of `structure` from its weak equations.

    Raises IdentificationError where a parameter is in no equation, nothing sets the scale, or columns move together.
    """
    _require_reached(system, structure)
    lower = np.array([parameter.lower for parameter in structure.parameters])
    upper = np.array([parameter.upper for parameter in structure.parameters])
    patches = [patch for patch in system.patches if len(patch.layout.free_terms)]
    after = [1.0 / np.maximum(patch.largest(), np.finfo(float).tiny) for patch in patches]
    for _ in range(_ROUNDS):
        weights = after
        normal, right = normal_equations(patches, weights, len(lower))
        values, free = _solve_bounded(normal, right, lower, upper, system.parameters)
        after = [1.0 / residual_power(patch, values) for patch in patches]
    noisy = [(patch, SlopeStatistics.along(patch, system, values)) for patch in patches]
    excess = residual_excess(noisy, values, system)
    scatter = assemble_blocks(score_blocks(noisy, weights, system), len(values))
    covariance = max(excess, 1.0) * _covariance(normal, scatter, free, system)
    return WeakFit(values, covariance, free, excess)


def _require_reached(system: WeakEquations, structure: Structure) -> None:
    reached = {number for patch in system.patches for number in patch.layout.free_parameters.tolist()}
    lost = [name for number, name in enumerate(system.parameters) if number not in reached]
    if lost:
        unseen = [
            f"x:{name}"
            for name, seen in zip(structure.mass_names, system.motion.measured, strict=True)
            if not seen
        ]
        raise IdentificationError(
            f"the record says nothing of {', '.join(lost)}: the weak form needs the displacement of a mass and of all its "
            f"neighbours; missing {', '.join(unseen) or 'x:base'}"
        )
    if not any(len(patch.layout.free_terms) and patch.fixed.any() for patch in system.patches):
        raise IdentificationError(
            "nothing sets the scale of the forces: every mass and coefficient is unknown and no force is in the record; give "
            "one mass or coefficient a number, or a channel force:MASS"
        )


def residual_power(patch: Patch, values: Floats) -> Floats:
    """(m,) mean squares of the residuals at the parameters (p,), floored at rounding."""
    numbers = patch.numbers(values)
    signed = patch.signs * numbers
    sums = np.maximum(((signed @ patch.products) * signed).sum(axis=1), 0.0)
    power = (sums + FLOOR * patch.largest(numbers)) / max(patch.windows, 1.0)
    return np.where(power > 0.0, power, 1.0)


def normal_equations(
    patches: Sequence[Patch], weights: Sequence[Floats], count: int, *, bias: float = 0.0
) -> tuple[Floats | csc_array, Floats]:
    """H (p, p) and g (p,) of the least squares over all masses, weighted by `weights` (m,) of each patch.

    `bias` is the share of the noise bias that is left in: with 1 H is never negative, but pulls values towards zero.
    """
    g = np.zeros(count)
    blocks = []
    for patch, weight in zip(patches, weights, strict=True):
        moments = patch.moments if bias == 0.0 else (1.0 - bias) * patch.moments + bias * patch.products
        weighted = moments * ((patch.signs.T * weight) @ patch.signs)
        asked, which = weighted[patch.layout.free_terms], patch.layout.free_parameters
        g -= np.bincount(which, asked @ patch.fixed, count)
        blocks.append((which, asked[:, patch.layout.free_terms]))
    return assemble_blocks(blocks, count), g


def assemble_blocks(blocks: Iterable[tuple[Indices, Floats]], count: int) -> Floats | csc_array:
    """The sum of square blocks at their places in (count, count); a place may stand in one block twice."""
    parts = [((count * which[:, None] + which).ravel(), block.ravel()) for which, block in blocks]
    places, data = (np.concatenate(part) for part in zip(*parts, strict=True))
    if count <= _DENSE:
        return np.bincount(places, data, count * count).reshape(count, count)
    return csc_array(coo_array((data, divmod(places, count)), shape=(count, count)))


def _solve_bounded(
    h: Floats | csc_array, g: Floats, lower: Floats, upper: Floats, names: tuple[str, ...]
) -> tuple[Floats, Bools]:
    """The minimum within bounds: a parameter that leaves them is held at its bound and the others are solved again."""
    free = np.ones(len(g), dtype=bool)
    values = np.zeros(len(g))
    while free.any():
        rest = g[free] - (0.0 if free.all() else h[free][:, ~free] @ values[~free])
        values[free] = _solver(_part(h, free), _named(names, free))(rest)
        outside = free & ((values < lower) | (values > upper))
        if not outside.any():
            break
        values[outside] = np.clip(values[outside], lower[outside], upper[outside])
        free &= ~outside
    return values, free


def _part(h: Floats | csc_array, free: Bools) -> Floats | csc_array:
    return h if free.all() else h[free][:, free]


def _named(names: tuple[str, ...], free: Bools) -> list[str]:
    return [name for name, each in zip(names, free, strict=True) if each]


def _solver(h: Floats | csc_array, names: list[str]) -> Callable[[Floats], Floats]:
    """What multiplies by h^-1, equilibrated.

    IdentificationError names what moves together where h is not positive definite.
    """
    diagonal = h.diagonal()
    if not np.isfinite(diagonal).all():
        lost = ", ".join(names[i] for i in np.flatnonzero(~np.isfinite(diagonal)))
        raise IdentificationError(
            f"the law with {lost} is not finite everywhere the record went: write it for both signs of d, as in "
            "sqrt(abs(d))*sign(d), or cut the record with record.between",
            arguments=("earliest", "latest"),
        )
    if np.any(diagonal <= 0.0):
        _raise_not_identifiable([names[i] for i in np.flatnonzero(diagonal <= 0.0)])
    scale = 1.0 / np.sqrt(diagonal)
    if isinstance(h, np.ndarray):
        scaled = h * np.outer(scale, scale)
        factor, failed = dpotrf(scaled)
        if failed or not np.min(factor.diagonal()) ** 2 >= _SINGULAR:
            _raise_not_identifiable(_null_names(scaled, names))
        return lambda right: np.asarray((dpotrs(factor, (right.T * scale).T)[0].T * scale).T)
    sparse = splu(csc_array(h.multiply(scale[:, None]).multiply(scale[None, :])))
    pivots = np.abs(sparse.U.diagonal())
    if pivots.min() < _SINGULAR:
        _raise_not_identifiable([names[int(np.flatnonzero(sparse.perm_c == np.argmin(pivots))[0])]])
    return lambda right: np.asarray(sparse.solve(right * scale) * scale)


def _null_names(scaled: Floats, names: list[str]) -> list[str]:
    """The parameters in the direction that the equations see least."""
    weight = np.abs(np.linalg.eigh(scaled)[1][:, 0])
    return [name for name, share in zip(names, weight, strict=True) if share > 0.2 * weight.max()]


def _raise_not_identifiable(names: list[str]) -> NoReturn:
    shown = ", ".join(names if len(names) <= _NAMED else [*names[:_NAMED], "..."])
    if len(names) == 1:
        raise IdentificationError(
            f"the record cannot tell {shown}: its term does not stand above the noise; give it a number, or record a motion "
            "that reaches it"
        )
    raise IdentificationError(
        f"the record cannot tell {shown} apart: their terms move together, or not at all above the noise; give one of them a "
        "number, share it with another, or record a motion that sets them apart"
    )


def _covariance(
    normal: Floats | csc_array, scatter: Floats | csc_array, free: Bools, system: WeakEquations
) -> Floats | csc_array:
    """H^-1 J H^-1 for the free parameters; for large structures only between parameters of one link."""
    count, at = len(free), np.flatnonzero(free)
    inner, middle = _part(normal, free), _part(scatter, free)
    if isinstance(inner, np.ndarray):
        kept = _named(system.parameters, free)
        covariance = np.zeros((count, count))
        if kept:
            solve = _solver(inner, kept)
            covariance[np.ix_(at, at)] = solve(solve(middle).T)
        return 0.5 * (covariance + covariance.T)
    if not len(at):
        return csc_array((count, count))
    place = np.cumsum(free) - 1
    rows, columns = _within_links(system.structure_layout, free)
    data = sandwich(inner, middle, place[rows], place[columns])
    return csc_array(coo_array((data, (rows, columns)), shape=(count, count)))


def _within_links(structure_layout: StructureLayout, free: Bools) -> tuple[Indices, Indices]:
    """Pairs of free parameters of one link, or twice the same one."""
    members: dict[int, list[int]] = {}
    for (index, _), number in structure_layout.parameter_index.items():
        if free[number]:
            members.setdefault(index, []).append(number)
    pairs = sorted({(one, two) for numbers in members.values() for one in numbers for two in numbers})
    rows, columns = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return rows, columns
