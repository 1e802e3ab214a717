"""Between the samples of a record: gaps that are bridged, and forces that are zero between hits."""

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw
from linkwise.signals.force_window import COARSE, coarse_hits, coarseness, with_force_windows
from linkwise.signals.gaps import denser, highest_frequency, is_sparse, short_gaps_bridged

HERTZ = 100.0
TIME = np.arange(200) / HERTZ
CYCLES = 2.0  # Hz: fifty samples a period


def _record(*missing: slice) -> lw.Record:
    motion = np.sin(2.0 * np.pi * CYCLES * TIME)
    for gap in missing:
        motion[gap] = np.nan
    return lw.Record(0.0, HERTZ, ("x:m1", "force:m1"), np.column_stack([motion, motion]))


@pytest.mark.parametrize("length", [1, 2, 6])
def test_a_short_gap_is_bridged(length: int) -> None:
    """The error of a cubic across h is at most h**4 / 384 of the fourth derivative; a factor of two for the spline."""
    gap = slice(40, 40 + length)
    bridged = short_gaps_bridged(_record(gap))
    assert bridged is not None
    across = 2.0 * np.pi * CYCLES * (length + 1) / HERTZ
    motion = np.sin(2.0 * np.pi * CYCLES * TIME)
    assert bridged.channel("x:m1") == pytest.approx(motion, abs=2.0 * across**4 / 384.0)
    assert np.isnan(bridged.channel("force:m1")[gap]).all()  # of an input nothing is guessed


def test_long_gaps_and_ends_are_left() -> None:
    assert short_gaps_bridged(_record(slice(40, 47))) is None
    assert short_gaps_bridged(_record(slice(0, 2), slice(198, 200))) is None
    assert short_gaps_bridged(_record()) is None
    assert short_gaps_bridged(_record(slice(3, 200))) is None


TONES = ((3.0, 0.4), (7.1, 1.9), (11.3, 0.2))  # Hz, and phases


def tones(rate: float, duration: float = 6.0) -> lw.Record:
    """Three tones, up to 11.3 Hz."""
    time = np.arange(round(duration * rate) + 1) / rate
    values = sum(np.sin(2.0 * np.pi * frequency * time + phase) for frequency, phase in TONES)
    return lw.Record(0.0, rate, ("x:m1",), np.asarray(values)[:, None])


def test_what_lies_between_the_samples_is_the_motion_of_the_band() -> None:
    record = replace(tones(40.0), noise={"x:m1": 0.01})
    assert 11.0 < highest_frequency(record) < 15.0
    dense, factor = denser(record)
    assert factor >= 3 and dense.rate == factor * record.rate
    assert (len(dense) - 1) == factor * (len(record) - 1)
    np.testing.assert_allclose(dense.values[::factor], record.values, atol=1e-9)
    inner = slice(10 * factor, -10 * factor)  # from the ends on the motion is not known
    error = dense.values - tones(dense.rate).values
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.02 * np.sqrt(np.mean(record.values**2))


def test_dense_long_and_incomplete_records_are_left_as_they_are() -> None:
    dense, long = tones(400.0), tones(40.0, 60.0)
    gap = tones(40.0)
    gap = replace(gap, values=np.where(np.arange(len(gap))[:, None] == 30, np.nan, gap.values))
    assert not is_sparse([dense]) and not is_sparse([long])
    assert denser(dense) == (dense, 1) and denser(long) == (long, 1) and denser(gap) == (gap, 1)
    assert is_sparse([tones(40.0)]) and not is_sparse([tones(40.0, 40.0), tones(40.0, 40.0)])


RATE, NOISE = 1000.0, 0.3
TIMES = np.arange(2000) / RATE


def struck(*starts: float, width: float = 0.006, peak: float = 300.0) -> np.ndarray:
    """Hits of the shape of a squared sine."""
    phases = [(TIMES - start) / width for start in starts]
    hits = [
        np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(np.pi * phase) ** 2, 0.0) for phase in phases
    ]
    return np.asarray(np.sum(hits, axis=0))


def record(force: np.ndarray) -> lw.Record:
    motion = np.random.default_rng(9).standard_normal(len(force))
    return lw.Record.from_arrays(TIMES, {"x:m1": motion, "force:m1": force})


def noise(seed: int = 1) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal(len(TIMES))


def test_between_hits_a_force_is_zero() -> None:
    clean = struck(0.1, 1.2)
    windowed = with_force_windows(record(clean + noise()))
    force = windowed.channel("force:m1")
    assert np.all(force[clean == 0.0][:50] == 0.0) and np.count_nonzero(force) < 40
    loud, mean = clean > 5 * NOISE, NOISE / np.sqrt(len(TIMES))
    # less the mean of the noise
    np.testing.assert_allclose(force[loud], (clean + noise())[loud], atol=4 * mean)
    assert windowed.noise["force:m1"] == pytest.approx(NOISE, rel=4 / np.sqrt(2 * len(TIMES)))
    assert "0 outside of 2 hits, where it shows noise of 0." in windowed.notes[-1]


@pytest.mark.parametrize(
    "force",
    [
        struck(0.1),  # without noise
        5.0 * np.sin(40.0 * TIMES) + noise(),  # no pulse
        struck(0.1) + 2.0 * np.sin(40.0 * TIMES) + noise(),  # a force between the hits
        struck(0.1) + np.convolve(noise(), np.ones(8) / 8, "same"),  # coloured
        struck(0.1) + 2.0 + noise(),  # a constant force
        struck(*np.arange(0.01, 1.9, 0.012)) + noise(),  # seldom quiet
        struck(0.1, peak=4.0) + noise(),  # as low as outliers
    ],
)
def test_other_forces_stay_as_they_are(force: np.ndarray) -> None:
    given = record(force)
    assert with_force_windows(given) is given


def test_a_window_can_be_asked_for() -> None:
    shifted = with_force_windows(record(struck(0.1) + 2.0 + noise()), 0.01, required=True)
    assert abs(shifted.channel("force:m1").max() - 300.0) < 5 * NOISE
    with pytest.raises(lw.RecordError, match=r"force:m1.*not quiet but for pulses"):
        with_force_windows(record(5.0 * np.sin(40.0 * TIMES)), required=True)
    motion = record(struck(0.1)).select(["x:m1"])
    with pytest.raises(lw.RecordError, match="no applied force was recorded"):
        with_force_windows(motion, required=True)


def test_hits_of_few_samples_are_coarse() -> None:
    """Of half a sine the sum over n samples is off by 1/(4 n**2 - 1) of the impulse, over all positions."""
    rng = np.random.default_rng(3)
    off: dict[int, list[float]] = {}
    for width in rng.uniform(2.0, 10.0, 4000):
        phase = (np.arange(100.0) - 20.0 - rng.uniform()) / width
        pulse = np.where((phase > 0.0) & (phase < 1.0), np.sin(np.pi * phase), 0.0)
        samples = coarse_hits(lw.Record(0.0, 1.0, ("force:m1",), pulse[:, None]), COARSE)["force:m1"]
        off.setdefault(samples, []).append(pulse.sum() * np.pi / 2.0 / width - 1.0)
    for samples in (3, 5, 8):
        assert np.std(off[samples]) == pytest.approx(coarseness(samples), rel=0.15)
    long = np.sin(np.pi * np.clip(np.arange(100.0) / 20.0, 0.0, 1.0))
    assert not coarse_hits(lw.Record(0.0, 1.0, ("force:m1",), long[:, None]), COARSE)
