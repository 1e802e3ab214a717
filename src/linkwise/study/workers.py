"""Workers of a study: what each does with a batch of cases, and the executors of batches, which are the processes of this
machine, those of a dask.distributed cluster (extra [cluster]), or what is given.

An executor returns futures of `concurrent.futures`, and classifies the failure of a batch.
"""

from __future__ import annotations

import concurrent.futures
import json
import math
import multiprocessing
import os
import signal
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from functools import lru_cache
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from time import perf_counter
from types import TracebackType
from typing import Any, Self, final

from linkwise.errors import LinkwiseError, StudyError
from linkwise.records.record import Record
from linkwise.registry import lazy_module
from linkwise.runtime import one_blas_thread
from linkwise.study.definition import Study, build_study
from linkwise.study.subject import FAILED, INTERNAL_ERROR, Case, MethodResult, Row

distributed = lazy_module("distributed")  # of an extra
ErrorType = type[BaseException] | None  # of the error that ends the work
_RECORDS = 64  # clean records that a worker caches
_ONE_AT_A_TIME = Lock()  # compiled integrators are not thread-safe, and a worker may have several threads


@dataclass(frozen=True)
class CaseBatch:
    """Cases to run together, the `study` that they belong to as JSON, and the version of `linkwise` that runs it."""

    study: str
    cases: tuple[Case, ...]
    linkwise: str = field(default_factory=lambda: version("linkwise"))


@dataclass(frozen=True)
class CaseResult:
    """A row, and the time in s that its case took in all: with simulation, noise and comparison."""

    row: Row
    seconds: float


def run_batch(batch: CaseBatch) -> list[CaseResult]:
    """Run every case of a batch. Errors of a case are not raised; they give a failed row with the reason.

    Raises StudyError if this process has another version of linkwise.
    """
    if batch.linkwise != version("linkwise"):
        raise StudyError(
            f"the worker has linkwise {version('linkwise')}, but the study is run by {batch.linkwise}; install that version"
        )
    with _ONE_AT_A_TIME, one_blas_thread():  # workers share the processors, and sums do not depend on threads
        study = _cached_study(batch.study)
        return [_run_case(study, batch.study, case) for case in batch.cases]


def failed_row(case: Case, masses: int, reason: str, *, seconds: float = 0.0, status: str = FAILED) -> Row:
    """The row of a case without an answer."""
    result = MethodResult(status=status, seconds=seconds, reason=" ".join(reason.split()))
    return Row(**vars(case), masses=masses, **vars(result))


def _run_case(study: Study, text: str, case: Case) -> CaseResult:
    started = perf_counter()
    subject = study.subject(case.structure)
    masses = subject.structure.size
    try:
        clean = _clean_record(text, case.structure, study.cycle(case) if subject.scatter else 0)
        result = study.method(case.method).evaluate(subject, clean, case.snr_db, case.seed)
        row = _row_of_result(case, masses, result)
    except LinkwiseError as error:
        row = failed_row(case, masses, str(error), seconds=perf_counter() - started)
    except Exception as error:  # an internal error in one case must not end a study of thousands
        reason = f"internal error of linkwise: {type(error).__name__}: {error}"
        row = failed_row(case, masses, reason, seconds=perf_counter() - started, status=INTERNAL_ERROR)
    return CaseResult(row, perf_counter() - started)


def _row_of_result(case: Case, masses: int, result: MethodResult) -> Row:
    numbers = [*result.links.values(), *result.coefficients.values(), *result.standard_errors.values()]
    if not all(map(math.isfinite, numbers)):
        reason = f"the answer is not finite. {result.reason}".strip()
        return failed_row(case, masses, reason, seconds=result.seconds)
    return Row(**vars(case), masses=masses, **vars(result))


@lru_cache(maxsize=2)
def _cached_study(text: str) -> Study:
    return build_study(json.loads(text), "study", Path())


@lru_cache(maxsize=_RECORDS)
def _clean_record(text: str, name: str, cycle: int) -> Record:
    """The clean record of a structure in a cycle, simulated once in this process unless the motion diverges."""
    return _cached_study(text).subject(name).simulate(cycle)


MOST_WORKERS = 1000  # each takes 0.2 GB of memory
_BATCHES_PER_WORKER = 2  # submitted at a time, so that no worker waits for the next
_ATTEMPTS = 2  # to start a worker, which may be killed by chance


class FailureKind(Enum):
    """Why a batch has no result."""

    WORKER_DIED = "its worker died while running it"
    NOT_STARTED = "its worker died before it started"
    CANNOT_RUN = "the worker cannot run it"


