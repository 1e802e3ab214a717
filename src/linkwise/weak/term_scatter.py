"""Variances due to noise of the normal equations of single terms: the diagonal of what `scatter` has, for less.

To first order the noise of a channel enters the sum of a term by k(t)' u(t), k the sums of kernels over windows for the term,
and u what the channel is weighted by, which is the same for all terms that act in the same equations with the same signs.
Their variance is the sum over time of k' (sum of u u' over channels) k.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.weak.equations import WeakEquations
from linkwise.weak.noise_paths import channel_weights, own_kernels, own_noise
from linkwise.weak.patch import Patch
from linkwise.weak.weak_form import INNER, PHI_2


@dataclass(frozen=True, eq=False)
class SingleTerms:
    """Terms of which each has a normal equation of its own.

    Attributes
    ----------
    rows : array of int, shape (r,)
        Different rows of the patch.
    place : array of int, shape (s,)
        Which of these each term is.
    acting : array of shape (k, m)
        Signs in the equations, of k kinds of terms.
    kind : array of int, shape (s,)
        The kind of each.
    """

    rows: Indices
    place: Indices
    acting: Floats
    kind: Indices

    @classmethod
    def of(cls, rows: Indices, signs: Floats) -> SingleTerms:
        """Terms that are the `rows` (s,) of a patch with some `signs` (m, s) in its equations."""
        acting, kind = np.unique(signs.T, axis=0, return_inverse=True)
        return cls(*np.unique(rows, return_inverse=True), acting, kind)

    def chosen(self, numbers: Indices) -> SingleTerms:
        """Some of the terms."""
        kinds, kind = np.unique(self.kind[numbers], return_inverse=True)
        rows, place = np.unique(self.place[numbers], return_inverse=True)
        return SingleTerms(self.rows[rows], place, self.acting[kinds], kind)


def linear_scatter(
    patch: Patch,
    system: WeakEquations,
    masses: Floats,
    weight: Floats,
    terms: SingleTerms,
    slopes: Floats,
    sums: Floats,
) -> Floats:
    """Variances of first order: sums of squares over points of the record, of which some give less than all.

    Parameters
    ----------
    patch : Patch
        The equations.
    system : WeakEquations
        All equations of the record.
    masses, weight : array of shape (m,)
        The masses in kg, and the weights of their equations.
    terms : SingleTerms
        The terms.
    slopes : array of shape (2, l, P)
        Mean slopes of the links with respect to d (N/m) and v (N s/m) at the points.
    sums : array of shape (K, r, P)
        Sums of the kernels at the points for the different rows of the terms.

    Returns
    -------
    array of shape (s,)
        The variances.
    """
    weights, kind, _ = channel_weights(patch, system, masses, terms.acting * weight, slopes)
    of_kind = (kind == np.arange(len(terms.acting))[:, None]).astype(float)
    kernels = [kernel for kernel in range(len(sums)) if kernel != INNER + PHI_2]
    total = np.zeros((sums.shape[1], len(terms.acting)))
    for first, second in combinations_with_replacement(kernels, 2):
        form = of_kind @ (weights[first] * weights[second])
        total += (1.0 if first == second else 2.0) * ((sums[first] * sums[second]) @ form.T)
    return total[terms.place, terms.kind]


def quadratic_scatter(
    patch: Patch, system: WeakEquations, masses: Floats, weight: Floats, terms: SingleTerms, slopes: Floats
) -> Floats:
    """What noise in the terms themselves adds: the diagonal of `scatter.quadratic_noise` over the whole record.

    Parameters
    ----------
    patch, system, masses, weight, terms
        As of `linear_scatter`.
    slopes : array of shape (2, l, P)
        Mean slopes of the links at every `WeakEquations.slope_stride`-th window.

    Returns
    -------
    array of shape (s,)
        What it adds to the variances.
    """
    window, layout = system.window, patch.layout
    kernels = own_kernels(patch, system, slopes, masses)
    flat = kernels.reshape(len(kernels), -1)
    variance = system.motion.covariance(patch.masses, floored=True).diagonal()
    amount = system.slope_stride * (weight * variance) ** 2
    squares = np.empty((len(amount), len(terms.rows)))
    for kernel in np.unique(layout.kernel[terms.rows]).tolist():
        own = np.flatnonzero(layout.kernel[terms.rows] == kernel)
        correlation = np.einsum("ij,ij->j", window.cross_correlations[kernel, kernel].T @ flat, flat)
        squares[:, own] = correlation.reshape(kernels.shape[1:]) @ (patch.slopes[terms.rows[own]] ** 2).T
    acting = own_noise(
        patch, system, terms.acting.T[:, terms.kind], layout.incidence[terms.rows[terms.place]]
    )
    return np.asarray(amount @ (acting**2 * squares[:, terms.place]))
