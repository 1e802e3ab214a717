"""Run a study from its definition to its tables: submit cases, store their results, and submit again what was lost."""

from __future__ import annotations

import concurrent.futures
import re
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from time import perf_counter

from linkwise.display import format_duration
from linkwise.errors import StudyError, expect
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.runtime import processors
from linkwise.study.definition import Study, read_study
from linkwise.study.store import SHARDS, Store, open_store, read_rows
from linkwise.study.subject import WORKER_DIED, Case, Row
from linkwise.study.summary import export_study
from linkwise.study.workers import (
    CaseBatch,
    CaseResult,
    DaskExecutor,
    Executor,
    FailureKind,
    GivenExecutor,
    ProcessExecutor,
    failed_row,
)

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
    >>> lw.study.StudyProgress(done=50, total=200, rate=2.0, left=75.0).report.activity
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


def run(study: Study, cases: Sequence[Case], store: Store, executor: Executor, progress: Progress) -> None:
    """Run every one of these cases of `study` that is not done in `store`. After an interrupt a later call continues.

    Raises StudyError if the workers cannot run cases at all.
    """
    done = store.done()
    pending = [case for case in cases if case not in done]
    queue = _Queue(study, executor, pending)

    def report() -> None:
        done = len(cases) - len(pending) + queue.done
        left = (len(cases) - done) / queue.rate if queue.done else None
        progress(StudyProgress(done, len(cases), queue.rate, left).report)

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
    """The cases that are pending, the batches that are `running`, and how many cases are `done`."""

    def __init__(self, study: Study, executor: Executor, pending: list[Case]) -> None:
        self._study, self._executor = study, executor
        self._text = study.text()
        self._began, self._worked, self.done = perf_counter(), 0.0, 0
        self._pending, self._deaths = deque(pending), Counter[Case]()
        self.running: dict[Future[list[CaseResult]], tuple[Case, ...]] = {}

    @property
    def rate(self) -> float:
        """Cases per second since the start, 0 before the first."""
        return self.done / max(perf_counter() - self._began, 1e-9)

    def submit(self) -> None:
        """Fill all slots of the executor."""
        slots = self._executor.slots
        # as many cases as last so long on average; towards the end fewer, so that all workers finish together
        lasting = self._executor.batch_seconds * self.done / max(self._worked, 1e-9)
        most = int(min(lasting, len(self._pending) / (_BATCHES_LEFT * slots)))
        while self._pending and len(self.running) < slots:
            cases = self._next_batch(most)
            self.running[self._executor.submit(CaseBatch(self._text, cases))] = cases

    def _next_batch(self, most: int) -> tuple[Case, ...]:
        """The next cases, so many at `most` and one at least; one at which a worker died goes by itself."""
        chosen = [self._pending.popleft()]
        while len(chosen) < most and self._pending and not {chosen[0], self._pending[0]} & {*self._deaths}:
            chosen.append(self._pending.popleft())
        return tuple(chosen)

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
                lost = "the connection to the workers is lost"
                failure = StudyError(f"{lost}; finished cases are stored, start the study again to continue")
            elif (error := future.exception()) is None:
                results += future.result()
            elif (kind := self._executor.failure_kind(future)) is FailureKind.CANNOT_RUN:
                failure = StudyError(f"a worker cannot run linkwise: {type(error).__name__}: {error}")
                failure.__cause__ = error
            else:
                results += self._resubmit(cases, kind)
        self.done += len(results)
        self._worked += sum(result.seconds for result in results)
        return results, failure

    def _resubmit(self, cases: tuple[Case, ...], kind: FailureKind) -> list[CaseResult]:
        """Put cases in front of the pending ones; those at which too many workers died have failed."""
        if kind is FailureKind.WORKER_DIED:
            self._deaths.update(cases)
        self._pending.extendleft(case for case in reversed(cases) if self._deaths[case] < _MOST_DEATHS)
        died = f"its worker process died {_MOST_DEATHS} times while running it"
        reason = f"{died}: killed, out of memory, or crashed"
        lost = [case for case in cases if self._deaths[case] >= _MOST_DEATHS]
        sizes = [self._study.subject(case.structure).structure.size for case in lost]
        rows = map(partial(failed_row, reason=reason, status=WORKER_DIED), lost, sizes)
        return [CaseResult(row, 0.0) for row in rows]


