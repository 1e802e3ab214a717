"""`linkwise study`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner
from here import studies_here
from present import some
from small_study import DIVERGING, small

import linkwise as lw
from linkwise.cli import linkwise, run

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
    lw.run_study(small(folder, cycles=3), folder / "out", quick=True, workers=1)
    return folder / "out"


def arguments(folder: Path, *options: str) -> list[str]:
    return ["study", str(folder.parent / "small.toml"), "-o", str(folder), *options]


def test_it_runs_a_study_as_the_library_does(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small(tmp_path, cycles=3)
    assert run(arguments(tmp_path / "new" / "out", "--quick")) == 2  # the file is not beside that folder
    assert "there is no such study; give a TOML file" in capsys.readouterr().err
    assert run(arguments(tmp_path / "out", "--quick", "--workers", "1")) == 0
    out, err = capsys.readouterr()
    assert err == "" and out.startswith("small: 12 of 12 cases done, 0 failed\n\nbnes2, 40 dB\n")
    written = out.rstrip().splitlines()[-1].removeprefix("written: ").split(", ")
    assert {"rows.csv", "summary.csv"} <= {Path(name).name for name in written}
    assert all(Path(name).is_file() for name in some(written))
    assert lw.study.read_rows(tmp_path / "out") == lw.study.read_rows(finished)


def test_what_is_finished_is_told_again(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = [row.seconds for row in lw.study.read_rows(finished)]
    assert run(arguments(finished, "--quick", "--json")) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert (
        err == ""
        and document["study"] == "small"
        and document["cases"] == document["done"] == 12
        and document["failed"] == 0
    )
    cell = next(
        cell
        for cell in document["cells"]
        if (cell["structure"], cell["snr_db"], cell["method"]) == ("bnes2", 20, "ml")
    )
    assert cell["median"] == next(
        r.nmse for r in lw.study.read_rows(finished) if r.method == "ml" and r.snr_db == 20
    )
    assert [row.seconds for row in lw.study.read_rows(finished)] == before


def test_export_runs_nothing(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (finished / "rows.csv").unlink()
    assert (
        run(arguments(finished, "--export")) == 0
    )  # without --quick: what is there is told, whatever is asked for
    assert "12 of 12 cases done" in capsys.readouterr().out
    assert (finished / "rows.csv").exists()
    assert run(["study", "paper", "-o", str(tmp_path / "nothing"), "--export"]) == 2
    assert (
        "the folder does not hold a study" in capsys.readouterr().err and not (tmp_path / "nothing").exists()
    )
    assert run(["study", "paper", "-o", str(finished), "--export"]) == 2
    assert 'holds the study "small", not "paper"; give that name' in capsys.readouterr().err


def test_an_earlier_study_is_not_mixed_with_another(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments(finished)) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(
        f"linkwise: {finished}: the study in this folder was started with another definition:"
    )
    assert "cycles was 1, now 3" in err and "choose another folder" in err


def test_no_answer_at_all_is_exit_code_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = small(tmp_path, more=DIVERGING)
    assert run(["study", str(file), "--quick", "--workers", "1", "-o", str(tmp_path / "out")]) == 3
    out, err = capsys.readouterr()
    assert err == "" and "18 of 18 cases done, 6 failed" in out
    assert "! pushed away, 40 dB, ml failed 1 times: " in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["papr", "-o", "x"], 'papr: there is no such study; did you mean "paper"?'),
        (["paper"], "Missing option '-o' / '--output'"),
        (["paper", "-o", "x", "--workers", "0"], "0 is not in the range x>=1"),
        (["paper", "-o", "x", "--workers", "2", "--scheduler", "tcp://a:1"], "--scheduler on a cluster; give only one"),
        (["paper", "-o", "x", "--scheduler", "tcp://127.0.0.1:1"], "tcp://127.0.0.1:1: no scheduler answers"),
    ],
)  # fmt: skip
def test_wrong_usage_is_one_paragraph(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["study", *options]) == 2
    out, err = capsys.readouterr()
    assert (
        out == "" and err.startswith("linkwise: ") and message in err and len(err.strip().splitlines()) == 1
    )


def test_a_bar_tells_how_long_is_left(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reports: list[str] = []

    class Bar:
        def __enter__(self) -> object:
            return lambda report: reports.append(report.activity)

        def __exit__(self, *arguments: object) -> None:
            pass

    monkeypatch.setattr(command, "progress", lambda title: Bar())
    file = small(tmp_path)
    assert run(["study", str(file), "--quick", "--workers", "1", "-o", str(tmp_path / "out")]) == 0
    cases = [line for line in reports if " cases, " in line]
    assert cases[0] == "0 of 12 cases, 0/s"
    assert cases[-1].startswith("12 of 12 cases, ") and cases[-1].endswith("/s, 0 s left")


def test_help_has_an_example() -> None:
    result = CliRunner().invoke(linkwise, ["study", "--help"])
    assert result.exit_code == 0
    assert (
        "linkwise study paper --quick -o results/quick" in result.output
        and "--scheduler ADDRESS" in result.output
    )
