"""Whether ambient forces are white and independent of each other, as they are taken to be.

Laws take up what forces differ by from white ones: behind a wind that falls off with the frequency a damper comes out three
times as large, and each stiffness by tens of its standard errors too small. The slopes of the cost by the forces have a
spectrum that draws of white and independent forces give, with states and coefficients following. In the band in which the
structure moves, the spectrum of the record must be the same multiple of it everywhere, and the forces on two masses must have
no more in common than their draws. Beyond that band forces hardly matter to the laws, and are seldom white.

References
----------
P. Whittle, Ark. Mat. 2, 423 (1953), for the likelihood of a spectrum: its ordinates are independent and exponential.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise

import numpy as np

from linkwise.arrays import Floats, Indices
from linkwise.estimates.causes import Cause, RandomForceEstimate
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.variance_score import normal_score

SPECTRAL_KINDS = ("coloured force", "correlated forces")
"""Kinds of causes; what else a structure lacks makes forces seem so, too, and is told before them."""

UNSTEADY = "unsteady force"
"""The kind of cause of a force whose level changes with time: terms that follow the motion seem to be missing then."""

BEHIND_FILTER = ", as behind a filter against aliasing"
"""Ends the remark on a force of which accelerations show nothing near half the sampling rate."""

_BANDS = 6  # of the same width, up to the end of the motion
_FEWEST = 8  # frequencies in a band: of fewer the spectrum is too rough to be judged
_MOTION = 0.99  # of the kinetic energy lies below the frequency where the motion ends ...
_BEYOND = 1.5  # ... and dampers and stiffnesses are still told a little further
_SIGNIFICANT = 4.0  # a normal score, as one force in 30 000 gives by chance, or one pair in 15 000
_SIZEABLE = 0.1  # of the density, by root mean square, or of the correlation: less moves laws by a standard error or so
_ROLLED_OFF = 0.5  # of the mean density: less in the last band is a filter's
_FEWEST_PARTS, _MOST_PARTS = 5, 50  # of the records, in which the level of a force is compared
_FREEDOM = 16.0  # degrees of freedom of the level in a part
_UNSTEADY = 0.46  # of the square of the density, by root mean square: intervals are too narrow by a tenth


def spectral_causes(fit: LikelihoodFit, slopes: Floats) -> tuple[Cause, ...]:
    """Causes of what ambient forces that are not white, not independent, or not steady, leave.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit with random forces.
    slopes : array of shape (r, K, 1 + d)
        Slopes of the cost by the random forces in each segment, in their deviations; and those of d draws.

    Returns
    -------
    tuple of Cause
        Those of `SPECTRAL_KINDS`, and of the kind `UNSTEADY`, that are significant.
    """
    forces, random = fit.random_forces, fit.optimum.segments.random
    assert random is not None
    ambient = [
        number
        for number, force in enumerate(forces)
        if force.ambient and random.present[number] and force.upper_limit is None  # else it may be chance
    ]
    parts = _Band.of_records(fit)
    if not ambient or sum(band.count for band in parts) < _BANDS * _FEWEST:
        return ()
    spectra = [
        np.concatenate([band.spectrum(slopes[number]) for band in parts], axis=0) for number in ambient
    ]
    places = np.concatenate([band.places() for band in parts])
    highest = max(band.highest for band in parts)
    named = [forces[number] for number in ambient]
    shown = fit.optimum.segments.centred
    coloured = _coloured(named, spectra, places, highest, of_accelerations=shown)
    unsteady = _unsteady(named, [slopes[number] ** 2 for number in ambient])
    return (*coloured, *_correlated(named, spectra), *unsteady)


def _coloured(
    forces: Sequence[RandomForceEstimate],
    spectra: Sequence[Floats],
    places: Indices,
    highest: float,
    *,
    of_accelerations: bool,
) -> Iterator[Cause]:
    """Forces whose `spectra` (F, 1 + d), at the `places` (F,) in bands, are no multiples of those of white ones."""
    count = np.bincount(places, minlength=_BANDS).astype(float)
    if count.min() < _FEWEST:
        return
    for force, spectrum in zip(forces, spectra, strict=True):
        powers = np.abs(spectrum) ** 2
        expected = np.bincount(places, powers[:, 1:].mean(axis=1), _BANDS)
        if not np.all(expected > 0.0):
            continue
        ratio = np.maximum(np.bincount(places, powers[:, 0], _BANDS) / expected, np.finfo(float).tiny)
        ratio *= count.sum() / (count @ ratio)
        gain = -2.0 * float(count @ np.log(ratio))
        size = float(np.sqrt(count @ (ratio - 1.0) ** 2 / count.sum()))
        freedom = _BANDS - 1.0
        if normal_score(gain - freedom, freedom, freedom) > _SIGNIFICANT and size > _SIZEABLE:
            remark = (
                f"its density is {ratio.min():.2g} to {ratio.max():.2g} times its mean below {highest:.3g} Hz"
            )
            if of_accelerations and ratio[-1] < _ROLLED_OFF:
                remark += BEHIND_FILTER
            error = float(1.0 / np.sqrt(count.sum()))
            yield Cause(SPECTRAL_KINDS[0], force.where, size, "1", gain, error, remark=remark)


def _correlated(forces: Sequence[RandomForceEstimate], spectra: Sequence[Floats]) -> Iterator[Cause]:
    """Pairs of forces whose `spectra` (F, 1 + d) have more in common than those of independent ones."""
    powers = [float(np.sum(np.abs(spectrum[:, 0]) ** 2)) for spectrum in spectra]
    for first, second in combinations(range(len(forces)), 2):
        common = np.sum((spectra[first].conj() * spectra[second]).real, axis=0)
        excess, scatter = common[0] - common[1:].mean(), common[1:].std()
        whole = max(float(np.sqrt(powers[first] * powers[second])), np.finfo(float).tiny)
        correlation = float(excess / whole)
        if abs(excess) > _SIGNIFICANT * scatter and abs(correlation) > _SIZEABLE:
            gain = -2.0 * len(spectra[first]) * float(np.log1p(-min(correlation**2, 1.0 - 1e-12)))
            where, source, error = forces[first].where, forces[second].where, float(scatter / whole)
            yield Cause(SPECTRAL_KINDS[1], where, correlation, "1", gain, error, source=source)


def _unsteady(forces: Sequence[RandomForceEstimate], squares: Sequence[Floats]) -> Iterator[Cause]:
    """Forces whose `squares` of slopes (K, 1 + d) are in some parts of the records another multiple of those of steady ones.

    Intervals of laws are too narrow then by the root of 1 + size^2, as the strongest parts tell most.
    """
    for force, square in zip(forces, squares, strict=True):
        drawn = _in_parts(square[:, 1:], _FEWEST_PARTS)
        freedom = 2.0 * float(
            np.sum(drawn.mean(axis=1) ** 2) / max(np.sum(drawn.var(axis=1)), np.finfo(float).tiny)
        )
        count = int(min(_FEWEST_PARTS * freedom / _FREEDOM, _MOST_PARTS, len(square)))
        if count < _FEWEST_PARTS:
            continue
        freedom *= _FEWEST_PARTS / count
        sums = _in_parts(square, count)
        ratio = np.maximum(sums[:, 0] / sums[:, 1:].mean(axis=1), np.finfo(float).tiny)
        ratio /= ratio.mean()
        gain = -freedom * float(np.log(ratio).sum())
        size = float(np.sqrt(max(np.mean((ratio - 1.0) ** 2) - 2.0 / freedom, 0.0)))
        if normal_score(gain - (count - 1.0), count - 1.0, count - 1.0) > _SIGNIFICANT and size > _UNSTEADY:
            low, high = np.sqrt([ratio.min(), ratio.max()])
            remark = f"its density is {low:.2g} to {high:.2g} times its root mean square in {count} parts of the record"
            yield Cause(
                UNSTEADY, force.where, size, "1", gain, float(np.sqrt(2.0 / (freedom * count))), remark=remark
            )


def _in_parts(values: Floats, count: int) -> Floats:
    """(count, ...) sums of values (K, ...) in parts of about equal length."""
    return np.add.reduceat(values, np.arange(count) * len(values) // count)


class _Band:
    """The frequencies of one record, `start` to `stop` among its segments, in which its structure moves."""

    def __init__(self, fit: LikelihoodFit, start: int, stop: int) -> None:
        segments, point = fit.optimum.segments, fit.optimum.point
        n = len(segments.system.incidence)
        self._part = slice(start, stop)
        velocities = np.fft.rfft(point.nodes[n : 2 * n, self._part], axis=1)
        energy = np.cumsum(segments.system.at(point.theta).masses @ np.abs(velocities) ** 2)
        end = int(np.searchsorted(energy, _MOTION * energy[-1]))
        whole = len(energy) - 1
        # accelerations show the forces themselves, and tell their level by all frequencies
        self.count = whole if segments.centred else min(int(_BEYOND * end), whole)
        step = float(segments.step[start] * segments.refine * len(segments.samples))
        self.highest = self.count / ((stop - start) * step)

    @classmethod
    def of_records(cls, fit: LikelihoodFit) -> list[_Band]:
        """Those of each record."""
        ends = np.flatnonzero(~fit.optimum.segments.linked) + 1
        edges = [0, *ends.tolist(), fit.optimum.segments.count]
        return [cls(fit, start, stop) for start, stop in pairwise(edges)]

    def spectrum(self, slopes: Floats) -> Floats:
        """(F, 1 + d) the complex spectrum of slopes (K, 1 + d), but for their mean."""
        series = np.moveaxis(slopes[self._part], 1, 0)
        return np.stack([np.fft.rfft(drawn)[1 : self.count + 1] for drawn in series], axis=1)

    def places(self) -> Indices:
        """(F,) in which of the bands each frequency lies."""
        return np.arange(self.count) * _BANDS // max(self.count, 1)
