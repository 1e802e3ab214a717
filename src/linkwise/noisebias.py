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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.atoms import Atoms
from linkwise.window import Window

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Straight:
    """What noise in the elongations makes of q terms to the first order: sums of `kernel` (q,) times `slope` (q,) e.

    `slope` is 0 for terms that are curved; the covariance of the noises e is `covariance` (q, q) in m^2.
    """

    kernel: NDArray[np.intp]
    slope: Floats
    covariance: Floats


def noise_bias(
    straight: Straight, curved: Sequence[tuple[slice, Atoms]], window: Window, valid: Floats, samples: int
) -> Floats:
    """(q, q): the bias of the products of all terms, summed over the windows, each weighted by `valid` (R,).

    `curved` are the atoms with their places among the terms, evaluated on so many `samples`.
    """
    kernel, slope, covariance = straight.kernel, straight.slope, straight.covariance
    gram = window.kernels @ window.kernels.T
    bias = valid.sum() * covariance * np.outer(slope, slope) * gram[kernel[:, None], kernel]
    coverage = {
        first: window.coverage(window.kernels[first] * window.kernels, valid, samples)
        for first in {atoms.part.kernel for _, atoms in curved}
    }
    for number, (here, one) in enumerate(curved):
        covered = coverage[one.part.kernel]
        reached = one.part.sign * (one.slope @ covered.T)
        linear = covariance[here] * reached[:, kernel] * slope
        bias[here] += linear
        bias[:, here] += linear.T
        for there, two in curved[number:]:
            sign = one.part.sign * two.part.sign
            mixed = sign * _product_bias(one, two, covariance[here, there], covered[two.part.kernel])
            bias[here, there] += mixed
            if two is not one:
                bias[there, here] += mixed.T
    return np.asarray(bias)


def _product_bias(one: Atoms, two: Atoms, covariance: Floats, weight: Floats) -> Floats:
    """(m, m'): the bias of the products of two sets of curved functions, summed over samples with `weight` (N,)."""
    total, factor = np.zeros(covariance.shape), -1.0
    for order, (h, g) in enumerate(zip(one.chain[1:], two.chain[1:], strict=False), start=1):
        factor /= -order
        weighted = h * weight
        products = g * weighted.sum(axis=-1, keepdims=True) if isinstance(g, float) else weighted @ g.T
        total += factor * covariance**order * products
    return total
