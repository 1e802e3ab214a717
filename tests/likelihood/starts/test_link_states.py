"""States of links along a motion."""

from __future__ import annotations

import numpy as np
import pytest
from structures import named

from linkwise.arrays import Floats
from linkwise.likelihood.starts.link_states import _decay_alone, follow_states, forget_start
from linkwise.model.law import Law

SLIP = Law.parse("k*d + F*z", {"z": "(v - s*abs(v)*z - (1 - s)*v*abs(z))/x0"})
BRANCH = Law.parse("z", {"z": "k*v - z/tau"})


def test_a_state_that_grows_along_the_motion_does_not_forget_where_it_began() -> None:
    time = np.linspace(0.0, 10.0, 4001)
    d, v = 2e-3 * np.sin(20.0 * time), 0.04 * np.cos(20.0 * time)
    lengths = np.array([1e-3, 1e-4, -1e-3, -1e-2])[:, None]
    slip: dict[str, float | Floats] = {"k": 1.0, "F": 1.0, "s": 0.6, "x0": lengths}
    assert forget_start(SLIP, slip, d, v, 2.5e-3, 4).tolist() == [True, True, False, False]
    branch: dict[str, float | Floats] = {"k": 10.0, "tau": np.array([[0.1], [-0.1]])}
    assert forget_start(BRANCH, branch, d, v, 2.5e-3, 2).tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "alone"),
    [("piezo", True), ("coil", True), ("zener", True), ("fractional(3)", True), ("bouc-wen", False)],
)
def test_states_that_decay_alone_are_those_of_the_steps(name: str, alone: bool) -> None:
    """Beside a state that decays otherwise, and acts on none, they are followed step by step."""
    law = named("link", "a-b", name).law
    stepped = Law.parse(law.text, {**{rate.name: rate.text for rate in law.rates}, "beside": "-beside**3"})
    time = np.linspace(0.0, 3.0, 1501)
    d, v = 1e-2 * np.sin(40.0 * time), 0.4 * np.cos(40.0 * time)
    rng = np.random.default_rng(3)
    values: dict[str, float | Floats] = {name: rng.uniform(0.5, 2.0, (4, 1)) for name in law.coefficients}
    values["R"] = 5.0
    filtered = follow_states(law, values, d, v, 2e-3, 4, 0.3)
    steps = follow_states(stepped, values, d, v, 2e-3, 4, 0.3)[:-1]
    assert _decay_alone(law) is alone and not _decay_alone(stepped)
    # identity, but for rounding in a thousand steps
    np.testing.assert_allclose(filtered, steps, atol=1e-12 * float(np.abs(steps).max()))


@pytest.mark.parametrize(("name", "count"), [("jenkins", 1), ("iwan(3)", 4)])
def test_sliders_follow_the_elongation_within_their_bounds(name: str, count: int) -> None:
    """Without the error of steps over their corners: one state, `beside`, makes the law step as others do."""
    law = named("link", "a-b", name).law
    beside = {rate.name: rate.text for rate in law.rates} | {"beside": "-beside**3"}
    stepped = Law.parse(law.text, beside)
    values: dict[str, float | Floats] = {"k": 2e3, "Fs": np.array([[5.0], [9.0]]), "KT": 2e3, "FS": 9.0}
    values |= {"chi": -0.4, "beta": np.array([[0.5], [2.0]])}
    errors = []
    for samples in (1501, 6001):
        time = np.linspace(0.0, 3.0, samples)
        d, v = 1e-2 * np.sin(40.0 * time), 0.4 * np.cos(40.0 * time)
        slid = follow_states(law, values, d, v, time[1], 2)
        steps = follow_states(stepped, values, d, v, time[1], 2)[:-1]
        assert slid.shape == (count, 2, samples)
        errors.append(float(np.sqrt(np.mean((slid - steps) ** 2)) / np.abs(slid).max()))
    assert errors[0] < 0.1 and errors[1] < 0.5 * errors[0]  # those of the steps, of order 1: a quarter


def test_a_slider_has_a_slope_by_the_force_at_which_it_slides() -> None:
    law = named("link", "a-b", "jenkins").law
    time = np.linspace(0.0, 3.0, 1501)
    d, v = 1e-2 * np.sin(40.0 * time), 0.4 * np.cos(40.0 * time)
    lower, upper = (
        follow_states(law, {"k": 2e3, "Fs": largest}, d, v, time[1])[0, 0] for largest in (5.0, 5.001)
    )
    assert np.abs(upper - lower).max() == pytest.approx(0.001, rel=1e-6)
    assert np.mean((upper - lower) ** 2) > 0.2e-6


def test_a_link_that_yields_between_two_samples_is_followed() -> None:
    """By steps finer than the samples: that of the samples is unstable where the link moves far beyond its length at yield."""
    law = named("link", "a-b", "bouc-wen").law
    lengths = np.array([[2e-5], [5e-5]])
    values: dict[str, float | Floats] = {"k": 0.0, "c": 0.0, "F": 1.0, "s": 0.05, "x0": lengths}
    motions = []
    for samples in (1501, 24001):  # 6 a period, and enough for steps of their own
        time = np.linspace(0.0, 3.0, samples)
        d, v = 2.5e-4 * np.sin(500.0 * time), 0.125 * np.cos(500.0 * time)
        motions.append(follow_states(law, values, d, v, time[1], 2)[0, :, :: (samples - 1) // 1500])
    for coarse, fine in zip(*motions, strict=True):
        assert np.abs(coarse).max() <= 1.0
        # cubics at 6 samples a period are off by (2 pi / 6)^4 / 384 of the motion, the elongation at yield is a twelfth of it
        assert np.sqrt(np.mean((coarse - fine) ** 2)) < 12 * (2.0 * np.pi / 6.0) ** 4 / 384.0


def test_a_state_that_decays_is_followed_where_its_rate_is_infinite_at_rest() -> None:
    """Its decay follows from the law, not from rates at d = 0."""
    law = Law.parse("q", {"q": "k*v - q/tau + b/(g + abs(d))"})
    time = np.arange(400) / 100.0
    d, v = 1.0 + 0.3 * np.sin(9.0 * time), 2.7 * np.cos(9.0 * time)
    values = {"k": 2.0, "tau": 0.1, "b": 0.1, "g": 0.0}
    states = follow_states(law, values, d, v, 0.01)
    assert np.isfinite(states).all()
    nearly = follow_states(law, values | {"g": 1e-12}, d, v, 0.01)
    np.testing.assert_allclose(states, nearly, rtol=1e-9, atol=1e-12)
