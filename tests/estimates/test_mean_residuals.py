"""Means of residuals along a motion are near zero of noise alone, and leave its band where a force is missing."""

import numpy as np

from linkwise.estimates.curves import MeanResiduals


def test_noise_leaves_the_band_in_one_part_of_twenty() -> None:
    """Of 2400 parts 109 to 2 standard errors, within four standard deviations of that count."""
    rng = np.random.default_rng(81)
    outside = 0
    for _ in range(100):
        means = MeanResiduals.along(rng.normal(size=2000), rng.normal(size=2000))
        outside += int(np.sum(np.abs(means.mean) > means.by_chance))
    assert 68 < outside < 151


def test_a_trend_is_shown_where_it_is_missing_samples_are_left_out_and_few_are_one_part() -> None:
    motion = np.linspace(-2.0, 2.0, 4001)
    means = MeanResiduals.along(motion, 3.0 * motion)
    np.testing.assert_allclose(means.mean, 3.0 * means.place, rtol=0, atol=1e-12)
    assert len(means.place) == 24 and means.by_chance[0] == 2.0 / np.sqrt(167)
    motion = np.arange(30.0)
    residuals = np.where(motion < 10.0, np.nan, 1.0)
    means = MeanResiduals.along(motion, residuals)
    assert (means.place.tolist(), means.mean.tolist()) == ([19.5], [1.0])
    assert np.isnan(MeanResiduals.along(motion, np.full(30, np.nan)).mean).all()
