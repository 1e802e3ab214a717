"""What a person waits for: five commands as whole processes, against the time that they may take: `make benchmark`.

The goals are seconds on an idle machine of two processors, and a command that stays within its seconds meets its goal. On a
slower machine it meets the goal too where it takes no more than that in units: a unit is the time of a process that imports
NumPy and scipy.linalg, in the same run. Every figure is the median of five processes, taken in turn after one that is not
counted, in which Python compiles modules and stores them, as the first command of an installation does. On a machine that has
other work, the processor time of a command (of its second process too, which draws while the first one computes) tells more
than the time on the wall.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

import pytest

import linkwise as lw

ROUNDS = 5
UNIT = 0.46  # s of the reference on the machine that the goals were set on: `identify` took 2.8 s there, 6.1 times as long
HEADROOM = 1.3  # of the goals in units, for machines whose parts differ in speed
BUSY = 1.3  # wall over processor time of the reference; above it other work takes the processors
REFERENCE = "imports NumPy and scipy.linalg"


@dataclass(frozen=True)
class Goal:
    """Seconds on an idle machine of two processors: before imports and figures were cut down, and those to reach."""

    before: float
    goal: float


GOALS = {
    "identify two masses": Goal(2.8, 1.2),
    "identify two masses -o": Goal(5.3, 3.0),
    "discover six masses -o": Goal(11.0, 5.0),
    "absorb two masses -o": Goal(9.8, 4.0),
    "--help": Goal(0.22, 0.22),
}


@dataclass(frozen=True)
class Times:
    """Of one command in s: on the wall, and of all processors, its children's included."""

    wall: float
    processor: float


def test_commands_answer_in_the_time_that_a_person_waits(tmp_path: Path) -> None:
    commands = _commands(tmp_path)
    times: dict[str, list[Times]] = {name: [] for name in commands}
    for number in range(1 + ROUNDS):
        for name, command in commands.items():
            shutil.rmtree(tmp_path / "answer", ignore_errors=True)
            time = _timed(command, tmp_path)
            times[name] += [time] if number else []
    medians = {
        name: Times(median(time.wall for time in taken), median(time.processor for time in taken))
        for name, taken in times.items()
    }
    unit = medians[REFERENCE]
    print(
        f"\n{'':31}{'wall, s':>9}{'units':>7}{'processor, s':>14}{'units':>7}{'before':>8}{'goal':>7}{'goal, s':>9}"
    )
    for name, time in medians.items():
        goal = GOALS.get(name)
        print(
            f"{name:31}{time.wall:9.2f}{time.wall / unit.wall:7.2f}{time.processor:14.2f}"
            f"{time.processor / unit.processor:7.2f}"
            + ("" if goal is None else f"{goal.before / UNIT:8.2f}{goal.goal / UNIT:7.2f}{goal.goal:9.2f}")
        )
    slow = {
        name: f"{medians[name].wall:.2f} s, {medians[name].wall / unit.wall:.2f} units"
        for name, goal in GOALS.items()
        if medians[name].wall > goal.goal * max(1.0, HEADROOM * unit.wall / UNIT)
    }
    if slow and unit.wall > BUSY * unit.processor:
        pytest.skip("the processors have other work; compare processor times")
    assert not slow, f"on the wall, above the goal in s and {HEADROOM:g} times that in units: {slow}"


def _commands(folder: Path) -> dict[str, list[str]]:
    """The commands by name, and the files that they read: the paper's chains after their hit, six seconds at 30 dB."""
    for masses, speed in ((2, 1.0), (6, 3.0)):
        chain = lw.bnes_chain(masses)
        record = lw.simulate(chain, release={"v:m1": speed}, duration=6.0, rate=1000.0)
        lw.write_record(record.with_noise(30.0, seed=1), folder / f"run{masses}.csv")
    lw.write_structure(lw.bnes_chain(2), folder / "chain.toml")
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), folder / "unknown.toml")
    masses_given = [f"--mass={mass.name}={mass.mass.value}" for mass in lw.bnes_chain(6).masses]
    python, output = [sys.executable], ["-o", "answer"]
    linkwise = [*python, "-m", "linkwise"]
    identify = [*linkwise, "identify", "run2.csv", "unknown.toml"]
    absorb = [*linkwise, "absorb", "chain.toml", "--duration", "6", "--release", "v:m1=1.0"]
    return {
        REFERENCE: [*python, "-c", "import numpy, scipy.linalg"],
        "identify two masses": identify,
        "identify two masses -o": [*identify, *output],
        "discover six masses -o": [*linkwise, "discover", "run6.csv", *masses_given, *output],
        "absorb two masses -o": [*absorb, *output],
        "--help": [*linkwise, "--help"],
    }


def _timed(command: list[str], folder: Path) -> Times:
    """Run a command in `folder`; what it prints goes nowhere, and it must succeed."""
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "compiled")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True
    )
    wall, after = perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    return Times(wall, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
