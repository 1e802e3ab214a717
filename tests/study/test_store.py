"""The folder of a study: rows that stay, one writer at a time, a definition that does not change unnoticed, and files without
an end.
"""

import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands import python, refusal
from small_study import small

import linkwise as lw
from linkwise.output import FullDiskError
from linkwise.study.store import DATABASE, open_store
from linkwise.study.subject import FAILED, WORKER_DIED, Row

HOLD = """
import sys, time
from pathlib import Path
import linkwise as lw
from linkwise.study.store import open_store
with open_store(Path(sys.argv[1]), lw.study.read_study(sys.argv[2])):
    print("open", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def study(tmp_path: Path) -> lw.study.Study:
    return lw.study.read_study(small(tmp_path))


def rows_of(study: lw.study.Study) -> list[lw.study.Row]:
    """A row for every case, with numbers that JSON and SQLite must not bend."""
    answer: dict[str, Any] = {
        "coefficients": {"nes1.alpha": -100.0 / 3.0},
        "standard_errors": {"nes1.alpha": 5e-324},
    }
    return [
        lw.study.Row(
            case.structure, study.subject(case.structure).structure.size, case.snr_db, case.method, case.seed,
            status="converged", links={"nes1": 0.1 + number, "nes2": 1e-300}, seconds=1 / 7, **answer,
        )
        for number, case in enumerate(study.cases())
    ]  # fmt: skip


def refused(folder: Path, study: lw.study.Study, match: str) -> None:
    """The folder is not opened for the study."""
    with pytest.raises(lw.StudyError, match=match), open_store(folder, study):
        pass


def test_rows_come_back_as_they_went_in(tmp_path: Path, study: lw.study.Study) -> None:
    rows = rows_of(study)
    folder = tmp_path / "out"
    with open_store(folder, study) as store:
        store.add(rows[5:])
        assert len(store.done()) == len(rows) - 5
        assert len(lw.study.read_rows(folder)) == len(rows) - 5  # while it runs
        refused(folder, study, "another process is running a study in this folder")
        once = r"out: rows could not be written: UNIQUE .*; earlier rows are not affected"
        with pytest.raises(lw.StudyError, match=once):
            store.add([rows[0], rows[5]])
    with open_store(folder, study) as store:
        assert store.done() == set(study.cases()) - {row.case for row in rows[:5]}
        store.add(rows[:5])
        assert store.done() == set(study.cases())
    stored = lw.study.read_rows(folder)
    assert sorted(stored, key=lambda row: row.case) == sorted(rows, key=lambda row: row.case)
    assert {row.seconds for row in stored} == {1 / 7}
    keys = [(row.structure, row.snr_db, row.method, row.seed) for row in stored]
    two = ("bnes2", 40)
    assert keys[:3] == [(*two, "weak", 1000), (*two, "weak", 1001), (*two, "classical, states", 1000)]
    assert lw.study.stored_study(folder).text() == study.text()


def test_a_case_is_done_unless_its_worker_died(tmp_path: Path, study: lw.study.Study) -> None:
    died, diverged, *_ = rows_of(study)
    with open_store(tmp_path / "out", study) as store:
        store.add([replace(died, status=WORKER_DIED), replace(diverged, status=FAILED, reason="it diverged")])
        assert store.done() == {diverged.case}


def test_the_lock_dies_with_its_process(tmp_path: Path, study: lw.study.Study) -> None:
    folder = tmp_path / "out"
    command = [sys.executable, "-c", HOLD, str(folder), str(small(tmp_path))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "open\n"
        refused(folder, study, "wait for it, stop it, or choose another folder")
        holder.send_signal(signal.SIGKILL)
    with open_store(folder, study) as store:
        assert store.done() == set()


def test_changed_definition(tmp_path: Path, study: lw.study.Study, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    with open_store(folder, study) as store:
        store.add(rows_of(study))
    subject, other = study.subjects
    chain = lw.bnes_chain(2).with_values({"nes1.alpha": -101.0})
    for message, changed in {
        r"cycles was 2, now 1\..*choose another folder, or continue with": study.quickly(),
        r"snr_db was \[40\.0, 20\.0\], now \[30\.0\]\.": replace(study, snr_db=(30.0,)),
        r'structure "bnes2"\.duration was 0\.5, now 0\.6': replace(
            study, subjects=(replace(subject, duration=0.6), other)
        ),
        r'structure "bnes2"\.toml has changed': replace(
            study, subjects=(replace(subject, structure=chain), other)
        ),
        r'method was \["weak", "classical, states", "ml"\], now \["weak"\]': replace(
            study, methods=study.methods[:1]
        ),
    }.items():
        refused(folder, changed, f"started with another definition: {message}")
    with open_store(folder, study) as store:  # and what is as it was is taken
        assert len(store.done()) == len(study)
    monkeypatch.setattr("linkwise.study.store.__version__", "99.0")
    refused(folder, study, r'another definition: linkwise was "0\.\d+\.\d+\", now "99\.0"')


def test_what_is_no_folder_of_a_study_is_left_alone(tmp_path: Path, study: lw.study.Study) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x")
    refused(foreign, study, r"the folder is not empty and does not hold a study")
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]
    refused(foreign / "thesis.tex", study, r"thesis\.tex: this is a file")
    for read in (
        lw.study.read_rows,
        lw.study.stored_study,
        lw.study.export_study,
        lw.study.study_summary,
        lw.study.success_maps,
        lw.report.write_study_report,
    ):
        with pytest.raises(lw.StudyError, match=r"foreign: the folder does not hold a study \(no study"):
            read(foreign)
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize("content", [b"not a database at all, but long enough to be read as one" * 20, None])
def test_a_damaged_store_is_told(content: bytes | None, tmp_path: Path, study: lw.study.Study) -> None:
    if content is None:
        with closing(sqlite3.connect(tmp_path / DATABASE)) as database:
            database.execute("CREATE TABLE mine (x)")
    else:
        (tmp_path / DATABASE).write_bytes(content)
    with pytest.raises(lw.StudyError, match=r"study\.sqlite: not a study of linkwise, or damaged"):
        lw.study.read_rows(tmp_path)
    refused(tmp_path, study, "not a study of linkwise")


def test_an_empty_store_is_begun_anew(tmp_path: Path, study: lw.study.Study) -> None:
    """As a kill between the first two system calls leaves it."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / DATABASE).touch()
    with pytest.raises(lw.StudyError, match="the folder does not hold a study"):
        lw.study.read_rows(tmp_path / "out")
    with open_store(tmp_path / "out", study) as store:
        assert store.done() == set()


