"""Records joined by time and in parts, delays taken out, the grids of times that they lie on, and periods averaged."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from record_faults import changed, without
from structures import oscillator

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.records.timeline import COARSEST, JITTER, LONGEST, Timeline

TIME = np.arange(400) / 200.0


def tone(late: float = 0.0, time: np.ndarray = TIME) -> np.ndarray:
    return np.sin(40.0 * (time - late)) + 0.3 * np.cos(110.0 * (time - late))


@pytest.fixture
def record() -> lw.Record:
    return BOTH


def test_channels_of_both_up_to_the_end_of_the_shorter(record: lw.Record) -> None:
    first = replace(record.select(["x:m1"]), noise={"x:m1": 1e-3}, notes=("One.", "Both."))
    second = replace(record.select(["a:base"])[:300], noise={"a:base": 2e-3}, notes=("Both.", "Other."))
    joined = lw.records.beside(first, second)
    assert joined.channels == ("x:m1", "a:base")
    assert (joined.values == record.values[:300]).all()
    assert dict(joined.noise) == {"x:m1": 1e-3, "a:base": 2e-3}
    assert joined.notes == ("One.", "Both.", "Other.")


@pytest.mark.parametrize(
    ("start", "noted"), [(0.0, False), (0.005, False), (0.2, True), (-0.2, True), (3e6, False)]
)
def test_times_that_were_not_used_are_noted(record: lw.Record, start: float, noted: bool) -> None:
    """A common clock tells when instruments were started; counters and an offset of a sample do not."""
    other = replace(record.select(["a:base"]), start=start)
    joined = lw.records.beside(record.select(["x:m1"]), other)
    assert any("not by these times" in note for note in joined.notes) == noted
    said = f"a:base: by the times of both records they start 0.2 s {'later' if start > 0 else 'earlier'}"
    assert not noted or said in joined.notes[-1]


@pytest.mark.parametrize("late", [0.0123, -0.0123])
def test_a_delay_is_taken_out(record: lw.Record, late: float) -> None:
    """To the pass band of the interpolating sinc, away from the ends that it continues: 1e-4."""
    shown = replace(record, values=np.stack([tone(), tone(late)], axis=1))
    shifted = lw.records.without_delays(shown, {"a:base": late})
    assert len(shifted) == len(record) - 3  # 2.46 samples
    assert shifted.start == pytest.approx(0.0 if late > 0 else 3 / 200.0, abs=1e-12)
    middle = slice(40, -40)
    assert shifted.channel("a:base")[middle] == pytest.approx(shifted.channel("x:m1")[middle], abs=1e-4)
    assert shifted.notes == (
        f"Delays were taken out: {late:g} s in a:base. One that is found with the laws is what is left beside it.",
    )


def test_records_of_one_clock_are_joined_by_time() -> None:
    """The other instrument began later, between two samples, at three times the rate."""
    motions = tone(time=np.arange(800) / 200.0), tone(time=0.7321 + np.arange(1500) / 600.0)
    first = lw.Record(0.0, 200.0, ("x:m1",), motions[0][:, None], notes=("One.",))
    second = lw.Record(0.7321, 600.0, ("a:base",), motions[1][:, None], noise={"a:base": 3e-3})
    joined = lw.records.joined_by_time(first, second)
    assert joined.rate == 200.0 and joined.channels == ("x:m1", "a:base")
    middle = slice(40, -40)
    # to the pass band of the interpolating sinc
    assert joined.channel("a:base")[middle] == pytest.approx(joined.channel("x:m1")[middle], abs=2e-4)
    # the root of the factor, as white noise shrinks
    assert joined.noise["a:base"] == pytest.approx(3e-3 / np.sqrt(3.0), rel=1e-3)
    again = lw.records.joined_by_time(second, first)
    assert again.rate == 200.0 and abs(len(again) - len(joined)) <= 1
    assert "a:base were joined by time." in joined.notes


def test_samples_at_the_same_times_stay(record: lw.Record) -> None:
    joined = lw.records.joined_by_time(record.select(["x:m1"])[:300], record.select(["a:base"])[100:])
    assert joined.start == 0.5 and (joined.values == record.values[100:300]).all()
    assert lw.records.without_delays(record, {}) is record


def test_parts_of_a_record_are_joined(record: lw.Record) -> None:
    second = replace(record[150:].select(["a:base", "x:m1"]), source="part2.csv")
    joined = lw.records.continued(record[:100], second)
    assert joined.channels == record.channels and len(joined) == 400
    assert (joined.values[:100] == record.values[:100]).all() and joined.missing[100:150].all()
    assert (joined.values[150:] == record.values[150:]).all()
    assert joined.notes[-1] == "The record continues in part2.csv, after a gap of 50 samples."
    assert not lw.records.continued(record[:100], record[100:]).missing.any()


def test_a_part_whose_clock_begins_anew_follows_with_a_note(record: lw.Record) -> None:
    parts = [
        replace(record[first : first + 100], start=0.0, source=f"part{first}.csv") for first in (0, 100, 200)
    ]
    joined = lw.records.continued(lw.records.continued(parts[0], parts[1]), parts[2])
    assert np.array_equal(joined.values, record.values[:300]) and joined.start == 0.0
    assert (
        "part100.csv, whose clock begins anew at 0 s: its first sample was taken to follow"
        in joined.notes[-2]
    )
    with pytest.raises(lw.RecordError, match="overlaps in time"):  # a file that is given twice
        lw.records.continued(parts[0], parts[0])


def test_parts_that_state_different_noise_are_refused(record: lw.Record) -> None:
    first, second = (replace(part, noise={"x:m1": 1e-4}) for part in (record[:100], record[100:]))
    assert lw.records.continued(first, second).noise == {"x:m1": 1e-4}
    assert lw.records.continued(first, replace(second, noise={})).noise == {"x:m1": 1e-4}
    later = replace(second, interpolation={"a:base": "linear"})
    # the second part alone states it
    assert lw.records.continued(first, later).interpolation == {"a:base": "linear"}
    message = "channel x:m1: states another noise of its sensor than the first"
    with pytest.raises(lw.RecordError, match=message):
        lw.records.continued(first, replace(second, noise={"x:m1": 2e-4}))
    known = [{"x:m1": lw.records.SensorUncertainty(gain=size)} for size in (0.01, 0.02)]
    parts = [replace(part, uncertainty=own) for part, own in zip((first, second), known, strict=True)]
    with pytest.raises(lw.RecordError, match="channel x:m1: states another uncertainty of its sensor"):
        lw.records.continued(*parts)


BOTH = lw.Record(0.0, 200.0, ("x:m1", "a:base"), np.stack([tone(), tone(0.0123)], axis=1))
X, BASE, EARLY, LATER = BOTH.select(["x:m1"]), BOTH.select(["a:base"]), BOTH[:100], BOTH[100:]
beside, joined_by_time, continued = lw.records.beside, lw.records.joined_by_time, lw.records.continued
REFUSED: list[tuple[Callable[..., lw.Record], lw.Record, lw.Record | dict[str, float], str]] = [
    (beside, X, replace(BASE, rate=201.0), "need one sampling rate, got 200 and 201 Hz"),
    (beside, X, BOTH, r"x:m1.*is in both records"),
    (joined_by_time, X, replace(BASE, start=7.0), r"does not overlap in time .*: 0 to 1\.995 s and 7 to 8\.995 s"),
    (joined_by_time, X, replace(BASE, rate=333.0), "of which one is a multiple of the other, got 200 and 333 Hz"),
    (joined_by_time, X, BOTH, r"x:m1.*is in both records"),
    (continued, EARLY, BOTH[50:], r"overlaps in time: 0 to 0\.495 s and 0\.25 to 1\.995 s"),
    (continued, EARLY, replace(LATER, start=0.5025), r"goes on 0\.0025 s after 0 to 0\.495 s, which is not a whole number of"),
    (continued, EARLY, replace(LATER, start=1000.5), r"begins 1000 s after .* a gap longer than both parts"),
    (continued, EARLY, LATER.select(["x:m1"]), "parts of a record need the same channels: x:m1, a:base and x:m1"),
    (continued, EARLY, replace(LATER, rate=250.0), "the parts of a record need one sampling rate, got 200 and 250 Hz"),
    (lw.records.without_delays, BOTH, {"x:m9": 0.1}, r"x:m9.*is not in the record"),
    (lw.records.without_delays, BOTH, {"x:m1": 3.0}, r"must be shorter than the record of 1\.995 s, got 3 s"),
    (lw.records.without_delays, BOTH, {"x:m1": 1.5, "a:base": -1.5}, "the delays leave no sample"),
    (lw.records.without_delays, without(BOTH, x_m1=5), {"x:m1": 0.1}, r"x:m1.*samples are missing"),
]  # fmt: skip


@pytest.mark.parametrize(("work", "first", "second", "message"), REFUSED)
def test_what_cannot_be_joined_or_taken_out_is_refused(
    work: Callable[..., lw.Record], first: lw.Record, second: lw.Record | dict[str, float], message: str
) -> None:
    with pytest.raises(lw.RecordError, match=message):
        work(first, second)


RATES = [1000.0, 610.3515625, 333.3, 100.0 * np.pi, 44100.0, 51200.0, 1.0 / 0.0016384, 123.456789012345, 1e6]


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("start", [0.0, 1.234, -3.3, math.e])
def test_a_grid_in_full_precision_comes_back_to_the_bit(rate: float, start: float) -> None:
    time = start + np.arange(3000) / rate
    timeline = Timeline.fit(time)
    assert np.array_equal(timeline.start + np.arange(timeline.count) / timeline.rate, time)
    assert timeline.rate == rate
    assert timeline.notes == ()


@pytest.mark.parametrize(
    ("rate", "digits"), [(48000.0, 6), (51200.0, 7), (1024.0, 4), (1000.0, 3), (256.0, 3), (300.0, 4)]
)
def test_a_rounded_time_gives_the_rate_that_was_meant(rate: float, digits: int) -> None:
    time = np.round(7.0 + np.arange(20_000) / rate, digits)
    timeline = Timeline.fit(time)
    assert timeline.rate == rate
    assert timeline.count == 20_000


def test_times_of_significant_digits_whose_start_was_set_to_zero_are_even() -> None:
    printed = np.array([float(f"{time:.7g}") for time in 0.1299873 + np.arange(15_000) / 5120.0])
    timeline = Timeline.fit(np.round(printed - printed[0], 9))
    assert timeline.rate == 5120.0
    assert timeline.count == 15_000


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
    with pytest.raises(lw.RecordError, match=message):
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
    with pytest.raises(lw.RecordError, match=message):
        Timeline.fit(time)


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
