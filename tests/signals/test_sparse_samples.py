"""Samples between those of a record that has few in a period of its fastest motion."""

from dataclasses import replace

import numpy as np

import linkwise as lw
from linkwise.signals.gaps import denser, highest_frequency, is_sparse

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


def test_noise_has_the_same_size_between_samples() -> None:
    noise = np.random.default_rng(5_003_710).normal(size=400)
    record = lw.Record(0.0, 10.0, ("x:m1",), noise[:, None], noise={"x:m1": 0.1})
    dense, factor = denser(record)
    between = dense.values[factor // 2 :: factor]
    assert factor > 1 and dense.noise == {"x:m1": 0.1}
    np.testing.assert_allclose(np.std(between), np.std(noise), rtol=0.1)


def test_dense_long_and_incomplete_records_are_left_as_they_are() -> None:
    dense, long = tones(400.0), tones(40.0, 60.0)
    gap = tones(40.0)
    gap = replace(gap, values=np.where(np.arange(len(gap))[:, None] == 30, np.nan, gap.values))
    assert not is_sparse([dense]) and not is_sparse([long])
    assert denser(dense) == (dense, 1) and denser(long) == (long, 1) and denser(gap) == (gap, 1)
    assert is_sparse([tones(40.0)]) and not is_sparse([tones(40.0, 40.0), tones(40.0, 40.0)])


def test_inputs_that_are_held_between_samples_are_not_interpolated() -> None:
    record = tones(40.0)
    values = np.column_stack([record.values, np.sign(record.values)])
    held = lw.Record(0.0, 40.0, ("x:m1", "force:m1"), values, interpolation={"force:m1": "held"})
    assert denser(held) == (held, 1)
    smooth = replace(held, interpolation={"force:m1": "band-limited"})
    assert denser(smooth)[1] > 1
