"""What a worker process does with a batch of cases."""

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
from linkwise.study.row import FAILED, INTERNAL_ERROR, Case, Row
from linkwise.study.toml_file import build_study

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
    with _ONE_AT_A_TIME:
        _use_one_blas_thread()
        study = _study(batch.study)
        return [_run(study, batch.study, case) for case in batch.cases]


def failed_row(case: Case, masses: int, reason: str, *, seconds: float = 0.0, status: str = FAILED) -> Row:
    """The row of a case without an answer."""
    return Row(
        case.structure,
        masses,
        case.snr_db,
        case.method,
        case.seed,
        status,
        seconds=seconds,
        reason=" ".join(reason.split()),
    )


def _run(study: Study, text: str, case: Case) -> CaseResult:
    started = perf_counter()
    subject = study.subject(case.structure)
    masses = subject.structure.size
    try:
        clean = _clean(text, case.structure, study.cycle(case) if subject.scatter else 0)
        result = study.method(case.method).evaluate(subject, clean, case.snr_db, case.seed)
        row = _row(case, masses, result)
    except LinkwiseError as error:
        row = failed_row(case, masses, str(error), seconds=perf_counter() - started)
    except Exception as error:  # an internal error in one case must not end a study of thousands
        reason = f"internal error of linkwise: {type(error).__name__}: {error}"
        row = failed_row(case, masses, reason, seconds=perf_counter() - started, status=INTERNAL_ERROR)
    return CaseResult(row, perf_counter() - started)


def _row(case: Case, masses: int, result: MethodResult) -> Row:
    numbers = [*result.links.values(), *result.coefficients.values(), *result.standard_errors.values()]
    if not all(map(math.isfinite, numbers)):
        reason = f"the answer is not finite. {result.reason}".strip()
        return failed_row(case, masses, reason, seconds=result.seconds)
    return Row(
        structure=case.structure,
        masses=masses,
        snr_db=case.snr_db,
        method=case.method,
        seed=case.seed,
        status=result.status,
        links=result.links,
        coefficients=result.coefficients,
        standard_errors=result.standard_errors,
        seconds=result.seconds,
        reason=result.reason,
        terms=result.terms,
    )


@lru_cache(maxsize=1)
def _use_one_blas_thread() -> AbstractContextManager[object]:
    """Use one BLAS thread from now on: workers share the processors, and sums do not depend on the number of threads."""
    return one_blas_thread()


@lru_cache(maxsize=2)
def _study(text: str) -> Study:
    return build_study(json.loads(text), "study", Path())


@lru_cache(maxsize=_RECORDS)
def _simulated(text: str, name: str, cycle: int) -> Record | LinkwiseError:
    try:
        return _study(text).subject(name).simulate(cycle)
    except LinkwiseError as error:  # cached too: a structure that diverges does so for every case
        return error


def _clean(text: str, name: str, cycle: int) -> Record:
    """The clean record of a structure in a cycle, simulated once in this process."""
    record = _simulated(text, name, cycle)
    if isinstance(record, LinkwiseError):
        raise record
    return record
