"""Bias that noise adds to the products of terms, summed over all windows.

Two terms of one equation contain the same noise, so their product is biased even where each of them is unbiased; this is the
errors-in-variables bias of ordinary regression (Fuller, Measurement Error Models, 1987). For functions h, g of elongations
d, d' whose noises have the covariance c, with unbiased h and g (`weak_form`), the bias of h(d) g(d') at one sample is

    c h' g' - c^2/2 h'' g'' + c^3/6 h''' g''' - ...

and in a window it is the sum of that over its samples, weighted by the product of both kernels. Summed over all windows it
is the product of two signals, weighted by the sum of the windows at each sample (`Window.coverage`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.weak.patch_layout import PatchLayout
from linkwise.weak.terms import LawTerms
from linkwise.weak.weak_form import WeakPart, none_alone
from linkwise.weak.window import Window


def noise_bias(
    layout: PatchLayout,
    curved: Sequence[LawTerms],
    slope: Floats,
    noise: Floats,
    window: Window,
    valid: Floats,
    alone: Callable[[WeakPart], bool] = none_alone,
) -> Floats:
    """Bias of the products of all terms of a layout, summed over windows.

    Parameters
    ----------
    layout : PatchLayout
        The q terms.
    curved : sequence of LawTerms
        The terms that are nonlinear in d.
    slope : array of shape (q,)
        Slopes of the terms where they are constant; 0 for nonlinear terms.
    noise : array of shape (c, c)
        Covariance in m^2 of the displacements of the nodes.
    window : Window
        The test functions.
    valid : array of shape (R,)
        Weights of the windows.
    alone : callable, optional
        Whether the terms of a part are tested one at a time: products of those of two such parts are left out.

    Returns
    -------
    array of shape (q, q)
        The bias.
    """
    kernel = layout.kernel
    covariance = layout.incidence @ noise @ layout.incidence.T
    gram = window.kernels @ window.kernels.T
    bias = valid.sum() * covariance * np.outer(slope, slope) * gram[kernel[:, None], kernel]
    coverage: dict[int, Floats] = {}
    for number, first in enumerate(curved):
        under, rows, samples = (
            first.part.kernel,
            first.terms,
            np.shape(first.slope)[-1],
        )
        if under not in coverage:
            coverage[under] = window.coverage(window.kernels[under] * window.kernels, valid, samples)
        linear = covariance[rows] * (first.signed[1] * (first.slope @ coverage[under].T))[:, kernel] * slope
        bias[rows] += linear
        bias[:, rows] += linear.T
        weighted: dict[int, list[Floats]] = {}
        for second in curved[number:]:
            if second is not first and alone(first.part) and alone(second.part):
                continue
            under_second = second.part.kernel
            if under_second not in weighted:
                weighted[under_second] = [h * coverage[under][under_second] for h in first.derivatives[1:]]
            mixed = _product_bias(first, second, covariance[rows, second.terms], weighted[under_second])
            bias[rows, second.terms] += mixed
            if second is not first:
                bias[second.terms, rows] += mixed.T
    return np.asarray(bias)


def _product_bias(
    first: LawTerms, second: LawTerms, covariance: Floats, weighted: Sequence[Floats]
) -> Floats:
    """(m, m'): the bias of the products of two sets of curved functions, summed over samples.

    `weighted` are the derivatives of the first, without their factors, times the weights of the samples.
    """
    total, factor = np.zeros(covariance.shape), -1.0
    pairs = zip(weighted, second.derivatives[1:], strict=False)
    factors = zip(first.signed[1:], second.signed[1:], strict=False)
    for order, ((h, g), (of_h, of_g)) in enumerate(zip(pairs, factors, strict=True), start=1):
        factor /= -order
        products = g * h.sum(axis=-1, keepdims=True) if isinstance(g, float) else h @ g.T
        total += factor * of_h * of_g * covariance**order * products
    return total
