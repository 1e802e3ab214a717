"""What explains the residuals of a fit: the noise that was expected, coloured noise of sensors, or a model error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.block_scores import block_scatter
from linkwise.likelihood.coloured_fit import ColouredFit, with_coloured_noise
from linkwise.likelihood.coloured_noise import ColouredNoise
from linkwise.likelihood.model_error import ModelErrorCandidate, lag_one_autocorrelation, with_model_error
from linkwise.likelihood.noise_level import with_noise_of_residuals
from linkwise.likelihood.shooting.anneal import Annealer, AnnealingFit, AnnealingStatus
from linkwise.likelihood.shooting.loss import Gaussian, Loss
from linkwise.likelihood.shooting.segments import Iterate, Segments

_WHITE = 0.1  # autocorrelation of the residuals beyond which they are not noise of another size
_LEAST_ROBUST = 0.5  # of the cost of normal noise; Student's t with 3 degrees of freedom leaves 0.80 to 0.92
_ROUNDED = 1.0 + 1e-9
_LARGEST_EXCESS = 2.0  # coloured residual power over the noise that no model error explains
_SMALL = 0.005  # of what each channel shows: coloured residuals that blocks can judge, a tenth of what a free run may leave


@dataclass(frozen=True)
class AllowedErrors:
    """What a fit may resort to: `coloured_noise` of sensors and a `model_error`; `known_model_error`, that there is one."""

    model_error: bool
    coloured_noise: bool
    known_model_error: bool


@dataclass(frozen=True, eq=False)
class ExplainedFit:
    """A fit and its errors.

    Attributes
    ----------
    fit : AnnealingFit
        The optimum.
    covariance : array of shape (P, P)
        Of parameters, offsets, gains and delays.
    chi_square, chi_square_off : float, bool
        Chi-square per degree of freedom, and whether it is far from 1.
    model_error, noise : float
        The relaxation q that stands for a model error, else 0, and the factor on the noise.
    error_ratios : array of shape (P,) or None
        With a model error, the factor on the standard errors over those of white model error; None for too short records.
    coloured : ColouredNoise or None
        The noise where it is coloured.
    """

    fit: AnnealingFit
    covariance: Floats
    chi_square: float
    chi_square_off: bool
    model_error: float
    noise: float
    error_ratios: Floats | None
    coloured: ColouredNoise | None = None


def explained_fit(
    segments: Segments,
    start: Iterate,
    fit: AnnealingFit,
    annealer: Annealer,
    *,
    limit: float,
    lowest: Floats,
    allowed: AllowedErrors,
) -> ExplainedFit:
    """`fit`, or, where noise as expected does not explain it, the likelier of fits with coloured noise and with model error.

    Parameters
    ----------
    segments : Segments
        The records.
    start : Iterate
        Where the search for `fit` started.
    fit : AnnealingFit
        The fit with white noise and exact laws.
    annealer : Annealer
        Fits again.
    limit : float
        By how much chi-square may differ from 1.
    lowest : array of shape (C,)
        The least deviations of the noise that residuals may show, infinite where it is stated.
    allowed : AllowedErrors
        What it may resort to.

    Returns
    -------
    ExplainedFit
        The fit and its errors.
    """
    any_stated = bool(np.isinf(lowest).any())
    off = _is_off(segments, fit, annealer.loss, limit, lowest)
    exact = allowed.model_error and not allowed.known_model_error
    coloured = with_coloured_noise(segments, fit, annealer) if exact and allowed.coloured_noise else None
    candidate = None
    unreached = did_not_converge(fit) and fit.misfit.data > (1.0 + limit) * fit.samples
    inexact = unreached or (off and fit.chi_square > 1.0 and _is_coloured(fit))
    if allowed.model_error and (allowed.known_model_error or inexact):
        candidate = with_model_error(segments, fit, start, annealer)
    if coloured is not None and (candidate is None or coloured.cost < candidate.cost):
        return _with_coloured_noise(coloured, off=any_stated and off)
    if candidate is not None and candidate.exact:
        fit = with_noise_of_residuals(segments, candidate.fit, annealer, lowest)
        return _with_exact_laws(fit, off=_is_off(segments, fit, annealer.loss, limit, lowest))
    if candidate is not None:
        return _with_model_error(segments, candidate, annealer, limit, any_stated)
    return _with_exact_laws(fit, off=off)


def _is_off(segments: Segments, fit: AnnealingFit, loss: Loss, limit: float, lowest: Floats) -> bool:
    """Whether chi-square is not that of the noise.

    Where outliers make up a part of it, a robust loss leaves less. Channels with hardly any noise leave nothing: whether
    chi-square is too small the others tell.
    """
    if fit.chi_square > 1.0 + limit:
        return True
    stated = np.isinf(lowest)
    least = 1.0 - limit if stated.any() or isinstance(loss, Gaussian) else min(_LEAST_ROBUST, 1.0 - limit)
    noisy = stated | (fit.scales.sigma > lowest * _ROUNDED)
    if noisy.all():
        return not fit.chi_square >= least
    samples = segments.observed[:, noisy].sum()
    power = float(np.sum(fit.misfit.residuals[:, noisy] ** 2)) / max(samples, 1)
    return bool(samples) and not power >= least


def _with_exact_laws(fit: AnnealingFit, *, off: bool) -> ExplainedFit:
    return ExplainedFit(fit, fit.covariance, fit.chi_square, off, 0.0, 1.0, np.ones(len(fit.covariance)))


def did_not_converge(fit: AnnealingFit) -> bool:
    """Whether a search ended without an optimum, and not by an interrupt."""
    return fit.status in (AnnealingStatus.EXHAUSTED, AnnealingStatus.STUCK)


def _with_coloured_noise(coloured: ColouredFit, *, off: bool) -> ExplainedFit:
    return ExplainedFit(
        coloured.fit,
        coloured.covariance,
        coloured.chi_square,
        off,
        0.0,
        1.0,
        np.ones(len(coloured.covariance)),
        coloured.noise,
    )


def _with_model_error(
    segments: Segments, candidate: ModelErrorCandidate, annealer: Annealer, limit: float, stated: bool
) -> ExplainedFit:
    fit, factor = candidate.fit, candidate.noise
    chi_square = factor**2
    ratios: Floats | None = np.ones(len(fit.covariance))
    if not did_not_converge(fit):
        scatter = block_scatter(
            segments, fit.misfit, fit.scales, annealer.loss, q=fit.q, noise=factor, free=~fit.at_bound
        )
        ratios = None if scatter is None else scatter.ratios
    judged = ratios is not None and _are_small(segments, fit)
    unexplained = chi_square > _LARGEST_EXCESS and _is_coloured(fit) and not judged
    p = segments.system.parameters.size
    widened = np.full(len(fit.covariance), factor)
    if ratios is not None:
        widened[:p] *= ratios[:p]  # sensors: those of white model error
    return ExplainedFit(
        fit,
        fit.covariance * np.outer(widened, widened),
        chi_square,
        bool(unexplained or (stated and abs(chi_square - 1.0) > limit)),
        candidate.q,
        factor,
        ratios,
    )


def _are_small(segments: Segments, fit: AnnealingFit) -> bool:
    """Whether the residuals are a small part of how far each channel moves from its mean."""
    count = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    mean = segments.samples.sum(axis=(0, 2)) / count
    motion = np.where(segments.observed, segments.samples - mean[:, None], 0.0)
    residuals = fit.misfit.residuals * fit.scales.sigma[:, None]
    return bool(np.all(np.sum(residuals**2, axis=(0, 2)) <= _SMALL**2 * np.sum(motion**2, axis=(0, 2))))


def _is_coloured(fit: AnnealingFit) -> bool:
    """Whether the search converged to residuals that are correlated from one sample to the next."""
    return fit.status is AnnealingStatus.CONVERGED and lag_one_autocorrelation(fit.misfit) > _WHITE
