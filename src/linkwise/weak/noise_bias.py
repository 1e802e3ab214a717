"""What noise adds to the products of terms, summed over all windows.

Two terms of one equation see the same noise, so their product is biased even where each of them is right on average; that is
what makes ordinary regression wrong when noise grows (errors in variables; Fuller, Measurement Error Models, 1987). For
functions h, g of elongations d, d' whose noises have the covariance c, with h and g free of bias (`weakform`), the bias of
h(d) g(d') at one sample is

    c h' g' - c^2/2 h'' g'' + c^3/6 h''' g''' - ...

and in a window it is the sum of that over its samples, weighted by the product of both kernels. Summed over all windows it
is the product of two signals, weighted by what all windows together make of each sample (`Window.coverage`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.weak.layout import PatchLayout
from linkwise.weak.terms import LawTerms
from linkwise.weak.window import Window


def noise_bias(
    layout: PatchLayout,
    atoms: Sequence[LawTerms],
    slope: Floats,
    noise: Floats,
    window: Window,
    valid: Floats,
) -> Floats:
    """(q, q): the bias of the products of all terms of `layout`, summed over windows, each weighted by `valid` (R,).

    `slope` (q,) are the slopes of the terms where they are constant, 0 for those of curved `atoms`; `noise` (c,) in m^2 is
    that in the displacements of the nodes.
    """
    kernel = layout.kernel
    covariance = (layout.incidence * noise) @ layout.incidence.T
    gram = window.kernels @ window.kernels.T
    bias = valid.sum() * covariance * np.outer(slope, slope) * gram[kernel[:, None], kernel]
    coverage: dict[int, Floats] = {}
    for number, one in enumerate(atoms):
        first, here, samples = one.part.kernel, one.terms, np.shape(one.slope)[-1]
        if first not in coverage:
            coverage[first] = window.coverage(window.kernels[first] * window.kernels, valid, samples)
        linear = covariance[here] * (one.part.sign * (one.slope @ coverage[first].T))[:, kernel] * slope
        bias[here] += linear
        bias[:, here] += linear.T
        for two in atoms[number:]:
            sign = one.part.sign * two.part.sign
            mixed = sign * _product_bias(
                one, two, covariance[here, two.terms], coverage[first][two.part.kernel]
            )
            bias[here, two.terms] += mixed
            if two is not one:
                bias[two.terms, here] += mixed.T
    return np.asarray(bias)


def _product_bias(one: LawTerms, two: LawTerms, covariance: Floats, weight: Floats) -> Floats:
    """(m, m'): the bias of the products of two sets of curved functions, summed over samples with `weight` (N,)."""
    total, factor = np.zeros(covariance.shape), -1.0
    for order, (h, g) in enumerate(zip(one.derivatives[1:], two.derivatives[1:], strict=False), start=1):
        factor /= -order
        weighted = h * weight
        products = g * weighted.sum(axis=-1, keepdims=True) if isinstance(g, float) else weighted @ g.T
        total += factor * covariance**order * products
    return total
