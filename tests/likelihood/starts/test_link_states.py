"""States of links along a motion."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.starts.link_states import forget_start
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
