"""How long cases take, measured on those that were run; the size of batches, and the time left."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from time import perf_counter

from linkwise.study.row import Case, Row

#: Structure, noise level in dB and method.
CellKey = tuple[str, float, str]


class Timing:
    """Measured times of cases by cell, and the expected times of those pending; `masses` by structure, at least 1."""

    def __init__(self, done: list[Row], pending: list[Case], masses: Mapping[str, int]) -> None:
        self._seconds: dict[CellKey, float] = {}
        self._counts: Counter[CellKey] = Counter()
        self._left: Counter[CellKey] = Counter(map(_cell, pending))
        self._masses = masses
        self._guesses: dict[str, float] = {}
        self._began = perf_counter()
        self._worked = 0.0
        self.done = 0
        for row in done:
            self._record(_cell(row.case), row.seconds)

    def finished(self, case: Case, seconds: float) -> None:
        """Note that a case took `seconds` of a worker."""
        self._record(_cell(case), seconds)
        self._left[_cell(case)] -= 1
        self._worked += seconds
        self.done += 1

    def known(self, case: Case) -> bool:
        """Whether a case of the same cell was run."""
        return self._counts[_cell(case)] > 0

    def expected(self, case: Case) -> float:
        """The expected time of a case in s: the mean of its cell.

        Without such, the mean of the same method (or any) on the largest structure so far, times the square of the ratio of
        masses.
        """
        return self._expected(_cell(case))

    @property
    def rate(self) -> float:
        """Cases per second since the start, 0 before the first."""
        return self.done / max(perf_counter() - self._began, 1e-9)

    @property
    def left(self) -> float | None:
        """Time left in s at the speed of the workers so far; None before the first case."""
        return self.work * (perf_counter() - self._began) / self._worked if self._worked else None

    @property
    def work(self) -> float:
        """The expected time in s of a single worker for all pending cases."""
        return sum(count * self._expected(cell) for cell, count in self._left.items() if count)

    def _record(self, cell: CellKey, seconds: float) -> None:
        count = self._counts[cell]
        self._seconds[cell] = (self._seconds.get(cell, 0.0) * count + seconds) / (count + 1)
        self._counts[cell] = count + 1
        if not count:
            self._guesses.clear()

    def _expected(self, cell: CellKey) -> float:
        if cell in self._seconds:
            return self._seconds[cell]
        if cell[2] not in self._guesses:
            self._guesses[cell[2]] = self._guess(cell[2])
        return self._guesses[cell[2]] * self._masses[cell[0]] ** 2

    def _guess(self, method: str) -> float:
        """Time in s over the square of the number of masses, of the largest structure so far; 0 before any."""
        cells = [cell for cell in self._seconds if cell[2] == method] or list(self._seconds)
        if not cells:
            return 0.0
        largest = max(self._masses[structure] for structure, _, _ in cells)
        seconds = [self._seconds[cell] for cell in cells if self._masses[cell[0]] == largest]
        return sum(seconds) / len(seconds) / largest**2


def next_batch(pending: deque[Case], timing: Timing, seconds: float, alone: set[Case]) -> tuple[Case, ...]:
    """Take at least one case, and no more than are expected to last `seconds`, from the front of `pending`.

    A case of a cell that was never timed, and a case in `alone`, makes a batch of its own.
    """
    chosen = [pending.popleft()]
    total = timing.expected(chosen[0])

    def single(case: Case) -> bool:
        return case in alone or not timing.known(case)

    while pending and not single(chosen[0]) and not single(pending[0]):
        total += timing.expected(pending[0])
        if total > seconds:
            break
        chosen.append(pending.popleft())
    return tuple(chosen)


def _cell(case: Case) -> CellKey:
    return case.structure, case.snr_db, case.method
