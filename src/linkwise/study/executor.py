"""Who runs the batches of a study: an interface, and the processes of this machine behind it.

A crew hands out futures of `concurrent.futures`, and says of a failed one what became of its batch.
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

_AHEAD = 2  # batches for each worker
_ATTEMPTS = 2  # to start a worker: one may be killed by chance


class FailureKind(Enum):
    """What became of a batch without a result."""

    DIED = "its worker died at it"
    SPARED = "its worker died before it came to it"
    FAULT = "the worker cannot run it"


class Executor(ABC):
    """Workers, from `__enter__` to `__exit__`; leaving by an exception abandons what they are at."""

    seconds: float  # how long a batch should last, so that handing it out costs next to nothing

    @property
    @abstractmethod
    def slots(self) -> int:
        """How many batches should be out at once."""

    @abstractmethod
    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        """Hand out a batch; no more than `slots` at a time."""

    @abstractmethod
    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        """What became of a batch whose future ended with an exception; but for a fault it can be handed out again."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@final
class ProcessExecutor(Executor):
    """`count` processes of this machine, each alone in a pool of its own: one that dies takes its own batch with it and no
    other, and a new one takes its place. Each has its next batch before it ends the one that it is at.

    Workers end with this process, even one that is killed. Raises StudyError where none can be started.
    """

    seconds = 0.1

    def __init__(self, count: int) -> None:
        if count < 1:
            raise StudyError(f"a study needs at least one worker, got {count}")
        self._count = count
        self._pools: list[ProcessPoolExecutor] = []
        self._at: list[list[Future[list[CaseResult]]]] = [[] for _ in range(count)]  # oldest first
        self._context = multiprocessing.get_context("spawn")
        self._ends: tuple[Connection, Connection] | None = None

    @property
    def slots(self) -> int:
        return _AHEAD * self._count

    def __enter__(self) -> Self:
        self._ends = self._context.Pipe(duplex=False)
        self._pools = [self._pool() for _ in range(self._count)]
        try:
            for place, started in enumerate([_submit(pool, os.getpid) for pool in self._pools]):
                self._await(place, started)
        except BaseException as error:  # an interrupt too must leave no process behind
            self.__exit__(type(error), error, None)
            raise
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        self._at = [[future for future in at if not future.done()] for at in self._at]
        place = min(range(self._count), key=lambda i: len(self._at[i]))
        try:
            future = _submit(self._pools[place], run_batch, batch)
        except BrokenProcessPool:
            self._renew(place)
            future = _submit(self._pools[place], run_batch, batch)
        self._at[place].append(future)
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        if not _broken(future):
            return FailureKind.FAULT
        first = [next((each for each in at if _broken(each)), None) for at in self._at]
        return FailureKind.DIED if future in first else FailureKind.SPARED

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._ends is not None
        if kind is not None:
            self._ends[1].close()  # tells every worker to leave at once
        for pool in self._pools:
            pool.shutdown(wait=True, cancel_futures=True)
        for end in self._ends:
            end.close()

    def _pool(self) -> ProcessPoolExecutor:
        assert self._ends is not None
        return ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._ends[0],))

    def _renew(self, place: int) -> None:
        self._pools[place].shutdown(wait=True)
        self._pools[place] = self._pool()

    def _await(self, place: int, started: Future[int]) -> None:
        """Wait until a worker is up: what keeps it from starting keeps it for good, and no case is to blame."""
        for _ in range(_ATTEMPTS):
            try:
                started.result()
                return
            except BrokenProcessPool:
                self._renew(place)
                started = _submit(self._pools[place], os.getpid)
        raise StudyError(
            "its worker processes end as soon as they start. A script that runs a study does so under "
            '`if __name__ == "__main__":` and is a file, since every worker imports it'
        )


def _broken(future: Future[list[CaseResult]]) -> bool:
    return future.done() and isinstance(future.exception(), BrokenProcessPool)


def _submit(pool: ProcessPoolExecutor, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    with _without_interrupt():  # a process that starts here is not the one that Ctrl-C is for
        return pool.submit(function, *arguments)


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Put off Ctrl-C; processes started meanwhile never see it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(end: Connection) -> None:
    """In a new worker: leave Ctrl-C to the coordinator, and leave when it is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(end,), daemon=True).start()


def _leave_with(end: Connection) -> None:
    """Wait until the other end of the pipe is closed, by the coordinator or by its death, and end this process."""
    try:
        end.poll(None)
    finally:
        os._exit(1)
