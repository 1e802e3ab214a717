"""Exponential windows of hammer tests, by which channels were multiplied: noise falls along the record as the window does.

To a motion that decays such a window is damping, by any laws, and the residuals stay noise; their level alone tells it. Noise
that grows with the motion falls as well, as the power of that: which of them it is the likelihoods of both levels say. Of a
nonlinear motion the amplitudes are wrong by then as well, which explains less than the level where it is the window.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from linkwise.arrays import Floats
from linkwise.estimates.causes import WINDOW, Cause
from linkwise.likelihood.checks.judgement import Examined, Judgement
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.search import moved
from linkwise.records.record import Record
from linkwise.verdict import Grade, Verdict

_BLOCKS = 24  # of each record, over which levels are taken
_PART = (np.arange(_BLOCKS) + 0.5) / _BLOCKS  # of a record, in the middle of each
_FALLS = np.linspace(0.0, 6.0, 121)  # logarithms of what a window takes off a record
_GROWTH = np.geomspace(
    0.01, 1e4, 61
)  # power of noise as large as the motion is on average, over that which is always there
_CHANCE = 16.0  # of -2 log likelihood: four standard errors
_LIKELIER = 9.0  # of it: three, by which noise that grows with the motion has to explain more ...
_BY_CHANCE = 0.0027  # ... and the probability of as much by chance, where each channel falls by itself
_ROUNDING = 0.1  # chi-square a sample: less is left by rounding, and by noise that is stated too high
_LEAST = 0.7  # logarithm of a half: windows take off more, and noise of sensors changes by less of itself
_SLOWER = 0.9  # times the rate at which the motion decays: what falls as fast as that follows it


def exponential_window(of: Examined, before: Judgement) -> Judgement | None:
    """Whether noise falls along records as behind an exponential window, which counts as damping of a motion that decays."""
    fit, records = of.fit, of.records
    shows_noise = fit.chi_square > _ROUNDING and not fit.random_forces and fit.optimum.coloured is None
    levels = _levels(fit, records) if before.verdict.grade is not Grade.REFUSED and shows_noise else None
    if levels is None:
        return None
    samples, noise, motion = levels
    fallen = np.exp(-2.0 * _FALLS[:, None, None] * _PART)
    of_each = _costs(samples, noise, fallen)
    costs = of_each.sum(axis=1)
    best = int(np.argmin(costs))
    # by how much levels scatter about the shape more than those of normal values do
    relative = noise / (_scale(samples, noise, fallen[best])[:, None] * fallen[best])
    scatter = max(1.0, float(np.mean(0.5 * samples * (relative - 1.0) ** 2)))
    gain = float(costs[0] - costs[best]) / scatter
    # laws that lack a term leave more at its motion
    least = max((_CHANCE, *(cause.gain for cause in before.diagnosis)))
    if gain < least or _FALLS[best] < _LEAST:
        return None
    follows = _FALLS[best] > _SLOWER * _FALLS[int(np.argmin(_costs(samples, motion, fallen).sum(axis=1)))]
    apart = max(len(samples) - 1, 1)  # a window falls in all channels alike
    by_each = float(of_each.min(axis=0).sum()) + chdtri(apart, _BY_CHANCE) * scatter
    grown = 1.0 + _GROWTH[:, None, None] * motion / np.mean(motion, axis=1, keepdims=True)
    by_growth = float(_costs(samples, noise, grown).sum(axis=1).min()) + _LIKELIER * scatter
    if follows or min(by_growth, by_each) < costs[best]:
        return None
    error = np.sqrt(scatter / np.sum(2.0 * samples * (_PART - 0.5) ** 2))
    rate = float(_FALLS[best] / records[0].duration)
    cause = Cause(WINDOW, "all channels", rate, "1/s", gain, float(error / records[0].duration))
    message = (
        f"What is left falls along the record as noise does behind {cause.description}, which would lower -2 log likelihood "
        f"by {gain:.3g}. It counts as damping of a motion that decays: divide all channels by it, or record without it."
    )
    return Judgement(Verdict.MEASUREMENT_ERROR, message, before.model_error, (cause,))


def _scale(samples: Floats, power: Floats, shape: Floats) -> Floats:
    """(..., R) the variances of normal values that go with shapes (..., R or 1, B), by mean squares (R, B) of some samples."""
    return np.asarray(np.sum(samples * power / shape, axis=-1) / np.sum(samples, axis=1))


def _costs(samples: Floats, power: Floats, shape: Floats) -> Floats:
    """(..., R) their -2 log likelihood."""
    variance = np.maximum(_scale(samples, power, shape)[..., None] * shape, np.finfo(float).tiny)
    return np.asarray(np.sum(samples * (np.log(variance) + power / variance), axis=-1))


def _levels(fit: LikelihoodFit, records: Sequence[Record]) -> tuple[Floats, Floats, Floats] | None:
    """Numbers of samples in blocks (R, B) of records and channels, and mean squares of noise and motion there, where all
    blocks of a channel are observed; None without any, and where segments do not follow each other.
    """
    segments = fit.segments
    counts = [-(-len(record) // len(segments.samples)) for record in records]
    if segments.count != sum(counts) or min(counts) < _BLOCKS:
        return None
    edges = [
        first + np.linspace(0, n, _BLOCKS + 1).astype(int)[:-1]
        for first, n in zip(np.cumsum([0, *counts[:-1]]), counts, strict=True)
    ]
    size, noise, motion = (
        np.add.reduceat(of.sum(axis=0, dtype=float), np.concatenate(edges), axis=1).reshape(-1, _BLOCKS)
        for of in (segments.observed, fit.misfit.residuals**2, moved(segments) ** 2)
    )
    shown = (size > 0.0).all(axis=1)
    size = size[shown]
    return (size, noise[shown] / size, motion[shown] / size) if len(size) else None
