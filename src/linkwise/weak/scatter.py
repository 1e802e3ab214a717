"""Covariance of the weak normal equations due to noise in the displacements.

The residual r_k of window k of mass i is, to first order, the noise of every displacement in it under

    m phi'' + k phi - c phi'      for its own, k and c the sums of the slopes of its links,
    -(k_l phi - c_l phi')         for the mass at the other end of link l.

The estimate solves sum_k a_k r_k = 0, a_k the columns of window k. Noise at time t enters that sum by G(t) = sum_k a_k
kernel(t - t_k) and adds sigma^2 G G' to its covariance for every sample. Since a_k is noisy too, G also adds
sigma^4 tr(Q Q'), Q the quadratic form of the noise in the sum; the covariance of a quadratic form is that plus
sigma^4 tr(Q Q).

How noise of the channels enters the weak equations of masses and modes.

The noise of a mass is that of its own channel. That of a mode comes from all channels of its host, so that one channel is in
the inertia of several equations, and in all links between points.

The covariance H^-1 J H^-1 of the coefficients of a large structure, near the diagonal only.

The whole matrix would be dense. Entries near the diagonal follow from the complex step (Squire and Trapp 1998): the imaginary
part of (H + i e J)^-1 = H^-1 - i e H^-1 J H^-1 + O(e^2), for an e whose square is below rounding. Ordered so that H and J are
block tridiagonal, that inverse follows near its diagonal from one sweep down the blocks and one up (Takahashi 1973). Time and
memory are linear in the number of coefficients for chains of parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement, pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import VARIABLES, Law
from linkwise.weak.equations import WeakEquations
from linkwise.weak.patch import Patch
from linkwise.weak.weak_form import INNER, PHI, PHI_1, PHI_2, NoiseCoupling, NoisePaths


def noise_couplings(patch: Patch, system: WeakEquations) -> tuple[NoiseCoupling, ...]:
    """How the noise of channels enters the equations of a patch, one for each mass or mode."""
    weights = system.motion.source_weights
    couplings = patch.layout.noise_couplings
    return couplings if weights is None else tuple(coupling.through(weights) for coupling in couplings)


def noise_paths(patch: Patch, system: WeakEquations) -> NoisePaths:
    """The ways by which noise of channels enters the equations of a patch."""
    if system.motion.source_weights is None:
        return patch.layout.noise_paths
    return NoisePaths.of(noise_couplings(patch, system), len(patch.layout.links))


def channel_weights(
    patch: Patch,
    system: WeakEquations,
    masses: Floats,
    acting: Floats,
    slopes: Floats,
    channels: Indices,
) -> tuple[list[Floats], Indices, Indices]:
    """What noise of channels, of variance 1, is weighted by in sums over windows.

    The weights are the same for all terms of one kind, which act in the same equations with the same signs.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    masses : array of shape (m,)
        The masses in kg.
    acting : array of shape (k, m)
        Signs in the equations times the weights of these, of k kinds of terms.
    slopes : array of shape (2, l, P)
        Mean slopes of the links with respect to d (N/m) and v (N s/m).
    channels : array of int
        The channels, in order.

    Returns
    -------
    weights : list of array of shape (c, P)
        Under each kernel, but for the last of an eliminated state, those of pairs of a kind and a channel with noise in it.
    kind, channel : array of int, shape (c,)
        The pairs, those of a channel one after the other.
    """
    paths, variance = noise_paths(patch, system), system.motion.floored_variance
    paths = paths.chosen(np.isin(paths.source, channels))
    by_path = acting[:, paths.equation] * np.sqrt(variance[paths.source])
    by_channel = np.zeros((len(channels), len(acting), len(paths.source)))
    by_channel[np.searchsorted(channels, paths.source), :, np.arange(len(paths.source))] = by_path.T
    place, kind = np.nonzero(by_channel.any(axis=2))
    through = by_channel[place, kind]
    passed, inner = through @ paths.passed, patch.layout.inner
    stiffness, damping = (passed * ~inner) @ slopes
    inertia = through @ (paths.inertia * masses[paths.equation])
    weights = [stiffness, -damping, np.broadcast_to(inertia[:, None], stiffness.shape)]
    if len(system.window.kernels) > INNER:
        stiffness, damping = (passed * inner) @ slopes
        weights += [stiffness, -damping]
    return weights, kind, channels[place]


def own_noise(patch: Patch, system: WeakEquations, signs: Floats, incidence: Floats) -> Floats:
    """How the noise in the displacement of each mass or mode itself acts in its equation through terms.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    signs : array of shape (m, k)
        Signs of the terms in the equations.
    incidence : array of shape (k, c)
        Weights of the nodes in what the terms are functions of.

    Returns
    -------
    array of shape (m, k)
        The sign times the share of each term's noise that follows that of the mode; 1 for each term in the equation of a mass.
    """
    if system.structure_layout.between_masses:
        return np.abs(signs)
    own = np.searchsorted(patch.layout.nodes, patch.masses)
    covariance = system.motion.covariance(patch.layout.nodes, floored=True)
    return np.asarray(signs * (incidence @ covariance[:, own] / covariance[own, own]).T)


def own_kernels(patch: Patch, system: WeakEquations, slopes: Floats, masses: Floats) -> Floats:
    """Weights of the kernels in the noise that the displacement of each mass or mode itself leaves in its equation.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    slopes : array of shape (2, l, P)
        Slopes of the links with respect to d and v.
    masses : array of shape (m,)
        The masses in kg.

    Returns
    -------
    array of shape (K, m, P)
        The weights.
    """
    own, inner = own_noise_of_links(patch, system), patch.layout.inner
    stiffness, damping = (own * ~inner) @ slopes
    kernels = [stiffness, -damping, np.broadcast_to(masses[:, None], stiffness.shape)]
    if len(system.window.kernels) > INNER:
        stiffness, damping = (own * inner) @ slopes
        kernels += [stiffness, -damping, np.zeros_like(stiffness)]
    return np.stack(kernels)


def own_noise_of_links(patch: Patch, system: WeakEquations) -> Floats:
    """(m, l) `own_noise` through the elongations of the links."""
    return own_noise(patch, system, patch.layout.link_incidence, patch.layout.readings)


def joint_sums(
    coupling: NoiseCoupling, slopes: Floats, kernels: Floats, system: WeakEquations
) -> tuple[Floats, Floats]:
    """What the noise of several channels adds to an equation, as that of two channels of variance 1.

    The sums of every channel are s phi - d phi', s and d its stiffness and damping, so that all channels together have the
    products of two sums at each point: those of the Cholesky factor of the covariance of s and d. So many channels that pass
    through links, and not through inertia or eliminated states, cost as much as two.

    Parameters
    ----------
    coupling : NoiseCoupling
        How noise enters the equation.
    slopes : array of shape (2, k, P)
        Slopes of its links with respect to d and v.
    kernels : array of shape (K, s, P)
        Sums over windows under the kernels.
    system : WeakEquations
        All equations of the record.

    Returns
    -------
    tuple of array of shape (s, P)
        The sums.
    """
    variance = system.motion.floored_variance[coupling.sources]
    stiffness, damping = coupling.passed @ slopes
    first = np.sqrt(variance @ stiffness**2)
    shared = np.divide(variance @ (stiffness * damping), first, out=np.zeros_like(first), where=first > 0.0)
    second = np.sqrt(np.maximum(variance @ damping**2 - shared**2, 0.0))
    phi, phi_1 = kernels[:PHI_2]
    return first * phi - shared * phi_1, second * phi_1


_STEP = 1e-30  # e, right_blocks matrices of order 1


def sandwich(h: csc_array, j: csc_array, rows: Indices, columns: Indices) -> Floats:
    """Entries of h^-1 j h^-1 where h or j has entries.

    Parameters
    ----------
    h : sparse array of shape (p, p)
        Symmetric and positive definite.
    j : sparse array of shape (p, p)
        Symmetric.
    rows, columns : array of int, shape (k,)
        Positions of the entries.

    Returns
    -------
    array of shape (k,)
        The entries.

    References
    ----------
    W. Squire and G. Trapp, SIAM Rev. 40, 110 (1998); K. Takahashi, J. Fagan and M.-S. Chin, Proc. 8th PICA Conf., 63 (1973).
    """
    scale = 1.0 / np.sqrt(h.diagonal())
    scaled = [matrix.multiply(scale[:, None]).multiply(scale).tocoo() for matrix in (h, j)]
    step = _STEP / max(float(np.max(np.abs(scaled[1].data), initial=0.0)), np.finfo(float).tiny)
    position = np.empty(len(scale), dtype=np.intp)
    position[reverse_cuthill_mckee((abs(h) + abs(j)).tocsr(), symmetric_mode=True)] = np.arange(len(scale))
    diagonal_blocks, right_blocks = _inverse(
        position[np.concatenate([matrix.row for matrix in scaled])],
        position[np.concatenate([matrix.col for matrix in scaled])],
        np.concatenate([scaled[0].data.astype(complex), 1j * step * scaled[1].data]),
        len(scale),
    )
    size = diagonal_blocks.shape[1]
    first, last = np.minimum(position[rows], position[columns]), np.maximum(position[rows], position[columns])
    block, inside = np.divmod(first, size)
    last_block, along = np.divmod(last, size)
    values = np.where(
        last_block == block, diagonal_blocks[block, inside, along], right_blocks[block, inside, along]
    )
    return np.asarray(-values.imag / step * scale[rows] * scale[columns])


def _inverse(
    rows: Indices, columns: Indices, data: NDArray[np.complex128], count: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The inverse of a symmetric matrix, sum of `data` at `rows` and `columns`, in blocks as wide as its band.

    Its blocks on the diagonal (K, b, b), and to the right of them (K, b, b), the last one of those without meaning.
    """
    size = max(int(np.max(np.abs(rows - columns))), 1)
    blocks = -(-count // size)
    diagonal, right = np.zeros((2, blocks, size, size), dtype=complex)
    padding = np.arange(count, blocks * size) % size
    diagonal[-1, padding, padding] = 1.0
    block, inside = np.divmod(rows, size)
    step, along = columns // size - block, columns % size
    for target, chosen in ((diagonal, step == 0), (right, step == 1)):
        np.add.at(target, (block[chosen], inside[chosen], along[chosen]), data[chosen])
    inverses = [np.linalg.inv(diagonal[0])]
    for k in range(1, blocks):
        coupling = right[k - 1].copy()
        right[k - 1] = inverses[-1] @ coupling
        inverses.append(np.linalg.inv(diagonal[k] - coupling.T @ right[k - 1]))
    diagonal_blocks, right_blocks = np.stack(inverses), np.zeros_like(right)
    for k in reversed(range(blocks - 1)):
        right_blocks[k] = -right[k] @ diagonal_blocks[k + 1]
        diagonal_blocks[k] -= right_blocks[k] @ right[k].T
    return diagonal_blocks, right_blocks


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
    masses : array of shape (m,)
        Masses in kg.
    mean, square : array of shape (2, l, P)
        Means and mean squares of the slopes of the links.
    """

    masses: Floats
    mean: Floats
    square: Floats

    @classmethod
    def along(cls, patch: Patch, system: WeakEquations, values: Floats) -> SlopeStatistics:
        """Statistics along the smoothed motion.

        Parameters
        ----------
        patch : Patch
            The equations.
        system : WeakEquations
            All equations of the record, at P of whose windows they are wanted.
        values : array of shape (p,)
            The parameters.

        Returns
        -------
        SlopeStatistics
            The statistics.
        """
        layout, windows = patch.layout, system.points
        deviation = np.sqrt(0.5 * system.context.floored_elongation_variance[layout.links])
        mean, square = np.empty((2, 2, len(layout.links), len(windows)))
        for group in layout.groups:
            program, constant = _slopes(group.weak_law.law)
            rows, links, at = group.positions, group.links[:, None], windows[:1] if constant else windows
            offsets = deviation[rows, None, None] * np.array([[-1.0], [1.0]])
            coefficients = [number.at(values)[:, None, None] for number in group.coefficients.values()]
            d, v = system.d[links, at][:, None] + offsets, system.v[links, at][:, None]
            for by, (low, high) in enumerate(
                slope.transpose(1, 0, 2) for slope in program(d, v, *coefficients)
            ):
                mean[by, rows] = 0.5 * (low + high)
                square[by, rows] = 0.5 * (low**2 + high**2)
        return cls(layout.inertia.at(values), mean, square)


@lru_cache(maxsize=512)
def _slopes(law: Law) -> tuple[Program, bool]:
    """Program for the slopes of a law with respect to d and v, and whether they are constant."""
    slopes = [differentiate(law.expression, name) for name in VARIABLES]
    constant = not any(name in symbols(slope) for name in VARIABLES for slope in slopes)
    return Program(slopes, (*VARIABLES, *law.coefficients), wide=VARIABLES), constant


def residual_excess(
    noisy: Sequence[tuple[Patch, SlopeStatistics]], values: Floats, system: WeakEquations
) -> float:
    """Power of the residuals over the power expected from noise.

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
    float
        The ratio; 1 for laws and noise that fit.
    """
    windows, total, count = system.points[system.inside], 0.0, 0.0
    for patch, statistics in noisy:
        residual, valid = patch.residual(values)[:, windows], patch.valid[windows]
        total += float((residual**2 / noise_power(patch, statistics, system)).sum(axis=0) @ valid)
        count += len(patch.masses) * float(valid.sum())
    return total / max(count, 1.0)


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
        Mean squares at the points of `system` that are `inside`.
    """
    gram = system.window.kernels @ system.window.kernels.T
    mean, square = (array[..., system.inside] for array in (statistics.mean, statistics.square))
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
    noisy: Sequence[tuple[Patch, SlopeStatistics]], weights: Sequence[Floats], system: WeakEquations
) -> Iterator[tuple[Indices, Floats]]:
    """Covariance of the normal equations due to noise, in blocks.

    Parameters
    ----------
    noisy : sequence of (Patch, SlopeStatistics)
        The equations and their slopes.
    weights : sequence of array of shape (m,)
        Weights of the masses of each patch.
    system : WeakEquations
        All equations of the record.

    Yields
    ------
    parameters : array of int, shape (s,)
        Indices of the parameters, some perhaps repeated.
    covariance : array of shape (s, s)
        Their block.
    """
    count = len(system.motion.floored_variance)
    of_patches = [np.bincount(noise_paths(patch, system).source, minlength=count) for patch, _ in noisy]
    equations = np.sum(of_patches, axis=0, dtype=int)
    pending = np.count_nonzero(of_patches, axis=0)
    across = pending > 1
    shared_sums: dict[int, list[tuple[Indices, Floats]]] = {}
    for (patch, statistics), weight, present in zip(noisy, weights, of_patches, strict=True):
        parameters = patch.layout.free_parameters
        sums = system.window.adjoint(patch.rows[patch.layout.free_terms], system.thinning)
        total = _quadratic_noise(patch, statistics, weight, system)
        alone = _alone(patch, system, equations)
        for terms, of_noise in _joint_sums(patch, statistics, weight, sums, system, alone):
            total[terms[:, None], terms] += of_noise @ of_noise.T
        others = np.setdiff1d(np.flatnonzero(present), list(alone))
        for channel, terms, of_noise in _channel_sums(patch, statistics, weight, sums, system, others):
            if across[channel]:
                shared_sums.setdefault(channel, []).append((parameters[terms], of_noise))
            else:
                total[terms[:, None], terms] += of_noise @ of_noise.T
        yield parameters, total
        pending -= present > 0
        for channel in [channel for channel in shared_sums if not pending[channel]]:
            which, of_noise = (np.concatenate(parts) for parts in zip(*shared_sums.pop(channel), strict=True))
            yield which, of_noise @ of_noise.T


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


