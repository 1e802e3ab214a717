"""Noise that was found too large: motion that fills the band up to half the sampling rate is taken for a part of it.

A fit of laws that are right shows less. Its residuals, per degree of freedom, are no less than the noise, whatever the laws
are, and so the noise of each channel may be lowered to them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.damped_step import freedom
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.segments import Segments

_CHANCE = 2.0  # standard deviations of chi-square
_LEAST = 0.08  # by which chi-square is below 1: what the estimate of the noise scatters by in long records
_STEPS = 20  # beside the optimum; a search that takes more may creep along a bend of the likelihood ...
_LOOSE = 0.01  # ... which looser links straighten: the relaxation from which it starts again


def with_noise_of_residuals(
    segments: Segments, fit: AnnealingFit, annealer: Annealer, lowest: Floats
) -> AnnealingFit:
    """A fit whose chi-square is below 1 again, with the noise of its residuals in place of that found beforehand.

    Parameters
    ----------
    segments : Segments
        The records.
    fit : AnnealingFit
        The fit.
    annealer : Annealer
        Fits again.
    lowest : array of shape (C,)
        The least deviations; infinite where the noise of a channel is stated, which stays as it is.

    Returns
    -------
    AnnealingFit
        The fit; the given one where its chi-square is not below 1, or without an optimum.
    """
    least = max(_LEAST, _CHANCE * np.sqrt(2.0 / fit.samples))
    if fit.status is not AnnealingStatus.CONVERGED or fit.chi_square > 1.0 - least:
        return fit
    if not isinstance(annealer.loss, Gaussian):  # whose mean cost alone is that of the noise
        return fit
    counts = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    powers = np.sum(fit.misfit.residuals**2, axis=(0, 2)) / counts * fit.samples / freedom(segments)
    least = np.minimum(lowest / fit.scales.sigma, 1.0)
    factors = np.clip(np.sqrt(powers), least, 1.0)
    if (factors == 1.0).all():
        return fit
    scales = replace(fit.scales, sigma=fit.scales.sigma * factors)
    tight = AnnealingSchedule(initial_q=fit.q, final_q=fit.q, max_steps=_STEPS)
    again = annealer(segments, fit.point, scales, tight)
    if again.status in (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK):
        loose = AnnealingSchedule(initial_q=max(fit.q, _LOOSE), final_q=fit.q)
        again = annealer(segments, fit.point, scales, loose)
    if again.status is AnnealingStatus.INTERRUPTED:
        return again
    if again.status is not AnnealingStatus.CONVERGED:
        return fit
    return replace(again, path=(*fit.path, *again.path))
