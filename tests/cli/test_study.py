"""`linkwise study`: what it runs, what it tells again, and what its folder is refused for."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import pytest
from commands import document, refusal, said
from here import studies_here
from present import some
from small_study import DIVERGING, small

import linkwise as lw

pytestmark = pytest.mark.usefixtures("in_this_process", "unrendered")
command = import_module("linkwise.cli.study")  # the package holds the command under that name


@pytest.fixture(scope="module")
def in_this_process() -> Iterator[None]:
    with studies_here():
        yield


@pytest.fixture(scope="module")
def finished(in_this_process: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small study that was run by the library, its file beside it."""
    folder = tmp_path_factory.mktemp("study")
    lw.study.run_study(small(folder, cycles=3), folder / "out", quick=True, workers=1)
    return folder / "out"


def study(folder: Path, *options: str) -> str:
    return " ".join(["study", str(folder.parent / "small.toml"), "-o", str(folder), *options])


@pytest.mark.slow
def test_it_runs_as_the_library(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[str] = []

    @contextmanager
    def bar(_: str) -> Iterator[lw.estimates.Progress]:
        yield lambda report: reports.append(report.activity)

    monkeypatch.setattr(command, "progress", bar)
    small(tmp_path, cycles=3)
    # the file is not beside that folder
    assert "there is no such study; give a TOML file" in refusal(study(tmp_path / "new" / "out", "--quick"))
    out, err = said(study(tmp_path / "out", "--quick", "--workers", "1"))
    assert err == "" and out.startswith("small: 12 of 12 cases done, 0 failed\n\nbnes2, 40 dB\n")
    written = out.rstrip().splitlines()[-1].removeprefix("written: ").split(", ")
    assert {"rows.csv", "summary.csv"} <= {Path(name).name for name in written}
    assert all(Path(name).is_file() for name in some(written))
    assert lw.study.read_rows(tmp_path / "out") == lw.study.read_rows(finished)
    cases = [line for line in reports if " cases, " in line]
    assert cases[0] == "0 of 12 cases, 0/s"
    assert cases[-1].startswith("12 of 12 cases, ") and cases[-1].endswith("/s, 0 s left")


def test_what_is_finished_is_told_again(finished: Path) -> None:
    before = [row.seconds for row in lw.study.read_rows(finished)]
    printed = document(study(finished, "--quick"))
    assert printed["study"] == "small" and printed["failed"] == 0
    assert printed["cases"] == printed["done"] == 12
    cells = {(cell["structure"], cell["snr_db"], cell["method"]): cell for cell in printed["cells"]}
    (row,) = (
        row
        for row in lw.study.read_rows(finished)
        if (row.structure, row.snr_db, row.method) == ("bnes2", 20, "ml")
    )
    assert cells["bnes2", 20, "ml"]["median"] == row.nmse
    assert [row.seconds for row in lw.study.read_rows(finished)] == before


def test_export_runs_nothing(finished: Path) -> None:
    (finished / "rows.csv").unlink()
    # without --quick: what is there is told, whatever is asked for
    assert "12 of 12 cases done" in said(study(finished, "--export")).out
    assert (finished / "rows.csv").exists()
    other = refusal(f"study paper -o {finished} --export")
    assert 'holds the study "small", not "paper"; give that name' in other
    earlier = refusal(study(finished))
    assert earlier.startswith(
        f"linkwise: {finished}: the study in this folder was started with another definition:"
    )
    assert "cycles was 1, now 3" in earlier and "choose another folder" in earlier


@pytest.mark.slow
def test_no_answer_at_all_is_exit_code_3(tmp_path: Path) -> None:
    file = small(tmp_path, more=DIVERGING)
    text, before = file.read_text(encoding="utf-8"), "[[structure]]\nbnes = 4"
    start = text.index(before)
    file.write_text(text[:start] + text[text.index("[[method]]") :], encoding="utf-8")
    out, err = said(f"study {file} --quick --workers 1 -o {tmp_path}/out", 3)
    assert err == "" and "12 of 12 cases done, 6 failed" in out
    assert "! pushed away, 40 dB, ml failed 1 times: " in out
    rows = lw.study.read_rows(tmp_path / "out")
    failed = [row for row in rows if row.failed]
    assert {row.structure for row in failed} == {"pushed away"} and (len(failed), len(rows)) == (6, 12)
    assert all("m1" in row.reason and row.nmse is None and row.worst is None for row in failed)
    assert not any(row.reason.startswith("this is a fault") for row in failed)
    assert lw.study.study_summary(tmp_path / "out").complete


def test_a_part_of_a_study_tells_how_all_are_gathered(finished: Path) -> None:
    """A part may have no case, where there are more parts than cases."""
    told = said(study(finished, "--quick", "--shard", "99/99"))
    assert told.out == ""
    assert "part 99/99 is done; without --shard the same command gathers all parts" in told.err
    assert lw.study.read_rows(finished / "shards" / "99-of-99") == ()
