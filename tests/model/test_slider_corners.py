"""Rates of sliders for estimators: as written but next to the corner, and with a derivative by the largest force."""

from collections.abc import Mapping

import numpy as np
from present import some

import linkwise as lw
from linkwise.expression import Program, differentiate
from linkwise.model.slider_corners import smooth_rates

VALUES = {"k": 200.0, "Fs": 12.0}
LAW = lw.Law.parse(lw.model.named_law("jenkins").law, lw.model.named_law("jenkins").states)
NAMES = (*LAW.variables, *LAW.coefficients)
FORCES = np.array([-11.6, -11.0, 0.0, 5.0, 11.6])  # N
NUMBERS = tuple(VALUES[name] for name in LAW.coefficients)


def test_a_slider_sticks_as_its_law_says_and_slides_at_its_largest_force() -> None:
    """A force beyond the largest is pulled back to it, and the rate at the corner tells the largest."""
    program = Program(list(smooth_rates(LAW)), NAMES, wide=LAW.variables)
    for v in some((-0.3, 0.3)):
        (rate,) = program(0.0, v, FORCES, *NUMBERS)
        exact = LAW.state_rates(0.0, v, {**VALUES, "q": FORCES})[0]
        np.testing.assert_allclose(rate, exact, rtol=1e-12)
        (rate,) = program(0.0, v, np.array([-12.0, 12.0]), *NUMBERS)
        np.testing.assert_allclose(rate, [200.0 * max(v, 0.0), 200.0 * min(v, 0.0)], atol=1e-12)
    (rate,) = program(0.0, 0.3, np.array([12.1]), *NUMBERS)
    assert rate[0] < 0.0 == LAW.state_rates(0.0, 0.3, {**VALUES, "q": 12.1})[0]
    for trees, tells in ((smooth_rates(LAW), True), (tuple(rate.expression for rate in LAW.rates), False)):
        slope = Program([differentiate(trees[0], "Fs")], NAMES, wide=LAW.variables)
        (by_largest,) = slope(0.0, 0.3, np.array([11.9]), *NUMBERS)
        assert (by_largest[0] > 0.0) == tells


def test_every_slider_of_iwan_is_rounded_and_other_rates_are_as_written() -> None:
    iwan = lw.model.named_law("iwan(3)")
    law = lw.Law.parse(iwan.law, iwan.states)
    written = tuple(rate.expression for rate in law.rates)
    assert all(rounded != tree for rounded, tree in zip(smooth_rates(law), written, strict=True))
    as_written: list[Mapping[str, lw.model.LinkState | str]] = [
        lw.model.named_law("bouc-wen").states,
        lw.model.named_law("backlash-slip").states,
        {"z": "v*(1 - 0.25*(1 + sign(abs(z) - abs(d)))*(1 + sign(z*v)))"},  # its limit moves
        {"z": "v*(1 - 0.5*(1 + sign(abs(z) - x0)))"},
    ]
    for states in some(as_written):
        other = lw.Law.parse("F*z", states)
        assert smooth_rates(other) == tuple(rate.expression for rate in other.rates)
