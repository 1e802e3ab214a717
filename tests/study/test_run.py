"""Running a study: rows that do not depend on who ran them, failures that are rows, workers that die."""

import concurrent.futures
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any, Self, final

import pytest
from here import Here, studies_here
from problems import chain_record

import linkwise as lw
from linkwise.progress import silent
from linkwise.study.runner import run
from linkwise.study.store import open_store
from linkwise.study.workers import CaseBatch, CaseResult, Executor, FailureKind, ProcessExecutor, run_batch


@pytest.mark.slow
def test_the_rows_are_those_of_the_library(small_folder: Path) -> None:
    by_case = {row.case: row for row in lw.study.read_rows(small_folder)}
    row = by_case[lw.study.Case("bnes4", 20.0, "ml", 1001)]
    chain = lw.bnes_chain(4)
    clean = chain_record(4, duration=0.5, speed=3.0 * (1.0 + 1e-10))  # the second cycle
    fit = lw.identify(clean.with_noise(20.0, seed=1001), chain.unknown("all"))
    links = {name: lw.nmse(chain.link(name), fit.structure.link(name), clean) for name in ("nes1", "nes2")}
    assert row.links == pytest.approx(links, rel=1e-8)  # same numerics
    assert row.nmse == pytest.approx(sum(links.values()) / 2) and row.worst == max(row.links.values())
    assert row.coefficients["nes2.beta"] == pytest.approx(fit.coefficient("nes2.beta").value, rel=1e-8)
    assert row.standard_errors["nes1.c"] == pytest.approx(fit.coefficient("nes1.c").standard_error, rel=1e-8)
    assert row.status == "converged" and row.reason == "" and row.seconds > 0.0 and row.masses == 4

    row = by_case[lw.study.Case("bnes2", 40.0, "classical, states", 1001)]
    chain = lw.bnes_chain(2)
    clean = chain_record(2, duration=0.5, sensors=("x", "v", "a"))
    states = lw.sindy.noisy_states(clean, "states", 40.0, seed=1001)
    classical = lw.sindy.LeastSquares().fit(lw.sindy.monomial_equations(states, order=3))
    # same numerics, but for the solve of two columns
    error = lw.sindy.monomial_nmse(classical, chain, "nes1", clean)
    assert row.links == pytest.approx({"nes1": error}, rel=1e-6)
    terms = classical.terms("x2''")
    expected = {"nes1.alpha": -0.01 * terms["x2"], "nes1.beta": -0.01 * terms["x2**3"]}
    assert row.coefficients == pytest.approx(expected, rel=1e-6)


@pytest.fixture
def study(small_folder: Path) -> lw.study.Study:
    return lw.study.stored_study(small_folder)


def run_by(executor: Executor, study: lw.study.Study, folder: Path) -> list[lw.study.Row]:
    """The rows of a study whose cases this executor runs, or goes on with."""
    with open_store(folder, study) as store, executor:
        run(study, tuple(study.cases()), store, executor, silent)
    return list(lw.study.read_rows(folder))


@pytest.mark.slow
def test_two_processes_give_the_same_rows_and_a_finished_study_is_not_run_again(
    small_folder: Path, study: lw.study.Study, tmp_path: Path
) -> None:
    reports: list[lw.study.StudyProgress] = []
    rows = lw.study.run_study(
        study, tmp_path / "out", workers=2, progress=lambda report: reports.append(report.detail)
    )
    assert rows == lw.study.read_rows(small_folder)
    assert reports[0].done == 0 and reports[0].left is None
    assert reports[-1].done == reports[-1].total == len(rows) == len(study) and reports[-1].left == 0.0
    again = lw.study.run_study(study, tmp_path / "out", workers=2)
    assert [row.seconds for row in again] == [row.seconds for row in rows]


def test_a_worker_that_dies_loses_a_batch(small_folder: Path, study: lw.study.Study, tmp_path: Path) -> None:
    known = list(lw.study.read_rows(small_folder))
    unlucky = list(study.cases())[-1]
    executor = Here(2, {unlucky: 2}, known=known)
    assert run_by(executor, study, tmp_path / "twice") == known
    assert sum(unlucky in batch for batch in executor.batches) == 3
    assert executor.batches[-2] == (unlucky,)  # alone, once it was under suspicion

    deadly = lw.study.Case("bnes2", 20.0, "ml", 1001)
    rows = run_by(Here(1, {deadly: 99}, known=known), study, tmp_path / "always")
    (row,) = (row for row in rows if row.failed)
    assert row.case == deadly
    assert row.reason == "its worker process died 3 times while running it: killed, out of memory, or crashed"
    assert [row for row in rows if not row.failed] == [row for row in known if row.case != deadly]


