"""The workers of a dask.distributed cluster as a crew."""

from __future__ import annotations

import socket
from concurrent.futures import Future
from types import TracebackType
from typing import Any, Self, final

from distributed import Client, KilledWorker
from distributed.comm import get_address_host_port

from linkwise.errors import StudyError
from linkwise.study.executor import Executor, FailureKind
from linkwise.study.worker import CaseBatch, CaseResult, run_batch

_PATIENCE = 30.0  # s for the scheduler to answer, and for a first worker to be there
_AHEAD = 2  # batches per thread, so that none waits for the next


@final
class DaskExecutor(Executor):
    """All workers of the cluster whose scheduler is at `address` ("tcp://host:8786"), however many come and go.

    dask itself moves a batch whose worker dies to another one, and gives it up after a few deaths. Raises StudyError
    where nobody answers at the address, and where no worker is there.
    """

    seconds = 2.0

    def __init__(self, address: str) -> None:
        self._address = address

    @property
    def slots(self) -> int:
        return _AHEAD * max(sum(map(int, self._client.nthreads().values())), 1)

    def __enter__(self) -> Self:
        try:
            # A client that cannot connect takes a minute to give up, so a plain connection is tried first.
            socket.create_connection(get_address_host_port(self._address), _PATIENCE).close()
            self._client: Any = Client(self._address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, ImportError) as error:
            raise StudyError(f"no scheduler answers: {error}", self._address) from error
        try:
            self._client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            self._client.close()
            raise StudyError(
                f"the scheduler has no worker within {_PATIENCE:g} s; start some: dask worker {self._address}",
                self._address,
            ) from error
        self._executor = self._client.get_executor(pure=False)
        return self

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        future: Future[list[CaseResult]] = self._executor.submit(run_batch, batch)
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        return FailureKind.DIED if isinstance(future.exception(), KilledWorker) else FailureKind.FAULT

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=kind is None)
        self._client.close()
