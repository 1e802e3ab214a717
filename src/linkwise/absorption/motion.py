"""Vibration of the primary masses about their rest positions: largest excursion still to come, settling time and rate of
decay.

Between samples the displacement is the cubic Hermite interpolant of displacements and velocities, so that peaks are those
of the motion, not of the samples. Time is on axis 0 of all arrays; runs or masses may follow on further axes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.absorption.sinks import place_motion
from linkwise.absorption.wells import Runs
from linkwise.arrays import Floats, Indices
from linkwise.model.structure import Structure

#: Indices of intervals between samples, axis by axis.
Intervals = tuple[Indices, ...]

TAIL = 0.05  # of the run: a mass that leaves its band so late has not settled within it
_BISECTIONS = 48
_LEAST_PEAKS = 3  # that a rate of decay needs


@dataclass(frozen=True, eq=False)
class Decay:
    """Excursions `x` (N, ...) m of masses from where they rest, and velocities `v` (N, ...) m/s, at `time` (N,) s."""

    time: Floats
    x: Floats
    v: Floats

    @cached_property
    def _step(self) -> float:
        return float(self.time[1] - self.time[0])

    def _cubic(self, intervals: Intervals) -> tuple[Floats, Floats, Floats, Floats]:
        """Coefficients of 1, s, s^2 and s^3 in the `intervals`, s = 0..1."""
        after = (intervals[0] + 1, *intervals[1:])
        start, rise = self.x[intervals], self.x[after] - self.x[intervals]
        first, last = self._step * self.v[intervals], self._step * self.v[after]
        return start, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise

    @cached_property
    def _turning_points(self) -> tuple[Intervals, Floats, Floats]:
        """The intervals (T,) with a turning point, its position 0..1 in each, and the excursion there in m."""
        intervals = np.nonzero(self.v[:-1] * self.v[1:] < 0.0)
        start, a, b, c = self._cubic(intervals)
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0)), b))
            first, second = q / (3.0 * c), a / q
        position = np.clip(np.where((first > 0.0) & (first < 1.0), first, second), 0.0, 1.0)
        return intervals, position, np.abs(start + position * (a + position * (b + position * c)))

    @cached_property
    def _largest(self) -> Floats:
        """(N - 1, ...) m: the largest excursion within each interval."""
        size = np.abs(self.x)
        largest: Floats = np.maximum(size[:-1], size[1:])
        intervals, _, turned = self._turning_points
        largest[intervals] = np.maximum(largest[intervals], turned)
        return largest

    @cached_property
    def envelope(self) -> Floats:
        """(N, ...) m: the largest excursion from each sample on."""
        padded = np.concatenate([self._largest, np.abs(self.x[-1:])])
        return np.maximum.accumulate(padded[::-1], axis=0)[::-1]

    @cached_property
    def peak(self) -> Floats:
        """(...) m: the largest excursion of all."""
        return np.asarray(self._largest.max(axis=0))

    @cached_property
    def mean_square(self) -> Floats:
        """(...) m^2: the mean squared excursion, by the trapezoidal rule with its end correction."""
        square, slope = self.x**2, 2.0 * self.x * self.v
        step = self._step
        total = step * (square.sum(axis=0) - 0.5 * (square[0] + square[-1]))
        total -= step**2 / 12.0 * (slope[-1] - slope[0])
        return np.asarray(total / (self.time[-1] - self.time[0]))

    def settled(self, level: Floats) -> Floats:
        """(...) s: the time after which each excursion stays below `level` (...) m; NaN if it does not.

        A mass that exceeds its level within the last `TAIL` of the run has not settled.
        """
        shape = self.x.shape[1:]
        level = np.broadcast_to(level, shape)
        beyond = self._largest > level
        ever = beyond.any(axis=0)
        last = len(beyond) - 1 - np.argmax(beyond[::-1], axis=0)
        intervals = (last, *np.indices(shape))
        x, a, b, c = self._cubic(intervals)
        turns = np.zeros(self._largest.shape)
        turns[self._turning_points[0]] = self._turning_points[1]
        start, end = np.where(np.abs(x) > level, 0.0, turns[intervals]), np.ones(shape)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            outside = np.abs(x + middle * (a + middle * (b + middle * c))) > level
            start, end = np.where(outside, middle, start), np.where(outside, end, middle)
        times = np.where(ever, self.time[last] + end * self._step, self.time[0])
        late = times > self.time[-1] - TAIL * (self.time[-1] - self.time[0])
        return np.where(late | np.isnan(level), np.nan, times)

    def of_run(self, run: int) -> Decay:
        """The masses (N, masses) of one of several runs."""
        return Decay(self.time, self.x[..., run], self.v[..., run])

    def rate(self, level: Floats) -> Floats:
        """(masses,) 1/s: the rate of an exponential through the peaks above `level` (masses,) m that no later peak exceeds.

        NaN if there are fewer than three such peaks. `x` is (N, masses).
        """
        (intervals, columns), position, turned = self._turning_points
        is_peak = (turned >= self.envelope[intervals + 1, columns]) & (turned >= level[columns])
        is_peak &= turned >= self._largest[intervals, columns]
        rates = np.full(self.x.shape[1], np.nan)
        for column in range(self.x.shape[1]):
            peaks = np.flatnonzero(is_peak & (columns == column))
            if len(peaks) >= _LEAST_PEAKS:
                times = self.time[intervals[peaks]] + self._step * position[peaks]
                rates[column] = -np.polyfit(times, np.log(turned[peaks]), 1)[0]
        return rates


@dataclass(frozen=True, eq=False)
class Vibration:
    """The P primary masses and points, `places`, of W runs of `structures`, about the rest positions nearest to their ends."""

    runs: Runs
    structures: Sequence[Structure]
    places: Sequence[str]
    positions: Sequence[Floats]

    @cached_property
    def rest(self) -> Floats:
        """(P, W) m: where the masses come to rest."""
        last = place_motion(self.structures, self.runs.x[-1:], self.places)[0]
        ends = zip(self.positions, last.T, strict=True)
        return np.stack([at[np.square(at - end).sum(axis=1).argmin()] for at, end in ends], axis=1)

    @cached_property
    def decay(self) -> Decay:
        """The excursions (N, P, W) from there."""
        x = place_motion(self.structures, self.runs.x, self.places)
        v = place_motion(self.structures, self.runs.v, self.places)
        return Decay(self.runs.time, x - self.rest, v)

    @cached_property
    def rms(self) -> Floats:
        """(P, W) m: the root mean square excursion."""
        return np.sqrt(self.decay.mean_square)


def reduction(with_sinks: Floats, without: Floats) -> Floats:
    """The relative reduction by the sinks; NaN if there is nothing to reduce."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(without > 0.0, 1.0 - with_sinks / without, np.nan))


def comparable(without: Floats, units: Collection[str]) -> Floats:
    """(P, ...) factors by which displacements of P masses may be added: 1, but over those `without` sinks in several `units`.

    Metres and radians have no sum, parts of what a mass would do without sinks have one. Masses at rest count for nothing.
    """
    if len(set(units)) <= 1:
        return np.ones_like(without)
    return np.divide(1.0, without, out=np.zeros_like(without), where=without > 0.0)


def root_sum_square(values: Floats) -> Floats:
    """(W,) of `values` (P, W), over the masses."""
    return np.asarray(np.sqrt(np.square(values).sum(axis=0)))