@pytest.mark.parametrize("cycles", [10**7, 10**10, 10**30])
def test_too_many_cases_are_refused(cycles: int, tmp_path: Path) -> None:
    file = small(tmp_path, cycles=cycles)
    assert "a study has at most 1000000 cases" in refusal(f"study {file} -o {tmp_path}/out --workers 1")
    assert not (tmp_path / "out").exists()
    assert len(lw.study.read_study(file).quickly()) == 12  # the quick one may be run


def test_more_workers_than_a_machine_holds_are_refused(tmp_path: Path) -> None:
    file = small(tmp_path, cycles=1)
    assert "at most 1000 workers" in refusal(f"study {file} -o {tmp_path}/out --workers 1000000")


def test_a_study_without_rows_is_not_exported(tmp_path: Path) -> None:
    file = small(tmp_path, cycles=1)
    with open_store(tmp_path / "out", lw.study.read_study(file)):
        pass
    assert "nothing to export" in refusal(f"study {file} --export -o {tmp_path}/out", 1)


def test_a_full_disk_is_no_wrong_usage(tmp_path: Path) -> None:
    study = lw.study.read_study(small(tmp_path, cycles=1))
    with open_store(tmp_path / "out", study) as store:
        store.database.execute("PRAGMA max_page_count = 1")
        rows = [
            replace(
                Row(case.structure, 2, case.snr_db, case.method, case.seed, status="converged"),
                reason="x" * 5000,
            )
            for case in study.cases()
        ]
        with pytest.raises(FullDiskError, match="rows could not be written") as error:
            store.add(rows)
    assert error.value.exit_code == 1


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no device without an end")
@pytest.mark.parametrize(
    "arguments",
    [
        ["structure", "show", "/dev/zero"],
        ["study", "/dev/zero", "-o", "out"],
        ["identify", "/dev/zero", "chain.toml"],
    ],
)
def test_a_file_without_an_end_is_refused(arguments: list[str], tmp_path: Path) -> None:
    """In a process that may not take more memory than a file of the largest size needs."""
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))\n"
        "from linkwise.__main__ import main; main()"
    )
    done = python("-c", code, *arguments, folder=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("linkwise: /dev/zero") and len(done.stderr) < 300
