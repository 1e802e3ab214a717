"""Modes that noise hides: frequency and damping keep what is known of them beforehand."""

from __future__ import annotations

import pytest
from structures import host, link, structure

import linkwise as lw

SHAPES = {"tip": [0.6, 0.5], "mid": [0.4, -0.5]}
LAW = "k3*d**3 + c*v"
FREQUENCIES, DAMPING = [5.0, 12.0], 0.01
FREQUENCY_SIGMA, DAMPING_SIGMA = 0.24, 0.003
SEED = 5204203


def answer(highest: float) -> lw.Estimate:
    """From a sweep of the first mode, or up to the second, to a link on a host of which little is known."""
    wing = structure(
        {},
        link("joint", "wing.tip-ground", LAW, k3=2e4, c=0.05),
        hosts=[host("wing", FREQUENCIES, DAMPING, SHAPES)],
    )
    record = lw.simulate(
        wing,
        forces={"wing.mid": f"5*sin(2*pi*(2*t + {(highest - 2.0) / 16.0}*t**2))"},
        duration=8.0,
        rate=200.0,
        sensors=["a:wing.tip"],
    ).with_noise(20.0, seed=SEED)
    frequencies = [
        lw.Coefficient.unknown(frequency + 0.1, sigma=FREQUENCY_SIGMA) for frequency in FREQUENCIES
    ]
    damping = [lw.Coefficient.unknown(0.7 * DAMPING, sigma=DAMPING_SIGMA)] * 2
    unknown = structure(
        {}, link("joint", "wing.tip-ground", LAW), hosts=[host("wing", frequencies, damping, SHAPES)]
    )
    return lw.identify(record, unknown)


def test_a_hidden_mode_keeps_what_is_known_of_it() -> None:
    hidden = answer(10.0)
    assert hidden.trusted
    errors = [hidden.coefficient(f"wing.mode2.{name}").standard_error for name in ("frequency", "damping")]
    assert errors == pytest.approx([FREQUENCY_SIGMA, DAMPING_SIGMA], rel=1e-12)
    [remark] = [text for text in hidden.remarks if "noise hides" in text]
    assert remark.startswith("wing.mode2.frequency and wing.mode2.damping are hardly determined")


def test_a_mode_that_is_swept_is_told_from_noise() -> None:
    swept = answer(14.0)
    assert swept.trusted
    assert not [text for text in swept.remarks if "noise hides" in text]
    error = swept.coefficient("wing.mode2.frequency").standard_error
    assert error is not None and error < 0.1 * FREQUENCY_SIGMA
