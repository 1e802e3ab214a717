"""What a worker does with a batch of cases, in whatever process it runs."""

from __future__ import annotations

import json
import math
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from threading import Lock
from time import perf_counter

from linkwise.errors import LinkwiseError, StudyError
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.study.definition import Study
from linkwise.study.method import MethodResult
from linkwise.study.row import FAILED, FAULT, Case, Row
from linkwise.study.toml_file import build_study

_RECORDS = 64  # clean records that a worker keeps
_ALONE = (
    Lock()
)  # compiled integrators are not for two threads: a worker with several takes one batch at a time


@dataclass(frozen=True)
class CaseBatch:
    """Cases to run in one go. `study` is the text of the study that they belong to, `linkwise` the version that runs it."""

    study: str
    cases: tuple[Case, ...]
    linkwise: str = field(default_factory=lambda: version("linkwise"))


@dataclass(frozen=True)
class CaseResult:
    """A row, and the seconds that its case took in all: with simulation, noise and comparison."""

    row: Row
    seconds: float


def run_batch(batch: CaseBatch) -> list[CaseResult]:
    """Run every case of a batch. Nothing that goes wrong in a case is raised: it is a row that failed, with the reason.

    Raises StudyError where this process has another version of linkwise.
    """
    if batch.linkwise != version("linkwise"):
        raise StudyError(
            f"it has version {version('linkwise')}, and the study is run by {batch.linkwise}; install that"
        )
    with _ALONE:
        _pin()
        study = _study(batch.study)
        return [_run(study, batch.study, case) for case in batch.cases]


def failure(case: Case, masses: int, reason: str, seconds: float = 0.0) -> Row:
    """The row of a case without an answer."""
    return Row(
        case.structure,
        masses,
        case.snr_db,
        case.method,
        case.seed,
        FAILED,
        seconds=seconds,
        reason=" ".join(reason.split()),
    )


def _run(study: Study, text: str, case: Case) -> CaseResult:
    started = perf_counter()
    subject = study.subject(case.structure)
    masses = subject.structure.size
    try:
        clean = _clean(text, case.structure, study.cycle(case) if subject.scatter else 0)
        answer = study.method(case.method).answer(subject, clean, case.snr_db, case.seed)
        row = _row(case, masses, answer)
    except LinkwiseError as error:
        row = failure(case, masses, str(error), perf_counter() - started)
    except Exception as error:  # a fault of one case must not end a study of thousands
        reason = f"{FAULT}{type(error).__name__}: {error}"
        row = failure(case, masses, reason, perf_counter() - started)
    return CaseResult(row, perf_counter() - started)


def _row(case: Case, masses: int, answer: MethodResult) -> Row:
    numbers = [*answer.links.values(), *answer.coefficients.values(), *answer.standard_errors.values()]
    if not all(map(math.isfinite, numbers)):
        return failure(case, masses, f"the answer is not finite. {answer.reason}".strip(), answer.seconds)
    return Row(
        structure=case.structure,
        masses=masses,
        snr_db=case.snr_db,
        method=case.method,
        seed=case.seed,
        status=answer.status,
        links=answer.links,
        coefficients=answer.coefficients,
        standard_errors=answer.standard_errors,
        seconds=answer.seconds,
        reason=answer.reason,
    )


@lru_cache(maxsize=1)
def _pin() -> AbstractContextManager[object]:
    """One BLAS thread from now on: workers share the processors, and sums come out the same whatever their number is."""
    return one_blas_thread()


@lru_cache(maxsize=2)
def _study(text: str) -> Study:
    return build_study(json.loads(text), "study", Path())


@lru_cache(maxsize=_RECORDS)
def _outcome(text: str, name: str, cycle: int) -> Record | LinkwiseError:
    try:
        return _study(text).subject(name).simulate(cycle)
    except LinkwiseError as error:  # kept too: a structure that diverges does so for every case
        return error


def _clean(text: str, name: str, cycle: int) -> Record:
    """The clean record of a structure in a cycle, simulated once in this process."""
    outcome = _outcome(text, name, cycle)
    if isinstance(outcome, LinkwiseError):
        raise outcome
    return outcome
