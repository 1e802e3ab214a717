"""Least squares on weak equations: coefficients, their covariance, and whether noise explains the residuals.

The sums of products carry no noise bias (`equations`), so the estimate is unbiased at any noise level that leaves them
positive definite. Its covariance is the sandwich H^-1 J H^-1, H the sums of products and J the covariance of the normal
equations due to noise (`score_blocks`), scaled by the residual excess where that is above 1. What is known of coefficients
beforehand joins it as the product of two normal densities (`with_priors`).

J follows from the noise in the displacements. The residual r_k of window k of mass i is, to first order, the noise of every
displacement in it under

    m phi'' + k phi - c phi'      for its own, k and c the sums of the slopes of its links,
    -(k_l phi - c_l phi')         for the mass at the other end of link l.

The estimate solves sum_k a_k r_k = 0, a_k the columns of window k. Noise at time t enters that sum by G(t) = sum_k a_k
kernel(t - t_k) and adds sigma^2 G G' to its covariance for every sample. Since a_k is noisy too, G also adds sigma^4 tr(Q Q'),
Q the quadratic form of the noise in the sum; the covariance of a quadratic form is that plus sigma^4 tr(Q Q). The noise of a
mode comes from all channels of its host, so that one channel is in several equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import compress
from typing import NoReturn

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import VARIABLES, Law
from linkwise.model.parameters import Parameter
from linkwise.model.structure import Structure
from linkwise.weak.displacements import source_names
from linkwise.weak.equations import Patch, WeakEquations
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2, NoisePaths

FLOOR = 1e-24  # of the power of the terms: residuals below are rounding
_CORRELATED = ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI))


@dataclass(frozen=True, eq=False)
class NoisyPatch:
    """The equations of a patch, with the slopes of its laws by d (N/m) and v (N s/m), over noise along the smoothed motion.

    Each is the mean over two points, the smoothed motion plus and minus the standard deviation of the noise over sqrt(2),
    which is correct to the fourth power of the noise.

    Attributes
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record, at P `points` of which slopes are taken.
    masses : array of shape (m,)
        Masses in kg.
    mean, square : array of shape (2, l, P)
        Means and mean squares of the slopes of the links.
    """

    patch: Patch
    system: WeakEquations
    masses: Floats
    mean: Floats
    square: Floats

    @classmethod
    def of(cls, patch: Patch, system: WeakEquations, values: Floats) -> NoisyPatch:
        """The patch with the slopes of its laws at the parameters `values` (p,)."""
        layout, windows = patch.layout, system.points
        deviation = np.sqrt(0.5 * system.floored_elongation_variance[layout.links])
        mean, square = np.empty((2, 2, len(layout.links), len(windows)))
        for group in layout.groups:
            program, constant = _slopes(group.weak_law.law)
            rows, links, at = group.positions, group.links[:, None], windows[:1] if constant else windows
            offsets = deviation[rows, None, None] * np.array([[-1.0], [1.0]])
            coefficients = [number.at(values)[:, None, None] for number in group.coefficients.values()]
            d, v = system.d[links, at][:, None] + offsets, system.v[links, at][:, None]
            signals = [system.signals[name][at] for name in group.weak_law.law.signals]
            slopes = program(d, v, *signals, *coefficients)
            for by, (low, high) in enumerate(slope.transpose(1, 0, 2) for slope in slopes):
                mean[by, rows] = 0.5 * (low + high)
                square[by, rows] = 0.5 * (low**2 + high**2)
        return cls(patch, system, layout.inertia.at(values), mean, square)

    @cached_property
    def paths(self) -> NoisePaths:
        """The ways by which noise of channels enters the equations."""
        return self.patch.layout.noise_paths(self.system.motion.source_weights)

    def under_kernels(self, passed: Floats, inertia: Floats, slopes: Floats) -> list[Floats]:
        """What noise is weighted by under each kernel, (w, P) each.

        It passes through links with `slopes` (2, l, P) as `passed` (w, l) says, and is in the displacements of masses by
        `inertia` (w,).
        """
        stiffness, damping = passed @ slopes
        return [stiffness, -damping, np.broadcast_to(inertia[:, None], stiffness.shape)]

    @cached_property
    def power(self) -> Floats:
        """(m, I) mean squares of the residuals that noise explains, at the points of `system` that are `inside`."""
        system, paths, masses = self.system, self.paths, np.arange(len(self.masses))
        gram, variance = system.window.kernels @ system.window.kernels.T, system.motion.floored_variance
        mean, square = self.mean[..., system.inside], self.square[..., system.inside]
        of_mass = (paths.equation == masses[:, None]) * variance[paths.source]
        curved = np.tensordot(gram.diagonal()[[PHI, PHI_1]], square - mean**2, 1)
        weights = self.under_kernels(paths.passed, paths.inertia * self.masses[paths.equation], mean)
        power = np.zeros_like(weights[PHI])
        for first, second in _CORRELATED[:-1]:
            share = gram[first, second] if first == second else 2.0 * gram[first, second]
            power += share * (weights[first] * weights[second])
        floor = FLOOR * self.patch.largest()[:, None] / system.windows + np.finfo(float).tiny
        return np.asarray(of_mass @ power + (of_mass @ paths.passed**2) @ curved + floor)


@lru_cache(maxsize=512)
def _slopes(law: Law) -> tuple[Program, bool]:
    """Program for the slopes of a law with respect to d and v, and whether they are constant."""
    slopes = [differentiate(law.expression, name) for name in VARIABLES]
    constant = not any(name in symbols(slope) for name in law.variables for slope in slopes)
    return Program(slopes, (*law.variables, *law.coefficients), wide=law.variables), constant


def residual_excess(noisy: Sequence[NoisyPatch], values: Floats) -> float:
    """Power of the residuals over the power expected from noise: 1 for laws and noise that fit."""
    total, count = 0.0, 0.0
    for own in noisy:
        windows = own.system.points[own.system.inside]
        residual, valid = own.patch.residual(values)[:, windows], own.patch.valid[windows]
        total += float((residual**2 / own.power).sum(axis=0) @ valid)
        count += len(own.masses) * float(valid.sum())
    return total / max(count, 1.0)


def score_blocks(noisy: Sequence[NoisyPatch], weights: Sequence[Floats]) -> Iterator[tuple[Indices, Floats]]:
    """Covariance of the normal equations due to noise, in blocks, for patches whose masses have `weights` (m,).

    Yields
    ------
    parameters : array of int, shape (s,)
        Indices of the parameters, some perhaps repeated.
    covariance : array of shape (s, s)
        Their block.
    """
    of_patches = [np.unique(own.paths.source) for own in noisy]
    pending = np.bincount(np.concatenate(of_patches))
    shared_sums: dict[int, list[tuple[Indices, Floats]]] = {}
    for own, weight, present in zip(noisy, weights, of_patches, strict=True):
        patch, system = own.patch, own.system
        parameters = patch.layout.free_parameters
        sums = system.window.adjoint(patch.rows[patch.layout.free_terms], system.thinning)
        yield parameters, _quadratic_noise(own, weight)
        for channel, terms, of_noise in _channel_sums(own, weight, sums, present):
            shared_sums.setdefault(channel, []).append((parameters[terms], of_noise))
        pending[present] -= 1
        for channel in [channel for channel in shared_sums if not pending[channel]]:
            which, of_noise = (np.concatenate(parts) for parts in zip(*shared_sums.pop(channel), strict=True))
            yield which, of_noise @ of_noise.T


def _channel_sums(
    noisy: NoisyPatch, weight: Floats, sums: Floats, channels: Indices
) -> Iterator[tuple[int, Indices, Floats]]:
    """For each of the channels with noise in an equation: its number, the terms (s,) in these equations, and sums (s, P).

    Terms that act in the same equations with the same signs weight noise alike.
    """
    layout, deviations = noisy.patch.layout, np.sqrt(noisy.system.motion.floored_variance)
    acting, kind = np.unique(layout.signs[:, layout.free_terms].T, axis=0, return_inverse=True)
    for channel in channels.tolist():
        paths = noisy.paths.chosen(noisy.paths.source == channel)
        through = (acting * weight)[:, paths.equation] * deviations[channel]
        inertia = through @ (paths.inertia * noisy.masses[paths.equation])
        weights = noisy.under_kernels(through @ paths.passed, inertia, noisy.mean)
        terms = np.flatnonzero(through.any(axis=1)[kind])
        own = kind[terms]
        yield (
            channel,
            terms,
            sum(weights[kernel][own] * sums[kernel, terms] for kernel in (PHI, PHI_1, PHI_2)),
        )


def _quadratic_noise(noisy: NoisyPatch, weight: Floats) -> Floats:
    """(s, s) tr(Q Q) for the noise in each mass's own displacement, over all masses of a patch.

    Columns under phi see the noise of windows before and after alike, those under phi' with opposite signs: of these it is
    negative.
    """
    patch, system, layout = noisy.patch, noisy.system, noisy.patch.layout
    window, stride = system.window, system.slope_stride
    at = np.flatnonzero(system.points[system.inside] % stride == 0)
    through = _own_noise(patch, system, layout.link_incidence, layout.readings)
    weights = noisy.under_kernels(through, noisy.masses, noisy.mean[:, :, at])
    shape = weights[PHI].shape
    kernels = np.reshape(weights, (len(weights), -1))
    slopes = patch.slopes[:, system.points[at] // stride]
    variance = system.motion.covariance(patch.layout.masses, floored=True).diagonal()
    amount = stride * (weight * variance) ** 2
    acting = _own_noise(patch, system, patch.layout.signs, layout.incidence)
    total, terms = np.zeros(patch.products.shape), layout.free_terms_by_kernel
    for row, column in _CORRELATED:
        first, second = terms[row], terms[column]
        if len(first) and len(second):
            correlated = window.cross_correlations[row, column].T @ kernels
            correlation = (correlated * kernels).sum(axis=0).reshape(shape)
            acts = acting[:, first, None] * acting[:, None, second]
            acts *= amount[:, None, None]
            sums = (slopes[first] * correlation[:, None]) @ slopes[second].T
            total[first[:, None], second] = (acts * sums).sum(axis=0)
    return total[layout.free_terms[:, None], layout.free_terms]


def _own_noise(patch: Patch, system: WeakEquations, signs: Floats, incidence: Floats) -> Floats:
    """(m, k) the sign of each term in an equation times the share of its noise that is that of the mass or mode itself.

    `signs` (m, k) are those of the terms in the equations, `incidence` (k, c) the weights of the nodes in what they read. 1
    for each term in the equation of a mass.
    """
    own = np.searchsorted(patch.layout.nodes, patch.layout.masses)
    covariance = system.motion.covariance(patch.layout.nodes, floored=True)
    variance = np.maximum(covariance[own, own], np.finfo(float).tiny)
    return np.asarray(signs * (incidence @ covariance[:, own] / variance).T)


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
    covariance : array of shape (p, p)
        Their covariance.
    free : array of bool, shape (p,)
        False where a parameter is at its bound.
    excess : float
        Power of the residuals over that expected from noise, 1 for laws that fit.
    significance : array of shape (p,)
        The information of the record on each parameter beside the others, without what noise adds to it, over the standard
        deviation of the latter; infinite at bounds and with priors.
    """

    values: Floats
    covariance: Floats
    free: Bools
    excess: float
    significance: Floats


