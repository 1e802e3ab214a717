"""Channels at an even rate: samples in their places, and no noise that splines amplify."""

import numpy as np
import pytest

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.channel import Channel
from linkwise.records.timeline import resample_evenly

RATE = 200.0
X, FORCE, BASE = map(Channel.parse, ("x:m1", "force:m1", "a:base"))


def noisy(times: Floats, seed: int) -> Floats:
    return np.sin(12.0 * times) + 0.01 * np.random.default_rng(seed).standard_normal(len(times))


def test_samples_whose_times_lie_on_the_grid_stay_as_they_are_and_none_is_invented() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(2001) / RATE
    there = rng.random(2001) > 0.4
    there[[0, -1]] = True
    samples = noisy(times, 2)
    for given in (times[there], times):  # rows that the file lacks, and empty cells
        column = samples[there] if len(given) < 2001 else np.where(there, samples, np.nan)
        start, columns, note = resample_evenly(given, {X: column}, RATE)
        assert start == 0.0
        assert np.array_equal(columns[X], np.where(there, samples, np.nan), equal_nan=True)
        assert note.endswith("lie on an even grid of 200 Hz: no response was interpolated.")


def test_short_gaps_of_an_input_are_interpolated_beside_responses_that_are_not() -> None:
    times = np.arange(1001) / RATE
    smooth = np.sin(12.0 * times)
    smooth[[300, 500, 501]] = np.nan
    _, columns, note = resample_evenly(times, {X: smooth, FORCE: smooth, BASE: smooth}, RATE)
    assert np.isnan(columns[X]).sum() == 3
    for name in (FORCE, BASE):
        assert np.max(np.abs(columns[name] - np.sin(12.0 * times))) < 1e-7
    assert note.endswith("Short gaps of force:m1, a:base were, by quintic splines.")


@pytest.mark.parametrize("missing", [0.0, 0.4])
def test_where_a_spline_would_amplify_noise_samples_are_missing(missing: float) -> None:
    """Through samples at random times, some nearly at once, a spline had errors of a hundred times their noise."""
    rng = np.random.default_rng(3)
    times = np.sort(rng.uniform(0.0, 10.0, 2001))
    column = np.where(rng.random(2001) < missing, np.nan, noisy(times, 4))
    start, columns, _ = resample_evenly(times, {X: column}, RATE * 1.01)
    grid = start + np.arange(len(columns[X])) / (RATE * 1.01)
    errors = columns[X] - np.sin(12.0 * grid)
    assert np.sum(~np.isnan(errors)) > 300
    assert np.nanmax(np.abs(errors)) < 5.0 * 3.0 * 0.01


@pytest.mark.parametrize("uneven", [0.0, 1e-3])
def test_infinite_and_few_samples_are_refused_on_and_off_the_grid(uneven: float) -> None:
    times = np.arange(64) / RATE + uneven * np.sin(np.arange(64))
    rate = RATE * (1.1 if uneven else 1.0)
    with pytest.raises(RecordError, match="infinite values"):
        resample_evenly(times, {X: np.full(64, np.inf)}, rate)
    with pytest.raises(RecordError, match="0 samples are too few"):
        resample_evenly(times, {X: np.full(64, np.nan)}, rate)
