"""What a fit leaves is drawn as it is, and asked for by names that are there."""

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.plot.estimates import residuals_figure

CHAIN = lw.bnes_chain(2)


@pytest.fixture(scope="module")
def with_a_gap() -> lw.Estimate:
    """A fit of two records, of which the first lacks samples of a sink."""
    first, second = (chain_record(2, duration=1.0).with_noise(30.0, seed=seed) for seed in (51, 52))
    values = first.values.copy()
    values[200:230, 1] = np.nan
    gapped = lw.Record.from_arrays(first.time, dict(zip(first.channels, values.T, strict=True)))
    return lw.identify([gapped, second], CHAIN.unknown("all"))


def test_residuals_are_those_of_all_samples_in_standard_deviations(with_a_gap: lw.Estimate) -> None:
    """Of white noise of unit power, whose mean square errs by three hundredths."""
    left = with_a_gap.motion.residuals
    assert left is not None and list(left) == ["x:m1", "x:m2"]
    assert np.flatnonzero(np.isnan(left["x:m2"])).tolist() == list(range(200, 230))
    assert not np.isnan(left["x:m1"]).any() and len(left["x:m1"]) == len(with_a_gap.motion.time)
    np.testing.assert_allclose([np.nanmean(values**2) for values in left.values()], 1.0, atol=0.15)


@pytest.mark.slow
def test_a_missing_term_shows_over_the_motion() -> None:
    """Means over the elongation leave the band of noise where the law lacks a constant force, and not where it has it."""
    record = chain_record(2, duration=2.0).with_noise(30.0, seed=53)
    shifted = {"x:m1": record.channel("x:m1"), "x:m2": record.channel("x:m2") + 2e-4}
    fits = [
        lw.identify(each, CHAIN.unknown("all"), as_stated=True)
        for each in (record, lw.Record.from_arrays(record.time, shifted))
    ]
    outside = []
    for fit in fits:
        axes = lw.plot.residuals(fit, "x:m2", "d of nes1")
        [mean] = axes.get_lines()
        band = axes.collections[0].get_paths()[0].get_extents().y1
        outside.append(int(np.sum(np.abs(np.asarray(mean.get_ydata())) > band)))
    assert outside[0] <= 4 < outside[1]  # of 24: one in twenty by chance


def test_what_is_not_there_is_refused(with_a_gap: lw.Estimate) -> None:
    with pytest.raises(lw.RecordError, match=r"no residuals of 'x:m3'.*choose from x:m1, x:m2"):
        lw.plot.residuals(with_a_gap, "x:m3")
    with pytest.raises(lw.RecordError, match=r'unknown quantity "d of nes2".*did you mean'):
        lw.plot.residuals(with_a_gap, "x:m1", "d of nes2")
    weak = lw.identify(with_a_gap.more_records[0], CHAIN.unknown("all"), method="weak")
    with pytest.raises(lw.RecordError, match="maximum likelihood alone"):
        residuals_figure(weak)
