"""Studies: what handing out costs, what ten kills cost, how long the paper takes: `make benchmark`."""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from time import perf_counter
from types import TracebackType
from typing import Self, final

import pytest
from coordinator import LOOKS, PAUSE, alive, rows, start, strike, wait_for_rows, workers
from small_study import small

import linkwise as lw
from linkwise.progress import silent
from linkwise.report.study import StudyReport
from linkwise.study.runner import run
from linkwise.study.store import open_store
from linkwise.study.workers import CaseBatch, CaseResult, Executor, FailureKind, ProcessExecutor

WORKERS = 2
HANDING_OUT = 0.05  # of the workers' time, at most
QUICK, WHOLE = 4.0, 90.0  # minutes on two processors
AT_START = 0, 5  # kills while workers are starting, the first of them maybe before there is a folder


@final
class Timed(Executor):
    """An executor that takes note of how long its workers worked, from when all of them were up to the last row."""

    def __init__(self, executor: Executor) -> None:
        self._executor, self.batch_seconds = executor, executor.batch_seconds
        self.worked, self.last, self.up = 0.0, 0.0, 0.0
        self._results = 0

    @property
    def slots(self) -> int:
        return self._executor.slots

    @property
    def idle(self) -> float:
        """The part of the time that workers waited."""
        return 1.0 - self.worked / (WORKERS * (self.last - self.up))

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        future = self._executor.submit(batch)
        future.add_done_callback(self._note)
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        return self._executor.failure_kind(future)

    def __enter__(self) -> Self:
        self._executor.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.__exit__(kind, error, trace)

    def _note(self, future: Future[list[CaseResult]]) -> None:
        self.last = perf_counter()
        self._results += 1
        if self._results == 2 * WORKERS:  # each has loaded the library and run something
            self.up, self.worked = self.last, 0.0
        else:
            self.worked += sum(done.seconds for done in future.result())


@pytest.fixture
def cluster() -> Iterator[Executor]:
    distributed = pytest.importorskip("distributed")
    crews = pytest.importorskip("linkwise.study.workers")
    with distributed.LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    ) as there:
        yield crews.DaskExecutor(there.scheduler_address)


def idle(executor: Executor, folder: Path) -> float:
    study = lw.study.read_study(small(folder, cycles=120))
    with open_store(folder / "out", study) as store, Timed(executor) as timed:
        run(study, store, timed, silent)
    return timed.idle


def test_handing_out_to_processes(tmp_path: Path) -> None:
    found = idle(ProcessExecutor(WORKERS), tmp_path)
    print(f"\n{WORKERS} processes: {100 * found:.1f} % of their time workers wait")
    assert found < HANDING_OUT


def test_handing_out_to_a_cluster(tmp_path: Path, cluster: Executor) -> None:
    found = idle(cluster, tmp_path)
    print(f"\ndask, {WORKERS} processes: {100 * found:.1f} % of their time workers wait")
    assert found < HANDING_OUT


def wait_for_the_end_of(processes: list[int]) -> None:
    for _ in range(LOOKS):
        if not any(map(alive, processes)):
            return
        time.sleep(PAUSE)
    raise AssertionError("workers outlived their coordinator")


def check_kept(before: tuple[lw.study.Row, ...], folder: Path) -> tuple[lw.study.Row, ...]:
    """The rows now; every earlier one is still there, and was not run again: its time is the same to the last bit."""
    after = rows(folder)
    seconds = {row.case: row.seconds for row in after}
    assert len(seconds) == len(after)
    assert [seconds[row.case] for row in before] == [row.seconds for row in before]
    return after


def killed(study: Path, folder: Path, kills: int, most: int, slots: int = 2) -> str:
    """Run a study to its end though it is killed so often, coordinator and one of its `slots` workers in turn, at random
    moments, up to `most` rows apart; what it printed at last.

    Checks on the way that no row is lost or made twice, and that workers end with their coordinator.
    """
    chance = random.Random(1000)
    completed: tuple[lw.study.Row, ...] = ()
    coordinator = start(study, folder, slots)
    struck = 0
    for kill in range(kills):
        if kill not in AT_START:  # they must not all hit workers that have just begun
            wait_for_rows(coordinator, folder, len(completed) + chance.randint(1, most))
        time.sleep(chance.uniform(0.0, 1.0 if kill in AT_START else 0.1))
        assert coordinator.poll() is None, coordinator.communicate()
        team = workers(coordinator.pid)
        if kill % 2:
            struck += strike(chance.choice(team)) if team else 0
        else:
            strike(coordinator.pid)
            coordinator.communicate()
            wait_for_the_end_of(team)
            coordinator = start(study, folder, slots)
        completed = check_kept(completed, folder)
    out, err = coordinator.communicate()
    assert coordinator.returncode == 0 and err == "", err
    assert struck >= kills // 2 - 1
    check_kept(completed, folder)
    return out


def test_killed_thirty_times(tmp_path: Path) -> None:
    file = small(tmp_path, cycles=60)
    started = perf_counter()
    undisturbed = lw.study.run_study(file, tmp_path / "undisturbed", workers=WORKERS)
    alone = perf_counter() - started
    killed(file, tmp_path / "killed", kills=30, most=20)
    print(
        f"\n720 cases: {alone:.0f} s undisturbed, {perf_counter() - started - alone:.0f} s when killed 30 times"
    )
    assert lw.study.read_rows(tmp_path / "killed") == undisturbed


def test_the_paper(tmp_path: Path) -> None:
    """The quick run in full, the whole one from what its cases took; of what its page claims, what five cycles can hold:
    maximum likelihood 500 times below the paper. Which cells of Table 2 come near hangs on the orbits of the cycles.
    """
    study = lw.study.read_study("paper")
    started = perf_counter()
    with open_store(tmp_path / "out", study.quickly()) as store, Timed(ProcessExecutor(WORKERS)) as timed:
        run(study.quickly(), store, timed, silent)
    quick = (perf_counter() - started) / 60
    whole = timed.worked * len(study) / len(study.quickly()) / WORKERS / 60
    print(f"\npaper: {quick:.1f} min for {study.quick} cycles, {whole:.0f} min predicted for {study.cycles}")
    print(lw.study.study_summary(tmp_path / "out"))
    claims = StudyReport.of(study.quickly(), lw.study.read_rows(tmp_path / "out")).claims
    print("\n".join(f"{claim.mark} {claim.text}" for claim in claims))
    assert [claim.met for claim in claims if claim.text.startswith("ml at 20 dB")] == [True]
    assert quick < QUICK and whole < WHOLE
