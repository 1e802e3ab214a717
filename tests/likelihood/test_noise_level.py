"""Noise that is lowered to the residuals where it was found too large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from duffing_ring import NOISE, SIZE, VALUES, noisy, ring

import linkwise as lw

RING = ring(*VALUES.reshape(3, SIZE))


@pytest.mark.parametrize("seed", [1002, 1003, 1005])
def test_noise_that_was_found_is_that_of_the_residuals_where_these_are_less(seed: int) -> None:
    """10 samples a period, of motion with harmonics: 10 to 30 % more noise is found than there is."""
    fit = lw.identify(noisy(seed), RING.unknown("all"))
    scatter = np.sqrt(2.0 / fit.samples)  # of chi-square
    assert fit.trusted
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=2.0 * scatter)
    sigma = [estimate.sigma for estimate in fit.noise.values()]
    assert np.mean(sigma) == pytest.approx(NOISE, rel=3.0 * scatter / 2.0)


def test_noise_that_is_stated_stays() -> None:
    record = noisy(1003)
    stated = replace(record, noise=dict.fromkeys(record.channels, 2.0 * NOISE))
    fit = lw.identify(stated, RING.unknown("all"))
    assert fit.chi_square_per_sample == pytest.approx(0.25, abs=3.0 * 0.25 * np.sqrt(2.0 / fit.samples))
    assert fit.verdicts[0] is lw.Verdict.NOISE_MISMATCH
