"""Workers, and what becomes of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterable, Iterator
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from fuzz.case import Outcome
from fuzz.worker import work

_PATIENCE = 120.0  # s after which a worker that uses no processor time hangs too
_ROUND = 1.0  # s that the pool waits at a time; a longer one was no waiting, the machine slept


class _Worker:
    """One process, the seed that it is at, and since when."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, end = context.Pipe()
        self.process: BaseProcess = context.Process(target=work, args=(end,), daemon=True)
        self.process.start()
        end.close()
        self.seed: int | None = None
        self.waited = 0.0

    def give(self, seed: int | None) -> None:
        self.seed, self.waited = seed, 0.0
        self.connection.send(seed)

    def end(self) -> str:
        """Why it is no more, in words."""
        self.process.join(5.0)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
            return "hangs without using the processor"
        if self.process.exitcode == -getattr(signal, "SIGXCPU", 0):
            return "hangs"
        return f"died with code {self.process.exitcode}"


def outcomes(seeds: Iterable[int], count: int) -> Iterator[tuple[int, Outcome]]:
    """The outcome of every seed, as they come, from `count` processes."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    pending = iter(seeds)
    workers: dict[Connection, _Worker] = {}
    for seed in pending:
        worker = _Worker()
        worker.give(seed)
        workers[worker.connection] = worker
        if len(workers) == count:
            break
    while workers:
        began = time.monotonic()
        ready = wait(list(workers), timeout=_ROUND)
        waited = min(time.monotonic() - began, _ROUND)
        for worker in workers.values():
            worker.waited += waited
        late = [c for c, worker in workers.items() if worker.waited > _PATIENCE and c not in ready]
        for connection in [*ready, *late]:
            if not isinstance(connection, Connection):
                raise TypeError(f"{connection!r} is no connection to a worker")
            worker = workers[connection]
            if worker.seed is None:
                raise RuntimeError("a worker without an input has answered")
            try:
                if connection in late:
                    raise EOFError
                result = connection.recv()
            except (EOFError, ConnectionError):
                result = Outcome(None, died=worker.end())
            yield worker.seed, result
            seed_or_none = next(pending, None)
            if result.died or seed_or_none is None:
                del workers[connection]
                if not result.died:
                    worker.give(None)
                    worker.process.join()
                connection.close()
                if seed_or_none is None:
                    continue
                worker = _Worker()
                workers[worker.connection] = worker
            worker.give(seed_or_none)
