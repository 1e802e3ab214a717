"""Discovery from few samples a period of the fastest motion, where sums over them are no integrals of powers of it."""

from __future__ import annotations

import numpy as np
import pytest
from duffing_ring import SIZE, VALUES, ring
from judged import masses, terms

import linkwise as lw


@pytest.mark.parametrize("decibel", [40.0, 24.0])
def test_the_ring_from_sixty_samples(decibel: float) -> None:
    """2 Hz, 29.8 s: none of these was exact with sums over the samples as measured."""
    truth = ring(*VALUES.reshape(3, SIZE))
    release = {f"x:{name}": 1.0 for name in truth.mass_names}
    clean = lw.simulate(truth, release=release, duration=29.8, rate=2.0)
    discovery = lw.discover(clean.with_noise(decibel, seed=5_003_010), masses(truth))
    assert terms(discovery.structure) == terms(truth)
    assert discovery.trusted


def test_a_chain_from_five_samples_a_period() -> None:
    """The motion seemed to be noise, and the record was refused."""
    truth = lw.bnes_chain(2)
    clean = lw.simulate(truth, release={"v:m1": 1.0}, duration=0.5, rate=137.5)
    discovery = lw.discover(clean.with_noise(24.0, seed=5_003_011), masses(truth))
    assert terms(discovery.structure) == terms(truth)
    assert discovery.trusted


def test_known_links_need_no_starts_at_few_samples() -> None:
    truth = ring(*VALUES.reshape(3, SIZE))
    release = {f"x:{name}": 1.0 for name in truth.mass_names}
    clean = lw.simulate(truth, release=release, duration=59.8, rate=2.0)
    fit = lw.identify(clean.with_noise(24.0, seed=5_003_012), truth.unknown("all"))
    errors = [
        value - float(truth.coefficient(p.name).value or 0.0)
        for p, value in zip(fit.parameters, fit.values, strict=True)
    ]
    assert fit.trusted
    assert (np.abs(errors) < 4.0 * np.sqrt(fit.covariance.diagonal())).all()
