"""Gaps, and samples between those of a record that has few in a period of its fastest motion."""

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw
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
