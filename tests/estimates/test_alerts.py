"""What is wrong with a channel by itself stands in every answer that rests on it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from record_faults import chain, faulty, without

import linkwise as lw

pytestmark = pytest.mark.slow


CLIPPED = 0.6  # of the peak
MASSES = {"m1": 1.0, "m2": 0.01}
ANSWERS: dict[str, Callable[[lw.Record], lw.Estimate | lw.Discovery | lw.Validation]] = {
    "identify, ml": lambda record: lw.identify(record, lw.bnes_chain(2).unknown("nes"), as_stated=True),
    "identify, weak": lambda record: lw.identify(record, lw.bnes_chain(2).unknown("nes"), method="weak"),
    "discover": lambda record: lw.discover(record, MASSES),
    "validate": lambda record: lw.validate(record, lw.bnes_chain(2)),
}


def clean_record() -> lw.Record:
    """A second of the paper's chain."""
    return chain(2, 30.0)[:1000]


def alerts_of(answer: lw.Estimate) -> list[tuple[str, str]]:
    return [(alert.kind, alert.channel) for alert in answer.alerts]


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


@pytest.mark.parametrize("name", ["identify, weak", "validate"])
def test_a_clean_record_has_none(name: str) -> None:
    assert ANSWERS[name](clean_record()).to_dict()["alerts"] == []


def test_alerts_of_all_records_are_told() -> None:
    clean, faults = clean_record(), replace(clipped_record(), source="second.csv")
    fit = lw.identify([clean, faults], lw.bnes_chain(2).unknown("nes"), as_stated=True)
    assert [(alert.kind, alert.record) for alert in fit.alerts] == [("clipped", "second.csv")]


def test_what_the_answer_allows_for_is_no_alert() -> None:
    """Samples that were marked as missing, and a drift that is estimated; of another channel it is told."""
    marked = lw.inspection.mark_missing(clipped_record(), "clipped")
    assert [alert.kind for alert in lw.inspect(marked).alerts] == ["dropped"]
    told = {name: ANSWERS[name](marked).to_dict()["alerts"] for name in ("identify, weak", "validate")}
    assert not any(told.values())
    clean = chain(2, 30.0)
    drifting = replace(clean, values=clean.values + np.outer(clean.time, [0.0, 1e-3]), simulated=None)
    asked = lw.bnes_chain(2).unknown("nes")
    assert alerts_of(lw.identify(drifting, asked, drifts=["x:m1"], as_stated=True)) == [("drift", "x:m2")]
    assert alerts_of(lw.identify(drifting, asked, drifts=["x:m2"])) == []


def test_samples_that_a_record_lacks_are_told_also_beside_marked_ones() -> None:
    for record, missing in (
        (clean_record(), slice(300, 330)),
        (lw.inspection.mark_missing(clipped_record(), "clipped"), slice(600, 700)),
    ):
        fit = lw.identify(without(record, x_m2=missing), lw.bnes_chain(2).unknown("nes"), method="weak")
        assert alerts_of(fit) == [("dropped", "x:m2")]


def test_a_hum_is_allowed_for_where_all_of_its_lines_are_estimated() -> None:
    clean = chain(2, 30.0)
    lines = 1e-3 * np.sin(2.0 * np.pi * np.outer(clean.time, [50.0, 150.0])).sum(axis=1)
    humming = replace(clean, values=clean.values + np.outer(lines, [0.0, 1.0]), simulated=None)
    [alert] = lw.inspect(humming).alerts
    np.testing.assert_allclose(alert.frequencies, (50.0, 150.0), atol=0.02)
    asked = lw.bnes_chain(2).unknown("nes")
    both, beside = (
        lw.identify(humming, asked, hums={"x:m2": lines}, as_stated=True)
        for lines in ([50.0, 150.0], [50.3, 150.0])
    )
    assert both.alerts == ()
    assert [told.kind for told in beside.alerts] == ["hum"] and not beside.trusted
