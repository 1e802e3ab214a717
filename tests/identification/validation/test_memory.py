"""Validation of links with memory between masses: by the truth, by wrong laws, and in windows of chaotic motion."""

from typing import Any

import numpy as np
import pytest
from present import some
from record_faults import without
from structures import harvester, link, named, structure

import linkwise as lw

pytestmark = pytest.mark.slow


HYSTERETIC = {"k": 400.0, "c": 0.6, "F": 8.0, "x0": 0.012, "s": 0.6}
# Hz: twenty samples a period of the faster tone, where errors are not compared with those expected
RATE = 200.0
HARVESTER = {"alpha": -50.0, "beta": 5e6, "c": 0.05, "theta": 1e-3, "R": 1e5, "C": 43e-9}


def joint(**changes: float) -> lw.Structure:
    """Two masses, the second of them on a hysteretic joint."""
    spring = link("spring", "m1-ground", "k*d + c*v", k=3000.0, c=1.0)
    second = named("joint", "m2-m1", "bouc-wen", **(HYSTERETIC | changes))
    return structure({"m1": 1.0, "m2": 0.4}, spring, second)


def bistable(**changes: float) -> lw.Structure:
    """A bistable mass with a piezo on a moving base."""
    return harvester(0.05, **(HARVESTER | changes))


def shaken(
    structure: lw.Structure,
    seed: int,
    sensors: tuple[str, ...] = ("x", "f:joint"),
    *,
    rate: float = RATE,
    snr_db: float = 40.0,
) -> lw.Record:
    """The joint under two tones, from 0.6 s on, so that its state at the start is not zero."""
    force = {"m1": "12*sin(31*t) + 7*cos(59*t)"}
    record = lw.simulate(structure, forces=force, duration=3.6, rate=rate, sensors=sensors)
    return record.with_noise(snr_db, seed=seed)[round(0.6 * rate) :]


def in_wells(
    structure: lw.Structure, duration: float, base: str, seed: int, *, rate: float = RATE
) -> lw.Record:
    sampling: dict[str, Any] = {"duration": duration, "rate": rate, "sensors": ("x", "state")}
    record = lw.simulate(structure, release={"x:m1": 0.003}, base=base, **sampling)
    return record.with_noise(30.0, seed=seed)


@pytest.mark.parametrize("sensors", [("a:m1", "x:m2"), ("x", "f:joint", "state:joint.z")])
def test_the_truth_leaves_the_noise(sensors: tuple[str, ...]) -> None:
    record, clean = (shaken(joint(), 5, sensors, rate=400.0, snr_db=snr) for snr in (40.0, 300.0))
    validation = lw.validate(record, joint())
    assert validation.free_run and validation.trusted
    assert set(validation.channels) == set(record.responses)
    for name, score in some(validation.channels.items()):
        noise = np.std(record.channel(name) - clean.channel(name))
        # of about 1140 samples, to 4 standard deviations of 1/sqrt(2 N), and what the state at the start leaves
        assert score.rmse == pytest.approx(noise, rel=4 / np.sqrt(2 * score.samples) + 0.02)
        assert score.one_step_rmse == pytest.approx(score.one_step_expected, rel=0.1)


def test_a_long_gap_does_not_pass_for_quiet() -> None:
    """The noise of a channel whose sensor was off for half the record was estimated 1000 times too small."""
    record = shaken(joint(), 24, ("x",))
    validation = lw.validate(without(record, x_m1=slice(300)), joint())
    assert validation.trusted


@pytest.mark.parametrize("changes", [{"F": 8.4}, {"x0": 0.013}])
def test_a_wrong_law_of_the_state_disagrees(changes: dict[str, float]) -> None:
    validation = lw.validate(shaken(joint(**changes), 6), joint())
    assert not validation.trusted and not validation.channels["f:joint"].agrees


def test_an_answer_predicts_the_voltage_of_another_record() -> None:
    """In its own unit, and each coefficient estimated again from the other record."""
    record = in_wells(bistable(), 12.0, "0.003*sin(18*t)", 7)
    unknown = bistable().unknown("piezo.alpha", "piezo.beta", "piezo.c", "piezo.theta")
    answer = lw.identify(record[:1200], unknown)
    assert answer.trusted and answer.noise["state:piezo.V"].unit == "V"
    validation = lw.validate(record[1200:], answer, refit=True)
    assert validation.trusted and validation.channels["state:piezo.V"].unit == "V"
    assert [coefficient.agrees for coefficient in validation.coefficients] == [True] * 4
    weaker = lw.validate(record[1200:], bistable(theta=0.9e-3))
    assert not weaker.trusted and not weaker.channels["state:piezo.V"].agrees
    assert any("V; noise and intervals allow" in finding for finding in weaker.findings)
