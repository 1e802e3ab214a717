"""Runs that share a folder, are killed while they write, or find the disk full: every folder whole, of one run, or absent.

LINKWISE_DAMAGE says how many pairs of runs and kills (default 50).
"""

from __future__ import annotations

import os
from collections import Counter

import pytest
from damaged_runs import ABSENT, DamagedRuns

COUNT = int(os.environ.get("LINKWISE_DAMAGE", "50"))
DISKS = 20
ONE_RUN = {"first", "second"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> DamagedRuns:
    return DamagedRuns(tmp_path_factory.mktemp("runs"))


def tell(what: str, states: Counter[str]) -> None:
    print(
        f"\n{states.total()} {what}; the folder is of",
        ", ".join(f"{n} {s}" for s, n in sorted(states.items())),
    )


def test_pairs(runs: DamagedRuns) -> None:
    states = Counter(runs.pair(number) for number in range(COUNT))
    tell("pairs of runs", states)
    assert set(states) <= ONE_RUN


def test_kills(runs: DamagedRuns) -> None:
    states = Counter(runs.kill(number) for number in range(COUNT))
    tell("kills during writing, every other one over an earlier result (second)", states)
    assert set(states) <= {*ONE_RUN, ABSENT}


def test_full_disks(runs: DamagedRuns) -> None:
    states = Counter(runs.full_disk(number, DISKS) for number in range(DISKS))
    tell("full disks, every other one with an earlier result (second)", states)
    assert states == {"second": DISKS // 2, ABSENT: DISKS // 2}
