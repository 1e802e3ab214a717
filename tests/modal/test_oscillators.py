"""Motions of single modes against simulations and their own equation."""

from __future__ import annotations

import numpy as np
from structures import host, structure

import linkwise as lw
from linkwise.modal.oscillators import SampledForce, free_motion


def test_motion_of_a_mode_is_that_of_a_simulation() -> None:
    record = lw.simulate(
        structure({}, hosts=[host("one", [21.0], 0.02, {"p": [1.5]})]),
        forces={"one.p": "8*exp(-((t - 0.05)/0.002)**2)"},
        duration=0.5,
        rate=2000.0,
        sensors=["x:one.p", "v:one.p", "a:one.p"],
    )
    motion = SampledForce(record.channel("force:one.p"), record.step).motion(21.0, 0.02)
    for kind, row in zip("xva", motion, strict=True):
        shown = record.channel(f"{kind}:one.p")
        assert np.abs(1.5**2 * row - shown).max() < 1e-5 * np.abs(shown).max()  # a spline of the fifth order


def test_free_motions_satisfy_the_equation_of_the_mode() -> None:
    x, v, a = free_motion(5.0, 0.1, 0.001, 400).transpose(1, 0, 2)
    w = 2.0 * np.pi * 5.0
    residual = a + 0.2 * w * v + w**2 * x
    assert np.abs(residual).max() < 1e-12 * np.abs(a).max()
