"""Covariance of the weak normal equations due to noise in the displacements.

The residual r_k of window k of mass i is, to first order, the noise of every displacement in it under

    m phi'' + k phi - c phi'      for its own, k and c the sums of the slopes of its links,
    -(k_l phi - c_l phi')         for the mass at the other end of link l.

The estimate solves sum_k a_k r_k = 0, a_k the columns of window k. Noise at time t enters that sum by G(t) = sum_k a_k
kernel(t - t_k) and adds sigma^2 G G' to its covariance for every sample. Since a_k is noisy too, G also adds
sigma^4 tr(Q Q'), Q the quadratic form of the noise in the sum; the covariance of a quadratic form is that plus
sigma^4 tr(Q Q).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import Law
from linkwise.model.law_text import VARIABLES
from linkwise.weak.equations import WeakEquations
from linkwise.weak.noise_paths import joint_sums, noise_couplings, own_kernels, own_noise, source_sums
from linkwise.weak.patch import Patch
from linkwise.weak.patch_layout import NoiseCoupling, PatchLayout
from linkwise.weak.stretches import Stretches
from linkwise.weak.weak_form import INNER, PHI, PHI_1, PHI_2

FLOOR = 1e-24  # of the power of the terms: residuals below are rounding
_AS_TWO = 2  # channels beyond which those of one equation are taken together
_CORRELATED = ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI))


@dataclass(frozen=True, eq=False)
class SlopeStatistics:
    """Means and mean squares over noise of the slopes of a patch's laws with respect to d (N/m) and v (N s/m).

    Each is the mean over two points, the smoothed motion plus and minus the standard deviation of the noise over sqrt(2),
    which is correct to the fourth power of the noise.

    Attributes
    ----------
    stretches : Stretches
        The stretches of the record that P points are of.
    masses : array of shape (m,)
        Masses in kg.
    mean, square : array of shape (2, l, P)
        Means and mean squares of the slopes of the links.
    """

    stretches: Stretches
    masses: Floats
    mean: Floats
    square: Floats

    @classmethod
    def along(
        cls, patch: Patch, system: WeakEquations, values: Floats, stretches: Stretches | None = None
    ) -> SlopeStatistics:
        """Statistics along the smoothed motion.

        Parameters
        ----------
        patch : Patch
            The equations.
        system : WeakEquations
            All equations of the record.
        values : array of shape (p,)
            The parameters.
        stretches : Stretches, optional
            Stretches of the record; the whole by default.

        Returns
        -------
        SlopeStatistics
            The statistics.
        """
        stretches = stretches or system.whole
        layout = patch.layout
        mean, square = _slopes_along(patch, system, values, stretches.windows)
        return cls(stretches, layout.inertia.at(values), mean, square)


def _slopes_along(
    patch: Patch, system: WeakEquations, values: Floats, windows: Indices
) -> tuple[Floats, Floats]:
    """(2, l, P) means and mean squares over noise of the slopes of the links at some windows."""
    layout = patch.layout
    deviation = np.sqrt(0.5 * system.context.floored_elongation_variance[layout.links])
    mean, square = np.empty((2, 2, len(layout.links), len(windows)))
    for group in layout.groups:
        program, constant = _slopes(group.weak_law.law)
        rows, links, at = group.positions, group.links[:, None], windows[:1] if constant else windows
        offsets = deviation[rows, None, None] * np.array([[-1.0], [1.0]])
        coefficients = [number.at(values)[:, None, None] for number in group.coefficients.values()]
        slopes = program(system.d[links, at][:, None] + offsets, system.v[links, at][:, None], *coefficients)
        for by, (low, high) in enumerate(slope.transpose(1, 0, 2) for slope in slopes):
            mean[by, rows] = 0.5 * (low + high)
            square[by, rows] = 0.5 * (low**2 + high**2)
    return mean, square


def slopes_of_links(layout: PatchLayout, values: Floats, d: Floats, v: Floats) -> Floats:
    """Slopes of the links of a patch along a motion without noise.

    Parameters
    ----------
    layout : PatchLayout
        The terms of the patch.
    values : array of shape (p,)
        The parameters.
    d, v : array of shape (l, P)
        Elongations in m and rates in m/s of its links.

    Returns
    -------
    array of shape (2, l, P)
        Slopes with respect to d (N/m) and v (N s/m).
    """
    slopes = np.empty((2, *d.shape))
    for group in layout.groups:
        program, _ = _slopes(group.weak_law.law)
        rows = group.positions
        coefficients = [number.at(values)[:, None] for number in group.coefficients.values()]
        slopes[0, rows], slopes[1, rows] = program(d[rows], v[rows], *coefficients)
    return slopes


@lru_cache(maxsize=512)
def _slopes(law: Law) -> tuple[Program, bool]:
    """Program for the slopes of a law with respect to d and v, and whether they are constant."""
    slopes = [differentiate(law.expression, name) for name in VARIABLES]
    constant = not any(name in symbols(slope) for name in VARIABLES for slope in slopes)
    return Program(slopes, (*VARIABLES, *law.coefficients), wide=VARIABLES), constant


def residual_excess(
    noisy: Sequence[tuple[Patch, SlopeStatistics]], values: Floats, system: WeakEquations
) -> Floats:
    """Power of the residuals over the power expected from noise, in each stretch.

    Parameters
    ----------
    noisy : sequence of (Patch, SlopeStatistics)
        The equations and their slopes.
    values : array of shape (p,)
        The parameters.
    system : WeakEquations
        All equations of the record.

    Returns
    -------
    array of shape (E,)
        The ratios; 1 for laws and noise that fit.
    """
    stretches = noisy[0][1].stretches
    windows, ends = stretches.windows[stretches.inside], [part.start for part in stretches.parts_inside]
    total, count = np.zeros((2, len(ends)))
    for patch, statistics in noisy:
        residual, valid = patch.residual(values)[:, windows], patch.valid[windows]
        power = noise_power(patch, statistics, system)
        total += np.add.reduceat((residual**2 / power).sum(axis=0) * valid, ends)
        count += len(patch.masses) * np.add.reduceat(valid, ends)
    return np.asarray(total / np.maximum(count, 1.0))


def noise_power(patch: Patch, statistics: SlopeStatistics, system: WeakEquations) -> Floats:
    """Power of the residuals that noise explains.

    Parameters
    ----------
    patch : Patch
        The equations.
    statistics : SlopeStatistics
        Their slopes.
    system : WeakEquations
        All equations of the record.

    Returns
    -------
    array of shape (m, I)
        Mean squares at the windows inside of the stretches of `statistics`.
    """
    gram = system.window.kernels @ system.window.kernels.T
    by_slope, variance = gram.diagonal()[[PHI, PHI_1]], system.motion.floored_variance
    mean, square = (array[..., statistics.stretches.inside] for array in (statistics.mean, statistics.square))
    passed, of_mean = (by_slope[0] * slopes[0] + by_slope[1] * slopes[1] for slopes in (square, mean**2))
    curved, expected = passed - of_mean, []
    for mass, coupling in zip(statistics.masses, noise_couplings(patch, system), strict=True):
        own, inertia = variance[coupling.sources], mass * coupling.inertia[:, None]
        stiffness, damping = (coupling.passed * ~coupling.inner @ slopes[coupling.links] for slopes in mean)
        power = by_slope[0] * stiffness**2 + by_slope[1] * damping**2
        power += inertia * (inertia * gram[PHI_2, PHI_2] + 2.0 * gram[PHI, PHI_2] * stiffness)
        if len(gram) > INNER:
            power = _power_without_state(gram, coupling, mean, inertia)
        expected.append(own @ power + (own @ coupling.passed**2) @ curved[coupling.links])
    floor = FLOOR * patch.largest()[:, None] / system.windows + np.finfo(float).tiny
    return np.asarray(np.stack(expected) + floor)


def _power_without_state(gram: Floats, coupling: NoiseCoupling, mean: Floats, inertia: Floats) -> Floats:
    """(s, I) `noise_power` of channels of variance 1, by the mean slopes, where a state is eliminated."""
    parts = []
    for chosen in (~coupling.inner, coupling.inner):
        stiffness, damping = (coupling.passed * chosen @ slopes[coupling.links] for slopes in mean)
        parts += [stiffness, -damping, np.zeros_like(stiffness)]
    parts[PHI_2] = np.broadcast_to(inertia, parts[PHI].shape)
    weights = np.stack(parts)
    return np.asarray(np.einsum("ksi,kl,lsi->si", weights, gram, weights, optimize=True))


def score_blocks(
    noisy: Sequence[tuple[Patch, SlopeStatistics]],
    weights: Sequence[Floats],
    system: WeakEquations,
    *,
    quadratic: bool = True,
) -> Iterator[tuple[Indices, Floats]]:
    """Covariance of the normal equations of each stretch due to noise, in blocks.

    Parameters
    ----------
    noisy : sequence of (Patch, SlopeStatistics)
        The equations and their slopes.
    weights : sequence of array of shape (m,)
        Weights of the masses of each patch.
    system : WeakEquations
        All equations of the record.
    quadratic : bool, optional
        Whether `quadratic_noise` is among them.

    Yields
    ------
    parameters : array of int, shape (s,)
        Indices of the parameters, some perhaps repeated.
    covariance : array of shape (E, s, s)
        Their block.
    """
    if not noisy:
        return
    variance = system.motion.floored_variance
    pending = Counter(
        channel
        for patch, _ in noisy
        for coupling in noise_couplings(patch, system)
        for channel in coupling.sources[variance[coupling.sources] > 0.0].tolist()
    )
    shared = frozenset(channel for channel, equations in pending.items() if equations > 1)
    contributions: dict[int, list[tuple[Indices, Floats, Floats]]] = {channel: [] for channel in pending}
    for (patch, statistics), weight in zip(noisy, weights, strict=True):
        products = statistics.stretches.products
        if quadratic:
            yield quadratic_noise(patch, statistics, weight, system)
        for channel, part in _noise_contributions(patch, statistics, weight, system, shared):
            if channel is None:
                which, scale, sums = part
                yield which, np.outer(scale, scale) * products(sums)
                continue
            contributions[channel].append(part)
            pending[channel] -= 1
            if not pending[channel]:
                which, scale, sums = (
                    np.concatenate(pieces) for pieces in zip(*contributions.pop(channel), strict=True)
                )
                yield which, variance[channel] * np.outer(scale, scale) * products(sums)


def _noise_contributions(
    patch: Patch, statistics: SlopeStatistics, weight: Floats, system: WeakEquations, shared: Collection[int]
) -> Iterator[tuple[int | None, tuple[Indices, Floats, Floats]]]:
    """For each channel whose noise enters an equation: parameters (s,), and G (s, P), to be scaled by (s,).

    Channels that are not `shared` with another equation stand together, as two of variance 1 without a number.
    """
    weighted = statistics.stretches.adjoint(patch.rows[patch.layout.free_terms])
    for i, coupling in enumerate(noise_couplings(patch, system)):
        kernels = weighted[coupling.terms].transpose(1, 0, 2)
        slopes = statistics.mean[:, coupling.links]
        scale = weight[i] * coupling.sign
        own = np.array([channel not in shared for channel in coupling.sources.tolist()]) & (
            coupling.inertia == 0.0
        )
        if np.sum(own) > _AS_TWO and not coupling.inner.any():
            for sums in joint_sums(coupling.of_sources(own), slopes, kernels, system):
                yield None, (coupling.parameter, scale, sums)
            coupling = coupling.of_sources(~own)
        for channel, sums in source_sums(coupling, statistics.masses[i], slopes, kernels, system):
            yield channel, (coupling.parameter, scale, sums)


def quadratic_noise(
    patch: Patch, statistics: SlopeStatistics, weight: Floats, system: WeakEquations
) -> tuple[Indices, Floats]:
    """tr(Q Q) for the noise in each mass's own displacement, over all masses of a patch.

    Columns under phi see the noise of windows before and after alike, those under phi' with opposite signs: of these it is
    negative.

    Parameters
    ----------
    patch, statistics, weight, system
        As of `score_blocks`, for one patch.

    Returns
    -------
    parameters : array of int, shape (s,)
        Indices of the parameters.
    covariance : array of shape (E, s, s)
        What it adds to their covariance.
    """
    window = system.window
    stretches = statistics.stretches
    inside = np.arange(len(stretches.windows))[stretches.inside]
    at = inside[stretches.windows[inside] % system.slope_stride == 0]
    parts = [slice(*np.searchsorted(at, [part.start, part.stop]).tolist()) for part in stretches.parts]
    kernels = own_kernels(patch, system, statistics.mean[:, :, at], statistics.masses)
    shape = kernels.shape[1:]
    kernels = kernels.reshape(len(kernels), -1)
    slopes = patch.slopes[:, stretches.windows[at] // system.slope_stride]
    variance = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = system.slope_stride * (weight * variance) ** 2
    acting = own_noise(patch, system, patch.signs, patch.layout.incidence)
    total = np.zeros((len(parts), *patch.products.shape))
    layout, terms = patch.layout, patch.layout.free_terms_by_kernel
    for row, column in _CORRELATED if len(kernels) == INNER else product(range(len(terms)), repeat=2):
        first, second = terms[row], terms[column]
        if len(first) and len(second):
            correlation = (
                ((window.cross_correlations[row, column].T @ kernels) * kernels).sum(axis=0).reshape(shape)
            )
            acts = acting[:, first, None] * acting[:, None, second]
            acts *= amount[:, None, None]
            weighted, others = slopes[first] * correlation[:, None], slopes[second].T
            for stretch, part in zip(total, parts, strict=True):
                sums = weighted[..., part] @ others[part]
                stretch[first[:, None], second] = (acts * sums).sum(axis=0)
    return layout.free_parameters, total[:, layout.free_terms[:, None], layout.free_terms]


def least_scatter(
    patch: Patch, system: WeakEquations, values: Floats, weight: Floats, rows: Indices, signs: Floats
) -> Floats:
    """What the variances of normal equations due to noise are at least: sums of squares over some points of the record.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    values : array of shape (p,)
        The parameters.
    weight : array of shape (m,)
        Weights of the masses.
    rows : array of int, shape (s,)
        The rows of the patch whose variances these are.
    signs : array of shape (m, s)
        Their signs in the equations.

    Returns
    -------
    array of shape (s,)
        The sums.
    """
    window, spacing, variance = system.window, system.slope_stride, system.motion.floored_variance
    mean, _ = _slopes_along(patch, system, values, np.arange(0, system.windows, spacing))
    masses = patch.layout.inertia.at(values)
    sums = window.some_adjoint(patch.rows, system.thinning, spacing)[rows]
    noise: dict[int, Floats] = {}
    for i, coupling in enumerate(noise_couplings(patch, system)):
        own = np.flatnonzero(signs[i])
        kernels = (sums[own] * (weight[i] * signs[i, own])[:, None, None]).transpose(1, 0, 2)
        slopes = mean[:, coupling.links]
        for channel, of_channel in source_sums(coupling, masses[i], slopes, kernels, system):
            noise.setdefault(channel, np.zeros((len(rows), mean.shape[2])))[own] += of_channel
    total = np.zeros(len(rows))
    for channel, of_channel in noise.items():
        total += variance[channel] * np.einsum("sp,sp->s", of_channel, of_channel)
    kernels = own_kernels(patch, system, mean, masses)
    shape = kernels.shape[1:]
    kernels = kernels.reshape(len(kernels), -1)
    of_masses = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = spacing * (weight * of_masses) ** 2
    acting = own_noise(patch, system, signs, patch.layout.incidence[rows]) ** 2
    for kernel in range(len(kernels)):
        own = np.flatnonzero(patch.layout.kernel[rows] == kernel)
        correlation = ((window.cross_correlations[kernel, kernel].T @ kernels) * kernels).sum(axis=0)
        squares = correlation.reshape(shape) @ (patch.slopes[rows[own]] ** 2).T
        total[own] += amount @ (acting[:, own] * squares)
    return total
