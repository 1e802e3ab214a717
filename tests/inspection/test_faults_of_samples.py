"""Each check of single channels with its fault and without, on chains and on an oscillator under force."""

from __future__ import annotations

import numpy as np
import pytest
from record_faults import RECORDS, Fault, faulty, kinds

import linkwise as lw

CHANNEL = "x:m1"


def clip(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    peak = np.abs(values).max()
    return np.asarray(np.clip(values, -0.8 * peak, 0.8 * peak))


def repeat_one(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    at = len(values) // 4
    return np.concatenate([values[: at + 1], values[at:-1]])


def hold(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    return np.repeat(values[::2], 2)[: len(values)]


def lose(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    values[300:305] = np.nan
    return values


def round_coarsely(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    step = 0.4 * np.std(values)
    return np.asarray(np.rint(values / step) * step)


FAULTS: dict[str, Fault] = {
    "clipped": clip,
    "doubled": repeat_one,
    "dropped": lose,
    "quantised": round_coarsely,
    "dead": lambda values, record, rng: np.full_like(values, 1e-3),
    "unit": lambda values, record, rng: 1e6 * values,
}


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("name", RECORDS)
def test_a_fault_is_told_and_nothing_else(kind: str, name: str) -> None:
    record = RECORDS[name]()
    assert kinds(record) == set()
    alerts = kinds(faulty(record, CHANNEL, FAULTS[kind]), CHANNEL)
    assert kind in alerts


def test_held_samples_are_told_as_doubled() -> None:
    for make in RECORDS.values():
        assert "doubled" in kinds(faulty(make(), CHANNEL, hold), CHANNEL)
