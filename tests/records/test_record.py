"""Record: what it refuses, what it hands out, and that slicing, noise and decimation do what they say."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from present import present

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.records.timeline import ATTENUATION, PASSBAND

N = 400
RATE = 1000.0


@pytest.fixture
def wave() -> dict[str, Floats]:
    t = np.arange(N) / RATE
    motion = {"x:m1": np.sin(40.0 * t), "a:m2": np.cos(70.0 * t)}
    return {**motion, "force:m1": np.zeros(N), "x:base": np.sin(5.0 * t)}


@pytest.fixture
def record(wave: dict[str, Floats]) -> lw.Record:
    return lw.Record(0.0, RATE, tuple(wave), np.column_stack(list(wave.values())))


def truth(n: int) -> lw.records.SimulationTruth:
    ramp = np.arange(float(n))
    energy = lw.records.EnergyBalance(ramp + 3.0, ramp, np.ones((n, 2)), np.full((n, 1), 1.0))
    return lw.records.SimulationTruth(
        structure=lw.bnes_chain(2),
        displacement=np.column_stack([ramp, -ramp]),
        velocity=np.column_stack([2.0 * ramp, ramp]),
        base=ramp,
        diagnostics=SimpleNamespace(energy=energy, horizon=0.5),
    )


def test_a_record_knows_its_shape_and_its_kinds(record: lw.Record) -> None:
    assert len(record) == N
    assert record.step == 1e-3
    assert record.duration == (N - 1) / RATE
    assert np.array_equal(record.time, np.arange(N) / RATE)
    assert record.responses == ("x:m1", "a:m2")
    assert record.inputs == ("force:m1", "x:base")
    assert record.masses == ("m1", "m2")
    assert [record.unit(name) for name in record.channels] == ["m", "m/s^2", "N", "m"]
    assert repr(record) == "Record of 400 samples at 1000 Hz, 0 to 0.399 s: x:m1, a:m2, force:m1, x:base"


def test_a_record_cannot_be_changed(record: lw.Record, wave: dict[str, Floats]) -> None:
    values = np.column_stack(list(wave.values()))
    protected = lw.Record(0.0, RATE, tuple(wave), values)
    values[0, 0] = 7.0
    assert protected.values[0, 0] == 0.0
    for array in (record.values, record.channel("x:m1"), record.time, record.missing, record[5:50].values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError, match="assignment"):
        record.noise["x:m1"] = 1.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("m1", "'m1' is not a channel: expected KIND:MASS, such as x:m1"),
        ("x:", "is not a channel: expected KIND:MASS"),
        ("y:m1", "unknown kind 'y'; choose from x (displacement, m)"),
        ("force:base", "a base is moved by x:base, v:base or a:base"),
        ("x:m1[mm]", "'m1[mm]' is not a valid name of a mass"),
        ("signal:u[V]", "'u[V]' is not a valid name of a signal: a record is in SI units"),
    ],
)
def test_what_is_no_channel_is_refused(name: str, message: str) -> None:
    with pytest.raises(lw.RecordError) as caught:
        lw.records.Channel.parse(name)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"channels": ("x:m1", "x:m1")}, "channel x:m1: is listed twice"),
        ({"values": np.zeros(5)}, "values have the shape (5,), expected (samples, 2) for the channels x:m1, x:m2"),
        ({"rate": 0.0}, "rate must be between 1e-30 and 1e+30 Hz, got 0 Hz"),
        ({"rate": np.nan}, "rate must be between 1e-30 and 1e+30 Hz, got nan Hz"),
        ({"start": np.inf}, "start must be finite, got inf s"),
        ({"noise": {"x:m3": 1.0}}, "channel x:m3: is not in the record, and something is stated of it (noise)"),
        ({"noise": {"x:m1": -1.0}}, "channel x:m1: noise must be a non-negative number, got -1.0"),
        ({"channels": (), "values": np.zeros((5, 0))}, "a record needs at least one channel and one sample"),
        ({"values": np.array([[0.0, 1.0], [0.0, -np.inf]])}, "channel x:m2: the value at 0.1 s is infinite"),
    ],
)  # fmt: skip
def test_what_is_no_record_is_refused(change: dict[str, Any], message: str) -> None:
    given = {"start": 0.0, "rate": 10.0, "channels": ("x:m1", "x:m2"), "values": np.zeros((5, 2)), **change}
    with pytest.raises(lw.RecordError) as caught:
        lw.Record(**given)
    assert message in str(caught.value)


def test_arrays_become_a_record_and_gaps_become_missing_samples(wave: dict[str, Floats]) -> None:
    time = np.arange(N) / RATE
    rows = np.delete(np.arange(N), [10, 11, 12, 200])
    wave["x:m1"][0] = np.nan
    kept = {name: values[rows] for name, values in wave.items()}
    record = lw.Record.from_arrays(time[rows], kept, source="bench")
    assert len(record) == N
    assert record.rate == RATE
    assert np.flatnonzero(record.missing[:, 0]).tolist() == [0, 10, 11, 12, 200]
    assert np.flatnonzero(record.missing[:, 1]).tolist() == [10, 11, 12, 200]
    assert np.array_equal(record.channel("a:m2")[rows], wave["a:m2"][rows])
    assert record.source == "bench"
    assert record.notes == (
        "Gaps in time: 2, the first after 0.009 s; 4 rows were added as missing samples.",
        "x:m1: 1 of 396 samples are missing.",
    )
    # whole numbers and slow clocks are noted, and an input may rest and repeat
    record = lw.Record.from_arrays(np.arange(N), {"x:m1": np.arange(N) % 7})
    assert record.values.dtype == np.float64
    assert record.notes == (
        "The sampling interval is 1 s. If the times are in ms, name their column time[ms].",
        "x:m1: integers were taken as values in m; counts need a unit.",
    )
    wave["force:m2"] = wave["force:m1"]
    assert lw.Record.from_arrays(time, wave).inputs == ("force:m1", "x:base", "force:m2")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x:m1": np.full(N, 0.25)}, "channel x:m1: every sample is 0.25: a constant channel carries no information"),
        ({"x:m1": np.full(N, np.nan)}, "channel x:m1: every sample is missing"),
        ({"x:m2": np.sin(40.0 * np.arange(N) / RATE)}, "channel x:m2: has the same samples as x:m1"),
        ({"x:m1": np.arange(N - 1.0)}, "channel x:m1: has shape (399,), but time has shape (400,)"),
        ({"time": np.zeros((N, 1))}, "time must be a one-dimensional array of numbers, got float64 of shape (400, 1)"),
        ({"x:m1": np.array(["a"] * N)}, "channel x:m1: the samples must be numbers, got <U1"),
        ({"x:m1": np.where(np.arange(N) == 30, np.inf, 1.0)},
         "channel x:m1: the value is infinite; leave the cell of an overloaded sample empty (sample 30)"),
    ],
)  # fmt: skip
def test_what_is_useless_is_refused(wave: dict[str, Floats], change: dict[str, Any], message: str) -> None:
    time = change.pop("time", np.arange(N) / RATE)
    with pytest.raises((lw.RecordError, lw.ArgumentTypeError)) as caught:
        lw.Record.from_arrays(time, {**wave, **change})
    assert message in str(caught.value)


def test_a_slice_is_a_record_that_starts_later(record: lw.Record) -> None:
    part = record[100:-50]
    assert part.start == 0.1
    assert len(part) == N - 150
    assert np.array_equal(part.values, record.values[100:-50])
    assert np.shares_memory(part.values, record.values)
    by_time = record.between(0.1, 0.349)
    assert by_time.start == part.start
    assert np.array_equal(by_time.values, part.values)
    assert len(record.between(-1.0, 9.0)) == N
    true = present(replace(record, simulated=truth(N))[100:150].simulated)
    assert np.array_equal(true.displacement[:, 0], np.arange(100.0, 150.0))
    assert np.array_equal(present(true.base), np.arange(100.0, 150.0))
    # 3 put in at the start, 2 + 1 stored and lost
    assert true.energy.residual == pytest.approx(np.zeros(50), abs=1e-12)
    assert true.horizon == 0.5


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda r: r[::2], "sliced as record[first:last] without a step; record.decimate(factor)"),
        (lambda r: r[3], 'a record is asked for a channel, record["x:m1"], or sliced as record[first:last]'),
        (lambda r: r["x:m9"], "is not in the record; the channels are"),
        (lambda r: r[30:20], "record[30:20] is empty; the record has 400 samples"),
        (lambda r: r.between(2.0, 3.0), "no sample between 2 and 3 s; the record runs from 0 to 0.399 s"),
        (lambda r: r.decimate(2.5), "factor must be a positive integer, got 2.5"),
        (lambda r: r.decimate(0), "factor must be a positive integer, got 0"),
        (lambda r: r.decimate(50), "400 samples are too few to decimate by 50: its anti-alias filter spans 2501"),
        (lambda r: replace(r, interpolation={"force:m1": "held"}).decimate(4),
         "is stated as held between its samples, which samples at a lower rate cannot show"),
        (lambda r: r.with_noise(np.inf, seed=0), "decibel must be within 1000 of zero, got inf"),
    ],
)  # fmt: skip
def test_a_wrong_request_says_why(
    record: lw.Record, act: Callable[[lw.Record], object], message: str
) -> None:
    with pytest.raises((lw.RecordError, lw.ArgumentTypeError)) as caught:
        act(record)
    assert message in str(caught.value)


def test_selection_keeps_order_and_noise(record: lw.Record, wave: dict[str, Floats]) -> None:
    part = replace(record, noise={"x:m1": 0.1, "a:m2": 0.2}).select(["a:m2", "force:m1"])
    assert part.channels == ("a:m2", "force:m1")
    assert part.noise == {"a:m2": 0.2}
    assert np.array_equal(part.channel("a:m2"), wave["a:m2"])
    message = "channel v:m1: is not in the record; the channels are x:m1, a:m2, force:m1, x:base"
    with pytest.raises(lw.RecordError, match=message):
        record.channel("v:m1")


# Noise ----------------------------------------------------------------


@pytest.mark.parametrize("decibel", [10.0, 20.0, 40.0])
def test_noise_has_the_variance_of_the_paper(decibel: float) -> None:
    n = 100_000
    t = np.arange(n) / RATE
    clean = 0.3 + np.sin(40.0 * t)  # the mean counts: sigma^2 = mean(x^2) 10^(-dB/10), not the variance of x
    record = lw.Record(0.0, RATE, ("x:m1",), clean[:, np.newaxis]).with_noise(decibel, seed=4)
    noise = record.channel("x:m1") - clean
    expected = np.mean(clean**2) * 10.0 ** (-decibel / 10.0)
    # Relative standard deviation of a variance from n normal samples: sqrt(2/n); 4 of them, seed fixed.
    assert abs(np.mean(noise**2) / expected - 1.0) < 4.0 * np.sqrt(2.0 / n)
    # likewise four deviations, of a mean and of a correlation of n samples
    assert abs(np.mean(noise)) < 4.0 * np.sqrt(expected / n)
    # four standard deviations of the correlation of n white samples
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4.0 / np.sqrt(n)


def test_added_noise_is_part_of_the_truth_only(record: lw.Record) -> None:
    known = replace(record, noise={"x:m1": 0.1, "x:base": 0.2}, simulated=truth(N))
    noisy = known.with_noise(20.0, seed=3)
    sigma = float(np.sqrt(np.mean(record.channel("x:m1") ** 2) * 0.01))
    assert noisy.noise == {"x:base": 0.2}
    assert present(noisy.simulated).noise["x:m1"] == pytest.approx(sigma, rel=1e-12)
    assert set(present(noisy.simulated).noise) == {"x:m1", "a:m2"}
    assert record.with_noise(20.0, seed=3).simulated is None
    values = record.values.copy()
    values[7, 0] = np.nan
    noisy = lw.Record(0.0, RATE, record.channels, values).with_noise(20.0, seed=3)
    assert np.argwhere(noisy.missing).tolist() == [[7, 0]]


# Decimation ----------------------------------------------------------------


def tone(frequency: float, n: int = 20000) -> lw.Record:
    motion = np.cos(2.0 * np.pi * frequency * np.arange(n) / RATE + 0.3)
    return lw.Record(0.0, RATE, ("x:m1",), motion[:, np.newaxis])


@pytest.mark.parametrize("factor", [2, 5, 16])
def test_decimation_keeps_the_passband_and_its_phase(factor: int) -> None:
    ripple = 10.0 ** (-ATTENUATION / 20.0)
    for share in (0.0, 0.4, PASSBAND):
        frequency = share * RATE / factor / 2.0
        thin = tone(frequency).decimate(factor)
        assert thin.rate == RATE / factor
        expected = np.cos(2.0 * np.pi * frequency * thin.time + 0.3)
        # the ripple that the filter is designed for
        assert np.max(np.abs(thin.channel("x:m1") - expected)) < 1.1 * ripple


def test_motion_that_folds_is_told() -> None:
    noise = 1e-3 * np.random.default_rng(3).standard_normal((20000, 1))
    slow, fast = tone(0.5 * RATE / 8.0), tone(1.1 * RATE / 8.0)
    both = lw.Record(0.0, RATE, ("x:m1",), slow.values + 0.01 * fast.values + noise).decimate(4)
    assert any(note.startswith("x:m1: the motion between") for note in both.notes)
    alone = lw.Record(0.0, RATE, ("x:m1",), slow.values + noise).decimate(4)
    assert len(alone.notes) == 1


def test_known_noise_shrinks_as_white_noise_does_and_no_filter_crosses_a_gap(record: lw.Record) -> None:
    n = 200_000
    white = np.random.default_rng(8).standard_normal((n, 1))
    thin = lw.Record(0.0, RATE, ("x:m1",), white, noise={"x:m1": 1.0}).decimate(5)
    # The outputs are independent, n / 5 of them; 4 standard deviations of their standard deviation.
    assert np.std(thin.values) == pytest.approx(thin.noise["x:m1"], rel=4.0 / np.sqrt(2.0 * n / 5))
    values = np.tile(record.values, (3, 1))
    values[600, 1] = np.nan
    message = "channel a:m2: samples are missing, and the anti-alias filter cannot bridge a gap"
    with pytest.raises(lw.RecordError, match=message):
        lw.Record(0.0, RATE, record.channels, values).decimate(2)
