"""Records of two instruments as one, and channels that are late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import linkwise as lw

TIME = np.arange(400) / 200.0


def tone(late: float = 0.0) -> np.ndarray:
    return np.sin(40.0 * (TIME - late)) + 0.3 * np.cos(110.0 * (TIME - late))


@pytest.fixture
def record() -> lw.Record:
    return lw.Record(0.0, 200.0, ("x:m1", "a:base"), np.stack([tone(), tone(0.0123)], axis=1))


def test_channels_of_both_up_to_the_end_of_the_shorter(record: lw.Record) -> None:
    one = replace(record.select(["x:m1"]), noise={"x:m1": 1e-3}, notes=("One.", "Both."))
    other = replace(record.select(["a:base"])[:300], noise={"a:base": 2e-3}, notes=("Both.", "Other."))
    joined = lw.beside(one, other)
    assert joined.channels == ("x:m1", "a:base")
    assert (joined.values == record.values[:300]).all()
    assert dict(joined.noise) == {"x:m1": 1e-3, "a:base": 2e-3}
    assert joined.notes == ("One.", "Both.", "Other.")


def test_other_rates_and_the_same_channel_are_refused(record: lw.Record) -> None:
    one = record.select(["x:m1"])
    with pytest.raises(lw.RecordError, match="need one sampling rate, got 200 and 201 Hz"):
        lw.beside(one, replace(record.select(["a:base"]), rate=201.0))
    with pytest.raises(lw.RecordError, match=r"x:m1.*is in both records"):
        lw.beside(one, record)


@pytest.mark.parametrize("late", [0.0123, -0.0123])
def test_a_delay_is_taken_out(record: lw.Record, late: float) -> None:
    """To the pass band of the interpolating sinc, away from the ends that it continues: 1e-4."""
    shown = replace(record, values=np.stack([tone(), tone(late)], axis=1))
    found = lw.without_delays(shown, {"a:base": late})
    assert len(found) == len(record) - 3  # 2.46 samples
    assert found.start == pytest.approx(0.0 if late > 0 else 3 / 200.0, abs=1e-12)
    middle = slice(40, -40)
    assert found.channel("a:base")[middle] == pytest.approx(found.channel("x:m1")[middle], abs=1e-4)
    assert found.notes == (f"Delays were taken out: {late:g} s in a:base.",)


def test_delays_that_cannot_be_are_refused(record: lw.Record) -> None:
    assert lw.without_delays(record, {}) is record
    with pytest.raises(lw.RecordError, match=r"x:m9.*is not in the record"):
        lw.without_delays(record, {"x:m9": 0.1})
    with pytest.raises(lw.RecordError, match=r"a delay must be shorter than the record of 1\.995 s, got 3 s"):
        lw.without_delays(record, {"x:m1": 3.0})
    with pytest.raises(lw.RecordError, match="the delays leave no sample"):
        lw.without_delays(record, {"x:m1": 1.5, "a:base": -1.5})
    values = record.values.copy()
    values[5, 0] = np.nan
    with pytest.raises(lw.RecordError, match=r"x:m1.*samples are missing"):
        lw.without_delays(replace(record, values=values), {"x:m1": 0.1})