def weak_fit(system: WeakEquations, structure: Structure) -> WeakFit:
    """Least squares on the weak equations of a structure, within the bounds of its parameters.

    Raises IdentificationError if a parameter is in no equation, nothing sets the scale of the forces, or terms are collinear.
    """
    _require_informed(system, structure)
    numbers = np.arange(len(structure.parameters))
    lower = np.array([parameter.lower for parameter in structure.parameters])
    upper = np.array([parameter.upper for parameter in structure.parameters])
    patches = [patch for patch in system.patches if len(patch.layout.free_terms)]
    next_weights = [1.0 / np.maximum(patch.largest(), np.finfo(float).tiny) for patch in patches]
    for _ in range(_ROUNDS):
        weights = next_weights
        normal, right = normal_equations(patches, weights, numbers)
        values, free = _solve_bounded(normal, right, lower, upper, system.parameters)
        next_weights = [1.0 / residual_power(patch, values) for patch in patches]
    noisy = [NoisyPatch.of(patch, system, values) for patch in patches]
    excess = residual_excess(noisy, values)
    scatter = summed_blocks(score_blocks(noisy, weights), numbers)
    noise = system.motion.density * max(excess, 1.0)
    covariance = noise * _covariance(normal, scatter, free, system.parameters)
    biased, _ = normal_equations(patches, weights, numbers, bias=1.0)
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
    signed = patch.layout.signs * numbers
    sums = np.maximum(((signed @ patch.products) * signed).sum(axis=1), 0.0)
    power = (sums + FLOOR * patch.largest(numbers)) / max(patch.windows, 1.0)
    return np.where(power > 0.0, power, 1.0)


