"""The likeliest motion near the weak form: maximum likelihood finds the same coefficients in another way."""

from __future__ import annotations

import numpy as np
import pytest
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.weak.displacements import read_displacements
from linkwise.weak.estimate import weak_search
from linkwise.weak.likely_motion import LikelyMotion, columns_of, likely_motion


def likeliest(record: lw.Record, asked: lw.Structure) -> LikelyMotion:
    equations, fit, _ = weak_search(record, asked, read_displacements(record, asked))
    known = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    likely = likely_motion(record, asked, equations, known, list(known))
    assert likely is not None
    return likely


def test_maximum_likelihood_agrees() -> None:
    """To one of its standard errors, of a nonlinear oscillator: both see nearly all that the record tells."""
    truth = oscillator("k*d + c*v + k3*d**3", k=900.0, c=1.5, k3=2e6)
    exact = lw.simulate(truth, duration=6.0, rate=1000.0, forces={"m1": "1*sin(33*t)"})
    record, asked = exact.with_noise(30.0, seed=61), truth.unknown("all")
    likely, ml = likeliest(record, asked), lw.identify(record, asked)
    assert ml.trusted
    distance = (likely.values - ml.values) / np.sqrt(ml.covariance.diagonal())
    assert np.abs(distance).max() < 1.0


@pytest.mark.parametrize("snr_db", [40.0, 50.0])
def test_coefficients_of_a_chaotic_motion_are_as_far_off_as_their_covariance_says(snr_db: float) -> None:
    chain = lw.bnes_chain(2)
    squares = []
    for seed in range(6):
        likely = likeliest(chain_record(2).with_noise(snr_db, seed=60 + seed), chain.unknown("all"))
        truth = [float(chain.coefficient(name).value or 0.0) for name in likely.system.parameters]
        columns = columns_of(likely.system.patches[0], np.arange(len(truth)))
        whitened = likely.noises[0].whitened(columns)
        normal = whitened @ whitened.T
        off = likely.values - truth
        squares.append(off @ normal @ off / len(off))
        windows = 2 * len(likely.residuals[0])
        assert abs(likely.chi_square - 1.0) < 4.0 * np.sqrt(2.0 / windows)
    assert abs(np.mean(squares) - 1.0) < 3.0 * np.sqrt(2.0 / (6 * len(truth)))


def test_gaps_are_left_out() -> None:
    clean = chain_record(2).with_noise(30.0, seed=62)
    values = clean.values.copy()
    values[1000:1010, 0] = np.nan
    gapped = lw.Record.from_arrays(clean.time, dict(zip(clean.channels, values.T, strict=True)))
    asked = lw.bnes_chain(2).unknown("all")
    likely = likeliest(gapped, asked)
    assert 0.9 < likely.chi_square < 1.1