def _quadratic_noise(
    patch: Patch, statistics: SlopeStatistics, weight: Floats, system: WeakEquations
) -> Floats:
    """(s, s) tr(Q Q) for the noise in each mass's own displacement, over all masses of a patch.

    Columns under phi see the noise of windows before and after alike, those under phi' with opposite signs: of these it is
    negative.
    """
    window = system.window
    at = np.flatnonzero(system.points[system.inside] % system.slope_stride == 0)
    kernels = own_kernels(patch, system, statistics.mean[:, :, at], statistics.masses)
    shape = kernels.shape[1:]
    kernels = kernels.reshape(len(kernels), -1)
    slopes = patch.slopes[:, system.points[at] // system.slope_stride]
    variance = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = system.slope_stride * (weight * variance) ** 2
    acting = own_noise(patch, system, patch.signs, patch.layout.incidence)
    total = np.zeros(patch.products.shape)
    layout, terms = patch.layout, patch.layout.free_terms_by_kernel
    for row, column in _CORRELATED if len(kernels) == INNER else product(range(len(terms)), repeat=2):
        first, second = terms[row], terms[column]
        if len(first) and len(second):
            correlation = (
                ((window.cross_correlations[row, column].T @ kernels) * kernels).sum(axis=0).reshape(shape)
            )
            acts = acting[:, first, None] * acting[:, None, second]
            acts *= amount[:, None, None]
            sums = (slopes[first] * correlation[:, None]) @ slopes[second].T
            total[first[:, None], second] = (acts * sums).sum(axis=0)
    return total[layout.free_terms[:, None], layout.free_terms]
