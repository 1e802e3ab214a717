"""Samples that a logger lost or repeated are told before the gains that they resemble."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw

LOST, AT = 15, 900


@pytest.mark.parametrize(
    ("fault", "words"), [("lost", "jumps between two samples at"), ("repeated", "repeat")]
)
def test_lost_and_repeated_samples_come_before_gains(fault: str, words: str) -> None:
    """The diagnosis stays as it is; a record without the fault says nothing of the kind."""
    chain = lw.bnes_chain(2)
    clean = lw.simulate(chain, release={"v:m1": 1.0}, duration=3.0, rate=1000.0)
    record = replace(clean.with_noise(40.0, seed=5_001_302), simulated=None)
    values = record.values.copy()
    if fault == "lost":
        values = np.delete(values, slice(AT, AT + LOST), axis=0)
    else:
        values = np.insert(values, [AT] * LOST, values[AT], axis=0)
    faulty = lw.Record(record.start, record.rate, record.channels, values)
    asked = chain.unknown("nes")
    fit = lw.identify(faulty, asked)
    assert not fit.trusted and fit.diagnosis
    assert fit.message.startswith("The record shows by itself") and words in fit.message
    assert "shows by itself" not in lw.identify(record, asked).message
