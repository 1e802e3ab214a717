"""The workers of a dask.distributed cluster as an executor; dask comes with the extra [cluster]."""

from __future__ import annotations

import socket
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Self, final

from distributed import Client, KilledWorker
from distributed.comm import get_address_host_port

from linkwise.errors import StudyError
from linkwise.study.executor import CaseBatch, CaseResult, ErrorType, Executor, FailureKind, run_batch

_TIMEOUT = 30.0  # s for the scheduler to answer, and for a first worker to connect
_BATCHES_PER_THREAD = 2  # submitted at a time, so that no worker waits for the next


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
        return _BATCHES_PER_THREAD * max(sum(map(int, self._client.nthreads().values())), 1)

    def __enter__(self) -> Self:
        try:
            # A client that cannot connect takes a minute to give up, so a plain connection is tried first.
            socket.create_connection(get_address_host_port(self._address), _TIMEOUT).close()
            self._client: Any = Client(self._address, timeout=_TIMEOUT, set_as_default=False)
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
        self._executor = self._client.get_executor(pure=False)
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        future: Future[list[CaseResult]] = self._executor.submit(run_batch, batch)
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        died = isinstance(future.exception(), KilledWorker)
        return FailureKind.WORKER_DIED if died else FailureKind.CANNOT_RUN

    def __exit__(self, kind: ErrorType, error: BaseException | None, trace: TracebackType | None) -> None:
        self._executor.shutdown(wait=kind is None)
        self._client.close()
