"""Pairs of runs on one folder, kills during writing and full disks, a few of each, in processes that need not load anything;
the benchmark has more, which are started as a user starts them."""

from __future__ import annotations

import sys

import pytest
from damaged_runs import ABSENT, MIXED, DamagedRuns, forked


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> DamagedRuns:
    return DamagedRuns(tmp_path_factory.mktemp("runs"), forked)


@pytest.mark.skipif(sys.platform == "win32", reason="a process there cannot be killed by a signal")
def test_every_folder_is_whole_of_one_run_or_absent(runs: DamagedRuns) -> None:
    assert runs.pair(0) in ("first", "second")
    assert {runs.kill(number) for number in range(2)} <= {"first", "second", ABSENT}
    assert [runs.full_disk(number, 2) for number in range(2)] == [ABSENT, "second"]  # an earlier result stays


def test_a_mixed_folder_is_noticed(runs: DamagedRuns) -> None:
    folder = runs.home / "mixed"
    folder.mkdir()
    for path in runs.folders["first"].iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    assert runs.state(folder) == "first"
    (folder / "structure.toml").write_bytes((runs.folders["second"] / "structure.toml").read_bytes())
    assert runs.state(folder) == MIXED
