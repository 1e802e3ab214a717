"""Spectra and coherence bridge missing samples and have known values of noise."""

import numpy as np
import pytest

from linkwise.inspection.channel_signal import Coherence, Spectrogram


def test_missing_samples_are_bridged_by_straight_lines() -> None:
    values = np.sin(0.02 * np.arange(4096))
    gapped = values.copy()
    gapped[1000:1003] = np.nan
    whole, bridged = Spectrogram.of(values, 100.0).mean, Spectrogram.of(gapped, 100.0).mean
    np.testing.assert_allclose(bridged[:4], whole[:4], rtol=1e-4)
    assert not Spectrogram.of(np.full(4096, np.nan), 100.0).power.any()


def test_white_noise_has_its_variance_over_the_band() -> None:
    density = Spectrogram.of(np.random.default_rng(82).normal(0.0, 3.0, 50_000), 200.0)
    assert density.mean[1:-1].mean() * 100.0 == pytest.approx(9.0, rel=0.03)
    assert density.frequency[-1] == 100.0


def test_coherence_is_the_part_that_follows_linearly() -> None:
    rng = np.random.default_rng(83)
    first = rng.normal(size=20_000)
    related = Coherence.of(first, first + rng.normal(size=20_000), 100.0)
    assert np.mean(related.values) == pytest.approx(0.5, abs=0.03)
    independent = Coherence.of(first, rng.normal(size=20_000), 100.0)
    assert np.mean(independent.values > independent.by_chance) == pytest.approx(0.05, abs=0.04)
    assert Coherence.of(first[:20], first[:20], 100.0).by_chance <= 1.0
