"""Coordinators of studies in processes of their own, and how to kill them and their workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import linkwise as lw

# s after which a process that takes one or two on an idle machine is ended as one that hangs
PATIENCE = 120.0
PAUSE = 0.03  # s between two looks at what others do, each of which reads all rows
LOOKS = 12_000  # after which nothing happens any more; a busy machine looks less often


def start(study: Path, folder: Path, slots: int = 2) -> subprocess.Popen[str]:
    """A coordinator with so many workers, in a process of its own."""
    options = ["--workers", str(slots), "-o", str(folder)]
    command = [sys.executable, "-m", "linkwise", "study", str(study), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def workers(coordinator: int) -> list[int]:
    """The processes that were started by a process to run cases."""
    numbers = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                command = (entry / "cmdline").read_text()
            except OSError:  # it has ended meanwhile
                continue
            if parent == coordinator and "spawn_main" in command:
                numbers.append(int(entry.name))
    return numbers


def alive(process: int) -> bool:
    """Whether it runs; one that has ended and whom nobody asked for its end counts as dead."""
    try:
        return (Path("/proc") / str(process) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def strike(process: int, by: signal.Signals = signal.SIGKILL) -> int:
    """End a process by a signal; 1 where it was there."""
    try:
        os.kill(process, by)
    except ProcessLookupError:
        return 0
    return 1


def wait_for_rows(coordinator: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Until a running study holds so many rows, or has ended."""
    for _ in range(LOOKS):
        if len(rows(folder)) >= count or coordinator.poll() is not None:
            return
        time.sleep(PAUSE)
    raise AssertionError(f"no {count} rows after {LOOKS} looks")


def rows(folder: Path) -> tuple[lw.study.Row, ...]:
    """What is stored; nothing before the study began."""
    try:
        return lw.study.read_rows(folder)
    except lw.StudyError as error:
        assert "the folder does not hold a study" in str(error)
        return ()
