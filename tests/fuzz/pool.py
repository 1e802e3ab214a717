"""Workers, and what becomes of them."""

import multiprocessing
import os
import signal
from collections.abc import Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import cast

from fuzz.case import Outcome
from fuzz.worker import work

_HANGS = {-getattr(signal, name, 0) for name in ("SIGXCPU", "SIGALRM")}


class _Worker:
    """One process, and the seed that it is at."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, end = context.Pipe()
        self.process = context.Process(target=work, args=(end,), daemon=True)
        self.process.start()
        end.close()

    def give(self, seed: int | None) -> None:
        self.seed = seed
        self.connection.send(seed)

    def result(self) -> Outcome:
        """What it found, or why it is no more."""
        try:
            return cast(Outcome, self.connection.recv())
        except (EOFError, ConnectionError):
            self.process.join()
            code = self.process.exitcode
            return Outcome(None, died="hangs" if code in _HANGS else f"died with code {code}")


def outcomes(seeds: Iterable[int], count: int) -> Iterator[tuple[int, Outcome]]:
    """The outcome of every seed, as they come, from `count` processes."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    pending = list(seeds)[::-1]
    workers: dict[Connection, _Worker] = {}
    for worker in [_Worker() for _ in pending[:count]]:
        workers[worker.connection] = worker
        worker.give(pending.pop())
    while workers:
        for connection in wait(list(workers)):
            worker = workers.pop(cast(Connection, connection))
            assert worker.seed is not None
            result = worker.result()
            yield worker.seed, result
            if pending:
                worker = _Worker() if result.died else worker
                workers[worker.connection] = worker
                worker.give(pending.pop())
            elif not result.died:
                worker.give(None)
                worker.process.join()
