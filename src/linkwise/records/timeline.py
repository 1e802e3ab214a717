"""The even grid behind a column of times that was printed, rounded, and perhaps has rows missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError

FEWEST = 32  # samples: fewer do not hold one period of anything together with its noise
JITTER = 1e-3  # of a step: what a clock may wander before its samples no longer count as even
COARSEST = 0.4  # of a step: printed figures coarser than that leave the grid to guesswork
RESOLVED = 0.05  # of a decimal: where double precision resolves less, every number looks like a printed one
SLOW = 0.5  # s: no structure that vibrates is sampled this slowly, milliseconds often are
LONGEST = 10  # times the rows: a grid with more missing samples than that is two records


@dataclass(frozen=True, eq=False)
class Timeline:
    """Samples `index` (N,) of an even grid of `count` points at `start` + k/`rate`; `notes` says what was
    assumed.
    """

    start: float
    rate: float
    index: NDArray[np.int64]
    count: int
    notes: tuple[str, ...] = ()

    @classmethod
    def fit(
        cls, time: NDArray[np.generic], *, file: str | None = None, lines: NDArray[np.int64] | None = None
    ) -> Timeline:
        """The grid of the moments `time` (N,) in s.

        Accepted are figures rounded in printing or kept in single precision, and gaps of whole steps. Raises
        RecordError with the line for missing, repeated, backward and uneven times. The rate is the roundest
        number that explains the column: 1000 Hz or a step of 0.0016384 s, not what a fit leaves in the last
        digit.
        """
        moments = np.asarray(time, dtype=np.float64)
        column = _Column(moments, file, lines)
        column.refuse_disorder()
        steps = np.diff(moments)
        step = _typical_step(steps)
        multiples = np.maximum(np.rint(steps / step), 1.0)
        index = np.concatenate([[0], np.cumsum(multiples)]).astype(np.int64)
        step = float(
            np.dot(index - index.mean(), moments - moments.mean()) / np.sum((index - index.mean()) ** 2)
        )
        grain = _grain(moments, step)
        column.refuse_uneven(index, step, max(JITTER * step, 1.01 * grain))
        count = int(index[-1]) + 1
        if count > LONGEST * len(moments):
            at = int(np.argmax(steps))
            raise column.error(
                at + 1,
                f"a gap of {steps[at]:g} s in a record of {len(moments)} samples every {step:g} s; cut the "
                "file in two there",
            )
        rate = _roundest_rate(moments, index, step, grain)
        return cls(float(moments[0]), rate, index, count, tuple(column.notes(index, rate)))


def refuse_disorder(moments: Floats, file: str | None, lines: NDArray[np.int64] | None) -> None:
    """RecordError for too few times (N,) and for times that are no numbers, stand still or run backwards."""
    _Column(moments, file, lines).refuse_disorder()


@dataclass(frozen=True, eq=False)
class _Column:
    """The times as read, and where each stands in its file."""

    moments: Floats
    file: str | None
    lines: NDArray[np.int64] | None

    def error(self, row: int, message: str) -> RecordError:
        line = None if self.lines is None else int(self.lines[row])
        return RecordError(message if line else f"{message} (sample {row})", self.file, line, "time")

    def refuse_disorder(self) -> None:
        """RecordError for too few times and for times that are no numbers, stand still or run backwards."""
        if len(self.moments) < FEWEST:
            raise RecordError(
                f"{len(self.moments)} samples are too few; a record needs at least {FEWEST}", self.file
            )
        unknown = np.flatnonzero(~np.isfinite(self.moments))
        if len(unknown):
            raise self.error(
                int(unknown[0]),
                "the time is missing; fill it in or, if every row is there, give the rate instead (--rate "
                "HZ)",
            )
        steps = np.diff(self.moments)
        if np.all(steps > 0.0):
            return
        row = int(np.argmax(steps <= 0.0))
        now, then = self.moments[row + 1], self.moments[row]
        if now == then:
            raise self.error(
                row + 1,
                f"the time {now:.12g} s stands twice; print more digits, drop one of the rows, or give the "
                "rate (--rate HZ)",
            )
        raise self.error(
            row + 1,
            f"the time runs backwards, from {then:.12g} to {now:.12g} s; a file holds one record, in order "
            "of time",
        )

    def refuse_uneven(self, index: NDArray[np.int64], step: float, tolerance: float) -> None:
        """RecordError unless every moment lies within `tolerance` of the grid and of its neighbour's place
        on it.
        """
        steps, counts = np.diff(self.moments), np.diff(index)
        usual = float(np.median(steps))
        uneven = np.abs(steps - counts * step) > 2.0 * tolerance
        advice = "resample it to an even rate (--resample HZ)"
        wrong = uneven & (np.abs(steps - counts * usual) > 2.0 * tolerance)
        if np.any(wrong):
            row = int(np.argmax(wrong))
            message = f"uneven time: a step of {steps[row]:.6g} s where {usual:.6g} s was expected; {advice}"
            raise self.error(row + 1, message)
        drift = self.moments - self.moments[0] - index * step
        drift -= np.median(drift)
        if np.any(uneven) or np.max(np.abs(drift)) > 2.0 * tolerance:
            row = int(np.argmax(np.abs(drift)))
            moment = self.moments[row]
            message = f"uneven time: {moment:.9g} s is {drift[row]:.3g} s off an even grid of {step:.9g} s; {advice}"
            raise self.error(row, message)

    def notes(self, index: NDArray[np.int64], rate: float) -> list[str]:
        """What was assumed in laying the grid, each a sentence."""
        told = []
        drift = float(np.max(np.abs(self.moments - self.moments[0] - index / rate)))
        if drift > JITTER / rate:
            told.append(
                f"The times are up to {drift:.2g} s off an even grid, as by rounding; {rate:.9g} Hz was "
                "taken."
            )
        absent = np.diff(index) - 1
        gaps = np.flatnonzero(absent)
        if len(gaps):
            where = f"the first after {self.moments[gaps[0]]:.9g} s"
            told.append(
                f"Gaps in time: {len(gaps)}, {where}; {int(np.sum(absent))} rows were added as missing "
                "samples."
            )
        if 1.0 / rate >= SLOW:
            told.append(
                f"The samples are {1.0 / rate:g} s apart: is the time in ms? Then its header is time[ms]."
            )
        return told


def _typical_step(steps: Floats) -> float:
    """The step between neighbours without a gap, averaged over all of them so that the rounding of each
    cancels.
    """
    median = float(np.median(steps))
    single = steps[np.abs(steps - median) < 0.5 * median]
    return float(np.mean(single))


def _grain(moments: Floats, step: float) -> float:
    """The rounding in s of the column: the printed decimal, or single or double precision. 0.25 steps at
    most.
    """
    largest = float(np.max(np.abs(moments)))
    double = 2.0 * float(np.spacing(largest))  # start + k/rate is rounded twice
    for digits in range(max(0, int(-np.floor(np.log10(step)))), 13):
        scaled, slack = moments * 10.0**digits, 4.0 * float(np.spacing(largest * 10.0**digits))
        if slack > RESOLVED:
            break
        if np.max(np.abs(scaled - np.rint(scaled))) <= slack:
            return max(10.0**-digits, double) if 10.0**-digits <= COARSEST * step else double
    if np.array_equal(moments, moments.astype(np.float32)):
        single = float(np.spacing(np.float32(largest)))
        return single if single <= COARSEST * step else double
    return double


def _roundest_rate(moments: Floats, index: NDArray[np.int64], step: float, grain: float) -> float:
    """The rate in Hz with the fewest digits, in itself or as a step, that puts every moment where it was
    printed.
    """
    drift = np.abs(moments - moments[0] - index * step).max()
    allowed = max(grain, float(drift) if drift > grain else 0.0)
    candidates = [value for digits in range(1, 16) for value in _rounded(step, digits)]
    last = int(np.argmax(index))
    for rate in candidates:
        if abs(moments[last] - moments[0] - index[last] / rate) <= allowed and (
            np.abs(moments - moments[0] - index / rate).max() <= allowed
        ):
            return _exact_neighbour(moments, index, rate)
    return _exact_neighbour(moments, index, 1.0 / step)


def _rounded(step: float, digits: int) -> tuple[float, float]:
    """The rate and the step, each rounded to so many significant digits, as rates."""
    return float(f"{1.0 / step:.{digits - 1}e}"), 1.0 / float(f"{step:.{digits - 1}e}")


def _exact_neighbour(moments: Floats, index: NDArray[np.int64], rate: float) -> float:
    """`rate`, or the number within 16 units of its last place that reproduces the column bit for bit."""
    ends = np.unique(np.linspace(0, len(index) - 1, 9).astype(np.int64))
    for units in sorted(range(-16, 17), key=abs):
        near = rate + units * float(np.spacing(rate))
        if np.array_equal(moments[0] + index[ends] / near, moments[ends]) and np.array_equal(
            moments[0] + index / near, moments
        ):
            return near
    return rate
