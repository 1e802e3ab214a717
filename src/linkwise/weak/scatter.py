"""Covariance of the weak normal equations due to noise in the displacements.

The residual r_k of window k of mass i is, to first order, the noise of every displacement in it under

    m phi'' + k phi - c phi'      for its own, k and c the sums of the slopes of its links,
    -(k_l phi - c_l phi')         for the mass at the other end of link l.

The estimate solves sum_k a_k r_k = 0, a_k the columns of window k. Noise at time t enters that sum by G(t) = sum_k a_k
kernel(t - t_k) and adds sigma^2 G G' to its covariance for every sample. Since a_k is noisy too, G also adds sigma^4 tr(Q Q'),
Q the quadratic form of the noise in the sum; the covariance of a quadratic form is that plus sigma^4 tr(Q Q). The noise of a
mode comes from all channels of its host, so that one channel is in several equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy
from scipy.sparse import csc_array

from linkwise.arrays import Floats, Indices
from linkwise.expression import Program, differentiate, symbols
from linkwise.model.law import VARIABLES, Law
from linkwise.weak.equations import WeakEquations
from linkwise.weak.patch import Patch
from linkwise.weak.weak_form import PHI, PHI_1, PHI_2, NoisePaths

FLOOR = 1e-24  # of the power of the terms: residuals below are rounding
_CORRELATED = ((PHI, PHI), (PHI_1, PHI_1), (PHI_2, PHI_2), (PHI, PHI_2), (PHI_2, PHI))
_COLUMNS = 64  # of an inverse, that are in memory together


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
        deviation = np.sqrt(0.5 * system.context.floored_elongation_variance[layout.links])
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
    window, stride = system.window, system.context.slope_stride
    at = np.flatnonzero(system.points[system.inside] % stride == 0)
    through = _own_noise(patch, system, layout.link_incidence, layout.readings)
    weights = noisy.under_kernels(through, noisy.masses, noisy.mean[:, :, at])
    shape = weights[PHI].shape
    kernels = np.reshape(weights, (len(weights), -1))
    slopes = patch.slopes[:, system.points[at] // stride]
    variance = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = stride * (weight * variance) ** 2
    acting = _own_noise(patch, system, patch.signs, layout.incidence)
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
    own = np.searchsorted(patch.layout.nodes, patch.masses)
    covariance = system.motion.covariance(patch.layout.nodes, floored=True)
    variance = np.maximum(covariance[own, own], np.finfo(float).tiny)
    return np.asarray(signs * (incidence @ covariance[:, own] / variance).T)


def sandwich(h: csc_array, j: csc_array, rows: Indices, columns: Indices) -> Floats:
    """Entries of h^-1 j h^-1 at k positions (`rows`, `columns`), which are near its diagonal; the whole matrix is dense.

    Some columns of h^-1 are in memory at a time, of as many parameters as there are.
    """
    factor, values = scipy.sparse.linalg.splu(csc_array(h)), np.empty(len(rows))
    for first in range(0, h.shape[0], _COLUMNS):
        some = np.flatnonzero((rows >= first) & (rows < first + _COLUMNS))
        which, places = np.unique(np.concatenate([rows[some], columns[some]]), return_inverse=True)
        solved = factor.solve((which == np.arange(h.shape[0])[:, None]).astype(float))
        left, right = solved[:, places[: len(some)]], (j @ solved)[:, places[len(some) :]]
        values[some] = np.einsum("pk,pk->k", left, right)
    return values
