"""Studies that are interrupted leave what can be gone on with; the benchmark kills one thirty times."""

import signal
from pathlib import Path

import pytest
from commands import python
from coordinator import PATIENCE, alive, rows, start, strike, wait_for_rows, workers
from small_study import small

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc").is_dir(), reason="workers are found in /proc"),
]


def test_ctrl_c_leaves_what_can_be_gone_on_with(tmp_path: Path) -> None:
    file, folder = small(tmp_path, cycles=200), tmp_path / "out"
    coordinator = start(file, folder)
    wait_for_rows(coordinator, folder, 1)
    team = workers(coordinator.pid)
    for process in (coordinator.pid, *team):  # as a terminal does
        strike(process, signal.SIGINT)
    out, err = coordinator.communicate(timeout=PATIENCE)
    assert coordinator.returncode == 130 and out == ""
    lines = [line for line in err.splitlines() if line]
    assert lines[0].endswith(f"of 2400 cases are in {folder}; the same command resumes it.")
    assert lines[1] == "linkwise: interrupted; nothing was left half written" and len(lines) == 2
    assert not any(map(alive, team))
    assert 0 < int(lines[0].split()[0]) <= len(rows(folder)) < 2400


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    """Every worker imports the script that runs the study; without the guard each would run it again."""
    file = small(tmp_path)
    script = tmp_path / "script.py"
    script.write_text(
        f"import linkwise as lw\nlw.study.run_study({str(file)!r}, {str(tmp_path / 'out')!r}, workers=1)\n"
    )
    result = python(str(script), timeout=PATIENCE)
    assert result.returncode == 1
    assert 'run the study under `if __name__ == "__main__":`' in result.stderr
