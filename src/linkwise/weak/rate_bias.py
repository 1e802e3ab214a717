"""Bias that noise adds to products of terms that act by a smoothed rate (`noise_bias` has that of all others).

A smoothed rate contains the noise of its elongation under the odd filter that gives the rate. It is in common with that of a
linear damper in the same window and with that of functions of the same rate, and hardly with terms under even test functions.
To first order the bias of a product is the covariance of both noises times the slopes of both functions, which are taken as
constant within a window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from linkwise.arrays import Floats
from linkwise.weak.patch_layout import PatchLayout
from linkwise.weak.terms import LawTerms
from linkwise.weak.weak_form import WeakPart, none_alone
from linkwise.weak.window import Window


def rate_bias(
    layout: PatchLayout,
    evaluated: Sequence[LawTerms],
    slope: Floats,
    noise: Floats,
    window: Window,
    valid: Floats,
    rate_filter: Floats,
    alone: Callable[[WeakPart], bool] = none_alone,
) -> Floats | float:
    """Bias of the products of all terms with those that act by a smoothed rate, summed over windows.

    Parameters
    ----------
    layout : PatchLayout
        The q terms.
    evaluated : sequence of LawTerms
        The terms of laws.
    slope : array of shape (q,)
        Slopes of the terms by d where they are constant; 0 for others.
    noise : array of shape (c, c)
        Covariance in m^2 of the displacements of the nodes.
    window : Window
        The test functions.
    valid : array of shape (R,)
        Weights of the windows.
    rate_filter : array of shape (T,)
        The filter that gives rates.
    alone : callable, optional
        Whether the terms of a part are tested one at a time: products of those of two such parts are left out.

    Returns
    -------
    array of shape (q, q) or float
        The bias; 0 where no term acts by a rate.
    """
    rated = [(terms, terms.rate_slope) for terms in evaluated if terms.rate_slope is not None]
    if not rated:
        return 0.0
    covariance = layout.incidence @ noise @ layout.incidence.T
    bias = np.zeros_like(covariance)
    samples, kernels = rated[0][1].shape[1], window.kernels
    with_rate = np.stack([_correlated(kernel, rate_filter) for kernel in kernels])
    with_both = np.stack([_correlated(kernel, -rate_filter) for kernel in with_rate])
    under = sorted({terms.part.kernel for terms, _ in rated})
    coverage = {
        kernel: window.coverage(
            kernels[kernel] * np.concatenate([with_rate, with_both[under]]), valid, samples
        )
        for kernel in under
    }
    for number, (first, by_rate) in enumerate(rated):
        rows = first.terms
        displaced = coverage[first.part.kernel][: len(kernels)]
        rates = dict(zip(under, coverage[first.part.kernel][len(kernels) :], strict=True))
        linear = covariance[rows] * (by_rate @ displaced.T)[:, layout.kernel] * slope
        bias[rows] += linear
        bias[:, rows] += linear.T
        for second in evaluated:
            if isinstance(second.slope, float) or _apart(first, second, alone):
                continue
            columns = second.terms
            weighted = by_rate * displaced[second.part.kernel]
            mixed = second.signed[1] * covariance[rows, columns] * (weighted @ second.slope.T)
            bias[rows, columns] += mixed
            bias[columns, rows] += mixed.T
        for second, by_second in rated[number:]:
            if _apart(first, second, alone):
                continue
            both = by_rate * rates[second.part.kernel]
            mixed = covariance[rows, second.terms] * (both @ by_second.T)
            bias[rows, second.terms] += mixed
            if second is not first:
                bias[second.terms, rows] += mixed.T
    return bias


def _apart(first: LawTerms, second: LawTerms, alone: Callable[[WeakPart], bool]) -> bool:
    """Whether nobody asks for the products of two sets of terms."""
    return second is not first and alone(first.part) and alone(second.part)


def _correlated(kernel: Floats, taps: Floats) -> Floats:
    """The sums of a kernel over the taps of a centred filter around each of its samples."""
    half = len(taps) // 2
    return np.correlate(kernel, taps, "full")[half : half + len(kernel)]