def normal_equations(
    patches: Sequence[Patch], weights: Sequence[Floats], numbers: Indices, *, bias: float = 0.0
) -> tuple[Floats, Floats]:
    """Normal equations H c = g of least squares over all masses, of the parameters `numbers` (s,): H (s, s) and g (s,).

    The masses of each patch have `weights` (m,). The share `bias` of the noise bias is left in: with 1, H is never indefinite
    but the values are biased towards zero.
    """
    g, blocks = np.zeros(np.max(numbers, initial=-1) + 1), []
    for patch, weight in zip(patches, weights, strict=True):
        moments = patch.moments if bias == 0.0 else (1.0 - bias) * patch.moments + bias * patch.products
        weighted = moments * ((patch.layout.signs.T * weight) @ patch.layout.signs)
        free_rows, which = weighted[patch.layout.free_terms], patch.layout.free_parameters
        g -= np.bincount(which, free_rows @ patch.fixed, len(g))
        blocks.append((which, free_rows[:, patch.layout.free_terms]))
    return summed_blocks(blocks, numbers), g[numbers]


def summed_blocks(blocks: Iterable[tuple[Indices, Floats]], numbers: Indices) -> Floats:
    """(s, s) sum of square blocks between the parameters `numbers` (s,), in their order; others have none.

    A block has the numbers of its parameters, of which some may be repeated, and values.
    """
    order, count = np.argsort(numbers), len(numbers)
    places = ((order[np.searchsorted(numbers, which, sorter=order)], block) for which, block in blocks)
    parts = [((count * place[:, None] + place).ravel(), block.ravel()) for place, block in places]
    positions, data = (np.concatenate(part) for part in zip(*parts, strict=True))
    return np.asarray(np.bincount(positions, data, count * count), dtype=float).reshape(count, count)


