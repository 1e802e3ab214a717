"""Measured points beside computed curves: a swept sine on the response, a decay on the backbone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal
from structures import HARDENING, oscillator

import linkwise as lw

SPRING = oscillator(HARDENING, name="spring", k=400.0, k3=1e5, c=0.8)
DRIVEN: dict[str, Any] = {"force": {"m1": 1.0}, "hz": (2.0, 4.5), "starts": 0}


@pytest.fixture(scope="module")
def sweep() -> lw.Record:
    """From 2.2 to 3.1 Hz, with the accelerometer's noise of 0.05 m/s2."""
    force = "1.0*cos(2*pi*(2.2 + 0.0075*t)*t)"
    record = lw.simulate(SPRING, forces={"m1": force}, duration=60.0, rate=60.0, sensors=["a:m1"])
    noise = 0.05 * np.random.default_rng(1).standard_normal(len(record))
    values = record.values + noise[:, None] * [name == "a:m1" for name in record.channels]
    return lw.Record(record.start, record.rate, record.channels, values)


def test_points_of_a_sweep_lie_on_the_curve(sweep: lw.Record) -> None:
    """By an acceleration, of which the displacement is shown; a slow sweep is behind by less than 2 %."""
    response = lw.respond(SPRING, **DRIVEN).beside(sweep)
    [branch], measured = response.levels[0].branches, response.measured
    assert measured is not None and len(measured.hz) > 10
    assert measured.size == pytest.approx(1.0, rel=1e-3)
    lower = slice(0, int(np.argmax(branch.amplitude[:, 0])))  # to the peak
    expected = np.interp(measured.hz, branch.hz[lower], branch.amplitude[lower, 0])
    early = measured.hz < 2.8
    assert early.sum() > 5 and measured.amplitude[early, 0] == pytest.approx(expected[early], rel=0.03)
    assert response.to_dict()["measured"][0]["amplitude"]["x:m1"] == measured.amplitude[0, 0]
    axes = lw.plot.response(response)
    assert "measured" in axes.get_legend_handles_labels()[1]


def test_a_decay_lies_on_the_backbone() -> None:
    record = lw.simulate(SPRING, release={"x:m1": 0.05}, duration=16.0, rate=60.0).with_noise(50.0, seed=1)
    curve = lw.backbone(SPRING, 1, to_amplitude={"x:m1": 0.06}).beside(record)
    measured = curve.measured
    assert measured is not None and np.ptp(measured.hz) > 0.02
    expected = np.interp(measured.amplitude[:, 0], curve.amplitude[:, 0], curve.hz)
    assert measured.hz == pytest.approx(expected, rel=0.01)
    assert set(curve.to_dict()["measured"][0]) == {"hz", "amplitude"}


def test_records_that_show_no_points_are_refused(sweep: lw.Record, tmp_path: Path) -> None:
    lw.write_structure(SPRING, tmp_path / "spring.toml")
    lw.write_record(sweep, tmp_path / "sweep.csv")
    lw.write_record(sweep.select(["a:m1"]), tmp_path / "alone.csv")
    lw.write_record(sweep.select(["force:m1"]), tmp_path / "force.csv")
    lw.write_record(sweep[:200], tmp_path / "short.csv")
    line = f"respond {tmp_path}/spring.toml --force m1=1 --from 2.2 --to 2.4 --starts 0 --record {tmp_path}"
    assert len(document(f"{line}/sweep.csv")["measured"]) > 10
    assert "need the excitation, force:m1" in refusal(f"{line}/alone.csv")
    assert "none of x:m1 was measured" in refusal(f"{line}/force.csv")
    assert "no 8 steady cycles in a row" in refusal(f"{line}/short.csv")
    mode = f"backbone {tmp_path}/spring.toml --mode 1 --to-energy 0.01 --levels {tmp_path}"
    assert "no mode rings down" in refusal(f"{mode}/sweep.csv")
