"""The coordinator: hands cases out, writes what comes back, and hands out again what was lost."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

from linkwise.errors import StudyError
from linkwise.progress import Progress, ProgressReport
from linkwise.study.definition import Study
from linkwise.study.executor import Executor, FailureKind
from linkwise.study.row import DIED, Case
from linkwise.study.store import Store
from linkwise.study.timing import Timing, next_batch
from linkwise.study.worker import CaseBatch, CaseResult, failure

_DEATHS = 3  # of a worker at one case, after which the case is to blame
_SHARES = 4  # batches for each place that must be left, or batches are made smaller
_TICK = 0.5  # s between two reports while nothing comes back


@dataclass(frozen=True)
class StudyProgress:
    """How far a study is: the `detail` of the reports that `run_study` gives to its `progress`.

    Parameters
    ----------
    done, total : int
        Cases that are done, those of earlier runs included, and all cases.
    rate : float
        Cases a second since this run began.
    left : float or None
        Seconds to go; None while nothing tells.
    """

    done: int
    total: int
    rate: float
    left: float | None

    @property
    def report(self) -> ProgressReport:
        """For whoever waits."""
        left = "" if self.left is None else f", {_duration(self.left)} left"
        activity = f"{self.done} of {self.total} cases, {self.rate:.2g}/s{left}"
        return ProgressReport(self.done / self.total, activity, self)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def run(study: Study, store: Store, executor: Executor, progress: Progress) -> None:
    """Run every case of `study` that is not done in `store`. What is interrupted, by whatever, goes on where it was.

    Raises StudyError where workers cannot run cases at all.
    """
    there = store.done()
    rows = [row for row in store.rows() if row.case in there]
    pending = [case for case in study.cases() if case not in there]
    timing = Timing(rows, pending, {one.name: one.structure.size for one in study.subjects})
    work = _Work(study, executor, timing, pending)

    def tell() -> None:
        progress(StudyProgress(len(there) + timing.done, len(study), timing.rate, timing.left).report)

    tell()
    work.hand_out()
    while work.out:
        results, fault = work.collect(wait(work.out, timeout=_TICK, return_when=FIRST_COMPLETED).done)
        if fault is None:
            work.hand_out()  # before writing, so that nobody waits for the disk
        store.add(result.row for result in results)
        if fault is not None:
            raise fault
        tell()


class _Work:
    """What is still to be handed out, and what is out."""

    def __init__(self, study: Study, executor: Executor, timing: Timing, pending: list[Case]) -> None:
        self._study, self._crew, self._pace = study, executor, timing
        self._text = study.text()
        self._pending = deque(pending)
        self._deaths: Counter[Case] = Counter()
        self.out: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}

    def hand_out(self) -> None:
        """Fill every place of the crew."""
        slots = self._crew.slots
        # Towards the end batches get smaller, so that all workers finish together.
        seconds = min(self._crew.seconds, self._pace.work / (_SHARES * slots))
        while self._pending and len(self.out) < slots:
            cases = next_batch(self._pending, self._pace, seconds, set(self._deaths))
            self.out[self._crew.submit(CaseBatch(self._text, cases))] = cases

    def collect(
        self, finished: Iterable[Future[list[CaseResult]]]
    ) -> tuple[list[CaseResult], StudyError | None]:
        """What came of some batches; what was lost is put in front again. And why there is no going on, if there is none."""
        results: list[CaseResult] = []
        fault = None
        for future in finished:
            cases = self.out.pop(future)
            if future.cancelled():
                fault = StudyError(
                    "the workers are gone; what was finished is kept, so start the study again to go on"
                )
            elif (error := future.exception()) is None:
                results += future.result()
            elif (failure_kind := self._crew.failure_kind(future)) is FailureKind.FAULT:
                fault = StudyError(f"a worker cannot run linkwise: {type(error).__name__}: {error}")
                fault.__cause__ = error
            else:
                results += self._lost(cases, failure_kind)
        for result in results:
            self._pace.finished(result.row.case, result.seconds)
        return results, fault

    def _lost(self, cases: tuple[Case, ...], failure_kind: FailureKind) -> list[CaseResult]:
        """Put cases in front again, but for those at which too many workers have died."""
        if failure_kind is FailureKind.DIED:
            self._deaths.update(cases)
        self._pending.extendleft(case for case in reversed(cases) if self._deaths[case] < _DEATHS)
        return [_blamed(self._study, case) for case in cases if self._deaths[case] >= _DEATHS]


def _blamed(study: Study, case: Case) -> CaseResult:
    masses = study.subject(case.structure).structure.size
    reason = f"{DIED}{_DEATHS} times while at it: killed, out of memory, or crashed"
    return CaseResult(failure(case, masses, reason), 0.0)
