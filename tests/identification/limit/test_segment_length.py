"""How long the segments of the bound are, unless stated: what identify reaches, and never less than shorter ones tell."""

from typing import Any

import numpy as np
import pytest
from present import present
from structures import oscillator

import linkwise as lw

pytestmark = pytest.mark.slow


SLOW = oscillator("k*d + k3*d**3 + c*v", mass=10.0, k=100.0, k3=2000.0, c=1.0)
"""Half a period a second, of which 0.25 s hold an eighth."""
RING_DOWN: dict[str, Any] = {"duration": 30.0, "rate": 50.0, "release": {"x:m1": 0.1}}
CHAOTIC: dict[str, Any] = {"duration": 6.0, "rate": 1000.0, "release": {"v:m1": 1.0}, "noise": 20.0}


def test_a_slow_structure_has_the_bound_that_identify_reaches() -> None:
    """Of segments of 0.25 s the bound of the damping was 600 times as large."""
    limit = lw.limit(SLOW, noise=30.0, **RING_DOWN)
    assert limit.segment * 50.0 == pytest.approx(len(limit.record))
    assert "in one segment with a\nfree start" in str(limit)
    record = lw.simulate(SLOW, **RING_DOWN).with_noise(30.0, seed=5840021)
    fit = lw.identify(record, SLOW.unknown("all"))
    reached = [present(fit.coefficient(parameter.name).standard_error) for parameter in limit.parameters]
    # the noise is found from 1501 samples, to 1/sqrt(3002) = 1.8 %, and the bound is taken at the truth
    np.testing.assert_allclose(reached, limit.standard_errors, rtol=3 * 0.018)


def test_chaotic_motion_has_shorter_segments_that_tell_more_than_the_shortest() -> None:
    chain = lw.bnes_chain(2)
    limit, short = (lw.limit(chain, unknown=["nes"], segment=segment, **CHAOTIC) for segment in (None, 0.25))
    assert limit.trusted and 0.25 < limit.segment < 6.0
    assert (limit.standard_errors < short.standard_errors).all()
    assert f"in segments of {limit.segment:g} s with free starts" in str(limit)
    clean = lw.simulate(chain, duration=6.0, rate=1000.0, release={"v:m1": 1.0})
    record = clean.with_noise(20.0, seed=5840022)
    fit = lw.identify(record, chain.unknown("nes"))
    reached = [present(fit.coefficient(parameter.name).standard_error) for parameter in limit.parameters]
    assert (np.array(reached) < limit.standard_errors).all()


def test_ten_chaotic_masses_keep_what_short_segments_determine() -> None:
    plan = {**CHAOTIC, "duration": 2.0, "release": {"v:m1": 3.0}}
    limit = lw.limit(lw.bnes_chain(10), unknown=["nes"], **plan)
    assert limit.trusted and np.isfinite(limit.standard_errors).all()


def test_segments_that_lose_what_shorter_ones_determine_and_too_low_a_rate_are_refused() -> None:
    """28 Hz at a sample in 20 s, of which steps as long as ten periods grew without end."""
    message = r"segments of 3 s are too long: .* what segments of 0\.25 s determine"
    with pytest.raises(lw.IdentificationError, match=message) as caught:
        lw.limit(lw.bnes_chain(2), unknown=["nes"], segment=3.0, **CHAOTIC)
    assert caught.value.arguments == ("segment",)
    with pytest.raises(lw.IdentificationError, match=r"0\.05 Hz are too few for the fastest") as caught:
        lw.limit(lw.bnes_chain(2), **{**CHAOTIC, "duration": 500.0, "rate": 0.05})
    assert caught.value.arguments == ("rate",)


def test_what_no_segment_determines_is_told_at_any_length() -> None:
    """Without a force on it, a motion is the same when mass, stiffness and damping grow together."""
    linear, unknown = oscillator("k*d + c*v", k=400.0, c=0.5), ["link", "mass:m1"]
    for segment in (None, 0.25, 30.0):
        limit = lw.limit(linear, noise=30.0, unknown=unknown, segment=segment, **RING_DOWN)
        assert limit.verdicts == (lw.Verdict.UNKNOWNS_NOT_DETERMINED,)
        assert len(limit.findings) == 1 and "are confounded" in limit.findings[0]


def test_a_low_rate_takes_segments_that_hold_enough_values() -> None:
    """Of 0.25 s at 8 Hz, which are two samples, there was no answer."""
    limit = lw.limit(SLOW, duration=30.0, rate=8.0, release={"x:m1": 0.1}, noise=30.0)
    assert limit.trusted
