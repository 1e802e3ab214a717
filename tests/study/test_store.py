"""The folder of a study: rows that stay, one writer at a time, and a definition that does not change unnoticed."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from small_study import small

import linkwise as lw
from linkwise.study.store import DATABASE, differences, open_store

HOLD = """
import sys, time
from pathlib import Path
import linkwise as lw
from linkwise.study.store import open_store
with open_store(Path(sys.argv[1]), lw.read_study(sys.argv[2])):
    print("open", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def study(tmp_path: Path) -> lw.Study:
    return lw.read_study(small(tmp_path))


def rows_of(study: lw.Study) -> list[lw.study.Row]:
    """A row for every case, with numbers that JSON and SQLite must not bend."""
    return [
        lw.study.Row(
            case.structure,
            study.subject(case.structure).structure.size,
            case.snr_db,
            case.method,
            case.seed,
            status="converged",
            links={"nes1": 0.1 + number, "nes2": 1e-300},
            coefficients={"nes1.alpha": -100.0 / 3.0},
            standard_errors={"nes1.alpha": 5e-324},
            seconds=1 / 7,
            reason="",
        )
        for number, case in enumerate(study.cases())
    ]


def test_rows_come_back_as_they_went_in(tmp_path: Path, study: lw.Study) -> None:
    rows = rows_of(study)
    folder = tmp_path / "out"
    with open_store(folder, study) as store:
        store.add(rows[5:])
        assert len(store.done()) == len(rows) - 5
    with open_store(folder, study) as store:
        store.add(rows[:5])
        assert store.done() == set(study.cases())
    stored = lw.study.read_rows(folder)
    assert sorted(stored, key=lambda row: row.case) == sorted(rows, key=lambda row: row.case)
    assert {row.seconds for row in stored} == {1 / 7}
    keys = [(row.structure, row.snr_db, row.method, row.seed) for row in stored]
    assert keys[:3] == [
        ("bnes2", 40, "weak", 1000),
        ("bnes2", 40, "weak", 1001),
        ("bnes2", 40, "classical, states", 1000),
    ]
    assert lw.study.stored_study(folder).text() == study.text()


def test_a_case_is_stored_once_and_a_batch_whole_or_not_at_all(tmp_path: Path, study: lw.Study) -> None:
    rows = rows_of(study)
    with open_store(tmp_path / "out", study) as store:
        store.add(rows[:1])
        with pytest.raises(
            lw.StudyError, match=r"out: rows could not be written: UNIQUE .*; earlier rows are not affected"
        ):
            store.add([rows[1], rows[0]])
        assert store.done() == {rows[0].case}


def test_a_study_that_runs_can_be_read_but_not_opened(tmp_path: Path, study: lw.Study) -> None:
    folder = tmp_path / "out"
    with open_store(folder, study) as store:
        store.add(rows_of(study)[:2])
        assert len(lw.study.read_rows(folder)) == 2
        with (
            pytest.raises(lw.StudyError, match="another process is running a study in this folder"),
            open_store(folder, study),
        ):
            pass


def test_the_lock_dies_with_its_process(tmp_path: Path, study: lw.Study) -> None:
    folder = tmp_path / "out"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), str(small(tmp_path))], stdout=subprocess.PIPE, text=True
    )
    with holder:
        assert holder.stdout is not None and holder.stdout.readline() == "open\n"
        with (
            pytest.raises(lw.StudyError, match="wait for it, stop it, or choose another folder"),
            open_store(folder, study),
        ):
            pass
        holder.send_signal(signal.SIGKILL)
    with open_store(folder, study) as store:
        assert store.done() == set()


def test_a_changed_definition_is_noticed(tmp_path: Path, study: lw.Study) -> None:
    folder = tmp_path / "out"
    with open_store(folder, study) as store:
        store.add(rows_of(study))
    subject = study.subjects[0]
    other_chain = lw.bnes_chain(2).with_values({"nes1.alpha": -101.0})
    changes = {
        r"cycles was 2, now 1\.": study.quickly(),
        r"snr_db was \[40\.0, 20\.0\], now \[30\.0\]\.": replace(study, snr_db=(30.0,)),
        r'structure "bnes2"\.duration was 0\.5, now 0\.6': replace(
            study, subjects=(replace(subject, duration=0.6), study.subjects[1])
        ),
        r'structure "bnes2"\.toml has changed': replace(
            study, subjects=(replace(subject, structure=other_chain), study.subjects[1])
        ),
        r'method was \["weak", "classical, states", "ml"\], now \["weak"\]': replace(
            study, methods=study.methods[:1]
        ),
    }
    for message, changed in changes.items():
        with (
            pytest.raises(lw.StudyError, match=f"started with another definition: {message}"),
            open_store(folder, changed),
        ):
            pass
    with (
        pytest.raises(lw.StudyError, match="choose another folder, or continue with"),
        open_store(folder, study.quickly()),
    ):
        pass
    with open_store(folder, study) as store:  # and what is as it was is taken
        assert len(store.done()) == len(study)


def test_rows_of_two_versions_do_not_mix(
    tmp_path: Path, study: lw.Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_store(tmp_path / "out", study):
        pass
    monkeypatch.setattr("linkwise.study.store.__version__", "99.0")
    with (
        pytest.raises(lw.StudyError, match=r'another definition: linkwise was "0\.\d+\.\d+", now "99\.0"'),
        open_store(tmp_path / "out", study),
    ):
        pass


def test_differences_name_the_key() -> None:
    assert differences({"a": 1}, {"a": 1}) == []
    assert differences({"a": 1}, {"a": 1, "b": [2]}) == ["b was not given, now [2]"]
    assert differences({"a": {"b": 1}}, {"a": {"b": 2}}) == ["a.b was 1, now 2"]
    assert differences({"a": "x" * 200}, {"a": "y"}) == ["a has changed"]


def test_what_is_no_folder_of_a_study_is_left_alone(tmp_path: Path, study: lw.Study) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("x")
    with (
        pytest.raises(lw.StudyError, match=r"the folder is not empty and does not hold a study"),
        open_store(foreign, study),
    ):
        pass
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]
    with (
        pytest.raises(lw.StudyError, match=r"thesis\.tex: this is a file"),
        open_store(foreign / "thesis.tex", study),
    ):
        pass
    for read in (lw.study.read_rows, lw.study.stored_study, lw.study.export_study, lw.study.study_summary):
        with pytest.raises(
            lw.StudyError, match=r"foreign: the folder does not hold a study \(no study\.sqlite\)"
        ):
            read(foreign)


def test_a_damaged_store_is_said_to_be_one(tmp_path: Path, study: lw.Study) -> None:
    for number, content in enumerate(
        (b"not a database at all, but long enough to be read as one" * 20, None)
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        if content is None:
            database = sqlite3.connect(folder / DATABASE)
            database.execute("CREATE TABLE mine (x)")
            database.close()
        else:
            (folder / DATABASE).write_bytes(content)
        with pytest.raises(lw.StudyError, match=r"study\.sqlite: not a study of linkwise, or damaged"):
            lw.study.read_rows(folder)
        with pytest.raises(lw.StudyError, match="not a study of linkwise"), open_store(folder, study):
            pass


def test_an_empty_store_is_begun_anew(tmp_path: Path, study: lw.Study) -> None:
    """As a kill between the first two system calls leaves it."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / DATABASE).touch()
    with pytest.raises(lw.StudyError, match="the folder does not hold a study"):
        lw.study.read_rows(tmp_path / "out")
    with open_store(tmp_path / "out", study) as store:
        assert store.done() == set()
