"""Runs that share a folder, are killed while they write, or find the disk full: every folder whole, of one run, or absent.

LINKWISE_DAMAGE says how many pairs of runs and kills (default 50).
"""

from __future__ import annotations

import os
from pathlib import Path

from damaged_runs import ABSENT, DamagedRuns, damage_counts

COUNT = int(os.environ.get("LINKWISE_DAMAGE", "50"))
DISKS = 20


def test_damage(tmp_path: Path) -> None:
    found = damage_counts(DamagedRuns(tmp_path), COUNT, COUNT, DISKS)
    print("\nwhat is in the folder afterwards")
    for name, counter in found.items():
        print(f"  {name:<28}", ", ".join(f"{count} {what}" for what, count in sorted(counter.items())))
    for counter in found.values():
        assert set(counter) <= {"first", "second", ABSENT}
    assert ABSENT not in found["pairs of runs on one folder"]
