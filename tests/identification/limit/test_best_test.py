"""The best of hits, sweeps and multisines within limits: what it promises, and what it refuses."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from commands import document, refusal, said
from structures import oscillator

import linkwise as lw
from linkwise.identification.best_test import BestTest

SPRING = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)
NOISE = {"x:m1": 1e-5, "a:m1": 1.0}
DRIVE = "--force m1=5 --noise x:m1=1e-5"


@pytest.fixture(scope="module")
def found() -> BestTest:
    within = {"force": 20.0, "stroke:spring": 0.02}
    return lw.best_test(SPRING, "spring.k", duration=2.0, rate=60.0, noise=NOISE, within=within)


def test_the_best_keeps_the_limits_and_its_error_is_that_of_limit(found: BestTest) -> None:
    """As an expression of t, not by its samples; of the linear structure errors halve where forces double."""
    best = found.plans[0]
    errors = [plan.error_of("spring.k") for plan in found.plans[1:]]
    assert best.error_of("spring.k") <= 1.1 * min(errors) and errors[2:] == sorted(errors[2:])
    assert all(plan.strokes["spring"] <= 0.02 and plan.peak <= 20.0 for plan in found.plans)
    assert list(best.limit.noise) == ["x:m1"]  # the accelerometer adds next to nothing
    bound = lw.limit(
        SPRING, duration=2.0, rate=60.0, noise={"x:m1": 1e-5}, sensors=["x:m1"], forces={"m1": best.force},
        segment=best.limit.segment,
    )  # fmt: skip
    assert bound.coefficient("spring.k").standard_error == pytest.approx(best.error_of("spring.k"), rel=1e-2)
    kind, band = found.plans[-1].kind, found.plans[-1].band
    alike = [
        plan for plan in found.plans if (plan.kind, plan.band) == (kind, band) and len(plan.limit.noise) == 2
    ]
    scaled = [plan.peak * plan.error_of("spring.k") for plan in alike]
    assert len(alike) > 1 and np.ptp(scaled) < 1e-3 * scaled[0]


def test_its_command_simulates_it(found: BestTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lw.write_structure(SPRING, tmp_path / "structure.toml")
    printed = found.to_dict()["tests"][0]
    assert printed["command"] in str(found)
    said(shlex.join(shlex.split(printed["command"])[1:]))
    record = lw.read_record(tmp_path / "test.csv")
    assert np.abs(record.channel("force:m1")).max() <= 1.01 * printed["peak"]
    assert np.abs(record.channel("x:m1")).max() == pytest.approx(printed["strokes"]["spring"], rel=0.02)


def test_the_command_compares_tests_and_refuses_a_drive(tmp_path: Path) -> None:
    lw.write_structure(SPRING, tmp_path / "spring.toml")
    asked = f"limit {tmp_path}/spring.toml --duration 1 --rate 50 --optimise spring.c"
    printed = document(f"{asked} --within force=20 --noise x:m1=1e-5")
    assert printed["coefficient"] == "spring.c" and printed["tests"][0]["standard_error"] > 0.0
    assert f"simulate {tmp_path}/spring.toml" in printed["tests"][0]["command"]
    assert "it takes neither a drive nor --noise" in refusal(f"{asked} {DRIVE}")
    assert "the largest force" in refusal(f"{asked} --noise x:m1=1e-5")
    assert "spring, got stroke:leaf=1" in refusal(f"{asked} --within stroke:leaf=1 --noise x:m1=1e-5")
    tight = "--within force=20 --within stroke=1e-9 --noise x:m1=1e-5"
    assert "allow a larger stroke" in refusal(f"{asked} {tight}", 1)
