"""The coordinator: hands cases out, writes what comes back, and hands out again what was lost."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

from linkwise.errors import StudyError
from linkwise.study.crew import Crew
from linkwise.study.definition import Study
from linkwise.study.pace import Pace, next_batch
from linkwise.study.row import Case
from linkwise.study.store import Store
from linkwise.study.worker import Batch, Done, failure

_DEATHS = 3  # of a worker at one case, after which the case is to blame
_TICK = 0.5  # s between two reports while nothing comes back


@dataclass(frozen=True)
class Progress:
    """How far a study is: `done` cases of `total`, those of earlier runs included, `rate` in cases a second since this run
    began, `left` seconds to go, None while nothing tells.
    """

    done: int
    total: int
    rate: float
    left: float | None


Report = Callable[[Progress], None]


def run(study: Study, store: Store, crew: Crew, report: Report) -> None:
    """Run every case of `study` that `store` does not hold yet. What is interrupted, by whatever, goes on where it was.

    Raises StudyError where workers cannot run cases at all.
    """
    rows = store.rows()
    there = {row.case for row in rows}
    pending = deque(case for case in study.cases() if case not in there)
    pace = Pace(rows, list(pending))
    text = study.text()
    deaths: Counter[Case] = Counter()
    out: dict[Future[list[Done]], tuple[Case, ...]] = {}

    def tell() -> None:
        report(Progress(len(there) + pace.done, len(study), pace.rate, pace.left))

    tell()
    while pending or out:
        while pending and len(out) < crew.places:
            cases = next_batch(pending, pace, crew.seconds, set(deaths))
            out[crew.submit(Batch(text, cases))] = cases
        for future in wait(out, timeout=_TICK, return_when=FIRST_COMPLETED).done:
            cases = out.pop(future)
            if future.cancelled():
                raise StudyError(
                    "the workers are gone; what was finished is kept, so start the study again to go on"
                )
            error = future.exception()
            if error is None:
                results = future.result()
            elif crew.lost(error):
                deaths.update(cases)
                pending.extendleft(case for case in reversed(cases) if deaths[case] < _DEATHS)
                results = [_blamed(study, case) for case in cases if deaths[case] >= _DEATHS]
            else:
                raise StudyError(f"a worker cannot run linkwise: {type(error).__name__}: {error}") from error
            store.add(result.row for result in results)
            for result in results:
                pace.finished(result.row.case, result.seconds)
        tell()


def _blamed(study: Study, case: Case) -> Done:
    masses = study.subject(case.structure).structure.size
    reason = f"its worker process died {_DEATHS} times while at it: killed, out of memory, or crashed"
    return Done(failure(case, masses, reason), 0.0)
