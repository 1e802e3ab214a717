"""Figures drawn by two processes: the same files, each drawn once, and nothing lost when the second process is."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from importlib import import_module
from pathlib import Path
from threading import Thread, current_thread
from time import monotonic, sleep
from types import SimpleNamespace
from typing import Any

import pytest
from copied_process import processes_are_copies

from linkwise.report.drawing_process import DrawingProcess, drawing_process
from linkwise.report.page import ResultFolder

NAMES = {"first", "second", "third", "fourth", "fifth", "sixth"}
FEW = {"first", "second"}
FOLDER = """
import os, signal, sys
from functools import partial
from linkwise.plot.style import sheet
from linkwise.report.page import ResultFolder
from linkwise.report.page import Section

SECOND = "pytest" not in sys.modules
{on_import}

def draw(log, name):
    {on_drawing}
    with open(log, "a") as file:
        print("second" if SECOND else "first", name, file=file)
    with sheet() as (figure, [axes]):
        axes.plot([1.0, 2.0], [3.0, 4.0], label=name)
    return figure

def sections(reported):
    return {{name: Section(name, figure=partial(draw, str(reported.result), name)) for name in {names!r}}}

FOLDER = ResultFolder(
    document=lambda result, truth: {{"method": "drawn"}},
    data=lambda reported, folder: None,
    figures=sections,
    page=lambda reported, pictures: "".join(pictures.values()),
)
"""
FAILURES = {
    "ends on import": ("if SECOND: os._exit(1)", ""),
    "is killed while it draws": ("", "if SECOND: os.kill(os.getpid(), signal.SIGKILL)"),
    "ends after its first figure": ("", "if SECOND and name != 'fifth': os._exit(0)"),
    "raises": ("", "if SECOND: raise ValueError(name)"),
    "speaks": ("if SECOND: os.write(1, b'not a figure')", "if SECOND: print('not a figure', flush=True)"),
    "returns no figure": ("", "if SECOND: return None"),
}


@pytest.fixture
def kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., str]]:
    """Makes a kind of result folder in a temporary module, which may do things on import and when it draws."""

    def make(on_import: str = "", on_drawing: str = "", names: Collection[str] = NAMES) -> str:
        code = FOLDER.format(on_import=on_import, on_drawing=on_drawing, names=sorted(names))
        (tmp_path / "temporary_folder.py").write_text(code, encoding="utf-8")
        return "temporary_folder:FOLDER"

    monkeypatch.syspath_prepend(str(tmp_path))
    yield make
    sys.modules.pop("temporary_folder", None)


@pytest.fixture
def copied() -> Iterator[None]:
    """The second process is a copy of this one, which knows nothing of the temporary module."""
    with processes_are_copies("linkwise.report.drawing_process", anew=("pytest", "temporary_folder")):
        yield


def folder_of(kind: str) -> ResultFolder[Any]:
    module, _, name = kind.partition(":")
    folder: ResultFolder[Any] = getattr(import_module(module), name)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_the_second_process_draws_what_the_first_then_writes(
    kind: Callable[..., str], tmp_path: Path
) -> None:
    log, name = tmp_path / "log", kind()
    folder = folder_of(name)
    alone = files(folder.write(tmp_path / "other log", tmp_path / "alone"))
    with closing(DrawingProcess(name)) as process:
        process.draw(log)
        assert set(process.pictures()) == NAMES
        written = files(folder.write(log, tmp_path / "both", process=process))
    assert written == alone and {f"{name}.svg" for name in NAMES} < set(written)
    assert sorted(log.read_text().splitlines()) == sorted(f"second {name}" for name in NAMES)
    assert process._process.poll() is not None


@pytest.mark.usefixtures("copied")
def test_each_figure_is_drawn_once(kind: Callable[..., str], tmp_path: Path) -> None:
    log, name = tmp_path / "log", kind()
    with closing(DrawingProcess(name)) as process:
        process.draw(log)
        folder_of(name).write(log, tmp_path / "both", process=process)
    assert sorted(line.split()[1] for line in log.read_text().splitlines()) == sorted(NAMES)


@pytest.mark.usefixtures("copied")
def test_few_figures_are_left_to_the_second_process(kind: Callable[..., str], tmp_path: Path) -> None:
    log, name = tmp_path / "log", kind(names=FEW)
    with closing(DrawingProcess(name)) as process:
        process.draw(log)
        folder_of(name).write(log, tmp_path / "both", process=process)
    assert sorted(log.read_text().splitlines()) == sorted(f"second {name}" for name in FEW)


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.usefixtures("copied")
def test_what_the_second_process_does_not_deliver_is_drawn_by_the_first(
    failure: str, kind: Callable[..., str], tmp_path: Path
) -> None:
    log, name = tmp_path / "log", kind(*FAILURES[failure])
    with closing(DrawingProcess(name)) as process:
        process.draw(log)
        process.pictures()  # wait for what there is
        written = files(folder_of(name).write(log, tmp_path / "both", process=process))
    assert {f"{name}.{suffix}" for name in NAMES for suffix in ("png", "svg")} < set(written)
    assert written["report.html"].count(b"<img") == len(NAMES)


@pytest.mark.usefixtures("copied")
def test_a_second_process_that_hangs_is_not_waited_for(
    kind: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("linkwise.report.drawing_process._LAST_FIGURE", 0.1)
    log, name = tmp_path / "log", kind("if SECOND: signal.pause()")
    with closing(DrawingProcess(name)) as process:
        process.draw(log)
        folder_of(name).write(log, tmp_path / "both", process=process)
    assert sorted(log.read_text().splitlines()) == sorted(f"first {name}" for name in NAMES)


@pytest.mark.usefixtures("copied")
def test_a_result_that_cannot_be_sent_is_drawn_by_the_first_process(
    kind: Callable[..., str], tmp_path: Path
) -> None:
    class Log(SimpleNamespace):
        """A class that pickle does not find."""

        def __str__(self) -> str:
            return str(tmp_path / "log")

    name = kind()
    with closing(DrawingProcess(name)) as process:
        process.draw(Log())
        folder_of(name).write(Log(), tmp_path / "both", process=process)
    assert sorted((tmp_path / "log").read_text().splitlines()) == sorted(f"first {name}" for name in NAMES)


@pytest.mark.usefixtures("copied")
def test_a_result_is_sent_as_it_is_when_it_is_handed_over(kind: Callable[..., str], tmp_path: Path) -> None:
    class Caching(SimpleNamespace):
        """A result that takes note of the threads in which it is pickled, as one that caches what it is asked for."""

        def __reduce__(self) -> tuple[type, tuple[str]]:
            threads.append(current_thread())
            return Path, (str(tmp_path / "log"),)

    threads: list[Thread] = []
    name = kind()
    with closing(DrawingProcess(name)) as process:
        process.draw(Caching())
        assert threads == [current_thread()]
        assert set(process.pictures()) == NAMES


@pytest.mark.usefixtures("copied")
def test_a_figure_that_cannot_be_drawn_is_an_error_of_the_first_process(
    kind: Callable[..., str], tmp_path: Path
) -> None:
    name = kind(on_drawing="raise ValueError('cannot be drawn')")
    with closing(DrawingProcess(name)) as process:
        process.draw(tmp_path / "log")
        with pytest.raises(ValueError, match="cannot be drawn"):
            folder_of(name).write(tmp_path / "log", tmp_path / "both", process=process)
    assert not (tmp_path / "both").exists() and process._process.poll() is not None


def test_there_is_no_second_process_where_drawing_is_loaded_already() -> None:
    assert "matplotlib.figure" in sys.modules
    with drawing_process("linkwise.report.estimate:ESTIMATE_FOLDER") as process:
        assert process is None


FIRST = """
import sys
from linkwise.report import drawing_process
drawing_process.processors = lambda: 2
with drawing_process.drawing_process(sys.argv[1]) as process:
    print(process._process.pid, flush=True)
    {then}
"""


@pytest.mark.skipif(
    not Path("/proc/self/stat").exists(), reason="the system does not list its processes there"
)
@pytest.mark.parametrize(
    "then", ["sys.stdin.read()", "raise ValueError", "process.draw(0); sys.stdin.read()"]
)
def test_the_second_process_ends_with_the_first(then: str, kind: Callable[..., str], tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", FIRST.format(then=then), kind()],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    ) as first:
        assert first.stdout is not None
        second = int(first.stdout.readline())
        if then != "raise ValueError":
            first.kill()
        first.wait()
    limit = monotonic() + 60.0  # s, where it waits in vain; it takes the time of an import
    while is_running(second) and monotonic() < limit:
        sleep(0.05)
    assert not is_running(second)


def is_running(process: int) -> bool:
    """Whether there is a process of this number that has not ended."""
    try:
        state = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"
