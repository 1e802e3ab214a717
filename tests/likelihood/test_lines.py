"""What counts as a line of the motion, and as a clock that is off: the constants of both at their edges."""

import numpy as np
import pytest
from scipy import signal

import linkwise as lw
from linkwise.likelihood import harmonics
from linkwise.likelihood.tests.diagnosis import _is_small
from linkwise.likelihood.tests.score_test import Hypothesis

RATE, DURATION, MACHINE = 200.0, 20.0, 14.3
TIME = np.arange(round(RATE * DURATION)) / RATE


def behind_resonance(line: float) -> lw.Record:
    """The answer of an oscillator at 9 Hz with 0.5 % of damping to noise, beside a line of an amplitude relative to it."""
    rng, w, before = np.random.default_rng(1200500), 2.0 * np.pi * 9.0, 4000
    poles = np.exp((-0.005 + 1j * np.sqrt(1.0 - 0.005**2)) * w / RATE)
    noise = rng.normal(size=len(TIME) + before)
    motion = signal.lfilter([1.0], np.poly([poles, np.conj(poles)]).real, noise)[before:]
    shown = motion / motion.std() + line * np.sqrt(2.0) * np.sin(2.0 * np.pi * MACHINE * TIME)
    return lw.Record(0.0, RATE, ("x:m1",), (shown + 0.01 * rng.normal(size=len(TIME)))[:, None])


@pytest.mark.parametrize(
    ("above", "alone", "beside"),
    [(0.5, [9.0], [9.0, MACHINE]), (1.0, [], [MACHINE]), (2.0, [], [MACHINE]), (4.0, [], [])],
)
def test_a_line_stands_above_what_noise_makes_of_a_resonance(
    above: float, alone: list[float], beside: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At half the limit noise behind a resonance would be a force, at four times it a machine of 1 % of the power none.

    Tolerance: discretisation, one line's width.
    """
    monkeypatch.setattr(harmonics, "_ABOVE", above * harmonics._ABOVE)
    for line, expected in ((0.0, alone), (0.1, beside)):
        found = sorted(one.frequency for one in harmonics._lines_of_motion([behind_resonance(line)]))
        assert found == pytest.approx(expected, abs=1.0 / DURATION)


@pytest.mark.parametrize(("left", "goes_on"), [(0.56, True), (0.45, False)])
def test_a_line_that_keeps_half_of_its_power_over_a_quarter_of_a_record_goes_on(
    left: float, goes_on: bool
) -> None:
    """A decay that keeps less is none that a force keeps up."""
    rate = -2.0 * np.log(left) / DURATION  # of the amplitude
    rng = np.random.default_rng(1200501)
    shown = np.exp(-rate * TIME) * np.sin(2.0 * np.pi * MACHINE * TIME) + 0.01 * rng.normal(size=len(TIME))
    found = harmonics._lines_of_motion([lw.Record(0.0, RATE, ("x:m1",), shown[:, None])])
    assert [round(one.frequency, 1) for one in found] == [MACHINE] * goes_on


@pytest.mark.parametrize(
    ("ppm", "is_small"), [(1.9e5, True), (-1.9e5, True), (2.1e5, False), (-2.7e5, False)]
)
def test_a_clock_is_off_by_no_more_than_the_first_order_describes(ppm: float, is_small: bool) -> None:
    """Of a free decay rounding alone tells one from the coefficients: one 27 % slow was named."""
    assert _is_small(Hypothesis("clock", "x:m1"), ppm, 0.01) is is_small
