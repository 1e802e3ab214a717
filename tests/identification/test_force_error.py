"""The error of an identified force, by Eq. (8) of the paper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from present import present
from structures import link, oscillator

import linkwise as lw


@pytest.fixture(scope="module")
def duffing() -> lw.Structure:
    return oscillator("k*d + k3*d**3 + c*v", k=900.0, k3=2e6, c=2.0)


@pytest.fixture(scope="module")
def forced(duffing: lw.Structure) -> lw.Record:
    """A force of three tones."""
    force = "3*sin(25*t) + 2*sin(61*t) + 2*cos(90*t)"
    return lw.simulate(duffing, forces={"m1": force}, duration=4.0, rate=500.0)


def test_nmse_in_closed_form() -> None:
    """Forces k d and (1 + e) k d over d: mean(e^2 d^2)/var(d)."""
    true, off = oscillator("k*d", k=10.0).links[0], oscillator("k*d", k=10.5).links[0]
    d = 0.3 + np.sin(np.linspace(0.0, 20.0, 500))
    record = lw.Record(0.0, 100.0, ("x:m1",), d[:, None])
    assert lw.nmse(true, off, record) == pytest.approx(100 * 0.05**2 * np.mean(d**2) / np.var(d), rel=1e-12)
    assert lw.nmse(true, true, record) == 0.0


def test_nmse_takes_true_elongations_and_forces_at_rest(duffing: lw.Structure, forced: lw.Record) -> None:
    """Noise in the record and another damper change nothing."""
    off = oscillator("k*d + k3*d**3 + c*v", k=950.0, k3=2e6, c=99.0).links[0]
    noisy = forced.with_noise(0.0, seed=1)
    d = present(forced.simulated).displacement[:, 0]
    expected = 100.0 * np.mean((50.0 * d) ** 2) / np.var(900.0 * d + 2e6 * d**3)  # in %
    assert lw.nmse(duffing.links[0], off, forced) == pytest.approx(expected, rel=1e-12)
    assert lw.nmse(duffing.links[0], off, noisy) == lw.nmse(duffing.links[0], off, forced)
    measured = replace(noisy, simulated=None)
    assert lw.nmse(duffing.links[0], off, measured) != lw.nmse(duffing.links[0], off, forced)


def test_nmse_leaves_missing_samples_out(duffing: lw.Structure, forced: lw.Record) -> None:
    off = oscillator("k*d + k3*d**3 + c*v", k=950.0, k3=2e6, c=2.0).links[0]
    values = forced.values.copy()
    values[::2, 0] = np.nan
    half = replace(forced, values=values, simulated=None)
    # half of the samples, every other one: the mean of squares over 50 periods and more; measured 2e-5
    assert lw.nmse(duffing.links[0], off, half) == pytest.approx(
        lw.nmse(duffing.links[0], off, forced), rel=0.1
    )


def test_nmse_of_a_force_that_does_not_vary(forced: lw.Record) -> None:
    constant = oscillator("f0", name="spring", f0=3.0).links[0]
    with pytest.raises(lw.RecordError, match='true force of link "spring" does not vary'):
        lw.nmse(constant, constant, forced)
    elsewhere = link("spring", "m7-ground", "k*d", k=1.0)
    with pytest.raises(lw.RecordError, match=r"x:m7.*is not in the record"):
        lw.nmse(elsewhere, elsewhere, replace(forced, simulated=None))
