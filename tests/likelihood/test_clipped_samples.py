"""Samples at the end of a sensor's range are the first cause where the fitted motion goes on beyond it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw

CHAIN = lw.bnes_chain(2)


def clipped(share: float, snr_db: float, seed: int) -> lw.Record:
    """The record with the displacement of the sink clipped at a share of its peak, after noise was added."""
    record = chain_record(2).with_noise(snr_db, seed=seed)
    x = record.channel("x:m2")
    values = record.values.copy()
    values[:, record.channels.index("x:m2")] = np.clip(x, -share * np.abs(x).max(), share * np.abs(x).max())
    return replace(record, values=values, simulated=None)


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_clipped_samples_are_the_first_cause(share: float, snr_db: float) -> None:
    record = clipped(share, snr_db, seed=81)
    fit = lw.identify(record, CHAIN.unknown("all"), method="ml")
    first = fit.diagnosis[0]
    assert (first.kind, first.where) == ("clipped", "x:m2") and not fit.trusted
    assert "goes on beyond the range of x:m2" in fit.message and "mark_missing" in fit.message
    at_ends = np.abs(record.channel("x:m2")) == np.abs(record.channel("x:m2")).max()
    assert first.size == at_ends.sum()


def test_marked_as_missing_they_are_no_cause() -> None:
    fit = lw.identify(
        lw.inspection.mark_missing(clipped(0.8, 40.0, seed=81)), CHAIN.unknown("all"), method="ml"
    )
    assert fit.trusted and fit.diagnosis == ()


def test_the_largest_samples_of_a_record_with_another_fault_are_none() -> None:
    record = chain_record(2).with_noise(40.0, seed=82)
    values = record.values.copy()
    values[:, record.channels.index("x:m2")] *= 1.05
    fit = lw.identify(replace(record, values=values, simulated=None), CHAIN.unknown("all"), method="ml")
    assert fit.diagnosis and "clipped" not in {cause.kind for cause in fit.diagnosis}


def test_as_bounds_they_tell_more_than_as_missing() -> None:
    """Large motions tell the stiffening; chance is beyond 4.5 standard errors once in 30 000."""
    record = lw.inspection.mark_missing(clipped(0.5, 20.0, seed=83))
    bounds, missing = (
        lw.identify(each, CHAIN.unknown("nes"), method="ml") for each in (record, replace(record, clipped={}))
    )
    assert bounds.trusted
    narrow, wide = (fit.coefficient("nes1.beta").standard_error for fit in (bounds, missing))
    assert narrow is not None and wide is not None and narrow < wide
    assert abs(bounds.coefficient("nes1.beta").value - 1e6) < 4.5 * narrow


def test_a_channel_that_was_changed_has_no_bounds() -> None:
    record = lw.inspection.mark_missing(clipped(0.8, 40.0, seed=81))
    own = record.clipped["x:m2"]
    assert own.of(record.channel("x:m2")) is own
    doubled = replace(record, values=2.0 * record.values)
    assert doubled.clipped["x:m2"].of(doubled.channel("x:m2")) is None
    part = record.between(0.1, 2.0)
    assert part.clipped["x:m2"].of(part.channel("x:m2")) is not None
    assert np.nansum(part.clipped["x:m2"].sides ** 2) < np.nansum(own.sides**2)


def test_a_robust_loss_takes_them_as_missing_and_says_so() -> None:
    record = lw.inspection.mark_missing(clipped(0.8, 30.0, seed=84).between(0.0, 2.0))
    robust, missing = (
        lw.identify(each, CHAIN.unknown("nes"), loss=lw.likelihood.Student())
        for each in (record, replace(record, clipped={}))
    )
    np.testing.assert_array_equal(robust.values, missing.values)
    assert any("taken as missing, not as bounds" in remark for remark in robust.remarks)
    assert not any("as bounds" in remark for remark in missing.remarks)


def test_a_late_channel_keeps_them_as_it_is_shifted() -> None:
    record = lw.inspection.mark_missing(clipped(0.6, 30.0, seed=85).between(0.0, 2.0))
    late = {"x:m1": 4}
    values = record.values.copy()
    values[4:, 0] = values[:-4, 0]
    fit = lw.identify(replace(record, values=values), CHAIN.unknown("nes"), delays=tuple(late))
    assert fit.trusted
    assert not any("as bounds" in remark for remark in fit.remarks)
