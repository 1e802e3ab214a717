"""Faults of samples and of whole signals: each is told where it is, and nothing where there is none."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from problems import chain_record
from record_faults import RECORDS, Fault, chain, changed, faulty, forced, kinds, without
from structures import oscillator

import linkwise as lw
from linkwise.inspection.channel_signal import RecordSignals

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


def ring_down(snr_db: float, seed: int = 1) -> lw.Record:
    """A linear oscillator that comes to rest in a third of the record."""
    structure, sensors = oscillator("k*d + c*v", k=4000.0, c=3.0), ("x", "v", "a")
    record = lw.simulate(structure, release={"x:m1": 0.01}, duration=12.0, rate=500.0, sensors=sensors)
    return record.with_noise(snr_db, seed=seed)


BESIDE: dict[str, Callable[[], lw.Record]] = {
    **{
        f"chain of {masses}, {decibel:g} dB": partial(chain, masses, decibel, sensors=("x", "v", "a"))
        for masses in (2, 6)
        for decibel in (20.0, 40.0)
    },
    **{f"forced, {decibel:g} dB": partial(forced, decibel) for decibel in (20.0, 40.0)},
    **{f"ring-down, {decibel:g} dB": partial(ring_down, decibel) for decibel in (20.0, 40.0)},
}


def rms(values: np.ndarray) -> float:
    return float(np.std(values))


def spike(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    values[rng.choice(np.arange(50, len(values) - 50), 4, replace=False)] += 3.0 * rms(values)
    return values


def late(values: np.ndarray, record: lw.Record, rng: np.random.Generator, samples: int = 2) -> np.ndarray:
    start = np.repeat(values[0], samples) + 1e-9 * rng.normal(size=samples)
    return np.concatenate([start, values[:-samples]])


def hum(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    amplitude = 0.08 * rms(values) * np.sqrt(2.0)
    return np.asarray(values + amplitude * np.sin(2.0 * np.pi * 50.02 * record.time + 0.4))


def trend(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    return values + 0.3 * rms(values) * record.time / record.duration


FAULTS_OF_SIGNALS: dict[tuple[str, str], Fault] = {
    ("spikes", "x:m1"): spike,
    ("hum", "x:m1"): hum,
    ("delay", "v:m1"): late,
    ("gain", "v:m1"): lambda values, record, rng: 1.1 * values,
    ("unit", "v:m1"): lambda values, record, rng: 1e3 * values,
    ("offset", "v:m1"): lambda values, record, rng: values + 0.1 * rms(values),
    ("drift", "a:m1"): trend,
}


@pytest.mark.parametrize("samples", [3, 8])
@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_a_delay_of_several_samples_is_told_as_it_is(samples: int, snr_db: float) -> None:
    """To first order in the delay, 3 samples were told as 3.3, and as a gain of 0.87 beside it."""
    record = faulty(BESIDE[f"chain of 2, {snr_db:g} dB"](), "a:m1", partial(late, samples=samples))
    (fit,) = (fit for fit in RecordSignals.of(record).kinematics if fit.upper.channel == "a:m1")
    assert fit.delay[0] * record.rate == pytest.approx(samples, abs=0.1)
    assert [(alert.kind, alert.channel) for alert in lw.inspect(record).alerts] == [("delay", "a:m1")]


def filtered(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
    """Noise of a tenth of the root mean square, whose neighbouring samples are correlated by 0.9."""
    noise = rng.normal(size=len(values))
    for row in range(1, len(noise)):
        noise[row] += 0.9 * noise[row - 1]
    return values + 0.1 * rms(values) / rms(noise) * noise


AT_REST: dict[tuple[str, str], Fault] = {
    ("coloured", "x:m1"): filtered,
    ("drift", "x:m1"): trend,
    ("offset", "a:m1"): lambda values, record, rng: values + 0.1 * rms(values),
}


@pytest.mark.parametrize(("kind", "channel"), AT_REST)
@pytest.mark.parametrize("snr_db", [40.0, 60.0])  # noisier white noise would hide the correlated one
def test_what_a_single_channel_says_at_rest(snr_db: float, kind: str, channel: str) -> None:
    alone = ring_down(snr_db).select([channel])
    assert kinds(alone) == set()
    assert kinds(faulty(alone, channel, AT_REST[kind, channel])) == {kind}


def test_a_mass_may_rest_in_a_well() -> None:
    """A bistable link holds its mass away from zero: no offset of the displacement, nor of what else is measured."""
    structure = oscillator("alpha*d + beta*d**3 + c*v", mass=0.01, alpha=-100.0, beta=1e6, c=0.2)
    sensors = ("x", "v", "a")
    clean = lw.simulate(structure, release={"v:m1": 2.0}, duration=4.0, rate=1000.0, sensors=sensors)
    record = clean.with_noise(40.0, seed=1)
    # its well, sqrt(-alpha/beta)
    assert abs(record.channel("x:m1")[-500:].mean()) == pytest.approx(0.01, rel=0.01)
    assert lw.inspect(record).alerts == ()


def test_a_displacement_in_a_wrong_unit_may_vibrate_faster_than_sound() -> None:
    """Millimetres taken for metres, of a slow motion: its accelerations alone are not beyond what vibrates."""
    structure = oscillator("k*d + c*v", k=(2 * np.pi * 5.0) ** 2, c=0.1)
    record = lw.simulate(structure, release={"x:m1": 0.05}, duration=8.0, rate=200.0).with_noise(60.0, seed=1)
    assert kinds(record) == set()
    (alert,) = lw.inspect(faulty(record, "x:m1", lambda values, record, rng: 1e3 * values)).alerts
    assert alert.kind == "unit" and "faster than sound" in alert.message


def test_motion_up_to_half_the_rate_is_aliased() -> None:
    """The sampled motion of a fast oscillator: every fifth sample, without a filter."""
    structure = oscillator("k*d + c*v", k=(2 * np.pi * 90.0) ** 2, c=4.0)
    clean = lw.simulate(structure, release={"x:m1": 1e-3}, duration=4.0, rate=1000.0)
    record = clean.with_noise(40.0, seed=1)
    assert kinds(record) == set()
    coarse = lw.Record.from_arrays(record.time[::5], {"x:m1": record.channel("x:m1")[::5]})
    assert {"aliasing", "few-samples"} <= kinds(coarse)


@pytest.mark.parametrize(("samples", "is_told"), [(4, True), (9, False)])
def test_a_hit_of_few_samples_does_not_tell_its_impulse(samples: int, is_told: bool) -> None:
    structure = oscillator("k*d + c*v", k=(2 * np.pi * 9.0) ** 2, c=1.0)
    phase = np.pi * (np.arange(40_001) - 995) / (10 * samples)
    half_sine = np.where((phase > 0.0) & (phase < np.pi), np.sin(phase), 0.0)
    force = {"m1": lw.model.Sampled(0.0, 1e4, half_sine, order=1)}
    clean = lw.simulate(structure, forces=force, duration=4.0, rate=1000.0)
    alerts = lw.inspect(clean.with_noise(40.0, seed=1)).alerts
    assert [(alert.kind, alert.channel) for alert in alerts] == [("few-samples", "force:m1")] * is_told
    assert (
        not is_told
        or "4 samples, which tell the impulse of half a sine to within 1.6 % only" in alerts[0].message
    )


def test_a_short_record_is_told_and_the_worst_comes_first() -> None:
    assert kinds(ring_down(40.0).select(["x:m1"]).between(0.0, 0.15)) == {"short"}
    record = chain(2, 40.0)
    first, second = map(str, record.channels[:2])
    alerts = lw.inspect(without(changed(record, **{first: 0.0}), **{second: 300})).alerts
    assert [alert.kind for alert in alerts] == ["dead", "dropped"]
    assert alerts[0].error > alerts[1].error > 0.0


@pytest.mark.parametrize("name", BESIDE)
def test_no_alert_without_a_fault(name: str) -> None:
    assert lw.inspect(BESIDE[name]()).alerts == ()


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "channel"), FAULTS_OF_SIGNALS)
@pytest.mark.parametrize("name", BESIDE)
def test_a_fault_is_told(name: str, kind: str, channel: str) -> None:
    assert kind in kinds(faulty(BESIDE[name](), channel, FAULTS_OF_SIGNALS[kind, channel]))


@pytest.mark.slow
def test_nothing_in_a_record_stops_an_inspection() -> None:
    """Few samples, gaps, constants, steps, lines and numbers of any size, in every channel; warnings are errors here."""
    rng = np.random.default_rng(5)
    names = ("x:m1", "v:m1", "a:m1", "force:m1", "x:base", "x:m2")
    for count in (1, 2, 5, 8, 17, 33, 60, 100, 250, 250, 700, 700) * 6:
        shapes = {
            "noise": rng.normal(size=count),
            "constant": np.full(count, rng.choice([0.0, 1.0, np.nan])),
            "gaps": np.where(rng.random(count) < rng.random(), np.nan, rng.normal(size=count)),
            "steps": np.round(rng.normal(size=count)),
            "sine": np.sin(np.arange(count) * rng.random()),
            "line": np.arange(count, dtype=float),
            "held": np.repeat(rng.normal(size=count), 3)[:count],
        }
        chosen = rng.choice(list(shapes), len(names))
        sizes = 10.0 ** rng.integers(-12, 12, len(names))
        values = np.stack([shapes[shape] for shape in chosen], axis=1) * sizes
        inspection = lw.inspect(lw.Record(0.0, 10.0 ** rng.uniform(-2, 6), names, values))
        assert len(inspection.channels) == len(names) and str(inspection)
        told = {"method", "verdicts", "trusted", "grade", "channels", "alerts", "records"}
        assert set(inspection.to_dict()) == told


@pytest.mark.parametrize("kind", ["x", "v", "a"])
@pytest.mark.parametrize("decibels", [0.0, 3.0, 6.0, 10.0])
def test_noise_is_no_fast_motion_and_hides_no_channel(kind: str, decibels: float) -> None:
    """What noise scatters beyond its mean over frequency was told as motion up to half the rate; weak motion as none."""
    clean = chain_record(2, duration=20.0, sensors=(kind,))
    for seed in range(3):
        assert not lw.inspect(clean.with_noise(decibels, seed=seed)).alerts


def test_a_channel_of_noise_alone_is_dead() -> None:
    rng = np.random.default_rng(91)
    for _ in range(20):
        noise = lw.Record.from_arrays(np.arange(5000) / 1000.0, {"x:m1": rng.normal(size=5000)})
        assert kinds(noise) == {"dead"}


def test_a_structure_that_is_driven_does_not_rest() -> None:
    """A mass that a slow force moves within its noise was told to have an offset while nothing moves."""
    time = np.arange(6000) / 1000.0
    rng = np.random.default_rng(92)
    velocity = np.where(time < 3.0, np.sin(40.0 * time), 0.0) + np.where(time >= 3.0, 0.02, 0.0)
    channels = {"v:m1": velocity + 0.01 * rng.normal(size=6000), "force:m1": np.sin(3.0 * time)}
    assert "offset" not in kinds(lw.Record.from_arrays(time, channels))
    channels["force:m1"] = np.where(time < 3.0, np.sin(40.0 * time), 0.0)
    assert "offset" in kinds(lw.Record.from_arrays(time, channels), "v:m1")


def _driven_by_a_sine(frequency: float, duration: float, seed: int) -> lw.Record:
    """A hardening oscillator, whose motion has harmonics of the force."""
    structure = oscillator("k*d + c*v + k3*d**3", k=4e3, c=4.0, k3=1e9)
    force = f"60*sin(2*pi*{frequency}*t)"
    record = lw.simulate(structure, forces={"m1": force}, duration=duration, rate=1000.0)
    return record.with_noise(70.0, seed=seed)


@pytest.mark.parametrize(("frequency", "duration"), [(10.0, 2.33), (50.0 / 12.0, 10.0), (50.0 / 16.0, 15.0)])
def test_a_harmonic_at_the_frequency_of_the_mains_is_no_hum(frequency: float, duration: float) -> None:
    """Whatever the number of periods in the record, and at high orders."""
    assert "hum" not in kinds(_driven_by_a_sine(frequency, duration, 5215501))


def test_hum_beside_harmonics_of_a_sine_is_told() -> None:
    record = faulty(_driven_by_a_sine(7.3, 6.0, 5215502), "x:m1", hum)
    assert "hum" in kinds(record)