def test_workers_that_cannot_work_end_the_study(study: lw.study.Study, tmp_path: Path) -> None:
    broken = Here(error=ModuleNotFoundError("No module named 'linkwise'"))
    with pytest.raises(lw.StudyError, match="a worker cannot run linkwise: ModuleNotFoundError: No module"):
        run_by(broken, study, tmp_path / "out")
    with pytest.raises(lw.StudyError, match="the connection to the workers is lost"):
        run_by(Gone(), study, tmp_path / "out")
    message = r"the worker has linkwise .*, but the study is run by 99\.0; insta"
    with pytest.raises(lw.StudyError, match=message):
        run_batch(CaseBatch(study.text(), (), linkwise="99.0"))


class Replaying(concurrent.futures.Executor):
    """An executor as libraries have them, that knows the rows."""

    def __init__(self, rows: Sequence[lw.study.Row]) -> None:
        self.rows = {row.case: row for row in rows}
        self.ran: list[lw.study.Case] = []

    def submit(self, function: Callable[..., Any], /, batch: CaseBatch) -> Future[Any]:  # type: ignore[override]
        assert function is run_batch
        self.ran += batch.cases
        future: Future[Any] = Future()
        future.set_result([CaseResult(self.rows[case], 0.1) for case in batch.cases])
        return future


def test_shards_of_any_executor_join(small_folder: Path, study: lw.study.Study, tmp_path: Path) -> None:
    known = lw.study.read_rows(small_folder)
    executor, folder = Replaying(known), tmp_path / "out"
    for part in (1, 3):
        rows = lw.study.run_study(study, folder, executor=executor, shard=f"{part}/3")
        assert {row.case for row in rows} == set(list(study.cases())[part - 1 :: 3])
        assert (folder / "shards" / f"{part}-of-3" / "summary.csv").exists()
    assert lw.study.run_study(study, folder, executor=executor) == known  # runs what is left
    assert executor.ran[-len(executor.ran[2::3]) :] == list(study.cases())[1::3] and len(executor.ran) == len(
        known
    )
    with pytest.raises(lw.StudyError, match="as in 3/16, got '4/3'"):
        lw.study.run_study(study, folder, shard="4/3")
    with (
        open_store(folder / "shards" / "1-of-3", study),
        pytest.raises(lw.StudyError, match="another process is run"),
    ):
        lw.study.run_study(study, folder, executor=executor)


@final
class Gone(Executor):
    """An executor whose cluster has gone: it drops what it is given."""

    batch_seconds = 1.0
    slots = 1

    def submit(self, batch: CaseBatch) -> Future[list[CaseResult]]:
        future: Future[list[CaseResult]] = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future

    def failure_kind(self, future: Future[list[CaseResult]]) -> FailureKind:
        return FailureKind.CANNOT_RUN

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *arguments: object) -> None:
        pass


def test_infinite_answers_are_no_answers(study: lw.study.Study, monkeypatch: pytest.MonkeyPatch) -> None:
    case = lw.study.Case("bnes2", 20.0, "weak", 1000)
    monkeypatch.setattr("linkwise.study.methods.nmse", lambda *given: float("nan"))
    (done,) = run_batch(CaseBatch(study.text(), (case,)))
    assert done.row.failed and done.row.reason == "the answer is not finite."
    monkeypatch.setattr("linkwise.study.methods.nmse", lambda *given: 1 / 0)
    (done,) = run_batch(CaseBatch(study.text(), (case,)))
    assert done.row.reason == "internal error of linkwise: ZeroDivisionError: division by zero"


