"""Averages over the periods of a test."""

from dataclasses import replace

import numpy as np
import pytest
from record_faults import changed, without
from structures import oscillator

import linkwise as lw

RATE, PERIOD, COUNT = 200.0, 2.0, 8
SIZE = round(PERIOD * RATE)
T = np.arange(COUNT * SIZE) / RATE


def repeated(sigma: float = 0.0, seed: int = 1) -> lw.Record:
    """A response and a force with the period, eight times, and white noise on the response."""
    x = np.sin(2.0 * np.pi * 3.0 / PERIOD * T) + 0.4 * np.cos(2.0 * np.pi * 11.0 / PERIOD * T)
    force = np.cos(2.0 * np.pi * 5.0 / PERIOD * T)
    noise = sigma * np.random.default_rng(seed).standard_normal(len(T))
    return lw.Record(0.0, RATE, ("x:m1", "force:m1"), np.stack([x + noise, force], axis=1))


def test_noise_follows_from_the_scatter() -> None:
    averaged = lw.records.average_periods(repeated(0.1), PERIOD)
    assert len(averaged) == SIZE and averaged.start == pytest.approx((COUNT - 1) * PERIOD, rel=1e-12)
    # a variance from (COUNT - 1) SIZE squares; four of its standard deviations
    part = 4.0 / np.sqrt(2.0 * (COUNT - 1) * SIZE)
    assert averaged.noise["x:m1"] == pytest.approx(0.1 / np.sqrt(COUNT), rel=part)
    left = averaged.channel("x:m1") - repeated().channel("x:m1")[:SIZE]
    assert np.std(left) == pytest.approx(averaged.noise["x:m1"], rel=4.0 / np.sqrt(2.0 * SIZE))
    assert "force:m1" not in averaged.noise and "Averaged over 8 periods of 2 s" in averaged.notes[-1]
    # stated noise is that of a sample
    averaged = lw.records.average_periods(replace(repeated(0.1), noise={"x:m1": 0.08}), PERIOD)
    assert averaged.noise["x:m1"] == pytest.approx(0.08 / np.sqrt(COUNT), rel=1e-12)


def test_periods_that_have_not_settled_are_left_out() -> None:
    record = repeated(0.01)
    ringing = 0.5 * np.exp(-T / 0.7)  # 3 % of that are left after one period, 0.2 % after two
    averaged = lw.records.average_periods(changed(record, x_m1=lambda x: x + ringing), PERIOD)
    assert "Averaged over 6 periods of 2 s" in averaged.notes[-1]
    assert "the first 2 were left out, in which the motion had not settled" in averaged.notes[-1]


def test_a_missing_sample_is_averaged_over_the_other_periods() -> None:
    record = repeated(0.01)
    lacking = without(record, x_m1=[5, *range(SIZE - 1, len(record), SIZE)])
    averaged = lw.records.average_periods(lacking, PERIOD)
    assert averaged.missing.sum() == 1 and averaged.missing[-1, 0]


def test_motion_that_does_not_repeat_is_told() -> None:
    record = repeated(0.01)
    other = 0.1 * np.sin(2.0 * np.pi * 3.3 / PERIOD * T)  # the force repeats, the motion does not
    averaged = lw.records.average_periods(changed(record, x_m1=lambda x: x + other), PERIOD)
    assert "x:m1: the last two periods differ by more than white noise" in averaged.notes[-1]
    assert not any("differ" in note for note in lw.records.average_periods(record, PERIOD).notes)


@pytest.mark.parametrize(
    ("period", "said"),
    [
        (0.0, "period must be positive, got 0.0 s"),
        (2.003, "is 400.600000 samples at 200 Hz, not a whole number"),
        (1.7, "force:m1: does not repeat after 1.7 s: its last two periods differ by"),
        (9.0, "is 1800 samples, and the record has 3200: two periods are needed"),
        (0.1, "has 20 samples at 200 Hz; 32 are needed"),
    ],
)
def test_what_is_no_period_is_refused(period: float, said: str) -> None:
    with pytest.raises(lw.RecordError) as caught:
        lw.records.average_periods(repeated(0.01), period)
    assert said in str(caught.value)


@pytest.mark.slow
def test_an_average_is_identified_as_all_periods_are() -> None:
    hardening = oscillator("k*d + k3*d**3 + c*v", name="spring", k=900.0, k3=2e5, c=3.0)
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 24)
    lines = (f"0.9*sin({2.0 * np.pi * k / 4.0!r}*t + {p!r})" for k, p in enumerate(phases.tolist(), start=4))
    clean = lw.simulate(hardening, forces={"m1": " + ".join(lines)}, duration=40.0 - 1.0 / RATE, rate=RATE)
    record = clean.with_noise(20.0, seed=2).between(8.0, 40.0)
    whole = lw.identify(record, hardening.unknown("all"))
    of_average = lw.identify(lw.records.average_periods(record, 4.0), hardening.unknown("all"))
    for name, true in (("k", 900.0), ("k3", 2e5), ("c", 3.0)):
        averaged, every = (fit.coefficient(f"spring.{name}") for fit in (of_average, whole))
        assert averaged.standard_error is not None and every.standard_error is not None
        # the free start of each segment costs a little more of one period than of eight
        assert every.standard_error < averaged.standard_error < 1.5 * every.standard_error
        # four standard errors: 6e-5 of chance each
        assert abs(averaged.value - true) < 4.0 * averaged.standard_error
