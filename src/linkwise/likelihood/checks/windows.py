"""Exponential windows of hammer tests, by which channels were multiplied: noise falls along the record as the window does.

To a motion that decays such a window is damping, by any laws, and the residuals stay noise; their level alone tells it. Noise
that grows with the motion falls as well, as the power of that: which of them it is the likelihoods of both levels say. Of a
nonlinear motion the amplitudes are wrong by then as well, which explains less than the level where it is the window.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class _Levels:
    """Mean squares of noise and motion (R, B) in blocks of records and channels, of so many samples."""

    noise: Floats
    motion: Floats
    samples: Floats

    def costs(self, power: Floats, shape: Floats) -> Floats:
        """(..., R) -2 log likelihood of mean squares of normal values, of which variances go with shapes (..., R or 1, B)."""
        scale = np.sum(self.samples * power / shape, axis=-1) / np.sum(self.samples, axis=1)
        variance = np.maximum(scale[..., None] * shape, np.finfo(float).tiny)
        return np.asarray(np.sum(self.samples * (np.log(variance) + power / variance), axis=-1))

    def overdispersion(self, shape: Floats) -> float:
        """By how much levels of noise scatter about a shape more than those of normal values do, at least 1."""
        scale = np.sum(self.samples * self.noise / shape, axis=1) / np.sum(self.samples, axis=1)
        return max(
            1.0, float(np.mean(0.5 * self.samples * (self.noise / (scale[:, None] * shape) - 1.0) ** 2))
        )

    def by_falls(self, power: Floats) -> Floats:
        """(F, R) these costs by how much a window takes off."""
        return self.costs(power, np.exp(-2.0 * _FALLS[:, None, None] * _PART))

    @property
    def by_growth(self) -> float:
        """The least cost of noise that grows with the motion."""
        relative = self.motion / np.mean(self.motion, axis=1, keepdims=True)
        return float(self.costs(self.noise, 1.0 + _GROWTH[:, None, None] * relative).sum(axis=1).min())


def exponential_window(of: Examined, before: Judgement) -> Judgement | None:
    """Whether noise falls along records as behind an exponential window, which counts as damping of a motion that decays."""
    fit, records = of.fit, of.records
    shows_noise = fit.chi_square > _ROUNDING and not fit.random_forces and fit.optimum.coloured is None
    if before.verdict.grade is Grade.REFUSED or not shows_noise:
        return None
    levels = _levels(fit, records)
    if levels is None:
        return None
    of_each = levels.by_falls(levels.noise)
    costs = of_each.sum(axis=1)
    best = int(np.argmin(costs))
    scatter = levels.overdispersion(np.exp(-2.0 * _FALLS[best] * _PART))
    gain = float(costs[0] - costs[best]) / scatter
    # laws that lack a term leave more at its motion
    least = max((_CHANCE, *(cause.gain for cause in before.diagnosis)))
    if gain < least or _FALLS[best] < _LEAST:
        return None
    follows = _FALLS[best] > _SLOWER * _FALLS[int(np.argmin(levels.by_falls(levels.motion).sum(axis=1)))]
    apart = max(len(of_each.T) - 1, 1)  # a window falls in all channels alike
    by_each = float(of_each.min(axis=0).sum()) + chdtri(apart, _BY_CHANCE) * scatter
    rival = min(levels.by_growth + _LIKELIER * scatter, by_each)
    if follows or rival < costs[best]:
        return None
    error = np.sqrt(scatter / np.sum(2.0 * levels.samples * (_PART - 0.5) ** 2))
    rate = float(_FALLS[best] / records[0].duration)
    cause = Cause(WINDOW, "all channels", rate, "1/s", gain, float(error / records[0].duration))
    message = (
        f"What is left falls along the record as noise does behind {cause.description}, which would lower -2 log likelihood "
        f"by {gain:.3g}. It counts as damping of a motion that decays: divide all channels by it, or record without it."
    )
    return Judgement(Verdict.MEASUREMENT_ERROR, message, before.model_error, (cause,))


def _levels(fit: LikelihoodFit, records: Sequence[Record]) -> _Levels | None:
    """Those of the channels of records that are observed in all blocks; None without any, and where segments do not follow
    each other.
    """
    segments = fit.segments
    counts = [-(-len(record) // len(segments.samples)) for record in records]
    if segments.count != sum(counts) or min(counts) < _BLOCKS:
        return None
    firsts = np.cumsum([0, *counts[:-1]])
    edges = [
        first + np.linspace(0, n, _BLOCKS + 1).astype(int)[:-1]
        for first, n in zip(firsts, counts, strict=True)
    ]
    size, noise, motion = (
        np.add.reduceat(of.sum(axis=0, dtype=float), np.concatenate(edges), axis=1).reshape(-1, _BLOCKS)
        for of in (segments.observed, fit.misfit.residuals**2, moved(segments) ** 2)
    )
    shown = (size > 0.0).all(axis=1)
    size = size[shown]
    return _Levels(noise[shown] / size, motion[shown] / size, size) if len(size) else None
