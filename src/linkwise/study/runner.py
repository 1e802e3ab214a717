"""The coordinator of a study: submits cases, stores their results, and submits again what was lost."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

from linkwise.display import format_duration
from linkwise.errors import StudyError
from linkwise.progress import Progress, ProgressReport
from linkwise.study.definition import Study
from linkwise.study.executor import Executor, FailureKind
from linkwise.study.row import WORKER_DIED, Case
from linkwise.study.store import Store
from linkwise.study.timing import Timing, next_batch
from linkwise.study.worker import CaseBatch, CaseResult, failed_row

_MOST_DEATHS = 3  # of workers that run a case, after which the case is the reason
_BATCHES_LEFT = 4  # per slot; with fewer left, batches are made smaller
_INTERVAL = 0.5  # s between two reports while no result arrives


@dataclass(frozen=True)
class StudyProgress:
    """How far a study is: the `detail` of the reports that `run_study` gives to its `progress`.

    Parameters
    ----------
    done, total : int
        The numbers of cases done, those of earlier runs included, and of all cases.
    rate : float
        Cases per second since this run began.
    left : float or None
        Seconds left; None before there is an estimate.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.StudyProgress(done=50, total=200, rate=2.0, left=75.0).report.activity
    '50 of 200 cases, 2/s, 75 s left'
    """

    done: int
    total: int
    rate: float
    left: float | None

    @property
    def report(self) -> ProgressReport:
        """The report for a person."""
        left = "" if self.left is None else f", {format_duration(self.left)} left"
        activity = f"{self.done} of {self.total} cases, {self.rate:.2g}/s{left}"
        return ProgressReport(self.done / self.total, activity, self)


def run(study: Study, store: Store, executor: Executor, progress: Progress) -> None:
    """Run every case of `study` that is not done in `store`. After an interrupt a later call continues.

    Raises StudyError if the workers cannot run cases at all.
    """
    done = store.done()
    rows = [row for row in store.rows() if row.case in done]
    pending = [case for case in study.cases() if case not in done]
    timing = Timing(rows, pending, {subject.name: subject.structure.size or 1 for subject in study.subjects})
    queue = _Queue(study, executor, timing, pending)

    def report() -> None:
        progress(StudyProgress(len(done) + timing.done, len(study), timing.rate, timing.left).report)

    report()
    queue.submit()
    while queue.running:
        finished = wait(queue.running, timeout=_INTERVAL, return_when=FIRST_COMPLETED).done
        results, error = queue.collect(finished)
        if error is None:
            queue.submit()  # before writing, so that no worker waits for the disk
        store.add(result.row for result in results)
        if error is not None:
            raise error
        report()


class _Queue:
    """The cases that are pending, and the batches that are `running`."""

    def __init__(self, study: Study, executor: Executor, timing: Timing, pending: list[Case]) -> None:
        self._study, self._executor, self._timing = study, executor, timing
        self._text = study.text()
        self._pending = deque(pending)
        self._deaths: Counter[Case] = Counter()
        self.running: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}

    def submit(self) -> None:
        """Fill all slots of the executor."""
        slots = self._executor.slots
        # Towards the end batches get smaller, so that all workers finish together.
        seconds = min(self._executor.batch_seconds, self._timing.work / (_BATCHES_LEFT * slots))
        while self._pending and len(self.running) < slots:
            cases = next_batch(self._pending, self._timing, seconds, set(self._deaths))
            self.running[self._executor.submit(CaseBatch(self._text, cases))] = cases

    def collect(
        self, finished: Iterable[Future[list[CaseResult]]]
    ) -> tuple[list[CaseResult], StudyError | None]:
        """The results of finished batches, and the error that ends the study, if there is one.

        Cases of batches without a result are put in front of the pending ones.
        """
        results: list[CaseResult] = []
        failure: StudyError | None = None
        for future in finished:
            cases = self.running.pop(future)
            if future.cancelled():
                failure = StudyError(
                    "the connection to the workers is lost; finished cases are stored, start the study again to continue"
                )
            elif (error := future.exception()) is None:
                results += future.result()
            elif (kind := self._executor.failure_kind(future)) is FailureKind.CANNOT_RUN:
                failure = StudyError(f"a worker cannot run linkwise: {type(error).__name__}: {error}")
                failure.__cause__ = error
            else:
                results += self._resubmit(cases, kind)
        for result in results:
            self._timing.finished(result.row.case, result.seconds)
        return results, failure

    def _resubmit(self, cases: tuple[Case, ...], kind: FailureKind) -> list[CaseResult]:
        """Put cases in front of the pending ones; those at which too many workers died have failed."""
        if kind is FailureKind.WORKER_DIED:
            self._deaths.update(cases)
        self._pending.extendleft(case for case in reversed(cases) if self._deaths[case] < _MOST_DEATHS)
        return [_killed(self._study, case) for case in cases if self._deaths[case] >= _MOST_DEATHS]


def _killed(study: Study, case: Case) -> CaseResult:
    masses = study.subject(case.structure).structure.size
    reason = (
        f"its worker process died {_MOST_DEATHS} times while running it: killed, out of memory, or crashed"
    )
    return CaseResult(failed_row(case, masses, reason, status=WORKER_DIED), 0.0)
