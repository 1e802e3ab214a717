"""A fit whose residuals are autoregressive noise of sensors: channels weighted anew, and the covariance by the scores.

The likelihood goes on as if the noise were white, each channel with the variance that its noise has where the motion is. The
estimates are then as good as their weights, which need not be exact, and their covariance is that of an M-estimator, H^-1 J
H^-1: H the information, J the covariance of the scores under the noise that was found (Newey and West 1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.coloured_noise import ColouredNoise, in_time
from linkwise.likelihood.model_error import degrees_of_freedom, evidence
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.eliminated_states import eliminated_rows
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.segments import Segments

_REWEIGHTED = AnnealingSchedule(initial_q=0.01, smallest_factor=0.003, trust_per_sample=10.0)


@dataclass(frozen=True, eq=False)
class ColouredFit:
    """A fit with coloured `noise`.

    Attributes
    ----------
    fit : AnnealingFit
        The optimum.
    noise : ColouredNoise
        The noise about it.
    covariance : array of shape (p + o + g, p + o + g)
        Of parameters, offsets, gains and delays.
    cost : float
        -2 log of the marginal likelihood and the penalty of the noise's coefficients, to be compared with a model error's.
    """

    fit: AnnealingFit
    noise: ColouredNoise
    covariance: Floats
    cost: float

    @property
    def chi_square(self) -> float:
        """Power of the residuals over that of the noise found."""
        squares = np.sum(self.fit.misfit.residuals**2, axis=(0, 2))
        return float(np.sum(squares / self.noise.variances) / self.noise.samples.sum())


def with_coloured_noise(segments: Segments, fit: AnnealingFit, annealer: Annealer) -> ColouredFit | None:
    """The fit with noise as coloured as the residuals of `fit`; None where they are white, or not such noise.

    `fit` need not have converged: too tight a weight on a coloured channel may be the cause.
    """
    if fit.status is AnnealingStatus.INTERRUPTED or not isinstance(annealer.loss, Gaussian):
        return None
    first = ColouredNoise.of(fit.misfit.residuals, segments.linked)
    if first is None:
        return None
    deviations = fit.scales.sigma[:, None]
    if segments.relative_noise is not None:
        deviations = deviations * segments.relative_noise
    shown = np.where(segments.observed, segments.samples - fit.misfit.residuals * deviations, np.nan)
    weights = np.sqrt(first.at_motion(in_time(shown, segments.linked)))
    coloured = np.isin(np.arange(len(weights)), first.channels)
    scales = replace(fit.scales, sigma=fit.scales.sigma * np.where(coloured, weights, 1.0))
    again = annealer(segments, fit.point, scales, _REWEIGHTED)
    if again.status is not AnnealingStatus.CONVERGED:
        return None
    noise = ColouredNoise.of(again.misfit.residuals, segments.linked)
    covariance = None if noise is None else _covariance(segments, again, noise, annealer)
    if noise is None or covariance is None:
        return None
    factor, cost = evidence(segments, again, again.q, annealer.loss)
    cost -= 2.0 * degrees_of_freedom(segments, again) * np.log(factor)
    in_first_units = 2.0 * noise.samples @ np.log(scales.sigma / fit.scales.sigma)
    searched = fit.path if fit.status is AnnealingStatus.CONVERGED else ()
    return ColouredFit(
        replace(again, path=max(searched, again.path, key=len)),
        noise,
        covariance,
        float(cost + noise.information + in_first_units),
    )


def _covariance(
    segments: Segments, fit: AnnealingFit, noise: ColouredNoise, annealer: Annealer
) -> Floats | None:
    rows = eliminated_rows(segments, fit.misfit, fit.scales, annealer.loss, fit.q)
    if rows is None:
        return None
    units = fit.scales.theta
    scores = noise.score_covariance(rows, segments.linked, len(segments.samples)) / np.outer(units, units)
    if segments.prior is not None:
        scores[np.diag_indices(len(units))] += segments.prior.curvature(np.ones(len(units)))
    return np.asarray(fit.covariance @ scores @ fit.covariance)
