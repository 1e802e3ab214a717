"""Pairs of runs on one folder, kills during writing and full disks, a few of each; the benchmark has more."""

from pathlib import Path

import pytest
from damaged_runs import ABSENT, MIXED, DamagedRuns


@pytest.mark.slow
def test_every_folder_is_whole_of_one_run_or_absent(tmp_path: Path) -> None:
    runs = DamagedRuns(tmp_path)
    assert runs.pair(0) in ("first", "second")
    assert {runs.kill(number) for number in range(2)} <= {"first", "second", ABSENT}
    assert [runs.full_disk(number, 2) for number in range(2)] == [ABSENT, "second"]  # an earlier result stays
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    for path in runs.folders["first"].iterdir():
        (mixed / path.name).write_bytes(path.read_bytes())
    assert runs.state(mixed) == "first"
    (mixed / "structure.toml").write_bytes((runs.folders["second"] / "structure.toml").read_bytes())
    assert runs.state(mixed) == MIXED
