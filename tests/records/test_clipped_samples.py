"""Clipped samples stay beside their channel through what takes, joins and shortens records."""

from dataclasses import replace

import numpy as np
import pytest
from present import present
from problems import chain_record, parsed

import linkwise as lw


def marked() -> lw.Record:
    """A record of 1 s clipped at six tenths of its peaks."""
    record = chain_record(2).with_noise(30.0, seed=71).between(0.0, 1.0)
    peak = 0.6 * np.max(np.abs(record.values), axis=0)
    clipped = replace(record, values=np.clip(record.values, -peak, peak), simulated=None)
    return lw.inspection.mark_missing(clipped)


def readings(record: lw.Record, name: str) -> np.ndarray:
    return present(record.clipped[name].of(record.channel(name))).readings


def test_joined_records_have_those_of_both_parts() -> None:
    whole = marked()
    joined = lw.records.continued(whole[:400], whole[430:])
    expected = readings(whole, "x:m2")
    expected[400:430] = np.nan
    np.testing.assert_array_equal(readings(joined, "x:m2"), expected)
    joined = lw.records.continued(replace(whole[:400], clipped={}), whole[400:])
    assert np.isnan(readings(joined, "x:m2")[:400]).all()
    assert np.isfinite(readings(joined, "x:m2")[400:]).any()
    joined = lw.records.beside(whole.select(["x:m1"]), whole.select(["x:m2"])[:700])
    for name in ("x:m1", "x:m2"):
        np.testing.assert_array_equal(readings(joined, name), readings(whole, name)[:700])


@pytest.mark.parametrize(
    ("samples", "readings", "sides", "message"),
    [
        ([np.nan, 1.0], [2.0], [1.0], "arrays of one length"),
        ([np.nan, 1.0], [2.0, np.nan], [3.0, 0.0], "-1, 0 or 1, got 3 at sample 0"),
        ([2.0, 1.0], [2.0, np.nan], [1.0, 0.0], "sample 0 is there beside its reading"),
    ],
)
def test_wrong_samples(samples: list[float], readings: list[float], sides: list[float], message: str) -> None:
    with pytest.raises(lw.RecordError, match=message):
        lw.records.ClippedSamples(np.array(samples), np.array(readings), np.array(sides))


def test_clipped_samples_of_what_is_no_response_are_refused() -> None:
    record = marked()
    with pytest.raises(
        lw.RecordError,
        match=r"x:m7: is not in the record, and something is stated of it \(clipped samples\); the channels are x:m1, x:m2",
    ):
        replace(record, clipped={"x:m7": record.clipped["x:m2"]})
    forced = replace(record, channels=parsed("x:m1", "force:m2"), clipped={}, noise={})
    with pytest.raises(lw.RecordError, match="force:m2 is an input"):
        replace(forced, clipped={"force:m2": record.clipped["x:m2"]})
