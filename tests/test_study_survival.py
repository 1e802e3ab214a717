"""Studies that are killed, ten times at random moments, end as those that are not."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_study import small

import linkwise as lw

KILLS = 10
AT_START = (0, 5)  # these come while workers are starting, the first of them maybe before there is a folder
PATIENCE = 60.0  # s for what takes one or two on an idle machine

pytestmark = pytest.mark.skipif(not Path("/proc").is_dir(), reason="workers are found in /proc")


def start(study: Path, folder: Path) -> subprocess.Popen[str]:
    """A coordinator with two workers, in a process of its own."""
    command = [sys.executable, "-m", "linkwise.cli", "study", str(study), "--workers", "2", "-o", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def workers(coordinator: int) -> list[int]:
    """The processes that were started by a process to run cases."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                command = (entry / "cmdline").read_text()
            except OSError:  # it has ended meanwhile
                continue
            if parent == coordinator and "spawn_main" in command:
                found.append(int(entry.name))
    return found


def alive(process: int) -> bool:
    """Whether it runs; one that has ended and whom nobody asked for its end counts as dead."""
    try:
        return (Path("/proc") / str(process) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def strike(process: int) -> int:
    """Kill a process; 1 where it was there."""
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return 0
    return 1


def wait_for_rows(coordinator: subprocess.Popen[str], folder: Path, count: int) -> None:
    """Until a running study holds so many rows, or has ended."""
    end = time.monotonic() + PATIENCE
    while len(rows(folder)) < count and coordinator.poll() is None:
        assert time.monotonic() < end, f"no {count} rows within {PATIENCE:g} s"
        time.sleep(0.01)


def wait_for_the_end_of(processes: list[int]) -> None:
    end = time.monotonic() + PATIENCE
    while any(map(alive, processes)):
        assert time.monotonic() < end, "workers outlived their coordinator"
        time.sleep(0.01)


def rows(folder: Path) -> tuple[lw.Row, ...]:
    """What is stored; nothing before the study began."""
    try:
        return lw.read_rows(folder)
    except lw.StudyError as error:
        assert "there is no study in it" in str(error)
        return ()


def check_kept(before: tuple[lw.Row, ...], folder: Path) -> tuple[lw.Row, ...]:
    """The rows now; every earlier one is still there, and was not run again: its time is the same to the last bit."""
    now = rows(folder)
    seconds = {row.case: row.seconds for row in now}
    assert len(seconds) == len(now)
    assert [seconds[row.case] for row in before] == [row.seconds for row in before]
    return now


def test_killed_ten_times_it_ends_as_if_undisturbed(tmp_path: Path) -> None:
    file = small(tmp_path, cycles=16)
    undisturbed = lw.run_study(file, tmp_path / "undisturbed", workers=2)
    folder = tmp_path / "killed"
    chance = random.Random(1000)
    kept: tuple[lw.Row, ...] = ()
    coordinator = start(file, folder)
    struck = 0
    for kill in range(KILLS):
        if kill not in AT_START:  # ten kills must not all hit workers that have just begun
            wait_for_rows(coordinator, folder, len(kept) + chance.randint(1, 6))
        time.sleep(chance.uniform(0.0, 1.0 if kill in AT_START else 0.2))
        assert coordinator.poll() is None, coordinator.communicate()
        team = workers(coordinator.pid)
        if kill % 2:
            struck += strike(chance.choice(team)) if team else 0
        else:
            strike(coordinator.pid)
            coordinator.communicate()
            wait_for_the_end_of(team)
            coordinator = start(file, folder)
        kept = check_kept(kept, folder)
    out, err = coordinator.communicate(timeout=PATIENCE)
    assert coordinator.returncode == 0 and err == "", err
    assert "192 of 192 cases done, 0 failed" in out
    assert struck >= KILLS // 2 - 1
    check_kept(kept, folder)
    assert lw.read_rows(folder) == undisturbed


def test_ctrl_c_leaves_what_can_be_gone_on_with(tmp_path: Path) -> None:
    file, folder = small(tmp_path, cycles=200), tmp_path / "out"
    coordinator = start(file, folder)
    wait_for_rows(coordinator, folder, 1)
    team = workers(coordinator.pid)
    for process in (coordinator.pid, *team):  # as a terminal does
        os.kill(process, signal.SIGINT)
    out, err = coordinator.communicate(timeout=PATIENCE)
    assert coordinator.returncode == 130 and out == ""
    told = [line for line in err.splitlines() if line]
    assert told[0].endswith(f"of 2400 cases are in {folder}; the same command goes on from there.")
    assert told[1] == "linkwise: interrupted; nothing was left half written" and len(told) == 2
    assert not any(map(alive, team))
    assert 0 < int(told[0].split()[0]) <= len(lw.read_rows(folder)) < 2400


def test_a_second_process_is_refused_while_the_first_runs(tmp_path: Path) -> None:
    file, folder = small(tmp_path, cycles=200), tmp_path / "out"
    first = start(file, folder)
    wait_for_rows(first, folder, 1)
    second = start(file, folder)
    out, err = second.communicate(timeout=PATIENCE)
    assert second.returncode == 2 and out == ""
    assert err.startswith(
        f"linkwise: {folder}: another process is running a study in this folder; wait for it"
    )
    first.kill()
    first.communicate()


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    """Every worker imports the script that runs the study; without the guard each would run it again."""
    file = small(tmp_path)
    script = tmp_path / "script.py"
    script.write_text(
        f"import linkwise as lw\nlw.run_study({str(file)!r}, {str(tmp_path / 'out')!r}, workers=1)\n"
    )
    result = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=PATIENCE
    )
    assert result.returncode == 1
    assert 'A script that runs a study does so under `if __name__ == "__main__":`' in result.stderr
