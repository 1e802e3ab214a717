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
