"""Free runs side by side against the integrator, and the search for starts by them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from present import some
from structures import host, link, structure

import linkwise as lw
from linkwise.likelihood.starts import free_runs
from linkwise.likelihood.starts.free_run_search import free_run_starts
from linkwise.likelihood.starts.free_runs import FreeRuns
from linkwise.likelihood.starts.memory import Valley
from linkwise.progress import ProgressReport, silent

SHAPES = {"tip": (1.0, -1.0), "joint": (0.6, 0.4)}
RATE = {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"}
TRUE = {"k": 60.0, "k3": 1e6, "c": 0.05, "F": 0.3, "s": 0.6, "x0": 2e-3}


def wing(frequency: float | lw.Coefficient = 4.0) -> lw.Structure:
    payload = link("payload", "store-wing.joint", "k*d + k3*d**3 + c*v + F*z", RATE, **TRUE)
    modes = host("wing", (frequency, 13.0), 0.01, SHAPES)
    return structure({"store": 0.05}, payload, hosts=[modes])


@cache
def shaken(level: float, seed: int = 5431) -> lw.Record:
    """From rest by a force of eight frequencies."""
    rng = np.random.default_rng(seed)
    tones = zip(rng.uniform(2.0, 15.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8), strict=True)
    force = " + ".join(f"{level}*sin({2.0 * np.pi * frequency}*t + {phase})" for frequency, phase in tones)
    return lw.simulate(
        wing(),
        forces={"wing.tip": force},
        duration=4.0,
        rate=200.0,
        sensors=["a:wing.tip", "v:wing.joint", "x:store"],
    )


def values_of(subject: lw.Structure, **others: float) -> np.ndarray:
    truth = {f"payload.{name}": value for name, value in TRUE.items()}
    return np.array([({**truth, **others})[p.name] for p in subject.parameters])


def test_runs_come_to_those_of_the_integrator_with_the_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown, errors = wing().unknown("payload"), []
    for steps in (12, 48):
        monkeypatch.setattr(free_runs, "_PER_PERIOD", steps)
        runs = FreeRuns.of([shaken(0.3)], unknown, values_of(unknown))
        errors.append(float(np.linalg.norm(runs.differences(values_of(unknown)[None]))))
    assert errors[0] < 0.05
    assert errors[1] < errors[0] / 4.0**1.5  # 16 without rounding of steps to parts of a sample


def test_runs_side_by_side_are_those_one_by_one() -> None:
    unknown = wing().unknown("payload")
    runs = FreeRuns.of([shaken(0.1), shaken(0.3)], unknown, values_of(unknown))
    values = values_of(unknown) * np.array([[1.0], [0.5]])
    both = runs.differences(values)
    assert both.shape == (2, 2 * len(shaken(0.1)) * 3)
    assert both[0] == pytest.approx(runs.differences(values[:1])[0], rel=1e-9, abs=1e-12)
    assert np.linalg.norm(both[1]) > 2.0 * np.linalg.norm(both[0])


def test_what_moves_freely_from_the_start_is_left_out() -> None:
    linear = structure({}, hosts=[host("wing", (lw.Coefficient.unknown(4.0, sigma=0.1), 13.0), 0.01, SHAPES)])
    released = lw.simulate(
        linear.with_values({"wing.mode1.frequency": 4.0}),
        forces={"wing.tip": "0.5*sin(20*t)"},
        release={"v:wing.mode1": 0.1},
        duration=4.0,
        rate=200.0,
        sensors=["a:wing.tip", "a:wing.joint"],
    )
    runs = FreeRuns.of([released], linear, np.array([4.0]))
    assert np.linalg.norm(runs.differences(np.array([[4.0]]))) < 0.02  # of the second order in steps
    assert np.linalg.norm(runs.differences(np.array([[4.4]]))) > 0.2


def test_values_with_which_a_run_leaves_the_numbers_are_the_worst() -> None:
    unknown = wing().unknown("payload")
    runs = FreeRuns.of([shaken(0.3)], unknown, values_of(unknown))
    values = np.stack([values_of(unknown), values_of(unknown, **{"payload.k": -1e9})])
    good, gone = np.linalg.norm(runs.differences(values), axis=1)
    assert np.isfinite(gone)
    assert gone > 100.0 * good


def test_starts_far_from_the_truth_come_near_to_it() -> None:
    """The frequency is 2 % off and known to within that; slip and stiffness are off by factors."""
    asked = wing(lw.Coefficient.unknown(4.08, sigma=0.08)).unknown("payload")
    start = values_of(asked, **{"wing.mode1.frequency": 4.08}) * np.where(
        [p.name.startswith("payload") for p in asked.parameters], [1.5, 0.5, 3.0, 0.6, 1.2, 0.5, 1.0], 1.0
    )
    reports: list[ProgressReport] = []
    records = [shaken(0.3).with_noise(40.0, seed=2)]
    best, *_ = free_run_starts(records, asked, {}, [Valley(start, 0.3)], reports.append)
    values = dict(zip((p.name for p in asked.parameters), best.values, strict=True))
    true = values_of(asked, **{"wing.mode1.frequency": 4.0})
    truth = FreeRuns.of(records, asked, true).differences(true[None])
    assert best.misfit < np.sum(truth**2)  # by the steps of runs, and noise
    assert values["wing.mode1.frequency"] == pytest.approx(4.0, abs=0.02)
    for name in some(["F", "x0"]):
        assert values[f"payload.{name}"] == pytest.approx(
            TRUE[name], rel=0.25
        )  # a search from there converges
    assert "free runs leave" in reports[-1].activity


def test_records_without_forces_have_no_free_runs() -> None:
    unknown = wing().unknown("payload")
    decay = shaken(0.1).select(["a:wing.tip", "v:wing.joint", "x:store"])
    start = [Valley(values_of(unknown), 0.3)]
    assert free_run_starts([decay], unknown, {}, start, silent) == ()
    slower = lw.Record(0.0, 100.0, shaken(0.1).channels, shaken(0.1).values)
    assert free_run_starts([shaken(0.1), slower], unknown, {}, start, silent) == ()


def test_states_of_a_run_are_those_of_the_motion() -> None:
    unknown, record = wing().unknown("payload"), shaken(0.3)
    runs = FreeRuns.of([record], unknown, values_of(unknown))
    [states] = runs.states(values_of(unknown))
    assert states.shape == (2 * unknown.size + 1, len(record))
    shown = record.channel("x:store")
    assert np.std(states[unknown.mass_names.index("store")] - shown) < 0.05 * np.std(shown)
    assert 0.5 < np.abs(states[-1]).max() < 1.1  # it slips
