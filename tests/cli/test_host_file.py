"""`structure host` keeps what was added to a file by hand, and tells of damping that was given in per cent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from linkwise.cli import run

SINK = """
[[mass]]
name = "ball"
mass = 0.02

[[link]]
name = "sink"
between = ["ball", "rod.mid"]
law = "k*d"
coefficients = { k = 1.0 }
"""


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A rod of 30 masses, to rod.toml."""
    monkeypatch.chdir(tmp_path)
    stiffness = 1e4 * (2.0 * np.eye(30) - np.eye(30, k=1) - np.eye(30, k=-1))
    np.savez("rod.npz", M=0.1 * np.eye(30), K=stiffness)
    return ["structure", "host", "rod.npz", "--point", "mid=15", "--keep", "4", "-o", "rod.toml"]


def test_links_that_were_added_are_not_lost(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*command, "--modal-damping", "0.01"]) == 0
    assert run([*command, "--modal-damping", "0.02"]) == 0  # a host alone is written again
    added = Path("rod.toml").read_text() + SINK
    Path("rod.toml").write_text(added)
    capsys.readouterr()
    assert run([*command, "--modal-damping", "0.01"]) == 2
    assert "-o rod.toml is there already and holds more than hosts" in capsys.readouterr().err
    assert Path("rod.toml").read_text() == added


def test_a_file_of_another_kind_is_not_lost(command: list[str]) -> None:
    Path("run.csv").write_text("time,x:m1\n0,1\n")
    assert run([*command[:-1], "run.csv"]) == 2
    assert Path("run.csv").read_text() == "time,x:m1\n0,1\n"


@pytest.mark.parametrize(("ratio", "told"), [("2", True), ("0.02", False)])
def test_a_mode_that_does_not_oscillate_is_told(
    command: list[str], ratio: str, told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*command, "--modal-damping", ratio]) == 0
    assert ("note: mode 1 does not oscillate: its damping ratio is 2" in capsys.readouterr().err) == told
