"""The even grid behind a column of times: found to the last bit where it is there, refused where it is not."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, strategies

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.timeline import COARSEST, JITTER, LONGEST, Timeline

RATES = [1000.0, 610.3515625, 333.3, 100.0 * np.pi, 44100.0, 51200.0, 1.0 / 0.0016384, 123.456789012345, 1e6]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("start", [0.0, 1.234, -3.3, np.e])
def test_a_grid_in_full_precision_comes_back_to_the_bit(rate: float, start: float) -> None:
    time = start + np.arange(3000) / rate
    timeline = Timeline.fit(time)
    assert np.array_equal(timeline.start + np.arange(timeline.count) / timeline.rate, time)
    assert timeline.rate == rate
    assert timeline.notes == ()


@given(strategies.floats(0.1, 1e6), strategies.floats(-1e3, 1e3), strategies.integers(32, 3000))
def test_any_grid_comes_back(rate: float, start: float, count: int) -> None:
    time = start + np.arange(count) / rate
    timeline = Timeline.fit(time)
    again = timeline.start + np.arange(timeline.count) / timeline.rate
    # Where steps are no longer resolved against the start, the last bits are not determined.
    assert np.max(np.abs(again - time)) <= 4.0 * np.spacing(np.max(np.abs(time)))


@pytest.mark.parametrize(
    ("rate", "digits"), [(48000.0, 6), (51200.0, 7), (1024.0, 4), (1000.0, 3), (256.0, 3), (300.0, 4)]
)
def test_a_rounded_time_gives_the_rate_that_was_meant(rate: float, digits: int) -> None:
    time = np.round(7.0 + np.arange(20_000) / rate, digits)
    timeline = Timeline.fit(time)
    assert timeline.rate == rate
    assert timeline.count == 20_000


@pytest.mark.parametrize("rate", [160.46573, 106.11374, 245.97814, 83.72193])
@pytest.mark.parametrize("rounding", [np.round, np.floor])
def test_a_rounded_time_gives_an_odd_rate(rate: float, rounding: Callable[[Floats], Floats]) -> None:
    time = rounding((0.4 + np.arange(2000) / rate) * 1000.0) / 1000.0
    # rounding to 1e-3 s differs between samples: it leaves open some 1e-3 s over length times number of samples
    assert Timeline.fit(time).rate == pytest.approx(rate, rel=10.0 * 1e-3 * rate / 2000.0**2)


def test_times_of_single_precision_and_of_a_clock_that_jitters_within_bounds_are_even() -> None:
    time = (np.arange(20_000) / 1000.0).astype(np.float32)
    timeline = Timeline.fit(time)
    assert timeline.rate == 1000.0
    assert np.array_equal(timeline.index, np.arange(20_000))
    even = np.arange(2000) / 1000.0
    jitter = np.random.default_rng(5).uniform(-1e-3, 1e-3, 2000)
    # a line fitted to 2000 times that jitter by less than 1e-3 of a step is this even
    assert Timeline.fit(even + 0.9 * JITTER * jitter).rate == pytest.approx(1000.0, rel=1e-6)
    message = r"channel time: uneven time: a step of .* s where .* s was expected"
    with pytest.raises(RecordError, match=message):
        Timeline.fit(even + 30.0 * JITTER * jitter)


STEPS = 1e-3 * (1.0 + 1e-3 * np.linspace(0.0, 1.0, 5000))
ROW, AFTER = np.arange(100) / 100.0, np.arange(100) >= 50


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (np.cumsum(STEPS), r"off an even grid of .* s; resample it to an even rate"),  # steps that hardly differ
        (np.round(np.arange(500) / 610.3515625, 3), "uneven time: a step of"),  # printed too coarsely
        (ROW + (LONGEST + 1.0) * AFTER, r"a gap of 11.01 s in a record of 100 samples every 0.01 s; split the file"),
        (ROW + 0.004 * AFTER, r"uneven time: a step of 0.014 s where 0.01 s was expected.* \(sample 50\)"),
    ],
)  # fmt: skip
def test_what_is_no_even_grid_is_refused(time: Floats, message: str) -> None:
    assert COARSEST * 1.0 / 610.3515625 < 1e-3  # the rounding to 1e-3 s is beyond what is taken as even
    with pytest.raises(RecordError, match=message):
        Timeline.fit(time)


def test_gaps_keep_every_sample_at_its_place() -> None:
    index = np.delete(np.arange(5000), np.r_[100:103, 700, 4000:4400])
    timeline = Timeline.fit(np.round(index / 51200.0, 7))
    assert np.array_equal(timeline.index, index)
    assert timeline.rate == 51200.0
    assert timeline.notes[-1].startswith("Gaps in time: 3, the first after 0.0019336 s; 404 rows were added")
