"""How a mass comes to rest: its largest excursion still to come, when it has settled, how fast it decays.

Between samples the displacement is the cubic through displacements and velocities at both ends, so peaks are those of the
motion, not of the samples. All arrays have time on axis 0; runs or masses may follow on further axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats, Indices

Rows = tuple[Indices, ...]

TAIL = 0.05  # of the run: a mass that leaves its band so late has not settled within it
_BISECTIONS = 48
_FEWEST = 3  # peaks that a rate of decay needs


@dataclass(frozen=True, eq=False)
class Decay:
    """Excursions of masses from where they rest: `x` (N, ...) in m at `time` (N,) in s, and velocities `v` (N, ...)."""

    time: Floats
    x: Floats
    v: Floats

    @cached_property
    def _step(self) -> float:
        return float(self.time[1] - self.time[0])

    def _cubic(self, rows: Rows) -> tuple[Floats, Floats, Floats, Floats]:
        """Coefficients of 1, s, s^2 and s^3 in the intervals that begin at `rows`, s = 0..1."""
        after = (rows[0] + 1, *rows[1:])
        start, rise = self.x[rows], self.x[after] - self.x[rows]
        first, last = self._step * self.v[rows], self._step * self.v[after]
        return start, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise

    @cached_property
    def _turns(self) -> tuple[Rows, Floats, Floats]:
        """(T,) where the motion turns: the intervals, the place 0..1 in each, and the excursion there."""
        rows = np.nonzero(self.v[:-1] * self.v[1:] < 0.0)
        start, a, b, c = self._cubic(rows)
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(np.maximum(b * b - 3.0 * a * c, 0.0)), b))
            one, other = q / (3.0 * c), a / q
        place = np.clip(np.where((one > 0.0) & (one < 1.0), one, other), 0.0, 1.0)
        return rows, place, np.abs(start + place * (a + place * (b + place * c)))

    @cached_property
    def _largest(self) -> Floats:
        """(N - 1, ...) the largest excursion within each interval."""
        size = np.abs(self.x)
        largest: Floats = np.maximum(size[:-1], size[1:])
        rows, _, turned = self._turns
        largest[rows] = np.maximum(largest[rows], turned)
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
        """(...) m^2: the average of the squared excursion over the run, by the trapezoidal rule with its end correction."""
        square, slope = self.x**2, 2.0 * self.x * self.v
        step = self._step
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
        x, a, b, c = self._cubic(rows)
        turns = np.zeros(self._largest.shape)
        turns[self._turns[0]] = self._turns[1]
        start, end = np.where(np.abs(x) > level, 0.0, turns[rows]), np.ones(shape)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (start + end)
            out = np.abs(x + middle * (a + middle * (b + middle * c))) > level
            start, end = np.where(out, middle, start), np.where(out, end, middle)
        found = np.where(ever, self.time[last] + end * self._step, self.time[0])
        late = found > self.time[-1] - TAIL * (self.time[-1] - self.time[0])
        return np.where(late | np.isnan(level), np.nan, found)

    def column(self, run: int) -> Decay:
        """The masses of one run of several, (N, masses)."""
        return Decay(self.time, self.x[..., run], self.v[..., run])

    def rate(self, level: Floats) -> Floats:
        """(masses,) 1/s: rate of an exponential through the peaks that none later exceeds, down to `level` (masses,).

        NaN where there are fewer than three such peaks. `x` is (N, masses).
        """
        (rows, columns), place, turned = self._turns
        kept = (turned >= self.envelope[rows + 1, columns]) & (turned >= level[columns])
        kept &= turned >= self._largest[rows, columns]
        rates = np.full(self.x.shape[1], np.nan)
        for column in range(self.x.shape[1]):
            which = np.flatnonzero(kept & (columns == column))
            if len(which) >= _FEWEST:
                when = self.time[rows[which]] + self._step * place[which]
                rates[column] = -np.polyfit(when, np.log(turned[which]), 1)[0]
        return rates
