"""What is wrong with a channel by itself stands in every answer that rests on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from record_faults import chain, faulty

import linkwise as lw

CLIPPED = 0.6  # of the peak
MASSES = {"m1": 1.0, "m2": 0.01}
ANSWERS: dict[str, Callable[[lw.Record], lw.Estimate | lw.Discovery | lw.Validation]] = {
    "identify, ml": lambda record: lw.identify(record, lw.bnes_chain(2).unknown("nes")),
    "identify, weak": lambda record: lw.identify(record, lw.bnes_chain(2).unknown("nes"), method="weak"),
    "discover": lambda record: lw.discover(record, MASSES),
    "validate": lambda record: lw.validate(record, lw.bnes_chain(2)),
}


def clean_record() -> lw.Record:
    """A second of the paper's chain."""
    return chain(2, 30.0)[:1000]


def clipped_record() -> lw.Record:
    def clip(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
        peak = CLIPPED * np.max(np.abs(values))
        return np.asarray(np.clip(values, -peak, peak))

    return faulty(clean_record(), "x:m2", clip)


@pytest.mark.usefixtures("memory_not_sought")
@pytest.mark.parametrize("name", ANSWERS)
def test_an_alert_stands_in_the_answer(name: str) -> None:
    answer = ANSWERS[name](clipped_record())
    content = answer.to_dict()
    assert [(alert["kind"], alert["channel"]) for alert in content["alerts"]] == [("clipped", "x:m2")]
    assert any(finding.startswith("clipped x:m2:") for finding in content["findings"])
    assert "! clipped x:m2:" in str(answer)


@pytest.mark.parametrize("name", ANSWERS)
def test_a_clean_record_has_none(name: str) -> None:
    assert ANSWERS[name](clean_record()).to_dict()["alerts"] == []


def test_alerts_of_all_records_are_told() -> None:
    clean, faults = clean_record(), replace(clipped_record(), source="second.csv")
    fit = lw.identify([clean, faults], lw.bnes_chain(2).unknown("nes"))
    assert [(alert.kind, alert.record) for alert in fit.alerts] == [("clipped", "second.csv")]
