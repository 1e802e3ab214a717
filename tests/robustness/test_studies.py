"""Studies that cannot be, files without an end, and cases that failed by no fault of their own."""

import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from here import studies_here
from small_study import small

import linkwise as lw
from linkwise.cli import run
from linkwise.output import FullDiskError
from linkwise.study.store import open_store
from linkwise.study.subject import FAILED, WORKER_DIED, Row


@pytest.mark.slow
def test_a_case_whose_worker_died_is_run_again_on_the_next_resume(tmp_path: Path) -> None:
    study = lw.study.read_study(small(tmp_path, cycles=1))
    with studies_here():
        rows = lw.study.run_study(study, tmp_path / "out", workers=1)
    database = sqlite3.connect(tmp_path / "out" / "study.sqlite")
    key = "structure = ? AND snr_db = ? AND method = ? AND seed = ?"
    with database:
        outcomes = ((WORKER_DIED, "its worker process died 3 times"), (FAILED, "it diverged"))
        for row, (status, reason) in zip(rows[:2], outcomes, strict=True):
            values = (status, reason, row.structure, row.snr_db, row.method, row.seed)
            change = "row = json_set(row, '$.status', ?, '$.reason', ?)"
            database.execute(f"UPDATE rows SET {change} WHERE {key}", values)
    database.close()
    with studies_here():
        again = lw.study.run_study(study, tmp_path / "out", workers=1)
    assert again[0] == rows[0] and not again[0].failed
    assert (again[1].status, again[1].reason) == (FAILED, "it diverged")


@pytest.mark.parametrize("cycles", [10**7, 10**10, 10**30])
def test_too_many_cases_are_refused(cycles: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = small(tmp_path, cycles=cycles)
    assert run(["study", str(file), "-o", str(tmp_path / "out"), "--workers", "1"]) == 2
    assert "a study has at most 1000000 cases" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert len(lw.study.read_study(file).quickly()) == 12  # the quick one may be run


def test_a_study_without_rows_is_not_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = small(tmp_path, cycles=1)
    with open_store(tmp_path / "out", lw.study.read_study(file)):
        pass
    assert run(["study", str(file), "--export", "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert said.out == "" and "nothing to export" in said.err


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
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("linkwise: /dev/zero") and len(done.stderr) < 300
