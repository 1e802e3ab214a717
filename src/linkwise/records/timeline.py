"""The even time grid behind a column of times that was printed, rounded, and may lack rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.checks import check_rate

MIN_SAMPLES = 32  # fewer do not hold one period of a vibration together with its noise
JITTER = 1e-3  # of a step: deviation of a clock up to which samples count as even
COARSEST = 0.4  # of a step: with printed digits coarser than that the grid is ambiguous
RESOLVED = 0.05  # of a decimal: where double precision resolves less, every number looks like a printed one
SLOW = 0.5  # s: no vibrating structure is sampled this slowly, but times in milliseconds look like it
EDGE = 1e-6  # of a step: a time typed in decimals is meant to hit its sample
LONGEST = 10  # times the number of rows: a grid with more missing samples than that is two records


@dataclass(frozen=True, eq=False)
class Timeline:
    """Samples `index` (N,) of an even grid of `count` points at `start` + k/`rate`; `notes` say what was assumed."""

    start: float
    rate: float
    index: NDArray[np.int64]
    count: int
    notes: tuple[str, ...] = ()

    @classmethod
    def fit(
        cls, time: NDArray[np.generic], *, file: str | None = None, lines: NDArray[np.int64] | None = None
    ) -> Timeline:
        """The grid of the times `time` (N,) in s.

        Rounding in printing or to single precision is accepted, and so are gaps of whole steps. The rate is the roundest
        number that explains the column: 1000 Hz, or a step of 0.0016384 s, not the last digits of a least-squares fit. Raises
        RecordError with the line for missing, repeated, decreasing and uneven times.
        """
        times = np.asarray(time, dtype=np.float64)
        column = _TimeColumn(times, file, lines)
        column.check_increasing()
        steps = np.diff(times)
        step = _typical_step(steps)
        check_rate(float(1.0 / np.clip(step, 1e-300, 1e300)), file)
        multiples = np.maximum(np.rint(steps / step), 1.0)
        index = np.concatenate([[0], np.cumsum(multiples)]).astype(np.int64)
        step = float(np.dot(index - index.mean(), times - times.mean()) / np.sum((index - index.mean()) ** 2))
        resolution = _resolution(times, step)
        column.check_even(index, step, max(JITTER * step, 1.01 * resolution))
        count = int(index[-1]) + 1
        if count > LONGEST * len(times):
            row = int(np.argmax(steps))
            raise column.error(
                row + 1,
                f"a gap of {steps[row]:g} s in a record of {len(times)} samples every {step:g} s; split the file there",
            )
        rate = _roundest_rate(times, index, step, resolution)
        return cls(float(times[0]), rate, index, count, tuple(column.notes(index, rate)))


def check_increasing(times: Floats, file: str | None, lines: NDArray[np.int64] | None) -> None:
    """Raise RecordError for too few times (N,), and for times that are missing, repeated or decreasing."""
    _TimeColumn(times, file, lines).check_increasing()


@dataclass(frozen=True, eq=False)
class _TimeColumn:
    """Times (N,) in s as read, and the line of each in its file."""

    times: Floats
    file: str | None
    lines: NDArray[np.int64] | None

    def error(self, row: int, message: str, *arguments: str) -> RecordError:
        """An error about one row; `arguments` are those of `read_record` that would resolve it."""
        line = None if self.lines is None else int(self.lines[row])
        message = message if line else f"{message} (sample {row})"
        return RecordError(message, self.file, line, "time", arguments=arguments)

    def check_increasing(self) -> None:
        """Raise RecordError for too few times, and for times that are missing, repeated or decreasing."""
        if len(self.times) < MIN_SAMPLES:
            raise RecordError(
                f"{len(self.times)} samples are too few; a record needs at least {MIN_SAMPLES}", self.file
            )
        missing = np.flatnonzero(~np.isfinite(self.times))
        if len(missing):
            raise self.error(
                int(missing[0]),
                "the time is missing; fill it in or, if no row is missing, give the sampling rate instead (`rate`)",
                "rate",
            )
        steps = np.diff(self.times)
        if np.all(steps > 0.0):
            return
        row = int(np.argmax(steps <= 0.0))
        time, previous = self.times[row + 1], self.times[row]
        if time == previous:
            raise self.error(
                row + 1,
                f"the time {time:.12g} s is repeated; write more digits, remove one of the rows, or give the sampling "
                "rate (`rate`)",
                "rate",
            )
        raise self.error(
            row + 1,
            f"time decreases from {previous:.12g} to {time:.12g} s; a file must hold one record, sorted by time",
        )

    def check_even(self, index: NDArray[np.int64], step: float, tolerance: float) -> None:
        """Raise RecordError unless times and steps are within `tolerance` in s of the grid `index` * `step`."""
        steps, counts = np.diff(self.times), np.diff(index)
        usual = float(np.median(steps))
        uneven = np.abs(steps - counts * step) > 2.0 * tolerance
        advice = "resample it to an even rate (`resample`)"
        wrong = uneven & (np.abs(steps - counts * usual) > 2.0 * tolerance)
        if np.any(wrong):
            row = int(np.argmax(wrong))
            message = f"uneven time: a step of {steps[row]:.6g} s where {usual:.6g} s was expected; {advice}"
            raise self.error(row + 1, message, "resample")
        deviation = self.times - self.times[0] - index * step
        deviation -= np.median(deviation)
        if np.any(uneven) or np.max(np.abs(deviation)) > 2.0 * tolerance:
            row = int(np.argmax(np.abs(deviation)))
            time = self.times[row]
            message = f"uneven time: {time:.9g} s is {deviation[row]:.3g} s off an even grid of {step:.9g} s; {advice}"
            raise self.error(row, message, "resample")

    def notes(self, index: NDArray[np.int64], rate: float) -> list[str]:
        """What was assumed in fitting the grid, one sentence each."""
        notes = []
        deviation = float(np.max(np.abs(self.times - self.times[0] - index / rate)))
        if deviation > JITTER / rate:
            notes.append(
                f"The times are up to {deviation:.2g} s off an even grid, as rounding causes; {rate:.9g} Hz was assumed."
            )
        missing = np.diff(index) - 1
        gaps = np.flatnonzero(missing)
        if len(gaps):
            where = f"the first after {self.times[gaps[0]]:.9g} s"
            notes.append(
                f"Gaps in time: {len(gaps)}, {where}; {int(np.sum(missing))} rows were added as missing samples."
            )
        if 1.0 / rate >= SLOW:
            notes.append(
                f"The sampling interval is {1.0 / rate:g} s. If the times are in ms, name their column time[ms]."
            )
        return notes


def rows_between(earliest: float, latest: float, start: float, rate: float, count: int) -> tuple[int, int]:
    """First and past-the-end row of the times in s from `earliest` to `latest` among `count` at `start` + k/`rate`.

    Raises RecordError for a time that is NaN.
    """
    if np.isnan(earliest) or np.isnan(latest):
        raise RecordError(
            f"times must be numbers, got {earliest:g} and {latest:g} s", arguments=("earliest", "latest")
        )
    ends = np.clip(np.array([earliest - start, latest - start]) * rate, -1.0, count)
    return max(0, int(np.ceil(ends[0] - EDGE))), min(count, int(np.floor(ends[1] + EDGE)) + 1)


def _typical_step(steps: Floats) -> float:
    """The step in s between neighbours without a gap, averaged over all of them so that their rounding cancels."""
    median = float(np.median(steps))
    single = steps[np.abs(steps - median) < 0.5 * median]
    return float(np.mean(single))


def _resolution(times: Floats, step: float) -> float:
    """The rounding of the column in s: the printed decimal, or single or double precision."""
    largest = float(np.max(np.abs(times)))
    double = 2.0 * float(np.spacing(largest))  # start + k/rate is rounded twice
    for digits in range(max(0, int(-np.floor(np.log10(step)))), 13):
        scaled, slack = times * 10.0**digits, 4.0 * float(np.spacing(largest * 10.0**digits))
        if slack > RESOLVED:
            break
        if np.max(np.abs(scaled - np.rint(scaled))) <= slack:
            return max(10.0**-digits, double) if 10.0**-digits <= COARSEST * step else double
    if np.array_equal(times, times.astype(np.float32)):
        single = float(np.spacing(np.float32(largest)))
        return single if single <= COARSEST * step else double
    return double


def _roundest_rate(times: Floats, index: NDArray[np.int64], step: float, resolution: float) -> float:
    """The rate in Hz with the fewest digits, in itself or as a step, that reproduces every time to its rounding.

    Times rounded to a resolution, to the nearest or downwards, lie in a band as wide as that about their grid, wherever it
    starts. To ask that each lies within the resolution of a grid from the first time on would leave the rate open by twice
    the resolution over the length of the record: some 1e-4, which a stiffness shows in many of its standard errors.
    """
    band = max(resolution, float(np.ptp(times - index * step))) + 2.0 * float(np.spacing(np.abs(times).max()))
    candidates = [value for digits in range(1, 16) for value in _rounded(step, digits)]
    for rate in candidates:
        ends = abs(times[-1] - times[0] - index[-1] / rate)  # the quicker to see of the many that differ
        if ends <= band and np.ptp(times - index / rate) <= band:
            return _exact_neighbour(times, index, rate)
    return _exact_neighbour(times, index, 1.0 / step)


def _rounded(step: float, digits: int) -> tuple[float, float]:
    """The rate and the step, each rounded to `digits` significant digits, both as rates in Hz."""
    return float(f"{1.0 / step:.{digits - 1}e}"), 1.0 / float(f"{step:.{digits - 1}e}")


def _exact_neighbour(times: Floats, index: NDArray[np.int64], rate: float) -> float:
    """`rate`, or the number within 16 units in its last place that reproduces the column bit for bit."""
    probes = np.unique(np.linspace(0, len(index) - 1, 9).astype(np.int64))
    for units in sorted(range(-16, 17), key=abs):
        neighbour = rate + units * float(np.spacing(rate))
        if np.array_equal(times[0] + index[probes] / neighbour, times[probes]) and np.array_equal(
            times[0] + index / neighbour, times
        ):
            return neighbour
    return rate
