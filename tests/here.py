"""Studies that are run by the process of the tests: what they start of processes is tested in tests/study."""

from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from types import TracebackType
from typing import Self, final

import pytest

from linkwise.study.subject import Case, Row
from linkwise.study.workers import CaseBatch, CaseResult, Executor, FailureKind, run_batch


class Died(Exception):
    """What the executor below raises for a worker that died."""


@final
class Here(Executor):
    """An executor that works in this process, the newest batch first; a worker dies at a case in `deadly`, so many times.

    Cases of the rows that are `known` are not run again, for tests of what becomes of the rows.
    """

    batch_seconds = 0.2

    def __init__(
        self,
        slots: int = 1,
        deadly: dict[Case, int] | None = None,
        error: Exception | None = None,
        *,
        known: Iterable[Row] = (),
    ) -> None:
        self._known = {row.case: row for row in known}
        self._places, self._left, self._error = slots, Counter(deadly or {}), error
        self.batches: list[tuple[Case, ...]] = []

    @property
    def slots(self) -> int:
        return self._places

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        self.batches.append(batch.cases)
        future: Future[list[CaseResult]] = Future()
        hit = [case for case in batch.cases if self._left[case] > 0]
        if self._error:
            future.set_exception(self._error)
        elif hit:
            self._left.subtract(hit)
            future.set_exception(Died())
        else:
            known_results = [
                CaseResult(self._known[case], 0.0) for case in batch.cases if case in self._known
            ]
            rest = tuple(case for case in batch.cases if case not in self._known)
            future.set_result([*known_results, *(run_batch(replace(batch, cases=rest)) if rest else ())])
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        return FailureKind.WORKER_DIED if isinstance(future.exception(), Died) else FailureKind.CANNOT_RUN

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.batches.append(())


@contextmanager
def studies_here() -> Iterator[None]:
    """In its block, studies that ask for processes of this machine are run in this one, which need not start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("linkwise.study.runner.ProcessExecutor", Here)
        yield
