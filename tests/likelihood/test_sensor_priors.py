"""Errors of sensors that are known to within: priors in the likelihood, of `identify`, `discover` and `validate`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw

CHAIN = lw.bnes_chain(2)
UNKNOWN = CHAIN.unknown("nes")


def noisy() -> lw.Record:
    return chain_record(2, duration=2.0).with_noise(30.0, seed=1)


def stating(record: lw.Record, **known: float) -> lw.Record:
    return replace(record, uncertainty={"x:m2": lw.records.SensorUncertainty(**known)})


def sensor_error(fit: lw.Estimate, phrase: str) -> tuple[float, float]:
    """Value and standard error of what the findings tell of x:m2."""
    [match] = [
        hit
        for text in fit.findings
        if (hit := re.match(rf"x:m2 {phrase} (\S+) .*error (\S+?)( ms)?\)", text))
    ]
    return float(match[1]), float(match[2])


@pytest.mark.parametrize(
    ("kind", "phrase", "unit"), [("offset", "is off by", 1.0), ("delay", "is late by", 1e3)]
)
def test_a_prior_adds_its_precision(kind: str, phrase: str, unit: float) -> None:
    free = sensor_error(lw.identify(stating(noisy(), **{kind: np.inf}), UNKNOWN), phrase)[1] / unit
    value, error = sensor_error(lw.identify(stating(noisy(), **{kind: free}), UNKNOWN), phrase)
    # as precise as the record: half the variance; both are told to two digits
    assert error / unit == pytest.approx(free / np.sqrt(2.0), rel=0.08)
    # four standard errors: 6e-5 of chance each
    assert abs(value) < 4.0 * error


def test_a_stated_gain_is_a_calibration() -> None:
    stated = lw.identify(stating(noisy(), gain=0.01), UNKNOWN)
    by_option = lw.identify(noisy(), UNKNOWN, calibration={"x:m2": 0.01})
    assert stated.coefficient("nes1.beta").standard_error == by_option.coefficient("nes1.beta").standard_error
    # what is asked for goes before what the record states
    narrow = lw.identify(stating(noisy(), gain=0.2), UNKNOWN, calibration={"all": 0.05, "x:m2": 0.01})
    both = lw.identify(noisy(), UNKNOWN, calibration={"all": 0.05, "x:m2": 0.01})
    assert narrow.coefficient("nes1.beta").value == both.coefficient("nes1.beta").value


def late() -> lw.Record:
    """The second laser is three samples of 1 ms late."""
    record = noisy()
    values = record.values.copy()
    values[3:, 1] = values[:-3, 1]
    return replace(record, values=values, simulated=None)[3:]


def test_a_prior_of_a_delay_is_of_the_whole_delay() -> None:
    value, error = sensor_error(lw.identify(stating(late(), delay=2e-3), UNKNOWN), "is late by")
    # the prior, 300 times as wide as the error, moves it by 1e-5 of 3 ms; the record says it to 0.0064 ms
    assert value == pytest.approx(3.0, abs=4.0 * error)
    wrong = lw.identify(stating(late(), delay=1e-4), UNKNOWN)
    assert not wrong.trusted
    assert wrong.diagnosis[0].kind == "prior" and wrong.diagnosis[0].where == "delay of x:m2"
    # four standard errors of the delay, 6e-5 of chance
    assert wrong.diagnosis[0].unit == "s" and wrong.diagnosis[0].size == pytest.approx(3e-3, abs=4e-3 * error)


def test_an_offset_beyond_its_prior_takes_trust_away() -> None:
    off = replace(noisy(), values=noisy().values + np.array([0.0, 1e-3]), simulated=None)
    wrong = lw.identify(stating(off, offset=1e-4), UNKNOWN)
    assert not wrong.trusted and "offset of x:m2 0.000999 m above the value that is stated" in wrong.message
    assert lw.identify(stating(off, offset=1e-3), UNKNOWN).trusted


def test_records_that_state_different_errors_are_refused() -> None:
    second = chain_record(2, duration=2.0).with_noise(30.0, seed=2)
    with pytest.raises(
        lw.IdentificationError,
        match=r"state different errors of x:m2: its offset is known to 0\.0001 m, and its offset is known to 0\.001 m; state",
    ):
        lw.identify([stating(noisy(), offset=1e-4), stating(second, offset=1e-3)], UNKNOWN)


def test_other_methods_say_that_they_do_not_count_it() -> None:
    fit = lw.identify(stating(noisy(), gain=0.01), UNKNOWN, method="weak")
    assert (
        'What is stated of the errors of x:m2 is not counted: method "ml" alone counts errors of sensors.'
        in fit.findings
    )


def test_a_discovery_counts_what_records_state() -> None:
    masses: Mapping[str, float] = {"m1": 1.0, "m2": 0.01}
    record = chain_record(2, duration=2.0).with_noise(40.0, seed=1)
    stated = lw.discover(stating(record, gain=0.01), masses)
    by_option = lw.discover(record, masses, calibration={"x:m2": 0.01})
    assert stated.estimate.values == pytest.approx(by_option.estimate.values, rel=1e-8)
    assert any(finding.startswith("x:m2 shows") for finding in stated.estimate.findings)


def test_a_validation_allows_for_stated_errors() -> None:
    record = noisy()
    wrong = replace(record, values=record.values * [1.0, 1.03], simulated=None)
    assert not lw.validate(wrong, CHAIN).trusted
    assert lw.validate(stating(wrong, gain=0.03), CHAIN).trusted
    unknown = lw.validate(stating(record, offset=np.inf), CHAIN)
    assert "Errors taken as zero, though stated as unknown: offset of x:m2." in unknown.remarks