@pytest.mark.slow
def test_what_failed_by_a_fault_of_linkwise_or_by_deaths_is_run_again(
    small_folder: Path, study: lw.study.Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And nothing else: not what had an answer."""
    answered = list(lw.study.read_rows(small_folder))
    pushed = lw.study.Case("bnes2", 20.0, "ml", 1001)
    with monkeypatch.context() as broken:
        broken.setattr("linkwise.study.methods.nmse", lambda *given: 1 / 0)  # of weak and ml
        known = [row for row in answered if row.structure == "bnes4" or row.method.startswith("classical")]
        before = run_by(Here(1, {pushed: 3}, known=known), study, tmp_path / "out")
    faulty = {row.case for row in before if "ZeroDivisionError" in row.reason} | {pushed}
    assert len(faulty) == len(study) // 3 and {row.case for row in before if row.failed} == faulty
    reports: list[lw.study.StudyProgress] = []
    with open_store(tmp_path / "out", study) as store, Here(known=answered) as executor:
        assert store.done() == set(study.cases()) - faulty
        run(study, tuple(study.cases()), store, executor, lambda report: reports.append(report.detail))
        assert store.done() == set(study.cases())
    assert reports[0].done == len(study) - len(faulty) and reports[-1].done == len(study)
    assert {case for batch in executor.batches for case in batch} == faulty
    assert list(lw.study.read_rows(tmp_path / "out")) == answered


@pytest.mark.slow
def test_a_process_that_is_killed_takes_one_batch_with_it(study: lw.study.Study) -> None:
    """The one that it was at; the next one, which it had already, can be told from that."""
    case = lw.study.Case("bnes4", 20.0, "ml", 1000)
    with ProcessExecutor(1) as executor:
        assert executor.slots == 2
        (first,) = executor.submit(CaseBatch(study.text(), (case,))).result()
        long = executor.submit(CaseBatch(study.text(), (case,) * 100))
        behind = executor.submit(CaseBatch(study.text(), (case,)))
        for child in multiprocessing.active_children():
            child.kill()
        wait([long, behind])
        assert executor.failure_kind(long) is FailureKind.WORKER_DIED
        assert executor.failure_kind(behind) is FailureKind.NOT_STARTED
        (again,) = executor.submit(CaseBatch(study.text(), (case,))).result()
        assert again.row == first.row
        unreadable = executor.submit(CaseBatch("no JSON", (case,)))
        wait([unreadable])
        assert executor.failure_kind(unreadable) is FailureKind.CANNOT_RUN


JOINT_AND_RIG = '''
snr_db = [40]
first_seed = 31
cycles = 1
method = [{ kind = "ml" }, { kind = "weak" }, { kind = "monomial", convention = "states" }]

[[structure]]
name = "joint"
toml = """
mass = [{ name = "m1", mass = 1.0 }]
[[link]]
name = "joint"
between = ["m1", "ground"]
law = "bouc-wen"
coefficients = { k = 400.0, c = 1.5, F = 12.0, x0 = "20 mm", s = 0.7 }
"""
forces = { m1 = "9*sin(17*t) + 5*sin(7.3*t) + 4*sin(41*t)" }
duration = 3.0
rate = 200.0
unknown = ["joint"]

[[structure]]
name = "rig"
toml = """
[[link]]
name = "damper"
between = ["base", "ground"]
law = "bouc-wen"
coefficients = { k = 2000.0, c = 50.0, F = 100.0, x0 = "1 mm", s = 0.7 }
"""
base = "0.01*sin(5*t)*sin(0.7*t) + 0.003*sin(17*t)"
duration = 4.0
rate = 200.0
'''


@pytest.mark.slow
def test_links_with_memory_and_rigs_are_studied(tmp_path: Path) -> None:
    """Rows are those of the library, intervals hold the truth, and methods that do not take them say so."""
    path = tmp_path / "mine.toml"
    path.write_text(JOINT_AND_RIG, encoding="utf-8")
    with studies_here():
        rows = lw.study.run_study(path, tmp_path / "out", workers=1)
    study = lw.study.read_study(path)
    for name, link in (("joint", "joint"), ("rig", "damper")):
        subject = study.subject(name)
        clean = subject.simulate()
        fit = lw.identify(subject.measured(clean).with_noise(40.0, seed=31), subject.stated_structure(31))
        row = next(row for row in rows if row.case == lw.study.Case(name, 40.0, "ml", 31))
        true = subject.true_structure.link(link)
        assert row.links == pytest.approx({link: lw.nmse(true, fit.structure.link(link), clean)}, rel=1e-8)
        assert row.status == "converged" and set(row.standard_errors) == {p.name for p in fit.parameters}
    cells = {(cell.structure, cell.method): cell for cell in lw.study.study_summary(tmp_path / "out").cells}
    assert cells["joint", "ml"].intervals == cells["rig", "ml"].intervals == 5
    assert cells["rig", "ml"].masses == 0
    for name in ("joint", "rig"):
        # 0.5 is four standard deviations off 95 % for four independent intervals; those of a link go together
        assert (cells[name, "ml"].coverage or 0.0) >= 0.5 and (cells[name, "ml"].nmse or 1.0) < 0.01
        for method in ("weak", "monomial, states"):
            ((reason, count),) = cells[name, method].reasons
            assert count == 1 and "not supported in" in reason
