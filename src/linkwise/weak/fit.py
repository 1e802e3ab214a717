"""Least squares on weak equations: coefficients, their covariance, and whether noise explains the residuals.

The sums of products carry no noise bias (`patch`), so the estimate is unbiased at any noise level that leaves them positive
definite. Its covariance is the sandwich H^-1 J H^-1, H the sums of products and J the covariance of the normal equations due
to noise (`scatter`), scaled by the residual excess where that is above 1. What is known of coefficients beforehand joins it
as the product of two normal densities (`with_priors`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
import scipy
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import csc_array

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.weak.displacements import source_names
from linkwise.weak.equations import WeakEquations
from linkwise.weak.layout import StructureLayout
from linkwise.weak.patch import Patch
from linkwise.weak.scatter import FLOOR, NoisyPatch, residual_excess, sandwich, score_blocks

_DENSE = 300  # parameters up to which matrices are dense
_ROUNDS = 3  # of reweighting the masses: the second changes weights by per cents, the third by far less
SINGULAR = 1e-13  # scaled pivot below which columns are collinear
SIGNIFICANT = 5.0
"""Standard deviations of what noise adds to the information on a parameter; below, intervals are too narrow."""
_CONTRADICTED = 4.0  # standard errors between a prior and the record: chance does that once in 16 000
_NAMED = 6  # parameters that a message lists

NO_FORCE_SCALE = (
    "nothing sets the scale of the forces: every mass and coefficient is unknown and no force is in the record; give one mass "
    "or coefficient a number, or a channel force:MASS"
)


@dataclass(frozen=True, eq=False)
class WeakFit:
    """Parameters from weak equations.

    Attributes
    ----------
    values : array of shape (p,)
        The parameters in SI units.
    covariance : array or sparse array of shape (p, p)
        Their covariance; of large structures only between parameters of one link.
    free : array of bool, shape (p,)
        False where a parameter is at its bound.
    excess : float
        Power of the residuals over that expected from noise, 1 for laws that fit.
    significance : array of shape (p,)
        The information of the record on each parameter beside the others, without what noise adds to it, over the standard
        deviation of the latter; infinite at bounds, for large structures, and with priors.
    """

    values: Floats
    covariance: Floats | csc_array
    free: Bools
    excess: float
    significance: Floats


def weak_fit(system: WeakEquations, structure: Structure) -> WeakFit:
    """Least squares on the weak equations of a structure, within the bounds of its parameters.

    Raises IdentificationError if a parameter is in no equation, nothing sets the scale of the forces, or terms are collinear.
    """
    _require_informed(system, structure)
    lower = np.array([parameter.lower for parameter in structure.parameters])
    upper = np.array([parameter.upper for parameter in structure.parameters])
    patches = [patch for patch in system.patches if len(patch.layout.free_terms)]
    next_weights = [1.0 / np.maximum(patch.largest(), np.finfo(float).tiny) for patch in patches]
    for _ in range(_ROUNDS):
        weights = next_weights
        normal, right = normal_equations(patches, weights, len(lower))
        values, free = _solve_bounded(normal, right, lower, upper, system.parameters)
        next_weights = [1.0 / residual_power(patch, values) for patch in patches]
    noisy = [NoisyPatch.of(patch, system, values) for patch in patches]
    excess = residual_excess(noisy, values)
    scatter = assemble_blocks(score_blocks(noisy, weights), len(values))
    noise = system.motion.density * max(excess, 1.0)
    covariance = noise * _covariance(normal, scatter, free, system)
    biased, _ = normal_equations(patches, weights, len(lower), bias=1.0)
    return WeakFit(values, covariance, free, excess, _significances(normal, biased, free, system.windows))


def _require_informed(system: WeakEquations, structure: Structure) -> None:
    reached = {number for patch in system.patches for number in patch.layout.free_parameters.tolist()}
    uninformed = [name for number, name in enumerate(system.parameters) if number not in reached]
    if uninformed:
        channels = zip(source_names(structure)[:-1], system.motion.has_channel, strict=False)
        unmeasured = [name for name, present in channels if not present]
        raise IdentificationError(
            f"the record has no information on {', '.join(uninformed)}: the weak form needs the displacement of a mass and of "
            f"all its neighbours; missing {', '.join(unmeasured) or 'x:base'}"
        )
    if not any(len(patch.layout.free_terms) and patch.fixed.any() for patch in system.patches):
        raise IdentificationError(NO_FORCE_SCALE)


def residual_power(patch: Patch, values: Floats) -> Floats:
    """(m,) mean squares of the residuals of each mass with parameters `values` (p,), at least those of rounding."""
    numbers = patch.numbers(values)
    signed = patch.signs * numbers
    sums = np.maximum(((signed @ patch.products) * signed).sum(axis=1), 0.0)
    power = (sums + FLOOR * patch.largest(numbers)) / max(patch.windows, 1.0)
    return np.where(power > 0.0, power, 1.0)


def normal_equations(
    patches: Sequence[Patch], weights: Sequence[Floats], count: int, *, bias: float = 0.0
) -> tuple[Floats | csc_array, Floats]:
    """Normal equations H c = g of least squares over all masses: H (p, p), dense or sparse, and g (p,).

    The masses of each patch have `weights` (m,). The share `bias` of the noise bias is left in: with 1, H is never indefinite
    but the values are biased towards zero.
    """
    blocks, g = normal_blocks(patches, weights, count, bias=bias)
    return assemble_blocks(blocks, count), g


def normal_blocks(
    patches: Sequence[Patch], weights: Sequence[Floats], count: int, *, bias: float = 0.0
) -> tuple[list[tuple[Indices, Floats]], Floats]:
    """The `normal_equations` in blocks, one for each patch: indices (s,) and values (s, s) of those of H, and g (p,)."""
    g = np.zeros(count)
    blocks = []
    for patch, weight in zip(patches, weights, strict=True):
        moments = patch.moments if bias == 0.0 else (1.0 - bias) * patch.moments + bias * patch.products
        weighted = moments * ((patch.signs.T * weight) @ patch.signs)
        free_rows, which = weighted[patch.layout.free_terms], patch.layout.free_parameters
        g -= np.bincount(which, free_rows @ patch.fixed, count)
        blocks.append((which, free_rows[:, patch.layout.free_terms]))
    return blocks, g


def assemble_blocks(blocks: Iterable[tuple[Indices, Floats]], count: int) -> Floats | csc_array:
    """Sum of square blocks at their positions in a matrix (count, count), sparse above 300 rows.

    A block has indices (s,), of which some may be repeated, and values (s, s).
    """
    parts = [((count * which[:, None] + which).ravel(), block.ravel()) for which, block in blocks]
    positions, data = (np.concatenate(part) for part in zip(*parts, strict=True))
    if count <= _DENSE:
        return np.bincount(positions, data, count * count).reshape(count, count)
    return csc_array((data, divmod(positions, count)), shape=(count, count))


def dense_blocks(blocks: Iterable[tuple[Indices, Floats]], numbers: Indices) -> Floats:
    """(s, s) sum of square blocks between the coefficients `numbers` (s,), in their order; others have none."""
    order = np.argsort(numbers)
    places = ((order[np.searchsorted(numbers, which, sorter=order)], block) for which, block in blocks)
    matrix = assemble_blocks(places, len(numbers))
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _solve_bounded(
    h: Floats | csc_array, g: Floats, lower: Floats, upper: Floats, names: tuple[str, ...]
) -> tuple[Floats, Bools]:
    """The minimum within bounds: a parameter that leaves them is held at its bound and the others are solved again."""
    free = np.ones(len(g), dtype=bool)
    values = np.zeros(len(g))
    while free.any():
        rest = g[free] - (0.0 if free.all() else h[free][:, ~free] @ values[~free])
        values[free] = _solver(_part(h, free), _free_names(names, free))(rest)
        outside = free & ((values < lower) | (values > upper))
        if not outside.any():
            break
        values[outside] = np.clip(values[outside], lower[outside], upper[outside])
        free &= ~outside
    return values, free


def _part(h: Floats | csc_array, free: Bools) -> Floats | csc_array:
    return h if free.all() else h[free][:, free]


def _free_names(names: tuple[str, ...], free: Bools) -> list[str]:
    return [name for name, is_free in zip(names, free, strict=True) if is_free]


def _solver(h: Floats | csc_array, names: list[str]) -> Callable[[Floats], Floats]:
    """A function that multiplies by h^-1, equilibrated.

    Raises IdentificationError, naming collinear parameters, where h is not positive definite.
    """
    diagonal = h.diagonal()
    if not np.isfinite(diagonal).all():
        not_finite = ", ".join(names[i] for i in np.flatnonzero(~np.isfinite(diagonal)))
        raise IdentificationError(
            f"the law with {not_finite} is not finite over the whole motion of the record: write it for both signs of d, as "
            "in sqrt(abs(d))*sign(d), or cut the record with record.between",
            arguments=("earliest", "latest"),
        )
    if np.any(diagonal <= 0.0):
        _raise_not_identifiable([names[i] for i in np.flatnonzero(diagonal <= 0.0)])
    scale = 1.0 / np.sqrt(diagonal)
    if isinstance(h, np.ndarray):
        scaled = h * np.outer(scale, scale)
        factor, failed = dpotrf(scaled)
        if failed or not np.min(factor.diagonal()) ** 2 >= SINGULAR:
            _raise_not_identifiable(_null_names(scaled, names))
        return lambda right: np.asarray((dpotrs(factor, (right.T * scale).T)[0].T * scale).T)
    scaled = csc_array(h.multiply(scale[:, None]).multiply(scale[None, :]))
    sparse = scipy.sparse.linalg.splu(scaled)
    pivots = np.abs(sparse.U.diagonal())
    if pivots.min() < SINGULAR:
        _raise_not_identifiable([names[int(np.flatnonzero(sparse.perm_c == np.argmin(pivots))[0])]])
    return lambda right: np.asarray(sparse.solve(right * scale) * scale)


def _null_names(scaled: Floats, names: list[str]) -> list[str]:
    """The parameters in the direction of the smallest eigenvalue."""
    weight = np.abs(np.linalg.eigh(scaled)[1][:, 0])
    return [name for name, share in zip(names, weight, strict=True) if share > 0.2 * weight.max()]


def _raise_not_identifiable(names: list[str]) -> NoReturn:
    shown = ", ".join(names if len(names) <= _NAMED else [*names[:_NAMED], "..."])
    if len(names) == 1:
        raise IdentificationError(
            f"the record does not determine {shown}: its term is not above the noise; give it a number, or record a motion "
            "that excites it"
        )
    raise IdentificationError(
        f"the record cannot distinguish {shown}: their terms are collinear, or not above the noise; give one of them a "
        "number, share it with another, or record a motion in which they vary independently"
    )


def _covariance(
    normal: Floats | csc_array, scatter: Floats | csc_array, free: Bools, system: WeakEquations
) -> Floats | csc_array:
    """H^-1 J H^-1 for the free parameters; for large structures only between parameters of one link."""
    count, indices = len(free), np.flatnonzero(free)
    inner, middle = _part(normal, free), _part(scatter, free)
    if isinstance(inner, np.ndarray):
        names = _free_names(system.parameters, free)
        covariance = np.zeros((count, count))
        if names:
            solve = _solver(inner, names)
            covariance[np.ix_(indices, indices)] = solve(solve(middle).T)
        return 0.5 * (covariance + covariance.T)
    if not len(indices):
        return csc_array((count, count))
    position = np.cumsum(free) - 1
    rows, columns = _within_links(system.structure_layout, free)
    data = sandwich(inner, middle, position[rows], position[columns])
    return csc_array((data, (rows, columns)), shape=(count, count))


def significance(information: Floats, bias: Floats, windows: int) -> Floats:
    """(s,) information over the standard deviation of what noise adds to it, the `bias` (s,).

    Both are sums of squares over windows, of which neighbours share their noise, so that two count as one.
    """
    bias = np.abs(bias)
    variance = (2.0 * bias**2 + 4.0 * np.abs(information) * bias) / (0.5 * windows)
    return np.asarray(information / np.sqrt(np.maximum(variance, np.finfo(float).tiny)))


def _significances(
    normal: Floats | csc_array, biased: Floats | csc_array, free: Bools, windows: int
) -> Floats:
    """(p,) `significance` of each parameter while the others follow it, infinite where not computed."""
    ratios = np.full(len(free), np.inf)
    if isinstance(normal, np.ndarray) and isinstance(biased, np.ndarray) and free.any():
        inner, added = _part(normal, free), _part(biased - normal, free)
        scale = 1.0 / np.sqrt(inner.diagonal())
        inverse = np.linalg.inv(inner * np.outer(scale, scale))
        directions = inverse / inverse.diagonal()
        bias = np.einsum("ip,ij,jp->p", directions, added * np.outer(scale, scale), directions)
        ratios[free] = significance(1.0 / inverse.diagonal(), bias, windows)
    return ratios


def _within_links(structure_layout: StructureLayout, free: Bools) -> tuple[Indices, Indices]:
    """Pairs of free parameters of one link, or twice the same one."""
    members: dict[int, list[int]] = {}
    for (index, _), number in structure_layout.parameter_index.items():
        if free[number]:
            members.setdefault(index, []).append(number)
    pairs = sorted({(row, column) for numbers in members.values() for row in numbers for column in numbers})
    rows, columns = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return rows, columns


def with_priors(fit: WeakFit, parameters: Sequence[Parameter]) -> tuple[WeakFit, tuple[str, ...]]:
    """The fit with Gaussian priors of its parameters, and the names of those that the record contradicts.

    Raises IdentificationError for a structure so large
    that the regression gives no covariance of all its parameters.
    """
    known = np.flatnonzero([p.sigma < np.inf and free for p, free in zip(parameters, fit.free, strict=True)])
    if not known.size:
        return fit, ()
    if not isinstance(fit.covariance, np.ndarray):
        raise IdentificationError(
            f"the weak form takes what is known beforehand of up to some hundred unknowns, not of {len(parameters)}: "
            'use method "ml", or state numbers'
        )
    covariance = fit.covariance
    mean = np.array([p.start or 0.0 for p in parameters])[known]
    variance = np.array([p.sigma for p in parameters])[known] ** 2
    given = np.isin(np.arange(len(parameters)), known)
    innovation = covariance[np.ix_(known, known)] + np.diag(variance)
    unit = np.sqrt(innovation.diagonal())
    missed = mean - fit.values[known]
    gain = np.linalg.solve(innovation / np.outer(unit, unit), covariance[known] / unit[:, None]).T / unit
    contradicted = tuple(parameters[i].name for i in known[np.abs(missed) > _CONTRADICTED * unit].tolist())
    lower = np.array([p.lower for p in parameters])
    upper = np.array([p.upper for p in parameters])
    joined = replace(
        fit,
        values=np.clip(fit.values + gain @ missed, lower, upper),
        covariance=covariance - gain @ covariance[known],
        significance=np.where(given, np.inf, fit.significance),  # known beside the record
    )
    return joined, contradicted
