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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement, pairwise, product

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import VARIABLES, Law
from linkwise.weak.equations import WeakEquations
from linkwise.weak.noise_paths import (
    channel_weights,
    joint_sums,
    noise_couplings,
    noise_paths,
    own_kernels,
    own_noise,
)
from linkwise.weak.patch import Patch
from linkwise.weak.patch_layout import PatchLayout
from linkwise.weak.stretches import InnerStretches, Stretches
from linkwise.weak.weak_form import INNER, PHI, PHI_1, PHI_2

FLOOR = 1e-24  # of the power of the terms: residuals below are rounding
_AT_ONCE = 2**17  # numbers in the weights of channels that are in memory together
_AS_TWO = 2  # channels beyond which those of one equation are taken together
_CORRELATED = ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI))


@dataclass(frozen=True, eq=False)
class SlopeStatistics:
    """Means and mean squares over noise of the slopes of a patch's laws with respect to d (N/m) and v (N s/m).

    Each is the mean over two points, the smoothed motion plus and minus the standard deviation of the noise over sqrt(2),
    which is correct to the fourth power of the noise.

    Attributes
    ----------
    stretches : Stretches or InnerStretches
        The stretches of the record that P points are of.
    masses : array of shape (m,)
        Masses in kg.
    mean, square : array of shape (2, l, P)
        Means and mean squares of the slopes of the links.
    """

    stretches: Stretches | InnerStretches
    masses: Floats
    mean: Floats
    square: Floats

    @classmethod
    def along(
        cls,
        patch: Patch,
        system: WeakEquations,
        values: Floats,
        stretches: Stretches | InnerStretches | None = None,
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
        stretches : Stretches or InnerStretches, optional
            Stretches of the record; the whole by default.

        Returns
        -------
        SlopeStatistics
            The statistics.
        """
        stretches = stretches or system.whole
        layout = patch.layout
        mean, square = slopes_along(layout, system, values, stretches.windows)
        return cls(stretches, layout.inertia.at(values), mean, square)


def slopes_along(
    layout: PatchLayout, system: WeakEquations, values: Floats, windows: Indices
) -> tuple[Floats, Floats]:
    """Means and mean squares over noise of the slopes of the links of a patch at some windows.

    Parameters
    ----------
    layout : PatchLayout
        The links of the patch with their laws.
    system : WeakEquations
        Equations of the record.
    values : array of shape (p,)
        The parameters of the laws.
    windows : array of int, shape (P,)
        The windows.

    Returns
    -------
    mean, square : array of shape (2, l, P)
        Those with respect to d (N/m) and v (N s/m).
    """
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
    assert isinstance(stretches, Stretches)  # not some of their points
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
    mean, square = (array[..., statistics.stretches.inside] for array in (statistics.mean, statistics.square))
    paths, layout = noise_paths(patch, system), patch.layout
    of_mass = (paths.equation == np.arange(len(layout.masses))[:, None]) * system.motion.floored_variance[
        paths.source
    ]
    curved = np.tensordot(gram.diagonal()[[PHI, PHI_1]], square - mean**2, 1)
    inertia = (paths.inertia * statistics.masses[paths.equation])[:, None]
    stiffness, damping = (paths.passed * ~layout.inner) @ mean
    weights = [stiffness, -damping, np.broadcast_to(inertia, stiffness.shape)]
    if len(gram) > INNER:
        stiffness, damping = (paths.passed * layout.inner) @ mean
        weights += [stiffness, -damping]
    power = np.zeros_like(stiffness)
    every = combinations_with_replacement(range(len(weights)), 2)
    for first, second in _CORRELATED[:-1] if len(gram) == INNER else every:
        share = gram[first, second] if first == second else 2.0 * gram[first, second]
        power += share * (weights[first] * weights[second])
    floor = FLOOR * patch.largest()[:, None] / system.windows + np.finfo(float).tiny
    return np.asarray(of_mass @ power + (of_mass @ paths.passed**2) @ curved + floor)


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
    count = len(system.motion.floored_variance)
    of_patches = [np.bincount(noise_paths(patch, system).source, minlength=count) for patch, _ in noisy]
    equations = np.sum(of_patches, axis=0, dtype=int)
    pending = np.count_nonzero(of_patches, axis=0)
    across = pending > 1
    shared_sums: dict[int, list[tuple[Indices, Floats]]] = {}
    for (patch, statistics), weight, present in zip(noisy, weights, of_patches, strict=True):
        products, parameters = statistics.stretches.products, patch.layout.free_parameters
        sums = statistics.stretches.adjoint(patch.rows[patch.layout.free_terms])
        total = np.zeros((len(statistics.stretches.ranges), len(parameters), len(parameters)))
        if quadratic:
            total += quadratic_noise(patch, statistics, weight, system)[1]
        alone = _alone(patch, system, equations)
        for terms, of_noise in _joint_sums(patch, statistics, weight, sums, system, alone):
            total[:, terms[:, None], terms] += products(of_noise)
        others = np.setdiff1d(np.flatnonzero(present), list(alone))
        for channel, terms, of_noise in _channel_sums(patch, statistics, weight, sums, system, others):
            if across[channel]:
                shared_sums.setdefault(channel, []).append((parameters[terms], of_noise))
            else:
                total[:, terms[:, None], terms] += products(of_noise)
        yield parameters, total
        pending -= present > 0
        for channel in [channel for channel in shared_sums if not pending[channel]]:
            which, of_noise = (np.concatenate(parts) for parts in zip(*shared_sums.pop(channel), strict=True))
            yield which, products(of_noise)


def _alone(patch: Patch, system: WeakEquations, equations: Indices) -> frozenset[int]:
    """Channels whose noise enters one of all equations, through links alone, where these are so many that they stand together.

    `equations` (C,) is in how many the noise of each channel is.
    """
    paths = noise_paths(patch, system)
    alone = (equations[paths.source] == 1) & (paths.inertia == 0.0)
    many = np.bincount(paths.equation[alone], minlength=len(patch.masses)) > _AS_TWO
    many &= ~((patch.layout.link_incidence != 0.0) & patch.layout.inner).any(axis=1)
    return frozenset(paths.source[alone & many[paths.equation]].tolist())


def _joint_sums(
    patch: Patch,
    statistics: SlopeStatistics,
    weight: Floats,
    sums: Floats,
    system: WeakEquations,
    alone: frozenset[int],
) -> Iterator[tuple[Indices, Floats]]:
    """For each of two channels that have the noise of those which stand together: terms (s,) and sums (s, P)."""
    for i, coupling in enumerate(noise_couplings(patch, system) if alone else ()):
        own = np.isin(coupling.sources, list(alone))
        if own.any():
            kernels = sums[:, coupling.terms] * (weight[i] * coupling.sign)[:, None]
            for of_noise in joint_sums(
                coupling.of_sources(own), statistics.mean[:, coupling.links], kernels, system
            ):
                yield coupling.terms, of_noise


def _channel_sums(
    patch: Patch,
    statistics: SlopeStatistics,
    weight: Floats,
    sums: Floats,
    system: WeakEquations,
    channels: Indices,
) -> Iterator[tuple[int, Indices, Floats]]:
    """For each of the channels with noise in an equation: its number, the terms (s,) in these equations, and sums (s, P)."""
    acting, kind_of_term = patch.layout.free_kinds
    acting, masses, mean = acting * weight, statistics.masses, statistics.mean
    at_once = max(1, _AT_ONCE // max(len(acting) * mean.shape[2], 1))
    for start in range(0, len(channels), at_once):
        some = channels[start : start + at_once]
        weights, kind, channel = channel_weights(patch, system, masses, acting, mean, some)
        pairs, terms = np.nonzero(kind[:, None] == kind_of_term)
        ends = np.flatnonzero(np.diff(channel[pairs], append=-1)) + 1
        for first, last in pairwise([0, *ends.tolist()]):
            own, of_term = pairs[first:last], terms[first:last]
            of_noise = weights[PHI][own] * sums[PHI, of_term]
            for kernel in range(PHI_1, len(weights)):
                if kernel != PHI_2 or weights[kernel][own, 0].any():  # most channels are not in inertia
                    of_noise += weights[kernel][own] * sums[kernel, of_term]
            yield int(channel[own[0]]), of_term, of_noise


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