def _solve_bounded(
    h: Floats, g: Floats, lower: Floats, upper: Floats, names: tuple[str, ...]
) -> tuple[Floats, Bools]:
    """The minimum within bounds: a parameter that leaves them is held at its bound and the others are solved again."""
    free = np.ones(len(g), dtype=bool)
    values = np.zeros(len(g))
    while free.any():
        rest = g[free] - h[np.ix_(free, ~free)] @ values[~free]
        values[free] = solver(h[np.ix_(free, free)], compress(names, free))(rest)
        outside = free & ((values < lower) | (values > upper))
        if not outside.any():
            break
        values[outside] = np.clip(values[outside], lower[outside], upper[outside])
        free &= ~outside
    return values, free


def solver(h: Floats, every: Iterable[str]) -> Callable[[Floats], Floats]:
    """A function that multiplies by h^-1, equilibrated.

    Raises IdentificationError, naming collinear parameters, where h is not positive definite.
    """
    diagonal, names = h.diagonal(), list(every)
    if not np.isfinite(diagonal).all():
        not_finite = ", ".join(compress(names, ~np.isfinite(diagonal)))
        raise IdentificationError(
            f"the law with {not_finite} is not finite over the whole motion of the record: write it for both signs of d, as "
            "in sqrt(abs(d))*sign(d), or cut the record with record.between",
            arguments=("earliest", "latest"),
        )
    if np.any(diagonal <= 0.0):
        _raise_not_identifiable(list(compress(names, diagonal <= 0.0)))
    scale = 1.0 / np.sqrt(diagonal)
    scaled = h * np.outer(scale, scale)
    factor, failed = dpotrf(scaled)
    if failed or not np.min(factor.diagonal()) ** 2 >= SINGULAR:
        weight = np.abs(np.linalg.eigh(scaled)[1][:, 0])  # of the smallest eigenvalue
        _raise_not_identifiable(list(compress(names, weight > 0.2 * weight.max())))
    return lambda right: np.asarray((dpotrs(factor, (right.T * scale).T)[0].T * scale).T)


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


