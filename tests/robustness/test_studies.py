"""Studies that cannot be, files without an end, and cases that failed by no fault of their own."""

from dataclasses import replace
from pathlib import Path

import pytest
from commands import python, refusal
from small_study import small

import linkwise as lw
from linkwise.output import FullDiskError
from linkwise.study.store import open_store
from linkwise.study.subject import Row


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
