"""Each check of single channels with its fault and without, on chains and on an oscillator under force."""

import numpy as np
import pytest
from record_faults import RECORDS, Fault, faulty, kinds
from structures import oscillator

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


def write_twice(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([values[:364], values[300:-64]])


@pytest.mark.parametrize("name", RECORDS)
def test_a_buffer_that_was_written_twice_is_told(name: str) -> None:
    """Bit for bit, which noise never repeats; a motion without noise does, wherever it is periodic."""
    record = faulty(RECORDS[name](), CHANNEL, write_twice)
    [alert] = [alert for alert in lw.inspect(record).alerts if alert.kind == "doubled"]
    then, now = (record.start + sample / record.rate for sample in (300, 364))
    assert alert.message.startswith(f"64 samples from {now:g} s on are those from {then:g} s on, bit for bit")


def test_a_motion_that_repeats_itself_was_not_written_twice() -> None:
    period = np.sin(2.0 * np.pi * np.arange(250.0) / 250.0)
    for values in (np.tile(period, 12), np.rint(100.0 * np.tile(period, 12)) / 100.0):
        alerts = lw.inspect(lw.Record(0.0, 1000.0, ("x:m1",), values[:, None])).alerts
        assert "bit for bit" not in " ".join(alert.message for alert in alerts)


def test_steps_of_powers_of_two_are_compared_value_by_value() -> None:
    """Of counts of converters, whose bits end in zeros."""
    counts = np.rint(np.random.default_rng(7).normal(0.0, 200.0, 20_000)).cumsum() / 1024.0
    noisy = counts - np.convolve(counts, np.ones(50) / 50.0, "same")
    alerts = lw.inspect(lw.Record(0.0, 1000.0, ("a:m1",), np.rint(1024.0 * noisy)[:, None] / 1024.0)).alerts
    assert "bit for bit" not in " ".join(alert.message for alert in alerts)


@pytest.mark.parametrize("samples", [5, 10])
@pytest.mark.parametrize("name", [name for name in RECORDS if "40 dB" in name])
def test_samples_that_a_logger_lost_are_no_spikes(samples: int, name: str) -> None:
    """To mark the samples on either side of a jump as missing mends nothing."""
    record = RECORDS[name]()
    at = np.argmax(np.abs(np.diff(record.channel(CHANNEL)))[500:2000]) + 500  # where it moves fast
    kept = np.delete(record.values, slice(at, at + samples), axis=0)
    shortened = lw.Record(record.start, record.rate, record.channels, kept)
    (alert,) = (alert for alert in lw.inspect(shortened).alerts if alert.channel == CHANNEL)
    assert alert.kind == "dropped"
    assert f"{at / record.rate:.6g} s" in alert.message
    marked = lw.inspection.mark_missing(shortened, ["spikes"])
    assert not np.isnan(marked.channel(CHANNEL)).any()


def test_the_ends_of_a_plateau_are_no_samples_that_a_logger_lost() -> None:
    """A decay whose first swings leave the range, seen with hardly any noise."""
    time, noise = np.arange(4000) / 500.0, np.random.default_rng(1).normal(size=4000)
    decay = 3e-3 * np.cos(50.0 * time + 0.7) * np.maximum(1.0 - 0.8 * time, 0.0) + 1e-6 * noise
    record = lw.Record(0.0, 500.0, (CHANNEL,), np.maximum(decay, -2e-3)[:, None])
    assert kinds(record) == {"clipped"}


@pytest.mark.parametrize("name", RECORDS)
def test_spikes_are_no_fast_motion(name: str) -> None:
    """Their power at all frequencies was told as motion up to half the rate, and as aliasing, before the spikes."""

    def strike(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
        at = 100 + np.arange(8) * (len(values) // 9)
        values[at] += 10.0 * np.std(values) * rng.choice([-1.0, 1.0], len(at))
        return values

    record = RECORDS[name]()
    struck = lw.inspect(faulty(record, CHANNEL, strike))
    assert {alert.kind for alert in struck.alerts if alert.channel == CHANNEL} == {"spikes"}
    before, after = (
        next(channel.highest_frequency for channel in seen.channels if channel.name == CHANNEL)
        for seen in (lw.inspect(record), struck)
    )
    assert after == pytest.approx(before, rel=0.2)


@pytest.mark.parametrize("samples", [3, 20, 60])
@pytest.mark.parametrize("name", RECORDS)
def test_a_logger_that_hangs_for_a_while_is_told(samples: int, name: str) -> None:
    def hang(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
        at = len(values) // 4
        return np.concatenate([values[:at], np.repeat(values[at], samples), values[at:]])[: len(values)]

    assert "doubled" in kinds(faulty(RECORDS[name](), CHANNEL, hang), CHANNEL)
    assert "doubled" in kinds(faulty(RECORDS[name](), CHANNEL, hold), CHANNEL)


def test_an_encoder_may_rest() -> None:
    """It repeats a level for as long as nothing moves, however long that is."""
    time = np.arange(4000) / 1000.0
    motion = np.where((time > 1.5) & (time < 2.5), np.sin(30.0 * 1.5), np.sin(30.0 * time))
    noise = np.random.default_rng(7).normal(size=len(time))
    for step in (1e-2, 1e-4):
        rounded = np.rint(np.round(motion + 0.2 * step * noise, 12) / step) * step
        assert "doubled" not in kinds(lw.Record.from_arrays(time, {CHANNEL: rounded}), CHANNEL)
    assert "doubled" not in kinds(lw.Record.from_arrays(time, {CHANNEL: motion}), CHANNEL)


def test_repeats_at_coarse_steps_are_no_doubled_samples() -> None:
    """In single precision the steps of a converter are not of one size, and were not seen."""
    time = np.arange(30000) / 10000.0
    steps = np.rint(40.0 * np.exp(-2.0 * time) * np.sin(60.0 * time**2) / 1.18e-4)
    motion = (1.18e-4 * steps).astype(np.float32).astype(float)
    record = lw.Record.from_arrays(time, {CHANNEL: motion})
    assert (np.diff(motion) == 0.0).sum() > 20
    assert "doubled" not in kinds(record, CHANNEL)
    written_twice = np.repeat(motion, np.where(np.arange(30000) % 50, 1, 2))[:30000]
    assert "doubled" in kinds(lw.Record.from_arrays(time, {CHANNEL: written_twice}), CHANNEL)


@pytest.fixture(scope="module")
def rubbing() -> lw.Record:
    """Velocity and acceleration of a driven oscillator with dry friction: one turns sharply where the other jumps."""
    rig = oscillator("k*d + c*v + F*tanh(v/w)", k=4e3, c=1.0, F=12.0, w=1e-3)
    return lw.simulate(rig, forces={"m1": "40*sin(20*t)"}, duration=3.0, rate=2000.0, sensors=["v", "a"])


@pytest.mark.slow
@pytest.mark.parametrize("decibels", [40.0, 60.0])
def test_dry_friction_makes_no_spikes(decibels: float, rubbing: lw.Record) -> None:
    """Jumps and sharp turns were told as spikes, which are to be marked as missing; a spike among them still is."""
    for seed in range(3):
        record = rubbing.with_noise(decibels, seed=seed)
        assert "spikes" not in kinds(record)
        values = record.values.copy()
        values[2500] += 0.5 * np.std(values, axis=0) * [1.0, 3.0, 0.0]
        struck = lw.Record(record.start, record.rate, record.channels, values)
        assert "spikes" in kinds(struck, "v:m1") and "spikes" in kinds(struck, "a:m1")