MOST_CASES = 1_000_000  # kept in memory and in one file: years of computing time


def run_study(
    study: Study | str | Path,
    folder: str | Path,
    *,
    quick: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    executor: concurrent.futures.Executor | None = None,
    shard: str | None = None,
    progress: Progress = silent,
) -> tuple[Row, ...]:
    """Run a study, or continue one, and write its tables.

    A process that is killed loses only the cases that were running; a row does not depend on the worker that computed it.

    Parameters
    ----------
    study : Study, str or path
        A study, the name of one that ships with linkwise ("paper", "reach"), or a TOML file.
    folder : str or path
        The folder of the study; it is created, or holds the same study already.
    quick : bool
        Whether to run the quick number of cycles only.
    workers : int, optional
        The number of processes on this machine, by default one for each processor; with `executor` that of its workers.
    scheduler : str, optional
        The address of the scheduler of a dask cluster to run on ("tcp://host:8786"), in place of `workers`.
    executor : concurrent.futures.Executor, optional
        What runs the cases: an executor of any library with this interface, whose futures are those of `concurrent.futures`.
        It is not shut down.
    shard : str, optional
        ``"i/n"`` runs the i-th of n parts of the cases into a folder of its own, for batch systems without a coordinator; a
        later call without it gathers them all.
    progress : Progress
        Called with reports whose `detail` is a `StudyProgress`.

    Returns
    -------
    tuple of Row
        In the order of the study; of a shard its own.

    Raises
    ------
    StudyError
        If the study cannot be read, the folder holds another one, another process runs one there, it has more than a million
        cases, or there are no workers.

    Examples
    --------
    >>> import linkwise as lw
    >>> rows = lw.study.run_study("mine.toml", "results/mine", workers=1)
    >>> [(row.case.method, row.status) for row in rows]
    [('weak', 'converged'), ('weak', 'converged')]
    """
    expect("run_study(study, folder): study", study, Study, str, Path)
    expect("run_study(study, folder): folder", folder, str, Path)
    definition = study if isinstance(study, Study) else read_study(study)
    definition = definition.quickly() if quick else definition
    if scheduler is not None and (workers, executor) != (None, None):
        message = "workers are processes of this machine, and a scheduler has workers of its own; give one of the two"
        raise StudyError(message)
    numbers = re.fullmatch(r"(\d+)/(\d+)", shard or "1/1")
    part, parts = map(int, numbers.groups()) if numbers else (0, 0)
    if not 1 <= part <= parts:
        raise StudyError(f"a shard is the i-th of n parts, as in 3/16, got {shard!r}")
    if definition.count > MOST_CASES:
        most = f"a study has at most {MOST_CASES} cases, got {definition.count}"
        raise StudyError(f"{most}; take fewer cycles, or make several studies of it", "cycles")
    cases = tuple(definition.cases())[part - 1 :: parts]
    home = Path(folder) if shard is None else Path(folder) / SHARDS / f"{part}-of-{parts}"
    with open_store(home, definition) as store:
        store.gather(definition)
        if not store.done().issuperset(cases):
            with _executor(workers, scheduler, executor) as chosen:
                run(definition, cases, store, chosen, progress)
        export_study(home)
    return read_rows(home)


def _executor(
    workers: int | None, scheduler: str | None, given: concurrent.futures.Executor | None
) -> Executor:
    if given is not None:
        return GivenExecutor(given, processors() if workers is None else workers)
    if scheduler is None:
        return ProcessExecutor(workers if workers is not None else processors())
    try:
        import_module("distributed")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("dask", "distributed"):
            raise
        message = "a scheduler needs the library distributed; install it with pip install 'linkwise[cluster]'"
        raise StudyError(message) from error
    return DaskExecutor(scheduler)
