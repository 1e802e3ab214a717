"""How a mass comes to rest: its largest excursion still to come, when it has settled, how fast it decays.

Between samples the displacement is the cubic through displacements and velocities at both ends, so peaks are those of the
motion, not of the samples. All arrays have time on axis 0; runs or masses may follow on further axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TAIL = 0.05  # of the run: a mass that leaves its band so late has not settled within it
_BISECTIONS = 60
_FEWEST = 3  # peaks that a rate of decay needs


@dataclass(frozen=True, eq=False)
class Decay:
    """Excursions of masses from where they rest: `x` (N, ...) in m at `time` (N,) in s, and velocities `v` (N, ...)."""

    time: Floats
    x: Floats
    v: Floats

    @cached_property
    def _cubic(self) -> tuple[Floats, Floats, Floats]:
        """(N - 1, ...) coefficients of s, s^2 and s^3, s = 0..1 in each interval."""
        step = self._wide(np.diff(self.time))
        first, last, rise = step * self.v[:-1], step * self.v[1:], np.diff(self.x, axis=0)
        return first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise

    def _wide(self, values: Floats) -> Floats:
        return values.reshape(-1, *(1 for _ in self.x.shape[1:]))

    @cached_property
    def _turns(self) -> Floats:
        """(N - 1, ...) where in each interval the motion turns, 0..1; 0 where it does not."""
        a, b, c = self._cubic
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0)), b))
            one, other = q / (3.0 * c), a / q
        inside = (one > 0.0) & (one < 1.0)
        place = np.where(inside, one, other)
        turning = (self.v[:-1] * self.v[1:] < 0.0) & (place > 0.0) & (place < 1.0)
        return np.where(turning, place, 0.0)

    def _at(self, s: Floats, rows: tuple[NDArray[np.intp], ...] | slice = slice(None)) -> Floats:
        """The displacement at places s of the intervals."""
        a, b, c = (each[rows] for each in self._cubic)
        value: Floats = self.x[:-1][rows] + s * (a + s * (b + s * c))
        return value

    @cached_property
    def _largest(self) -> Floats:
        """(N - 1, ...) the largest excursion within each interval."""
        size = np.abs(self.x)
        return np.maximum(np.maximum(size[:-1], size[1:]), np.abs(self._at(self._turns)))

    @cached_property
    def envelope(self) -> Floats:
        """(N, ...) m: the largest excursion from each sample on."""
        padded = np.concatenate([self._largest, np.abs(self.x[-1:])])
        return np.maximum.accumulate(padded[::-1], axis=0)[::-1]

    @cached_property
    def peak(self) -> Floats:
        """(...) m: the largest excursion of all."""
        return np.asarray(self.envelope[0])

    @cached_property
    def mean_square(self) -> Floats:
        """(...) m^2: the average of the squared excursion over the run, by the trapezoidal rule with its end correction."""
        square, slope = self.x**2, 2.0 * self.x * self.v
        step = self.time[1] - self.time[0]
        total = step * (square.sum(axis=0) - 0.5 * (square[0] + square[-1])) - step**2 / 12.0 * (
            slope[-1] - slope[0]
        )
        return np.asarray(total / (self.time[-1] - self.time[0]))

    def settled(self, level: Floats) -> Floats:
        """(...) s: when each excursion comes below `level` (...) in m to stay there; NaN where it does not.

        A mass that is beyond its level within the last `TAIL` of the run counts as one that has not settled.
        """
        shape = self.x.shape[1:]
        level = np.broadcast_to(level, shape)
        beyond = self._largest > level
        ever = beyond.any(axis=0)
        last = len(beyond) - 1 - np.argmax(beyond[::-1], axis=0)
        rows = (last, *np.indices(shape))
        start = np.where(np.abs(self.x[rows]) > level, 0.0, self._turns[rows])
        end = np.ones(shape)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            out = np.abs(self._at(middle, rows)) > level
            start, end = np.where(out, middle, start), np.where(out, end, middle)
        step = self.time[1] - self.time[0]
        found = np.where(ever, self.time[last] + end * step, self.time[0])
        late = found > self.time[-1] - TAIL * (self.time[-1] - self.time[0])
        return np.where(late | np.isnan(level), np.nan, found)

    def column(self, run: int) -> Decay:
        """The masses of one run of several, (N, masses)."""
        return Decay(self.time, self.x[..., run], self.v[..., run])

    def rate(self, level: Floats) -> Floats:
        """(masses,) 1/s: rate of an exponential through the peaks that none later exceeds, down to `level` (masses,).

        NaN where there are fewer than three such peaks. `x` is (N, masses).
        """
        later = self.envelope[1:]
        peaks = (self._turns > 0.0) & (self._largest >= later) & (self._largest >= level)
        peaks &= np.abs(self._at(self._turns)) >= self._largest
        step = self.time[1] - self.time[0]
        rates = np.full(self.x.shape[1], np.nan)
        for column in range(self.x.shape[1]):
            rows = np.flatnonzero(peaks[:, column])
            if len(rows) >= _FEWEST:
                when = self.time[rows] + step * self._turns[rows, column]
                rates[column] = -np.polyfit(when, np.log(self._largest[rows, column]), 1)[0]
        return rates
