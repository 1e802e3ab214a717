"""`linkwise identify` and `discover` with `--ambient` and `--input-noise`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from structures import asked_oscillator

import linkwise as lw
from linkwise.cli import run


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str]:
    """A record of a mass on a spring of 1000 N/m in a force that a load cell shows with noise, and its structure."""
    rng, rate, count = np.random.default_rng(5), 100.0, 1000
    force = rng.standard_normal(count)
    response = np.exp(-0.5 * np.arange(count) / rate) * np.sin(np.sqrt(1000.0) * np.arange(count) / rate)
    x = np.convolve(force, response)[:count] / (rate * np.sqrt(1000.0))
    columns = np.column_stack(
        [x + 1e-5 * rng.standard_normal(count), force + 0.1 * rng.standard_normal(count)]
    )
    lw.write_record(lw.Record(0.0, rate, ("x:m1", "force:m1"), columns), tmp_path / "run.csv")
    lw.write_structure(asked_oscillator("k*d + c*v", 1.0), tmp_path / "unknown.toml")
    return str(tmp_path / "run.csv"), str(tmp_path / "unknown.toml")


@pytest.mark.parametrize(
    ("option", "where", "kind", "is_found"),
    [
        (("--ambient", "all"), "m1", "ambient", True),
        (("--ambient", "m1=0.014"), "m1", "ambient", False),
        (("--input-noise", "force:m1=100 mN"), "force:m1", "input noise", False),
    ],
)
def test_the_forces_counted_in_are_told(
    files: tuple[str, str],
    option: tuple[str, str],
    where: str,
    kind: str,
    is_found: bool,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run(["identify", *files, *option, "--json"])
    [force] = json.loads(capsys.readouterr().out)["random_forces"]
    assert (force["where"], force["kind"], force["found"]) == (where, kind, is_found)
    if (
        not is_found
    ):  # 100 mN a sample at 100 Hz are 0.1 * sqrt(2 / 100) N/sqrt(Hz), and so is 0.014 but for its digits
        assert force["deviation"] == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--ambient", "m1=loud"), "--ambient takes a number in N/sqrt(Hz), as in m1=0.5, got 'loud'"),
        (("--input-noise", "force:m1=3 kg"), "--input-noise force:m1=3 kg: '3 kg'"),
        (("--input-noise", "a:base=3 N"), "--input-noise a:base=3 N: '3 N'"),
        (("--input-noise", "force"), "no noise of force"),
        (("--ambient", "m1", "--ambient", "m1=0.5"), "--ambient is given twice for 'm1'"),
        (("--ambient", "m1", "--method", "weak"), "--ambient is for --method ml, not for weak"),
        (("--ambient", "m9"), "no ambient force can act on m9"),
    ],
)
def test_wrong_use_is_told(
    files: tuple[str, str], options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["identify", *files, *options]) != 0
    assert words in " ".join(capsys.readouterr().err.split())


def test_discover_takes_the_same(files: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    given = ["discover", files[0], "--mass", "m1=1.0", "--terms", "d, v"]
    assert run([*given, "--ambient", "m9"]) != 0
    assert "no ambient force can act on m9" in capsys.readouterr().err
    run([*given, "--input-noise", "force:m1=100 mN"])
    assert "Noise of force:m1 of 0.1 N, as stated, is allowed for." in " ".join(
        capsys.readouterr().out.split()
    )
