"""Executors of the batches of a study: the interface, and the processes of this machine behind it.

An executor returns futures of `concurrent.futures`, and classifies the failure of a batch.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from enum import Enum
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self, final

from linkwise.errors import StudyError
from linkwise.study.worker import CaseBatch, CaseResult, run_batch

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

    @property
    @abstractmethod
    def slots(self) -> int:
        """How many batches should be submitted at a time."""

    @abstractmethod
    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        """Submit a batch; at most `slots` at a time."""

    @abstractmethod
    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        """Why a future ended with an exception; the batch can be submitted again unless the worker cannot run it."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


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
        self._pipe: tuple[Connection, Connection] | None = None

    @property
    def slots(self) -> int:
        return _BATCHES_PER_WORKER * self._count

    def __enter__(self) -> Self:
        self._pipe = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(self._count)]
        try:
            for worker, started in enumerate([_submit(pool, os.getpid) for pool in self._pools]):
                self._wait_for_start(worker, started)
        except BaseException as error:  # an interrupt, too, must leave no process behind
            self.__exit__(type(error), error, None)
            raise
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        self._submitted = [[future for future in some if not future.done()] for some in self._submitted]
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
        running = [
            next((future for future in futures if _is_broken(future)), None) for futures in self._submitted
        ]
        return FailureKind.WORKER_DIED if future in running else FailureKind.NOT_STARTED

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._pipe is not None
        if kind is not None:
            self._pipe[1].close()  # every worker ends at once
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)
        for end in self._pipe:
            end.close()

    def _pool(self) -> ProcessPoolExecutor:
        assert self._pipe is not None
        return ProcessPoolExecutor(
            1, self._context, initializer=_initialize_worker, initargs=(self._pipe[0],)
        )

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


def _initialize_worker(end: Connection) -> None:
    """In a new worker: ignore Ctrl-C, and end with the coordinator."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with, args=(end,), daemon=True).start()


def _exit_with(end: Connection) -> None:
    """End this process when the other end of the pipe is closed, by the coordinator or by its death."""
    try:
        end.poll(None)
    finally:
        os._exit(1)
