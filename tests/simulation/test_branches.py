"""The branches of laws with kinks, where a piece of an input begins."""

import numpy as np
import pytest
from structures import oscillator

import linkwise as lw

FRICTION = oscillator(
    "k*d + g*max(d - e, 0) + g*min(d + e, 0) + f*tanh(v/s) + c*v*abs(v)",
    mass=1.0,
    k=400.0, g=4000.0, e=0.02, f=0.3, s=0.01, c=0.5,
)  # fmt: skip


@pytest.mark.slow
def test_an_input_in_pieces_leaves_the_motion_as_it_is() -> None:
    """A force of 0 in 2000 pieces: what is chosen at the start of each of them is what was there before."""
    nothing = lw.model.Sampled(0.0, 1000.0, np.zeros(2001))
    motion, in_pieces = (
        lw.simulate(FRICTION, release={"v:m1": 1.0}, forces=forces, duration=2.0, rate=1000.0).channel("x:m1")
        for forces in ({}, {"m1": nothing})
    )
    assert np.count_nonzero(np.diff(np.sign(motion - 0.02))) > 4
    np.testing.assert_allclose(in_pieces, motion, rtol=0.0, atol=1e-12)  # the integrator is right to rounding


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_piece_may_begin_on_a_kink(side: float) -> None:
    """At rest on the edge of a gap, |v| zero as well, and pushed over it by what a later piece of the force brings."""
    force = np.full(2001, 8.0)  # holds the spring at the edge
    force[1001:] += np.linspace(0.0, 2.0, 1000)
    forces = {"m1": lw.model.Sampled(0.0, 1000.0, side * force)}
    record = lw.simulate(FRICTION, release={"x:m1": 0.02 * side}, forces=forces, duration=2.0, rate=1000.0)
    pushed = side * record.channel("x:m1")
    np.testing.assert_allclose(pushed[:900], 0.02, atol=1e-9)
    stop = (10.0 + 80.0) / (400.0 + 4000.0)  # where both springs bear the force; 0.025 without the second
    assert abs(pushed[-1] - stop) < 1e-4  # it still moves a little