def _covariance(normal: Floats, scatter: Floats, free: Bools, names: Sequence[str]) -> Floats:
    """H^-1 J H^-1 for the free parameters, 0 for the others."""
    covariance = np.zeros(normal.shape)
    if free.any():
        inner = np.ix_(free, free)
        solve = solver(normal[inner], compress(names, free))
        covariance[inner] = solve(solve(scatter[inner]).T)
    return 0.5 * (covariance + covariance.T)


def significance(information: Floats, bias: Floats, windows: int) -> Floats:
    """(s,) information over the standard deviation of what noise adds to it, the `bias` (s,).

    Both are sums of squares over windows, of which neighbours share their noise, so that two count as one.
    """
    bias = np.abs(bias)
    variance = (2.0 * bias**2 + 4.0 * np.abs(information) * bias) / (0.5 * windows)
    return np.asarray(information / np.sqrt(np.maximum(variance, np.finfo(float).tiny)))


def _significances(normal: Floats, biased: Floats, free: Bools, windows: int) -> Floats:
    """(p,) `significance` of each parameter while the others follow it, infinite for those at a bound."""
    ratios, block = np.full(len(free), np.inf), np.ix_(free, free)
    inner, added = normal[block], (biased - normal)[block]
    scale = 1.0 / np.sqrt(inner.diagonal())
    inverse = np.asarray(np.linalg.inv(inner * np.outer(scale, scale)), dtype=float)
    directions = inverse / inverse.diagonal()
    bias = np.einsum("ip,ip->p", directions, (added * np.outer(scale, scale)) @ directions)
    ratios[free] = significance(1.0 / inverse.diagonal(), bias, windows)
    return ratios


def with_priors(fit: WeakFit, parameters: Sequence[Parameter]) -> tuple[WeakFit, tuple[str, ...]]:
    """The fit with Gaussian priors of its parameters, and the names of those that the record contradicts."""
    known = np.flatnonzero([p.sigma < np.inf and free for p, free in zip(parameters, fit.free, strict=True)])
    if not known.size:
        return fit, ()
    covariance = fit.covariance
    stated = [(p.start or 0.0, p.sigma, p.lower, p.upper) for p in parameters]
    mean, deviation, lower, upper = np.array(stated).T
    given = np.isin(np.arange(len(parameters)), known)
    innovation = covariance[np.ix_(known, known)] + np.diag(deviation[known] ** 2)
    unit = np.sqrt(innovation.diagonal())
    missed = (mean - fit.values)[known]
    gain = np.linalg.solve(innovation / np.outer(unit, unit), covariance[known] / unit[:, None]).T / unit
    contradicted = tuple(parameters[i].name for i in known[np.abs(missed) > _CONTRADICTED * unit].tolist())
    joined = replace(
        fit,
        values=np.clip(fit.values + gain @ missed, lower, upper),
        covariance=covariance - gain @ covariance[known],
        significance=np.where(given, np.inf, fit.significance),  # known beside the record
    )
    return joined, contradicted
