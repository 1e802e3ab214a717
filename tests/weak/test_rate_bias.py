"""Laws that act by a smoothed rate: standard errors of their coefficients against many records."""

from __future__ import annotations

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw


@pytest.mark.parametrize("law", ["tanh(v/0.02)", "v*abs(v)"])
def test_damping_by_the_rate_is_unbiased_where_the_motion_decays_into_noise(law: str) -> None:
    """z over 24 records: mean 0 within 4/sqrt(24), and none trusted that is 4.5 standard errors off.

    The damper and the friction were 2.7 standard errors off in the root mean square, all to the same side.
    """
    true = oscillator(f"k*d + c*v + F*{law}", k=1000.0, c=1.0, F=0.5)
    record = lw.simulate(true, release={"v:m1": 1.5}, duration=6.0, rate=1000.0)
    z = []
    for seed in range(24):
        fit = lw.identify(record.with_noise(20.0, seed=seed), true.unknown("all"), method="weak")
        assert fit.trusted, fit.message
        z.append((fit.values - [1000.0, 1.0, 0.5]) / np.sqrt(fit.covariance.diagonal()))
    assert np.abs(np.mean(z, axis=0)).max() < 4 / np.sqrt(24)
    assert np.abs(z).max() < 4.5