class Executor(ABC):
    """Workers, from `__enter__` to `__exit__`; leaving by an exception abandons the batches that they run."""

    batch_seconds: float  # how long a batch should take, so that submitting it costs little in comparison

    _count: int  # of workers

    @property
    def slots(self) -> int:
        """How many batches should be submitted at a time."""
        return _BATCHES_PER_WORKER * self._count

    @abstractmethod
    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        """Submit a batch; at most `slots` at a time."""

    @abstractmethod
    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        """Why a future ended with an exception; the batch can be submitted again unless the worker cannot run it."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, kind: ErrorType, error: BaseException | None, trace: TracebackType | None) -> None: ...


@final
class GivenExecutor(Executor):
    """An executor of any library with the interface of `concurrent.futures`, of `count` workers, that its owner shuts down."""

    batch_seconds = 2.0

    def __init__(self, executor: concurrent.futures.Executor, count: int) -> None:
        self._executor, self._count = executor, count

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        return self._executor.submit(run_batch, batch)

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        return FailureKind.CANNOT_RUN

    def __exit__(self, kind: ErrorType, error: BaseException | None, trace: TracebackType | None) -> None: ...


@final
class ProcessExecutor(Executor):
    """`count` worker processes of this machine, each in a pool of its own.

    A process that dies takes its own batches with it and no others, and is replaced. Workers end with this process, even if
    it is killed. Raises StudyError if none can be started.
    """

    batch_seconds = 0.1

    def __init__(self, count: int) -> None:
        if count < 1:
            raise StudyError(f"a study needs at least one worker, got {count}")
        if count > MOST_WORKERS:
            raise StudyError(f"a study has at most {MOST_WORKERS} workers on one machine, got {count}")
        self._count = count
        self._pools: list[ProcessPoolExecutor] = []
        self._submitted: list[list[Future[list[CaseResult]]]] = [[] for _ in range(count)]  # oldest first
        self._context = multiprocessing.get_context("spawn")

    def __enter__(self) -> Self:
        self._pipe: tuple[Connection, Connection] = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(self._count)]
        try:
            for worker, started in enumerate([_submit(pool, os.getpid) for pool in self._pools]):
                self._wait_for_start(worker, started)
        except BaseException as error:  # an interrupt, too, must leave no process behind
            self.__exit__(type(error), error, None)
            raise
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        self._submitted = [[future for future in futures if not future.done()] for futures in self._submitted]
        worker = min(range(self._count), key=lambda i: len(self._submitted[i]))
        try:
            future = _submit(self._pools[worker], run_batch, batch)
        except BrokenProcessPool:
            self._replace(worker)
            future = _submit(self._pools[worker], run_batch, batch)
        self._submitted[worker].append(future)
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        if not _is_broken(future):
            return FailureKind.CANNOT_RUN
        running = [next(filter(_is_broken, futures), None) for futures in self._submitted]
        return FailureKind.WORKER_DIED if future in running else FailureKind.NOT_STARTED

    def __exit__(self, kind: ErrorType, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            self._pipe[1].close()  # every worker ends at once
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)
        for end in self._pipe:
            end.close()

    def _pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, self._context, initializer=_watch, initargs=(self._pipe[0],))

    def _replace(self, worker: int) -> None:
        self._pools[worker].shutdown(wait=True)
        self._pools[worker] = self._pool()

    def _wait_for_start(self, worker: int, started: Future[int]) -> None:
        """Wait until a worker runs; what prevents its start is permanent, and not the fault of a case."""
        for _ in range(_ATTEMPTS):
            try:
                started.result()
                return
            except BrokenProcessPool:
                self._replace(worker)
                started = _submit(self._pools[worker], os.getpid)
        raise StudyError(
            "worker processes end as soon as they start. Every worker imports the script that runs the study: it must be a "
            'file, and run the study under `if __name__ == "__main__":`'
        )


def _is_broken(future: Future[list[CaseResult]]) -> bool:
    return future.done() and isinstance(future.exception(), BrokenProcessPool)


def _submit(pool: ProcessPoolExecutor, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    with _interrupts_blocked():  # Ctrl-C is for the coordinator, not for a process that is started here
        return pool.submit(function, *arguments)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT; processes that are started meanwhile inherit the block."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _watch(end: Connection) -> None:
    """In a new worker: ignore Ctrl-C, and end with the coordinator."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with, args=(end,), daemon=True).start()


def _exit_with(end: Connection) -> None:
    """End this process when the other end of the pipe is closed, by the coordinator or by its death."""
    try:
        end.poll(None)
    finally:
        os._exit(1)


_TIMEOUT = 30.0  # s for the scheduler to answer, and for a first worker to connect


@final
class DaskExecutor(Executor):
    """All workers of the cluster with the scheduler at `address` ("tcp://host:8786"), which may come and go.

    dask moves a batch whose worker dies to another worker, and gives it up after a few deaths. Raises StudyError if no
    scheduler answers at the address, and if it has no worker.
    """

    batch_seconds = 2.0

    def __init__(self, address: str) -> None:
        self._address = address

    @property
    def slots(self) -> int:
        return _BATCHES_PER_WORKER * max(sum(map(int, self._client.nthreads().values())), 1)

    def __enter__(self) -> Self:
        try:
            # A client that cannot connect takes a minute to give up, so a plain connection is tried first.
            socket.create_connection(distributed.comm.get_address_host_port(self._address), _TIMEOUT).close()
            self._client: Any = distributed.Client(self._address, timeout=_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, ImportError) as error:
            raise StudyError(f"no scheduler answers: {error}", self._address) from error
        try:
            self._client.wait_for_workers(1, timeout=_TIMEOUT)
        except TimeoutError as error:
            self._client.close()
            raise StudyError(
                f"no worker has connected to the scheduler within {_TIMEOUT:g} s; start some: dask worker {self._address}",
                self._address,
            ) from error
        self._executor: concurrent.futures.Executor = self._client.get_executor(pure=False)
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        return self._executor.submit(run_batch, batch)

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        died = isinstance(future.exception(), distributed.KilledWorker)
        return FailureKind.WORKER_DIED if died else FailureKind.CANNOT_RUN

    def __exit__(self, kind: ErrorType, error: BaseException | None, trace: TracebackType | None) -> None:
        self._executor.shutdown(wait=kind is None)
        self._client.close()
